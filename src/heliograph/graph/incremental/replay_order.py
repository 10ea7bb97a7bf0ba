"""The order in which a replay lets poses, points and factors arrive, and what each new variable starts from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Indices
from heliograph.errors import GraphError
from heliograph.graph.model.factor_graph import Added, FactorGraph
from heliograph.graph.model.noise import FULL
from heliograph.graph.model.records import key_list
from heliograph.graph.model.values import Values
from heliograph.lie import SE2, SE3

__all__ = ["ReplayOrder", "StartingPoint"]


_KINDS = ("Between", "Prior", "Landmark", "Position")


class StartingPoint(NamedTuple):
    """Where a new variable starts: seen from another one, or, without one, in the world.

    Parameters
    ----------
    key : int
        The variable's.
    origin : int or None
        The pose it is seen from.
    relative : SE2, SE3 or (d,) float64
        T_origin_key of a pose, p_origin of a point; T_world_key or p_world without an origin.
    """

    key: int
    origin: int | None
    relative: Any


class ReplayOrder:
    """When everything of a graph arrives; one step a pose in the order of keys, parameters as in `replay_steps`."""

    def __init__(self, graph: FactorGraph, values: Values) -> None:
        self._graph, self._values = graph, values
        flat = [group for group in (SE2, SE3) if len(values.block(group)[0])]
        if len(flat) != 1:
            raise GraphError("a replay needs poses of the plane or of space, SE2 or SE3, and not of both")
        self._group = flat[0]
        self._poses = np.sort(values.block(self._group)[0])
        self._points = np.sort(values.block(self._group.space)[0])
        if len(self._poses) + len(self._points) != len(values):
            raise GraphError("a replay takes poses and points only; solve this graph with `solve` or feed ISAM2 itself")
        for added in graph.groups():
            if added.record.kind not in _KINDS or (added.record.kind == "Between" and _group_of(added) != flat[0]):
                raise GraphError(
                    f"{added.name(0)}: a replay has no start for {added.record.kind}; it takes relative poses, priors, "
                    "positions and sightings of points: solve this graph with another method"
                )
        self.count = len(self._poses)
        self._step: dict[int, int] = {}
        self._from: list[list[StartingPoint]] = [[] for _ in range(self.count)]
        self._edges = self._joined()
        self._arrive()
        self._see()

    def _of(self, *kinds: str) -> list[Added]:
        return [added for added in self._graph.groups() if added.record.kind in kinds and len(added.record)]

    def _joined(self) -> dict[int, list[tuple[int, Added, int]]]:
        """Return for each pose whom it has relative poses to, in the order of addition."""
        edges: dict[int, list[tuple[int, Added, int]]] = {key: [] for key in self._poses.tolist()}
        for added in self._of("Between"):
            for row, (i, j) in enumerate(added.record.keys.tolist()):
                if i not in edges or j not in edges:
                    raise GraphError(f"{added.name(row)}: no value for one of them")
                edges[i].append((j, added, row))
                edges[j].append((i, added, row))
        return edges

    def _arrive(self) -> None:
        """Let poses arrive: each in its turn if something places it, else with the one that does."""
        anchors = set(self._graph.fixed.tolist())
        for added in self._of("Prior", "Position"):
            anchors.update(added.record.keys[:, 0].tolist())
        for added in self._of("Landmark"):  # who sees a held point is tied to the world by it
            keys = added.record.keys
            anchors.update(keys[np.isin(keys[:, 1], self._graph.fixed), 0].tolist())
        waiting: set[int] = set()
        before = None
        for step, key in enumerate(self._poses.tolist()):
            waiting.add(key)
            source = self._placed(key, before)
            if source is None and key in anchors:
                source = StartingPoint(key, None, self._values.at(key))
            queue = [] if source is None else [source]
            while queue:
                source = queue.pop()
                if source.key not in waiting:
                    continue
                waiting.discard(source.key)
                self._step[source.key] = step
                self._from[step].append(source)
                there = [other for other, _, _ in self._edges[source.key] if other in waiting]
                queue += [found for other in reversed(there) if (found := self._placed(other, None)) is not None]
            before = key
        if waiting:
            raise GraphError(
                f"{key_list(sorted(waiting))}: no chain of relative poses from one that is held or has a prior, so a "
                "replay has no start for them; hold one of them with `fix`, or solve this graph with another method"
            )

    def _placed(self, key: int, before: int | None) -> StartingPoint | None:
        """Return from where a pose is placed: from the one before it, else by its first relative pose."""
        first = None
        for other, added, row in self._edges[key]:
            if other in self._step and (first is None or other == before):
                first = other, added, row
                if other == before or before is None:
                    break
        if first is None:
            return None
        other, added, row = first
        T_i_j = self._group(_measured(added, row))
        forward = int(added.record.keys[row, 0]) == other
        return StartingPoint(key, other, T_i_j if forward else T_i_j.inverse())

    def _see(self) -> None:
        """Let points arrive with the first sighting that determines them; with the last, where none does alone."""
        points, held = set(self._points.tolist()), set(self._graph.fixed.tolist())
        best: dict[int, tuple[bool, int, StartingPoint]] = {}
        for added in self._of("Landmark"):
            full = _determined(added)
            for row, (pose, point) in enumerate(added.record.keys.tolist()):
                if point not in points or pose not in self._step:
                    raise GraphError(f"{added.name(row)}: a replay takes sightings of points from poses")
                partial, step = not full[row], self._step[pose]
                if point in held:
                    now = (False, step, StartingPoint(point, None, self._values.at(point)))
                else:
                    now = (
                        partial,
                        -step if partial else step,
                        StartingPoint(point, pose, added.record.measurement[row]),
                    )
                if point not in best or now[:2] < best[point][:2]:
                    best[point] = now
        for point in self._points.tolist():
            _, step, source = best.get(point, (False, 0, StartingPoint(point, None, self._values.at(point))))
            self._step[point] = abs(step)
            self._from[abs(step)].append(source)

    def sources(self) -> Iterator[tuple[StartingPoint, ...]]:
        """Yield the starts of each step's variables, in the order in which they can be computed."""
        return (tuple(sources) for sources in self._from)

    def steps_of(self, keys: Indices) -> Indices:
        """Return the steps (N,) in which variables arrive."""
        return np.array([self._step.get(key, -1) for key in keys.tolist()], dtype=np.int64)

    def step_of_factors(self) -> Indices:
        """Return the step (N,) of every factor: that of its last variable."""
        steps = [self.steps_of(a.record.keys.reshape(-1)).reshape(a.record.keys.shape) for a in self._graph.groups()]
        return np.concatenate([s.max(axis=1) for s in steps]) if steps else np.zeros(0, dtype=np.int64)


def _group_of(added: Added) -> type | None:
    return None if added.record.measured is None else added.record.measured.lie


def _measured(added: Added, row: int) -> NDArray[np.float64]:
    """Return the relative pose of a row as a matrix (k, k)."""
    assert added.record.measured is not None
    return np.asarray(added.record.measured.elements(added.record.measurement[row : row + 1])[0])


def _determined(added: Added) -> NDArray[np.bool_]:
    """Return which sightings (N,) determine a point by themselves: those whose information is not singular."""
    noise, count = added.whitening, len(added.record)
    diagonal = noise.sqrt_information
    if noise.form == FULL:
        diagonal = np.einsum("nii->ni", diagonal.reshape(-1, added.record.rows, added.record.rows))
    size = np.abs(diagonal)
    return np.broadcast_to(size.min(axis=1) > 1e-9 * size.max(axis=1), (count,))

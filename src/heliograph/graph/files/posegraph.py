"""A pose graph as its file states it: poses, relative poses, landmarks, priors, and what is fixed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from heliograph.arrays import Array, Indices, freeze
from heliograph.graph.files.odometry_start import distinct, odometry_start
from heliograph.graph.files.row_kinds import KINDS, Role, numbers_of
from heliograph.graph.files.tables import Table
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.factors import Between, Landmark, Position, Prior
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Information
from heliograph.graph.model.values import Values
from heliograph.lie import SE2, SE3

__all__ = ["PoseGraphFile"]


_FACTORS: tuple[Role, ...] = ("between", "landmark", "pose_prior", "position_prior")


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: what follows from the rows is kept once computed
class PoseGraphFile:
    """What a g2o or TORO file says, to the bit and in its order.

    Parameters
    ----------
    dimension : int
        Of the space, 2 or 3.
    tables : tuple of Table
        The rows, one table a kind.
    fixed : (F,) int64
        Ids of the FIX lines.
    fixed_line : (F,) int64
        The lines they stand in.
    others : tuple of (int, str)
        Comments and parameters with their lines; written back as they were.
    """

    dimension: int
    tables: tuple[Table, ...]
    fixed: Indices
    fixed_line: Indices
    others: tuple[tuple[int, str], ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    @staticmethod
    def of(
        dimension: int,
        *,
        edges: tuple[Indices, Indices, Array, Array] | None = None,
        poses: tuple[Indices, Array] | None = None,
        fixed: Iterable[int] = (),
    ) -> PoseGraphFile:
        """Return a pose graph from arrays.

        Parameters
        ----------
        dimension : int
            2 or 3.
        edges : (i (E,), j (E,), T_i_j (E, k, k), information (E, d, d)), optional
            Relative poses as homogeneous matrices, information with the rotation first.
        poses : (ids (N,), T_world_i (N, k, k)), optional
            Known poses.
        fixed : ints
            Ids that are not to be estimated.
        """
        suffix = "SE2" if dimension == 2 else "SE3:QUAT"
        tables = []
        if poses is not None:
            kind = KINDS[f"VERTEX_{suffix}"]
            tables.append(Table.of(kind, poses[0], numbers_of(kind, poses[1])))
        if edges is not None:
            kind = KINDS[f"EDGE_{suffix}"]
            numbers = numbers_of(kind, edges[2])
            tables.append(Table.of(kind, np.column_stack(edges[:2]), numbers, edges[3]))
        ids = np.array(list(fixed), dtype=np.int64)
        return PoseGraphFile(dimension=dimension, tables=tuple(tables), fixed=ids, fixed_line=np.zeros_like(ids))

    def of_role(self, *roles: Role) -> tuple[Table, ...]:
        """Return the tables that play one of these parts, in the order of the file."""
        return tuple(table for table in self.tables if table.kind.role in roles)

    @cached_property
    def pose_ids(self) -> Indices:
        """All poses, whether a line gives their value or only a factor names them, ascending, (P,) int64."""
        parts = [table.ids[:, 0] for table in self.of_role("pose", "landmark", "pose_prior", "position_prior")]
        parts += [table.ids.ravel() for table in self.of_role("between")]
        return _union(parts)

    @cached_property
    def point_ids(self) -> Indices:
        """All landmarks, ascending, (Q,) int64."""
        return _union([t.ids[:, 0] for t in self.of_role("point")] + [t.ids[:, 1] for t in self.of_role("landmark")])

    @cached_property
    def missing_ids(self) -> Indices:
        """Poses and landmarks that no line gives a value, ascending, (M,) int64."""
        given = _union([table.ids[:, 0] for table in self.of_role("pose", "point")])
        return _without(_union([self.pose_ids, self.point_ids]), given)

    @cached_property
    def edges(self) -> tuple[Indices, Indices, SE2 | SE3]:
        """All relative poses: ids i, ids j, (E,) each, and T_i_j as one batch, in the order of the file."""
        group = SE2 if self.dimension == 2 else SE3
        tables = self.of_role("between")
        if not tables:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), group.identity((0,))
        order = np.argsort(np.concatenate([t.line for t in tables]), kind="stable")
        ids = np.concatenate([t.ids for t in tables])[order]
        return ids[:, 0], ids[:, 1], group(np.concatenate([t.matrices for t in tables])[order])

    @property
    def edge_count(self) -> int:
        """Number of factors of all kinds."""
        return sum(len(table) for table in self.of_role(*_FACTORS))

    @cached_property
    def _start(self) -> tuple[Indices, Indices, Array]:
        """All poses, the component of each (named by its lowest id), and their matrices by odometry."""
        i, j, T_i_j = self.edges
        start = odometry_start(i, j, T_i_j, self.pose_ids)
        return start.ids, self._joined(start.ids, start.root), start.matrices

    def _joined(self, ids: Indices, root: Indices) -> Indices:
        """Return component labels with those joined that see a common landmark."""
        tables = self.of_role("landmark")
        names, index = np.unique(root, return_inverse=True)
        if not tables or len(names) == 1:
            return root
        pairs = np.concatenate([table.ids for table in tables])
        pose, point = index[np.searchsorted(ids, pairs[:, 0])], np.searchsorted(self.point_ids, pairs[:, 1])
        label = names
        while True:  # the lowest name spreads from component to landmark to component
            lowest = np.full(len(self.point_ids), np.iinfo(np.int64).max)
            np.minimum.at(lowest, point, label[pose])
            updated = label.copy()
            np.minimum.at(updated, pose, lowest[point])
            if (updated == label).all():
                return np.asarray(updated[index])
            label = updated

    @cached_property
    def gauge_ids(self) -> Indices:
        """What is held: the FIX lines, and the lowest pose of each component that has neither those nor a prior."""
        ids, component, _ = self._start
        anchors = [self.fixed, *(t.ids[:, 0] for t in self.of_role("pose_prior", "position_prior"))]
        anchored = component[np.isin(ids, np.concatenate(anchors))]
        return _union([self.fixed, _without(distinct(component), distinct(anchored))])

    def odometry_values(self) -> Values:
        """Return a start from the relative poses, see `odometry_start`; landmarks by the first pose that sees them.

        A component that holds FIX lines with a value, or priors, is moved so that the lowest such pose is where that
        says; fixed poses keep their values.
        """
        ids, component, T = self._start
        T = self._placed(ids, component, T)
        group = SE2 if self.dimension == 2 else SE3
        values = Values()
        values.insert(ids, group(T))
        if len(self.point_ids):
            values.insert(self.point_ids, self._points_from(ids, T))
        return values

    def _placed(self, ids: Indices, component: Indices, T: Array) -> Array:
        """Return the poses with each component moved to where its fixed poses or priors say."""
        known_ids = [t.ids[:, 0] for t in self.of_role("pose")]
        known = [t.matrices for t in self.of_role("pose")]
        given = _union(known_ids)
        fixed = np.intersect1d(self.fixed, given)
        said: dict[int, Array] = {}
        for table in self.of_role("pose_prior"):
            said.update(zip(table.ids[::-1, 0].tolist(), table.matrices[::-1], strict=True))
        if len(fixed):
            names, stacked = np.concatenate(known_ids), np.concatenate(known)
            order = np.argsort(names)
            at = order[np.searchsorted(names, fixed, sorter=order)]
            said.update(zip(fixed.tolist(), stacked[at], strict=True))
        if not said:
            return T
        out: Array = T.copy()
        anchors = np.array(sorted(said), dtype=np.int64)
        for label in np.unique(component[np.searchsorted(ids, anchors)]).tolist():
            members = np.flatnonzero(component == label)
            inside = anchors[np.isin(anchors, ids[members])]
            preferred = inside[np.isin(inside, fixed)] if np.isin(inside, fixed).any() else inside
            anchor = int(preferred[0])
            shift = said[anchor] @ np.linalg.inv(T[np.searchsorted(ids, anchor)])
            out[members] = shift @ T[members]
        for name in fixed.tolist():
            out[np.searchsorted(ids, name)] = said[name]
        return out

    def _points_from(self, ids: Indices, T: Array) -> Array:
        """Return every landmark where the first pose that sees it has it; one that nobody sees where its line says."""
        points = np.zeros((len(self.point_ids), self.dimension))
        for table in self.of_role("point"):
            points[np.searchsorted(self.point_ids, table.ids[:, 0])] = table.numbers
        for table in reversed(self.of_role("landmark")):
            names, first = np.unique(table.ids[:, 1], return_index=True)
            pose = T[np.searchsorted(ids, table.ids[first, 0])]
            seen = np.einsum("nab,nb->na", pose[:, :-1, :-1], table.numbers[first]) + pose[:, :-1, -1]
            points[np.searchsorted(self.point_ids, names)] = seen
        return points

    def values(self) -> Values:
        """Return the values that the file gives, in its order; those of `missing_ids` are not among them."""
        group = SE2 if self.dimension == 2 else SE3
        values = Values()
        for table in self.of_role("pose"):
            values.insert(table.ids[:, 0], group(table.matrices))
        for table in self.of_role("point"):
            values.insert(table.ids[:, 0], table.numbers)
        return values

    def graph(self, *, kernel: Kernel | None = None) -> FactorGraph:
        """Return the factors, one group a kind, with what is held; `kernel` is that of every relative pose.

        Factor numbers run through the kinds in the order of `tables`, and within a kind in that of the file.
        """
        group = SE2 if self.dimension == 2 else SE3
        graph = FactorGraph()
        for table in self.of_role(*_FACTORS):
            noise = Information(_shared(table.information))
            role, i = table.kind.role, table.ids[:, 0]
            if role == "between":
                graph.add(Between(i, table.ids[:, 1], group(table.matrices), noise, kernel=kernel))
            elif role == "landmark":
                graph.add(Landmark(i, table.ids[:, 1], table.numbers, noise, kernel=kernel))
            elif role == "pose_prior":
                graph.add(Prior(i, group(table.matrices), noise))
            else:
                graph.add(Position(i, table.numbers, noise))
        graph.fix(self.gauge_ids)
        return graph

    def with_values(self, values: Values) -> PoseGraphFile:
        """Return the same graph with these values in its vertex lines; those without a line get one at the top.

        Raises
        ------
        GraphError
            A pose or landmark has no value.
        """
        tables = []
        for table in self.tables:
            role = table.kind.role
            if role == "pose":
                matrices = values.at(table.ids[:, 0]).matrix
                tables.append(replace(table, numbers=numbers_of(table.kind, matrices)))
            elif role == "point":
                tables.append(replace(table, numbers=np.asarray(values.at(table.ids[:, 0]))))
            else:
                tables.append(table)
        poses = np.intersect1d(self.missing_ids, self.pose_ids)
        points = np.setdiff1d(self.missing_ids, poses)
        if len(poses):
            kind = KINDS[self._vertex_tag()]
            tables.insert(0, Table.of(kind, poses, numbers_of(kind, values.at(poses).matrix)))
        if len(points):
            kind = KINDS["VERTEX_XY" if self.dimension == 2 else "VERTEX_TRACKXYZ"]
            tables.insert(int(len(poses) > 0), Table.of(kind, points, np.asarray(values.at(points))))
        return replace(self, tables=tuple(tables))

    def _vertex_tag(self) -> str:
        """Return the tag of vertices that suits the file's edges."""
        partner = {"EDGE2": "VERTEX2", "EDGE3": "VERTEX3"}
        tags = [table.kind.tag for table in self.tables]
        return next(
            (partner[tag] for tag in tags if tag in partner), "VERTEX_SE2" if self.dimension == 2 else "VERTEX_SE3:QUAT"
        )


def _shared(information: Array) -> Array:
    """Return the one matrix that all of (N, d, d) are, or all of them."""
    same = len(information) > 0 and bool((information == information[:1]).all())
    return information[0] if same else information


def _without(ids: Indices, taken: Indices) -> Indices:
    """Return those of `ids` that are not in `taken`, both ascending."""
    if not len(taken):
        return ids
    at = np.minimum(np.searchsorted(taken, ids), len(taken) - 1)
    return np.asarray(ids[taken[at] != ids])


def _union(parts: list[Indices]) -> Indices:
    return distinct(np.concatenate(parts)) if parts else np.empty(0, dtype=np.int64)

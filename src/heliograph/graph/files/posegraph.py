"""A pose graph as its file states it: poses, relative poses, landmarks, priors, and what is fixed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from heliograph.arrays import Array, Indices, freeze
from heliograph.errors import GraphError
from heliograph.graph.files.anchors import anchored, placed, points_from
from heliograph.graph.files.file_factors import planes_of, records_of
from heliograph.graph.files.odometry_start import SpanningStart, distinct, odometry_start
from heliograph.graph.files.offsets import at_poses
from heliograph.graph.files.row_kinds import KINDS, Role, numbers_of
from heliograph.graph.files.tables import Table
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.values import Values
from heliograph.lie import SE2, SE3

__all__ = ["PoseGraphFile"]


_THROUGH_ORIGIN = 1e-6  # [m] distance of a plane from the origin below which its normal is lost
_UNARY: tuple[Role, ...] = ("pose_prior", "position_prior", "direction_prior")
_SIGHTINGS: tuple[Role, ...] = ("landmark", "bearing")
_FACTORS: tuple[Role, ...] = ("between", *_SIGHTINGS, "plane_sighting", *_UNARY)


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: what follows from the rows is kept once computed
class PoseGraphFile:
    """What a g2o or TORO file says, to the bit and in its order.

    Parameters
    ----------
    dimension : int
        Dimension of the space, 2 or 3.
    tables : tuple of Table
        The rows, one table a kind.
    fixed : (F,) int64
        Ids of the FIX lines.
    fixed_line : (F,) int64
        The lines they stand in.
    others : tuple of (int, str)
        Comments and parameters with their lines; written back as they were.
    offsets : mapping of int to (k, k) float64
        T_pose_sensor of the sensors that the rows name by these numbers; others sit at their pose.
    notes : tuple of str
        What reading the file has passed over or repaired.
    """

    dimension: int
    tables: tuple[Table, ...]
    fixed: Indices
    fixed_line: Indices
    others: tuple[tuple[int, str], ...] = ()
    offsets: Mapping[int, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

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
        parts = [table.ids[:, 0] for table in self.of_role("pose", "plane_sighting", *_SIGHTINGS, *_UNARY)]
        parts += [table.ids.ravel() for table in self.of_role("between")]
        return _union(parts)

    @cached_property
    def point_ids(self) -> Indices:
        """All landmarks, ascending, (Q,) int64."""
        return _union([t.ids[:, 0] for t in self.of_role("point")] + [t.ids[:, 1] for t in self.of_role(*_SIGHTINGS)])

    @cached_property
    def plane_ids(self) -> Indices:
        """All planes, ascending, (R,) int64; those that are fixed are known and no variables."""
        return _union(
            [t.ids[:, 0] for t in self.of_role("plane")] + [t.ids[:, 1] for t in self.of_role("plane_sighting")]
        )

    @cached_property
    def known_planes(self) -> tuple[Indices, Array]:
        """Ids of fixed planes, ascending, (M,), and their a b c d with a unit normal, (M, 4)."""
        tables = self.of_role("plane")
        ids = np.concatenate([t.ids[:, 0] for t in tables]) if tables else np.empty(0, dtype=np.int64)
        planes = np.concatenate([planes_of(t.numbers) for t in tables]) if tables else np.empty((0, 4))
        order = np.argsort(ids)
        order = order[np.isin(ids[order], self.fixed)]
        return ids[order], planes[order]

    @cached_property
    def missing_ids(self) -> Indices:
        """Poses, landmarks and planes that no line gives a value, ascending, (M,) int64."""
        given = _union([table.ids[:, 0] for table in self.of_role("pose", "point", "plane")])
        return _without(_union([self.pose_ids, self.point_ids, self.plane_ids]), given)

    @cached_property
    def edges(self) -> tuple[Indices, Indices, SE2 | SE3]:
        """All relative poses: ids i, ids j, (E,) each, and T_i_j as one batch, in the order of the file."""
        group = SE2 if self.dimension == 2 else SE3
        tables = self.of_role("between")
        if not tables:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), group.identity((0,))
        order = np.argsort(np.concatenate([t.line for t in tables]), kind="stable")
        ids = np.concatenate([t.ids for t in tables])[order]
        return ids[:, 0], ids[:, 1], group(np.concatenate([at_poses(t, self.offsets)[0] for t in tables])[order])

    @property
    def edge_count(self) -> int:
        """Number of factors of all kinds."""
        return sum(len(table) for table in self.of_role(*_FACTORS))

    @cached_property
    def _start(self) -> tuple[SpanningStart, Indices]:
        """All poses by odometry, and the component of each (named by its lowest id) when landmarks join them too."""
        i, j, T_i_j = self.edges
        start = odometry_start(i, j, T_i_j, self.pose_ids)
        return start, self._joined(start.ids, start.root)

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
        """What is held: the FIX lines, and the lowest pose of each component that has neither those nor a prior.

        A fixed landmark anchors the poses that see it, as a fixed pose does.
        """
        start, component = self._start
        held = _without(self.fixed, self.plane_ids) if len(self.plane_ids) else distinct(self.fixed)
        free = _without(distinct(component), distinct(anchored(self, start.ids, component)))
        return _union([held, free])

    def odometry_values(self) -> Values:
        """Return a start from the relative poses, see `odometry_start`; landmarks by the first pose that sees them.

        A component that holds FIX lines with a value, or priors, is moved so that the lowest such pose is where that
        says, or so that it sees fixed landmarks where they are; what is fixed keeps its value.
        """
        start, component = self._start
        ids, T = start.ids, placed(self, start, component)
        group = SE2 if self.dimension == 2 else SE3
        values = Values()
        values.insert(ids, group(T))
        if len(self.point_ids):
            values.insert(self.point_ids, points_from(self, ids, T))
        self._insert_planes(values)
        return values

    def _insert_planes(self, values: Values) -> None:
        """Insert the planes that are estimated, by their points closest to the world's origin."""
        for table in self.of_role("plane"):
            mine = np.flatnonzero(~np.isin(table.ids[:, 0], self.known_planes[0]))
            if not len(mine):
                continue
            planes = planes_of(table.numbers[mine])
            through = ~(np.abs(planes[:, 3]) > _THROUGH_ORIGIN)
            if through.any():
                name = table.ids[mine[int(np.argmax(through))], 0]
                raise GraphError(
                    f"plane {name} goes through the world's origin, where its closest point has no direction; fix it, "
                    "or move the origin"
                )
            values.insert(table.ids[mine, 0], -planes[:, 3:] * planes[:, :3])

    def values(self) -> Values:
        """Return the values that the file gives, in its order; those of `missing_ids` are not among them."""
        group = SE2 if self.dimension == 2 else SE3
        values = Values()
        for table in self.of_role("pose"):
            values.insert(table.ids[:, 0], group(table.matrices))
        for table in self.of_role("point"):
            values.insert(table.ids[:, 0], table.numbers)
        self._insert_planes(values)
        return values

    def graph(self, *, kernel: Kernel | None = None) -> FactorGraph:
        """Return the factors, one group a kind, with what is held; `kernel` is that of every relative pose.

        Sensors that do not sit at their pose are brought there exactly, measurement and information.

        Factor numbers run through the kinds in the order of `tables`, and within a kind in that of the file.
        """
        graph = FactorGraph()
        for table in self.of_role(*_FACTORS):
            for record in records_of(table, self.offsets, self.known_planes, kernel=kernel):
                graph.add(record)
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
            elif role == "plane":
                tables.append(replace(table, numbers=self._plane_numbers(table, values)))
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

    def _plane_numbers(self, table: Table, values: Values) -> Array:
        """Return the numbers of planes with those that are estimated at their values; sides stay as they were."""
        numbers = np.array(table.numbers)
        mine = np.flatnonzero(~np.isin(table.ids[:, 0], self.known_planes[0]))
        if len(mine):
            closest = np.asarray(values.at(table.ids[mine, 0]))
            away = np.linalg.norm(closest, axis=1, keepdims=True)
            side = np.where(np.einsum("na,na->n", closest, numbers[mine, :3]) < 0.0, -1.0, 1.0)[:, None]
            numbers[mine, :4] = side * np.concatenate([closest / away, -away], axis=1)
        return numbers

    def _vertex_tag(self) -> str:
        """Return the tag of vertices that suits the file's edges."""
        partner = {"EDGE2": "VERTEX2", "EDGE3": "VERTEX3"}
        tags = [table.kind.tag for table in self.tables]
        return next(
            (partner[tag] for tag in tags if tag in partner), "VERTEX_SE2" if self.dimension == 2 else "VERTEX_SE3:QUAT"
        )


def _without(ids: Indices, taken: Indices) -> Indices:
    """Return those of `ids` that are not in `taken`, both ascending."""
    if not len(taken):
        return ids
    at = np.minimum(np.searchsorted(taken, ids), len(taken) - 1)
    return np.asarray(ids[taken[at] != ids])


def _union(parts: list[Indices]) -> Indices:
    return distinct(np.concatenate(parts)) if parts else np.empty(0, dtype=np.int64)

"""A factor graph in the words of a pose-graph file, as far as those reach."""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Indices
from heliograph.errors import GraphError
from heliograph.graph.files.posegraph import PoseGraphFile
from heliograph.graph.files.row_kinds import KINDS, numbers_of
from heliograph.graph.files.tables import Table
from heliograph.graph.model.factor_graph import Added, FactorGraph
from heliograph.graph.model.noise import DIAGONAL, SCALAR, Information
from heliograph.graph.model.values import Values
from heliograph.lie import SE2, SE3

__all__ = ["pose_graph_of"]


_TAGS = {
    ("Between", "SE2"): "EDGE_SE2",
    ("Between", "SE3"): "EDGE_SE3:QUAT",
    ("Prior", "SE2"): "EDGE_PRIOR_SE2",
    ("Prior", "SE3"): "EDGE_SE3_PRIOR",
    ("Landmark", 2): "EDGE_SE2_XY",
    ("Landmark", 3): "EDGE_SE3_TRACKXYZ",
    ("Position", 2): "EDGE_PRIOR_SE2_XY",
    ("Position", 3): "EDGE_SE3_XYZPRIOR",
    ("Bearing", "SO2"): "EDGE_BEARING_SE2_XY",
}
_AT_THE_POSE = (-1, "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1")  # before all rows: g2o wants to know the sensor that they name


def pose_graph_of(graph: FactorGraph, values: Values) -> PoseGraphFile:
    """Return poses, landmarks, relative poses and priors as what a g2o file may say; robust kernels are left out.

    Parameters
    ----------
    graph : FactorGraph
        Factors `Between` and `Prior` on SE2 or SE3, `Landmark`, `Position` of poses, and `Bearing` in the plane.
    values : Values
        SE2 and points (2,), or SE3 and points (3,).

    Raises
    ------
    GraphError
        It holds what such a file has no word for; `save_graph` keeps everything.
    """
    for family in values.families():
        if family.lie not in (SE2, SE3) and family.dof not in (2, 3):
            raise GraphError(f"a pose-graph file has no word for {family.name}; save the graph with save_graph")
    group = SE2 if len(values.block(SE2)[0]) else SE3
    if len(values.block(SE3 if group is SE2 else SE2)[0]):
        raise GraphError("a pose-graph file is of the plane or of space, not of both; save the graph with save_graph")
    tables = []
    keys, poses = values.block(group)
    kind = KINDS["VERTEX_SE2" if group is SE2 else "VERTEX_SE3:QUAT"]
    tables.append(Table.of(kind, keys, numbers_of(kind, poses.matrix)))
    points, places = values.block(group.space)
    if len(points):
        tables.append(Table.of(KINDS["VERTEX_XY" if group is SE2 else "VERTEX_TRACKXYZ"], points, places))
    tables += [_table(added, keys) for added in graph.groups()]
    fixed = graph.fixed
    sensors = any(table.kind.parameters for table in tables)
    return PoseGraphFile(
        dimension=group.space,
        tables=tuple(tables),
        fixed=fixed,
        fixed_line=np.zeros(len(fixed), dtype=np.int64),
        others=(_AT_THE_POSE,) if sensors else (),
    )


def _table(added: Added, poses: Indices) -> Table:
    record = added.record
    word = record.measured.name if record.measured is not None and record.measured.lie is not None else record.rows
    tag = _TAGS.get((record.kind, word))
    if record.kind == "Position" and not np.isin(record.keys, poses).all():
        tag = None  # of points
    if tag is None or added.whitening.constrained:
        noise = "hard " if added.whitening.constrained else ""
        raise GraphError(
            f"a pose-graph file has no word for {noise}{record.kind} ({len(record)} factors from {added.name(0)}); "
            "save the graph with save_graph"
        )
    kind = KINDS[tag]
    numbers = record.measurement
    if kind.layout != "point" and record.measured is not None:
        numbers = numbers_of(kind, record.measured.elements(numbers))
    return Table.of(kind, record.keys, numbers, _information(added))


def _information(added: Added) -> Array:
    """Return the information of every factor, (N, d, d): as it was given, else from its square root."""
    record, whitening, rows = added.record, added.whitening, added.record.rows
    shape = (len(record), rows, rows)
    if isinstance(record.noise, Information):
        return np.broadcast_to(record.noise.numbers, shape)
    roots = whitening.sqrt_information
    if whitening.form in (SCALAR, DIAGONAL):
        squares: Array = roots[:, :, None] ** 2 * np.eye(rows)
        return np.broadcast_to(squares, shape)
    S = roots.reshape(-1, rows, rows)
    return np.broadcast_to(np.swapaxes(S, 1, 2) @ S, shape)

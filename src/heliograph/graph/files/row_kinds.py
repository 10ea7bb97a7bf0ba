"""What a line of a pose-graph file may say: the tags of g2o and TORO, and where each of their numbers belongs.

References
----------
.. [1] R. Kuemmerle et al., "g2o: A general framework for graph optimization", ICRA 2011, and the file format's page.
.. [2] G. Grisetti et al., "A tree parameterization for efficiently computing maximum likelihood maps using gradient
   descent", RSS 2007: TORO, whose planar information comes as I11 I12 I22 I33 I13 I23.
.. [3] M. Kaess et al., "iSAM: Incremental smoothing and mapping", T-RO 2008: its ODOMETRY and LANDMARK lines give the
   square root of the information.
.. [4] K. Koide et al., IJARS 16(2), 2019: hdl_graph_slam, for planes and partial priors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from heliograph.arrays import Array
from heliograph.lie import se2, se3, so2, so3

__all__ = ["KINDS", "Layout", "Role", "RowKind", "matrices_of", "numbers_of"]

Role = Literal[
    "pose",
    "point",
    "plane",
    "between",
    "landmark",
    "bearing",
    "plane_sighting",
    "pose_prior",
    "position_prior",
    "direction_prior",
]
Layout = Literal["xy_theta", "quaternion", "rpy", "point", "angle", "plane", "coloured_plane", "directions"]

_NUMBERS: dict[Layout, tuple[int, str]] = {
    "xy_theta": (3, "x y theta"),
    "quaternion": (7, "x y z qx qy qz qw"),
    "rpy": (6, "x y z roll pitch yaw"),
    "angle": (1, "an angle"),
    "plane": (4, "a b c d of a x + b y + c z + d = 0"),
    "coloured_plane": (7, "a b c d of a x + b y + c z + d = 0 and a colour"),
    "directions": (6, "a direction of the world and its measurement"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RowKind:
    """A kind of line.

    Parameters
    ----------
    tag : str
        Its first word.
    role : str
        What it states: a variable's value or a factor.
    layout : str
        How its value is written: ``x y theta``, ``x y z qx qy qz qw``, ``x y z roll pitch yaw``, a point, ...
    dimension : int
        Dimension of the space, 2 or 3.
    ids : int
        How many variables it names.
    parameters : int
        How many numbers of sensor offsets follow the ids: 0, 1, or 2 for a sensor at either end.
    information : tuple of (int, int)
        Place of each information number in our matrix (rotation first), in the order of the file; empty for values.
    form : str
        What those numbers are: ``information``, or ``root``: an upper triangular S with the information ``S' S``.
    coordinates : int
        Coordinates of a point, where fewer than the dimension are given; 0: all.
    """

    tag: str
    role: Role
    layout: Layout
    dimension: int
    ids: int
    parameters: int = 0
    information: tuple[tuple[int, int], ...] = ()
    form: Literal["information", "root"] = "information"
    coordinates: int = 0

    @property
    def numbers(self) -> int:
        """How many numbers its value takes."""
        return (self.coordinates or self.dimension) if self.layout == "point" else _NUMBERS[self.layout][0]

    @property
    def rows(self) -> int:
        """Rows of the factor's residual, 0 for a value."""
        return 1 + max(a for a, _ in self.information) if self.information else 0

    @property
    def words(self) -> int:
        """Words after the tag."""
        return self.ids + self.parameters + self.numbers + len(self.information)

    def describe(self) -> str:
        """Return what its words are, for messages."""
        parts = ["one id" if self.ids == 1 else "two ids"]
        parts += [["an offset's id"], ["two offsets' ids"]][self.parameters - 1] if self.parameters else []
        parts.append("x y z"[: 2 * self.numbers - 1] if self.layout == "point" else _NUMBERS[self.layout][1])
        if self.information:
            parts.append(f"{len(self.information)} of the information matrix")
        return ", ".join(parts)


def _upper(places: list[int]) -> tuple[tuple[int, int], ...]:
    """Return the upper triangle, row by row, of a matrix whose file index k is our index ``places[k]``."""
    return tuple((places[a], places[b]) for a in range(len(places)) for b in range(a, len(places)))


_PLANE, _SPACE, _POINT2, _POINT3 = (_upper(p) for p in ([1, 2, 0], [3, 4, 5, 0, 1, 2], [0, 1], [0, 1, 2]))
_TORO_PLANE = ((1, 1), (1, 2), (2, 2), (0, 0), (1, 0), (2, 0))


def _kind(
    tag: str,
    role: Role,
    layout: Layout,
    ids: int,
    information: tuple[tuple[int, int], ...] = (),
    *,
    dimension: int = 0,
    parameters: int = 0,
    form: Literal["information", "root"] = "information",
    coordinates: int = 0,
) -> RowKind:
    flat = layout in ("xy_theta", "angle") or "XY" in tag.replace("XYZ", "")
    return RowKind(
        tag=tag,
        role=role,
        layout=layout,
        dimension=dimension or (2 if flat else 3),
        ids=ids,
        parameters=parameters,
        information=information,
        form=form,
        coordinates=coordinates,
    )


KINDS: dict[str, RowKind] = {
    kind.tag: kind
    for kind in (
        _kind("VERTEX_SE2", "pose", "xy_theta", 1),
        _kind("EDGE_SE2", "between", "xy_theta", 2, _PLANE),
        _kind("VERTEX_SE3:QUAT", "pose", "quaternion", 1),
        _kind("EDGE_SE3:QUAT", "between", "quaternion", 2, _SPACE),
        _kind("VERTEX_XY", "point", "point", 1),
        _kind("VERTEX_TRACKXYZ", "point", "point", 1),
        _kind("EDGE_SE2_XY", "landmark", "point", 2, _POINT2),
        _kind("EDGE_SE3_TRACKXYZ", "landmark", "point", 2, _POINT3, parameters=1),
        _kind("EDGE_PRIOR_SE2", "pose_prior", "xy_theta", 1, _PLANE),
        _kind("EDGE_SE3_PRIOR", "pose_prior", "quaternion", 1, _SPACE, parameters=1),
        _kind("EDGE_PRIOR_SE2_XY", "position_prior", "point", 1, _POINT2),
        _kind("EDGE_SE2_OFFSET", "between", "xy_theta", 2, _PLANE, parameters=2),
        _kind("EDGE_SE3_OFFSET", "between", "quaternion", 2, _SPACE, parameters=2),
        _kind("EDGE_SE2_POINTXY_OFFSET", "landmark", "point", 2, _POINT2, parameters=1),
        _kind("EDGE_BEARING_SE2_XY", "bearing", "angle", 2, ((0, 0),)),
        # Of a pose's own position, whatever offset is named; hdl_graph_slam's two name none.
        _kind("EDGE_SE3_XYZPRIOR", "position_prior", "point", 1, _POINT3, parameters=1),
        _kind("EDGE_SE3_PRIORXYZ", "position_prior", "point", 1, _POINT3),
        _kind("EDGE_SE3_PRIORXY", "position_prior", "point", 1, _POINT2, dimension=3, coordinates=2),
        _kind("EDGE_SE3_PRIORVEC", "direction_prior", "directions", 1, _POINT3),
        _kind("VERTEX_PLANE", "plane", "plane", 1),
        _kind("EDGE_SE3_PLANE", "plane_sighting", "plane", 2, _POINT3),
        _kind("VERTEX2", "pose", "xy_theta", 1),
        _kind("EDGE2", "between", "xy_theta", 2, _TORO_PLANE),
        _kind("VERTEX3", "pose", "rpy", 1),
        _kind("EDGE3", "between", "rpy", 2, _SPACE),
        _kind("ODOMETRY", "between", "xy_theta", 2, _PLANE, form="root"),
        _kind("LANDMARK", "landmark", "point", 2, _POINT2, dimension=2, form="root"),
    )
}


def matrices_of(kind: RowKind, numbers: Array) -> Array:
    """Return the homogeneous matrices of a kind's rows, (N, k, k) from (N, numbers); quaternions are normalised."""
    if kind.layout == "xy_theta":
        return se2.from_rotation_translation(so2.exp(numbers[:, 2:]), numbers[:, :2])
    if kind.layout == "angle":
        return so2.exp(numbers)
    if kind.layout == "quaternion":
        return se3.from_rotation_translation(so3.from_quaternion(numbers[:, 3:]), numbers[:, :3])
    R = so3.from_rpy(numbers[:, 3], numbers[:, 4], numbers[:, 5])
    return se3.from_rotation_translation(R, numbers[:, :3])


def numbers_of(kind: RowKind, matrices: Array) -> Array:
    """Return the numbers by which a kind writes homogeneous matrices, (N, kind.numbers) from (N, k, k)."""
    T = np.asarray(matrices, dtype=np.float64)
    if kind.layout == "xy_theta":
        return np.concatenate([T[:, :2, 2], so2.log(T[:, :2, :2])], axis=1)
    if kind.layout == "angle":
        return so2.log(T)
    rotation = so3.to_quaternion(T[:, :3, :3]) if kind.layout == "quaternion" else so3.to_rpy(T[:, :3, :3])
    return np.concatenate([T[:, :3, 3], rotation], axis=1)

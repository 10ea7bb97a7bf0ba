"""Rows of a pose-graph file as factors, and those factors that only such files know."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from heliograph.arrays import Array, Indices
from heliograph.graph.files.offsets import at_poses, points_at_poses
from heliograph.graph.files.tables import Table
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.factors import Bearing, Between, Landmark, Position, Prior
from heliograph.graph.model.kernels import Kernel
from heliograph.graph.model.noise import Information
from heliograph.graph.model.records import FactorRecord
from heliograph.graph.model.surfaces import Attitude, Plane
from heliograph.lie import S2, SE2, SE3, SO2, s2

__all__ = ["PlaneSighting", "planes_of", "records_of"]


class PlaneSighting(Factor):
    """A plane is seen from a pose; the variable is the plane's point that is closest to the world's origin.

    Residual: azimuth and elevation of the measured normal seen from the estimated one [rad], and the difference of the
    distances [m], as g2o writes it. Which side of the plane a normal points to does not count.
    """

    variables = (SE3, 3)
    rows = 3

    @staticmethod
    def residual(T_world_i: Array, closest_world: Array, plane_i: Array) -> Array:
        """Return (N, 3) from poses (N, 4, 4), closest points (N, 3) and planes (N, 4) of unit normals."""
        away = np.linalg.norm(closest_world, axis=1, keepdims=True)
        normal = closest_world / np.where(away > 0.0, away, 1.0)
        return _plane_residual(T_world_i, np.concatenate([normal, -away], axis=1), plane_i)


def _plane_residual(T_world_i: Array, plane_world: Array, plane_i: Array) -> Array:
    normal = np.einsum("nab,na->nb", T_world_i[:, :3, :3], plane_world[:, :3])
    offset = plane_world[:, 3] + np.einsum("na,na->n", plane_world[:, :3], T_world_i[:, :3, 3])
    measured = plane_i[:, :3]
    side = np.where(np.einsum("na,na->n", normal, measured) < 0.0, -1.0, 1.0)
    normal, offset = side[:, None] * normal, side * offset
    # The angle between the normals, along the measured one's tangent plane: smooth for every direction, unlike angles.
    along = np.einsum("nab,na->nb", _east_and_up(measured), normal)
    sine = np.linalg.norm(along, axis=1)
    angle = np.arctan2(sine, np.einsum("na,na->n", normal, measured))
    scale = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 1.0)
    return np.column_stack([-along * scale[:, None], plane_i[:, 3] - offset])


def planes_of(numbers: Array) -> Array:
    """Return (N, 4) with normals of unit length from a b c d ... of files, (N, 4) or more."""
    planes = numbers[:, :4]
    return np.asarray(planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True))


def records_of(
    table: Table, offsets: Mapping[int, Array], planes: tuple[Indices, Array], *, kernel: Kernel | None
) -> list[FactorRecord]:
    """Return the factors that rows state, in their order.

    Parameters
    ----------
    table : Table
        Rows whose role is a factor's.
    offsets : mapping of int to (k, k) float64
        T_pose_sensor.
    planes : ((M,) int64, (M, 4) float64)
        Those that are fixed, ids ascending: they are no variables.
    kernel : Kernel or None
        Kernel of relative poses and of what poses see.
    """
    role, i = table.kind.role, table.ids[:, 0]
    group = SE2 if table.kind.dimension == 2 else SE3
    if role == "between":
        T, information = at_poses(table, offsets)
        return [Between(i, table.ids[:, 1], group(T), Information(_shared(information)), kernel=kernel)]
    if role == "landmark":
        points, information = points_at_poses(table, offsets)
        return [Landmark(i, table.ids[:, 1], points, Information(_shared(information)), kernel=kernel)]
    noise = Information(_shared(table.information))
    if role == "bearing":
        return [Bearing(i, table.ids[:, 1], SO2(table.matrices), noise, kernel=kernel)]
    if role == "pose_prior":
        T, information = at_poses(table, offsets)
        return [Prior(i, group(T), Information(_shared(information)))]
    if role == "direction_prior":
        return [_level(table)]
    if role == "plane_sighting":
        return _sightings(table, planes, kernel)
    missing = table.kind.dimension - table.kind.numbers
    if not missing:
        return [Position(i, table.numbers, noise)]
    numbers = np.pad(table.numbers, ((0, 0), (0, missing)))
    return [Position(i, numbers, Information(np.pad(table.information, ((0, 0), (0, missing), (0, missing)))))]


def _level(table: Table) -> Attitude:
    """Return measured directions, whose information is that of R' d - m, as angles: to first order it lies across m."""
    world, seen = (directions / np.linalg.norm(directions, axis=1, keepdims=True) for directions in _halves(table))
    across = s2.basis(seen)
    information = np.swapaxes(across, 1, 2) @ table.information @ across
    return Attitude(table.ids[:, 0], S2(seen), Information(_shared(information)), world=S2(world))


def _halves(table: Table) -> tuple[Array, Array]:
    return table.numbers[:, :3], table.numbers[:, 3:]


def _sightings(table: Table, planes: tuple[Indices, Array], kernel: Kernel | None) -> list[FactorRecord]:
    """Return the sightings of planes: of those that are estimated, and of those that are known."""
    ids, known = planes
    seen = planes_of(table.numbers)
    fixed = np.isin(table.ids[:, 1], ids)
    out: list[FactorRecord] = []
    if (~fixed).any():
        rows = ~fixed
        out.append(
            PlaneSighting(
                (table.ids[rows, 0], table.ids[rows, 1]),
                data=(seen[rows],),
                noise=Information(table.information[rows]),
                kernel=kernel,
            )
        )
    if fixed.any():
        at = np.searchsorted(ids, table.ids[fixed, 1])
        out.append(_known_planes(table.ids[fixed, 0], seen[fixed], known[at], table.information[fixed], kernel))
    return out


def _known_planes(keys: Indices, seen: Array, known: Array, information: Array, kernel: Kernel | None) -> Plane:
    """Return sightings of planes that are known, with information for azimuth, elevation and distance as g2o has them.

    Azimuth and elevation are those of the measured normal seen from the estimated one; a `Plane` has the same angle
    along another basis, and the other way round. A distance is that along the normal, -d of a x + b y + c z + d = 0.
    """
    normal = seen[:, :3]
    east_and_up = _east_and_up(normal)
    turn = np.zeros((len(keys), 3, 3))
    turn[:, :2, :2] = -np.swapaxes(east_and_up, 1, 2) @ s2.basis(normal)
    turn[:, 2, 2] = 1.0
    noise = Information(_shared(np.swapaxes(turn, 1, 2) @ information @ turn))
    return Plane(keys, S2(normal), -seen[:, 3], noise, plane=(S2(known[:, :3]), -known[:, 3]), kernel=kernel)


def _east_and_up(normal: Array) -> Array:
    """Return the directions of growing azimuth and elevation at unit vectors (N, 3), as columns (N, 3, 2)."""
    azimuth, across = np.arctan2(normal[:, 1], normal[:, 0]), np.hypot(normal[:, 0], normal[:, 1])
    c, s = np.cos(azimuth), np.sin(azimuth)
    east = np.stack([-s, c, np.zeros_like(s)], axis=1)
    up = np.stack([-normal[:, 2] * c, -normal[:, 2] * s, across], axis=1)
    return np.stack([east, up], axis=2)


def _shared(information: Array) -> Array:
    """Return the one matrix that all of (N, d, d) are, or all of them."""
    same = len(information) > 0 and bool((information == information[:1]).all())
    return information[0] if same else information

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
from heliograph.lie import SE2, SE3, SO2, so3

__all__ = ["DirectionPrior", "KnownPlane", "PlaneSighting", "planes_of", "records_of"]


class DirectionPrior(Factor):
    """A direction of the world is measured by a body: ``R_world_i' d_world - d_i``, as hdl_graph_slam's PRIORVEC."""

    variables = (SE3,)
    rows = 3

    @staticmethod
    def residual(T_world_i: Array, d_world: Array, d_i: Array) -> Array:
        """Return (N, 3) from poses (N, 4, 4) and unit vectors (N, 3)."""
        return np.asarray(np.einsum("nab,na->nb", T_world_i[:, :3, :3], d_world) - d_i)

    @staticmethod
    def jacobians(T_world_i: Array, d_world: Array, d_i: Array) -> tuple[Array]:
        """Return (N, 3, 6) by right perturbation, rotation first."""
        J = np.zeros((len(d_i), 3, 6))
        J[:, :, :3] = so3.hat(np.einsum("nab,na->nb", T_world_i[:, :3, :3], d_world))
        return (J,)


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


class KnownPlane(Factor):
    """A plane that is known in the world is seen from a pose; residual as that of `PlaneSighting`."""

    variables = (SE3,)
    rows = 3

    @staticmethod
    def residual(T_world_i: Array, plane_world: Array, plane_i: Array) -> Array:
        """Return (N, 3) from poses (N, 4, 4) and planes (N, 4) of unit normals in the world and as seen."""
        return _plane_residual(T_world_i, plane_world, plane_i)


def _plane_residual(T_world_i: Array, plane_world: Array, plane_i: Array) -> Array:
    normal = np.einsum("nab,na->nb", T_world_i[:, :3, :3], plane_world[:, :3])
    offset = plane_world[:, 3] + np.einsum("na,na->n", plane_world[:, :3], T_world_i[:, :3, 3])
    measured = plane_i[:, :3]
    side = np.where(np.einsum("na,na->n", normal, measured) < 0.0, -1.0, 1.0)
    normal, offset = side[:, None] * normal, side * offset
    azimuth = np.arctan2(measured[:, 1], measured[:, 0])
    across = np.hypot(measured[:, 0], measured[:, 1])
    c, s = np.cos(azimuth), np.sin(azimuth)
    east = np.stack([-s, c, np.zeros_like(s)], axis=1)
    up = np.stack([-measured[:, 2] * c, -measured[:, 2] * s, across], axis=1)
    # The angle between the normals, along the measured one's tangent plane: smooth for every direction, unlike angles.
    along = np.stack([np.einsum("na,na->n", normal, east), np.einsum("na,na->n", normal, up)], axis=1)
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
        return [DirectionPrior(i, data=_directions(table), noise=noise)]
    if role == "plane_sighting":
        return _sightings(table, planes, kernel)
    missing = table.kind.dimension - table.kind.numbers
    if not missing:
        return [Position(i, table.numbers, noise)]
    numbers = np.pad(table.numbers, ((0, 0), (0, missing)))
    return [Position(i, numbers, Information(np.pad(table.information, ((0, 0), (0, missing), (0, missing)))))]


def _directions(table: Table) -> tuple[Array, Array]:
    """Return unit vectors in the world and as measured by the body, (N, 3) each."""
    first, second = table.numbers[:, :3], table.numbers[:, 3:]
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = second / np.linalg.norm(second, axis=1, keepdims=True)
    if table.kind.tag == "EDGE_SE3_GRAVITY":  # up in the body comes first, then gravity in the world
        return second, -first
    return first, second


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
        noise = Information(table.information[fixed])
        out.append(KnownPlane(table.ids[fixed, 0], data=(known[at], seen[fixed]), noise=noise, kernel=kernel))
    return out


def _shared(information: Array) -> Array:
    """Return the one matrix that all of (N, d, d) are, or all of them."""
    same = len(information) > 0 and bool((information == information[:1]).all())
    return information[0] if same else information

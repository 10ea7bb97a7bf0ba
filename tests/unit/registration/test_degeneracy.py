"""Which directions a registration sees: known rooms with known blind directions."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import MapConfig
from heliograph.maps import VoxelMap
from heliograph.registration import MatchSettings, linearize, observability
from neighbour_map import NeighbourMap
from states import random_rotation, wall

SETTINGS = MatchSettings(gate=0.3, kernel=0.0, sigma=0.03)


def seen(rng, walls, *, scale=1.0, R=None, residual="plane"):
    """Eigenvalues with the sensor in the middle of walls given as (normal, distance), all turned by R."""
    R = np.eye(3) if R is None else R
    n = 9000 // len(walls)
    cloud = np.concatenate([wall(rng, R @ normal, scale * d, n, half=4.0 * scale, sigma=0.005) for normal, d in walls])
    local_map = (
        VoxelMap(MapConfig(voxel=0.5 * scale)) if residual == "point" else NeighbourMap(spacing=1e-3, radius=1e3)
    )
    local_map.insert(cloud, np.eye(4))
    some = np.ascontiguousarray(cloud[:: len(cloud) // 2000])
    settings = replace(SETTINGS, residual=residual, gate=3.0 if residual == "point" else 0.3)
    equations = linearize(local_map, some, np.eye(4), settings)
    assert equations.matches > 1000
    return observability(equations, float(np.mean(np.sum(some**2, axis=1))))


X, Y, Z = np.eye(3)
ROOM = [(s * n, 3.0) for n in (X, Y, Z) for s in (1.0, -1.0)]
CORRIDOR = [(s * n, 3.0) for n in (Y, Z) for s in (1.0, -1.0)]


def test_room_is_seen_evenly(rng):
    found = seen(rng, ROOM)
    assert found.translation.sum() == pytest.approx(1.0)
    assert found.translation.min() > 0.25
    assert found.rotation.min() > 0.05


@pytest.mark.parametrize("turned", [False, True])
def test_corridor_is_blind_along_its_axis_only(rng, turned):
    R = random_rotation(rng) if turned else np.eye(3)
    found = seen(rng, CORRIDOR, R=R)
    assert found.translation[0] < 4e-3
    assert found.translation[1] > 0.3
    assert abs(found.weak_direction @ (R @ X)) > 0.999
    assert found.rotation.min() > 0.01  # ends of the walls still hold all turns


def test_single_plane_is_blind_in_two_translations_and_one_turn(rng):
    found = seen(rng, [(Z, -2.0)])
    np.testing.assert_allclose(found.translation, [0.0, 0.0, 1.0], atol=5e-3)
    assert found.rotation[0] < 4e-3
    assert found.rotation[1] > 0.1
    assert abs(found.rotation_directions[:, 0] @ Z) > 0.999


@pytest.mark.parametrize("walls", [ROOM, CORRIDOR])
def test_eigenvalues_do_not_depend_on_the_size_of_the_world(walls):
    small, large = (seen(np.random.default_rng(2), walls, scale=scale) for scale in (0.5, 2.0))
    np.testing.assert_allclose(small.translation, large.translation, atol=0.02)
    np.testing.assert_allclose(small.rotation, large.rotation, atol=0.02)


def test_eigenvalues_do_not_depend_on_the_number_of_points(rng):
    n = np.array([X, Y, Z, (X + Y) / np.sqrt(2.0)])
    J = np.hstack([np.cross(3.0 * n + 0.3, n), n])
    from heliograph.registration import NormalEquations

    def equations(copies):
        return NormalEquations(
            information=copies * J.T @ J, gradient=np.zeros(6), feigned=np.zeros((6, 6)), feigned_square=0.0,
            blocks=("pose",), weight=4.0 * copies,
            robust_weight=4.0, square=0.0, cost=0.0, matches=4, fallback_matches=0, queries=4,
        )  # fmt: skip

    few, many = (observability(equations(copies), 9.0) for copies in (1, 1000))
    np.testing.assert_allclose(few.translation, many.translation, rtol=1e-12)
    np.testing.assert_allclose(few.rotation, many.rotation, rtol=1e-12, atol=1e-15)


def test_point_to_point_cannot_see_a_corridor(rng):
    """The textbook's comparison: its information is the identity whatever the geometry."""
    found = seen(rng, CORRIDOR, residual="point")
    np.testing.assert_allclose(found.translation, 1.0 / 3.0, atol=1e-9)


def test_no_match_sees_nothing():
    empty = linearize(VoxelMap(), np.ones((3, 3), np.float32), np.eye(4), SETTINGS)
    found = observability(empty, 1.0)
    assert not found.translation.any()
    assert not found.rotation.any()

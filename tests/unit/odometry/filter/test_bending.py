"""How far a sweep is from a steady motion, as its thirds tell it."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import MapConfig
from heliograph.lie import so3
from heliograph.maps import VoxelMap
from heliograph.odometry.filter.bending import CLOUD_BENT, sweep_bend
from heliograph.registration import MatchSettings
from scenes import corner_room
from states import rest_state

SWEEP = 0.3
SETTINGS = MatchSettings(gate=0.6, kernel=0.25, sigma=0.02)


@pytest.fixture(scope="module")
def room():
    rng = np.random.default_rng(5)
    planes = VoxelMap(MapConfig())
    planes.insert(corner_room(rng, density=300), np.eye(4))
    return planes, rng.permutation(corner_room(rng, density=40))


def bend_of(room, turn=(0.0, 0.0, 0.0), move=(0.0, 0.0, 0.0), sweep=SWEEP):
    """Points of a sweep whose end the best line through the motion misses by a turn and a move."""
    planes, cloud = room
    s = np.linspace(0.0, 1.0, len(cloud), dtype=np.float32)
    miss = 6.0 * s**2 - 6.0 * s + 1.0  # a parabola less its line, 1 at the end
    moved = np.einsum("nij,nj->ni", so3.exp(miss[:, None] * np.asarray(turn)), cloud) + miss[:, None] * np.asarray(move)
    order = np.random.default_rng(6).permutation(len(cloud))
    points, before = moved[order].astype(np.float32), (sweep * s)[order]
    state = replace(rest_state(), R_odom_imu=np.eye(3), p_odom=np.zeros(3))
    return sweep_bend(points, before, state, planes, SETTINGS, correlation=4.0, forgiven=0.1)


def test_a_steady_motion_is_not_bent(room):
    found = bend_of(room)
    assert found.turn < 2e-3
    assert found.move < 2e-3
    assert not found.beyond_model


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.05), (0.02, -0.02, 0.0)])
def test_thirds_tell_by_how_much_the_end_is_missed(room, turn):
    found = bend_of(room, turn=turn)
    assert np.sqrt(3.0) * found.turn == pytest.approx(np.linalg.norm(turn), rel=0.25)
    assert found.beyond_model == (np.linalg.norm(turn) > 0.04)  # of a room of some four metres


def test_a_move_is_told_from_a_turn(room):
    found = bend_of(room, move=(0.03, -0.04, 0.02))
    assert np.sqrt(3.0) * found.move == pytest.approx(np.linalg.norm((0.03, -0.04, 0.02)), rel=0.25)
    assert found.turn < 5e-3


def test_all_points_at_one_instant_cannot_be_bent(room):
    found = bend_of(room, turn=(0.0, 0.0, 0.05), sweep=0.0)
    assert (found.turn, found.move, found.beyond_model) == (0.0, 0.0, False)


def test_the_cloud_as_a_whole_is_misplaced_by_a_fifth_of_the_variance_at_its_end():
    s = np.linspace(0.0, 1.0, 10_001)
    assert np.mean((6.0 * s**2 - 6.0 * s + 1.0) ** 2) == pytest.approx(CLOUD_BENT, rel=1e-3)

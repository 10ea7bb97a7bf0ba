import numpy as np
import pytest

from fakes import make_result
from heliograph.checks.surfaces import SurfaceWatch
from heliograph.lie import so3


def room(rng, sigma, count=3000):
    """Points of six walls of a room of 5 x 4 x 2.4 m around the sensor."""
    half = np.array([2.5, 2.0, 1.2])
    points = rng.uniform(-half, half, (count, 3))
    axis, side = rng.integers(0, 3, count), rng.choice([-1.0, 1.0], count)
    points[np.arange(count), axis] = side * half[axis] + sigma * rng.standard_normal(count)
    return points


def clutter_in_a_corridor(rng, sigma):
    """Points of a floor, a ceiling and two walls that all face two ways, and of six coats that face the third."""
    walls = room(rng, sigma)
    walls = walls[np.abs(walls[:, 0]) < 2.4]
    coats = rng.uniform(-0.2, 0.2, (360, 3)) * [0.0, 1.0, 1.0] + rng.normal(0.0, [0.07, 0.0, 0.0], (360, 3))
    coats += np.repeat([[1.12, y, z] for y in (-0.96, 0.04, 1.04) for z in (-0.42, 0.58)], 60, axis=0)
    return np.concatenate([walls, coats])


def watched(turn_error=0.0, sigma=0.01, scene=room):
    """Walls seen from a body that turns back and forth; where it turns, its heading is off by ``turn_error``."""
    rng, watch = np.random.default_rng(0), SurfaceWatch()
    for k in range(120):
        yaw, rate = 0.8 * np.sin(0.07 * k), 0.056 * np.cos(0.07 * k)
        R = so3.exp(np.array([0.0, 0.0, yaw]))
        T = np.eye(4)
        T[:3, :3] = so3.exp(np.array([0.0, 0.0, turn_error * rate / 0.056])) @ R
        points = (scene(rng, sigma) @ R).astype(np.float32)
        watch.add(make_result(k, T_odom_imu=T, points_imu=points, intensity=None))
    watch.close()
    return watch.windows[0]


def test_thickness_is_the_noise_across_the_walls():
    found = watched(sigma=0.02)
    assert found.whole == pytest.approx(0.02, rel=0.25)
    assert found.cubes > 50


def test_a_heading_that_is_off_in_turns_thickens_the_walls_there():
    clean, smeared = watched(), watched(turn_error=0.03)
    assert smeared.whole > 1.5 * clean.whole
    assert smeared.turning > 1.3 * smeared.calm


def test_a_few_thick_pieces_that_face_one_way_are_clutter():
    assert watched(scene=clutter_in_a_corridor).whole == pytest.approx(0.01, rel=0.4)

"""The sensors' records against the truth they were made from."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.simulate import EPOCH_NS, GRAVITY

QUIET_IMU = {
    "gyro_noise": 0.0,
    "accel_noise": 0.0,
    "gyro_walk": 0.0,
    "accel_walk": 0.0,
    "gyro_bias": 0.0,
    "accel_bias": 0.0,
}
SMALL = SCENARIOS["warehouse"].thinned(beams=8, columns=128, duration=8.0)


def rotation_exp(phi):
    """Slow and obvious exponential of rotation vectors (M, 3)."""
    angle = np.maximum(np.linalg.norm(phi, axis=1), 1e-12)[:, None, None]
    K = np.zeros((len(phi), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = phi.T
    K -= np.transpose(K, (0, 2, 1))
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)


@pytest.mark.parametrize("mount", [{}, {"rig_rpy_deg": (90.0, 10.0, 0.0)}, {"imu_rpy_deg": (180.0, 0.0, 90.0)}])
@pytest.mark.parametrize("place", ["warehouse", "room"])
def test_imu_integrates_to_the_truth(place, mount):
    scenario = SCENARIOS[place].varied(imu={**QUIET_IMU, "rate": 1000.0}, mount=mount, walk={"duration": 15.0})
    simulation = simulate(scenario, seed=3)
    gyro, accel = simulation.imu()
    truth = simulation.truth.motion(simulation.imu_stamps_ns)
    dt = 1e-3
    steps = rotation_exp(0.5 * (gyro[1:] + gyro[:-1]) * dt)
    R, v, p = truth.R_world_body[0], truth.v_world[0], truth.p_world[0]
    g = np.array([0.0, 0.0, -GRAVITY])
    for k, step in enumerate(steps):
        R_next = R @ step
        a = 0.5 * (R @ accel[k] + R_next @ accel[k + 1]) + g
        p = p + v * dt + 0.5 * a * dt**2
        v = v + a * dt
        R = R_next
    assert np.linalg.norm(p - truth.p_world[-1]) < 2e-3
    assert np.linalg.norm(v - truth.v_world[-1]) < 1e-3
    np.testing.assert_allclose(R, truth.R_world_body[-1], atol=1e-5)


def test_rest_is_truly_still():
    simulation = simulate(SMALL.varied(imu=QUIET_IMU), seed=1)
    gyro, accel = simulation.imu()
    resting = simulation.imu_stamps_ns < EPOCH_NS + int(SMALL.walk.rest * 1e9)
    assert SMALL.walk.rest >= 3.0
    assert np.abs(gyro[resting]).max() == 0.0
    np.testing.assert_allclose(np.linalg.norm(accel[resting], axis=1), GRAVITY, rtol=1e-12)
    assert np.abs(gyro[~resting]).max() > 0.01


def test_lap_is_closed_and_about_150_m():
    truth = simulate(SCENARIOS["warehouse"], seed=1)
    motion = truth.truth.motion(truth.imu_stamps_ns)
    length = np.linalg.norm(np.diff(motion.p_world, axis=0), axis=1).sum()
    assert 140.0 < length < 160.0
    np.testing.assert_allclose(motion.p_world[-1], motion.p_world[0], atol=1e-9)
    np.testing.assert_allclose(motion.R_world_body[-1], motion.R_world_body[0], atol=1e-9)
    assert np.linalg.norm(motion.v_world, axis=1).max() == pytest.approx(1.5, abs=0.1)


def test_points_deskewed_with_truth_lie_on_the_surfaces():
    exact = SCENARIOS["warehouse"].varied(lidar={"range_noise": 0.0, "dropout": 0.0}).thinned(columns=256, beams=16)
    simulation = simulate(replace(exact, walk=replace(exact.walk, begin=20.0, duration=0.6)), seed=2)
    sweep = list(simulation.sweeps())[-1]
    scan = sweep.scan()
    T = simulation.truth.lidar_pose(scan.stamp_ns + scan.offsets_ns.astype(np.int64))
    deskewed = np.einsum("nij,nj->ni", T[:, :3, :3], scan.points.astype(np.float64)) + T[:, :3, 3]
    frozen = scan.points @ T[0, :3, :3].T + T[0, :3, 3]
    assert np.quantile(surface_distance(simulation.world, deskewed), 0.999) < 1e-5
    assert np.quantile(surface_distance(simulation.world, frozen), 0.9) > 0.03


def surface_distance(world, points):
    """Distance of each point from the nearest primitive's surface, one primitive at a time."""
    best = np.full(len(points), np.inf)
    for p in world.primitives:
        local = (points - p.center) @ p.R_world_local
        if p.shape == "cylinder":
            local = np.stack([np.hypot(local[:, 0], local[:, 1]), 0 * local[:, 0], local[:, 2]], axis=1)
            half = np.array([p.half[0], 1.0, p.half[2]])
        else:
            half = p.half
        outside = np.abs(local) - half
        distance = np.linalg.norm(np.maximum(outside, 0.0), axis=1)
        if p.shape == "cylinder":
            inside = np.minimum(-outside[:, 0], -outside[:, 2])
        else:
            inside = -outside.max(axis=1) if p.shape == "box" else np.zeros(len(points))
        best = np.minimum(best, np.where(distance > 0.0, distance, np.abs(inside)))
    return best

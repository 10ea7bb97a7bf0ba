"""The sensors' records against the truth they were made from."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.data import GnssFix, ImuBatch, Scan
from heliograph.geodesy import ecef_to_geodetic, enu_to_geodetic, geodetic_to_ecef
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.sensors import LidarModel
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
    assert np.quantile(simulation.world.distance(deskewed), 0.999) < 1e-5
    assert np.quantile(simulation.world.distance(frozen), 0.9) > 0.03


def test_records_come_in_causal_order_and_complete():
    simulation = simulate(SMALL, seed=1)
    records = list(simulation)
    received = [r.received_ns for r in records]
    assert received == sorted(received)
    scans = [r for r in records if isinstance(r, Scan)]
    imu = [r for r in records if isinstance(r, ImuBatch)]
    assert len(scans) == simulation.sweep_count() == 79
    assert np.array_equal(np.concatenate([b.stamps_ns for b in imu]), simulation.imu_stamps_ns)
    assert len([r for r in records if isinstance(r, GnssFix)]) == 16
    for k, record in enumerate(records):
        if isinstance(record, Scan):  # an IMU sample at or after the sweep's last point has come already
            assert max(b.stamps_ns[-1] for b in records[:k] if isinstance(b, ImuBatch)) >= record.end_ns - 5_000_000
            assert record.end_ns - record.stamp_ns == record.offsets_ns.max()


def test_same_seed_gives_the_same_bits_and_another_does_not():
    one, same, other = (list(simulate(SMALL, seed=s, threads=t)) for s, t in ((5, 1), (5, 3), (6, 1)))
    for a, b in zip(one, same, strict=True):
        for name in ("points", "intensity", "gyro", "accel", "latitude_deg"):
            np.testing.assert_array_equal(getattr(a, name, None), getattr(b, name, None))
    gyro = [np.concatenate([r.gyro for r in records if isinstance(r, ImuBatch)]) for records in (one, other)]
    assert not np.array_equal(*gyro)
    simulation = simulate(SMALL, seed=5)
    assert np.array_equal(next(simulation.sweeps()).points, next(simulation.sweeps()).points)


def test_range_noise_and_dropouts_have_their_sizes():
    noisy = SMALL.varied(walk={"duration": 3.0}, lidar={"beams": 32, "columns": 512})
    clean = noisy.varied(lidar={"range_noise": 0.0, "dropout": 0.0})
    errors, lost = [], []
    for a, b in zip(simulate(noisy, seed=4).sweeps(), simulate(clean, seed=4).sweeps(), strict=True):
        both = (a.ranges > 0.0) & (b.ranges > 1.0)
        errors.append((a.ranges - b.ranges)[both])
        lost.append((a.ranges == 0.0)[b.ranges > 1.0])
    errors, lost = np.concatenate(errors), np.concatenate(lost)
    assert np.std(errors) == pytest.approx(0.02, rel=0.01)
    assert abs(np.mean(errors)) < 3.0 * 0.02 / np.sqrt(len(errors))
    assert np.mean(lost) == pytest.approx(0.01, rel=0.05)


def test_imu_noise_has_its_densities():
    scenario = SCENARIOS["warehouse"].varied(imu={"gyro_bias": 0.0, "accel_bias": 0.0}, walk={"rest": 2000.0})
    scenario = scenario.varied(walk={"duration": 2000.0})
    simulation = simulate(scenario, seed=8)
    gyro, accel = simulation.imu()
    gyro, accel = gyro - gyro.mean(axis=0), accel - accel.mean(axis=0)
    for samples, density, walk in ((gyro, 2e-4, 1e-5), (accel, 2e-3, 1e-4)):
        step = np.diff(samples, axis=0)  # white noise at 200 Hz dwarfs the walk in single steps
        assert np.std(step) / np.sqrt(2.0) == pytest.approx(density * np.sqrt(200.0), rel=0.01)
        means = samples[: 200 * 2000].reshape(-1, 200 * 100, 3).mean(axis=1)  # and the walk remains in long means
        growth = np.std(np.diff(means, axis=0)) / np.sqrt(100.0 * 2.0 / 3.0)
        assert growth == pytest.approx(walk, rel=0.4)


def test_constant_biases_have_their_sizes():
    first = [simulate(SMALL, seed=s).imu_errors for s in range(60)]
    for name, sigma in (("gyro_bias", 0.01), ("accel_bias", 0.05)):
        assert np.std([getattr(e, name)[0] for e in first]) == pytest.approx(sigma, rel=0.2)


def test_mounting_stays_in_its_ranges_and_differs_between_seeds():
    rigs = [simulate(SMALL, seed=s).rig.T_imu_lidar for s in range(20)]
    arms = np.array([np.linalg.norm(T[:3, 3]) for T in rigs])
    angles = np.degrees([np.linalg.norm(so3.log(T[:3, :3])) for T in rigs])
    assert arms.min() >= 0.05
    assert arms.max() <= 0.10
    assert np.ptp(arms) > 0.01
    assert angles.min() >= 5.0
    assert angles.max() <= 20.0


def test_turning_the_imu_leaves_the_lidar_where_it_is():
    plain, turned = simulate(SMALL, seed=2), simulate(SMALL.varied(mount={"imu_rpy_deg": (0.0, 0.0, 90.0)}), seed=2)
    stamps = plain.imu_stamps_ns[::100]
    np.testing.assert_allclose(plain.truth.lidar_pose(stamps), turned.truth.lidar_pose(stamps), atol=1e-12)
    np.testing.assert_array_equal(next(plain.sweeps()).points.shape, next(turned.sweeps()).points.shape)
    R = plain.truth.motion(stamps).R_world_body[0].T @ turned.truth.motion(stamps).R_world_body[0]
    np.testing.assert_allclose(R, so3.from_rpy(0.0, 0.0, np.pi / 2), atol=1e-12)


def test_rolling_the_rig_turns_imu_and_lidar_together():
    plain, rolled = simulate(SMALL, seed=2), simulate(SMALL.varied(mount={"rig_rpy_deg": (180.0, 0.0, 0.0)}), seed=2)
    np.testing.assert_allclose(plain.rig.T_imu_lidar, rolled.rig.T_imu_lidar, atol=1e-12)
    assert rolled.imu()[1][:100, 2].mean() < -9.0


def test_recording_can_start_in_motion():
    simulation = simulate(SMALL.varied(walk={"begin": 10.0, "duration": 1.0}), seed=2)
    assert np.linalg.norm(simulation.truth.motion(simulation.imu_stamps_ns[:1]).v_world) > 1.0


def test_point_times_can_be_left_out():
    scan = next(r for r in simulate(replace(SMALL, point_times=False), seed=2) if isinstance(r, Scan))
    assert not scan.has_point_times
    assert scan.offsets_ns.max() == 0


def test_gnss_has_a_fix_in_the_yard_only_and_its_noise():
    scenario = SCENARIOS["warehouse"].varied(gnss={"rate": 5.0})
    simulation = simulate(scenario, seed=2)
    fixes = list(simulation.fixes())
    p_world = simulation.truth.motion(np.array([f.stamp_ns for f in fixes])).p_world
    outdoors = p_world[:, 0] > 42.2
    assert [f.valid for f in fixes] == outdoors.tolist()
    geodetic = np.array([(np.radians(f.latitude_deg), np.radians(f.longitude_deg), f.altitude) for f in fixes])
    exact = enu_to_geodetic(p_world, np.array([np.radians(52.0), np.radians(11.0), 80.0]))
    error = geodetic_to_ecef(geodetic) - geodetic_to_ecef(exact)
    assert np.sqrt((error**2).sum(axis=1).mean()) == pytest.approx(np.sqrt(1.5), rel=0.1)


def test_geodetic_conversion_inverts_and_agrees_with_known_points():
    # The equator at Greenwich and the north pole, from the ellipsoid's own axes.
    known = geodetic_to_ecef(np.array([(0.0, 0.0, 10.0), (np.pi / 2, 0.0, 0.0)]))
    np.testing.assert_allclose(known, [(6378147.0, 0.0, 0.0), (0.0, 0.0, 6356752.314245)], atol=1e-6)
    rng = np.random.default_rng(1)
    geodetic = np.stack([rng.uniform(-1.5, 1.5, 50), rng.uniform(-3.0, 3.0, 50), rng.uniform(-100, 9000, 50)], axis=1)
    np.testing.assert_allclose(ecef_to_geodetic(geodetic_to_ecef(geodetic)), geodetic, rtol=1e-12, atol=1e-8)
    north = enu_to_geodetic(np.array([(0.0, 100.0, 0.0)]), np.array([0.9, 0.2, 50.0]))[0]
    assert north[0] > 0.9
    assert north[1] == pytest.approx(0.2, abs=1e-12)


@pytest.mark.parametrize("name", ["warehouse", "demo", "room", "tunnel"])
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_course_keeps_clear_of_the_world(name, seed):
    simulation = simulate(SCENARIOS[name], seed)
    T = simulation.truth.pose(simulation.imu_stamps_ns[::100])
    fan = LidarModel(beams=5, columns=len(T), elevation_deg=(-20.0, 20.0)).directions()
    for turn in range(0, len(T), max(1, len(T) // 24)):  # each pose looks into 24 directions, five beams each
        hits = simulation.world.cast(np.roll(fan, turn, axis=1), T, max_range=100.0)
        assert hits.range[hits.primitive >= 0].min() > 0.5

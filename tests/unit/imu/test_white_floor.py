"""White noise read from moving records, and where there is none to read."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from heliograph.config import ImuConfig
from heliograph.data import ImuBatch
from heliograph.errors import DataError
from heliograph.imu.stretches import even_stretches
from heliograph.imu.white_floor import noise_in_motion, white_floor
from heliograph.sim import SCENARIOS, simulate
from imu_noise import START_NS, resting_imu

CONFIG = ImuConfig()


def recorded(name, seed, **imu):
    simulation = simulate(SCENARIOS[name].varied(imu=imu), seed)
    gyro, accel = simulation.imu()
    return ImuBatch(stamps_ns=simulation.imu_stamps_ns, gyro=gyro, accel=accel, received_ns=0), simulation.imu_noise


def driven(rng, *, gyro=2e-4, accel=2e-3, duration=120.0, rate=100.0):
    """A drive: stops, bends and accelerations up to about 2 Hz, no vibration."""
    imu = resting_imu(rng, duration=duration, rate=rate, gyro={"white": gyro}, accel={"white": accel})
    t = 1e-9 * (imu.stamps_ns - START_NS)
    phases = rng.uniform(0.0, 2.0 * np.pi, (12, 6))
    speeds = 2.0 * np.pi * rng.uniform(0.05, 2.0, 12)
    motion = np.sin(speeds[:, None, None] * t[:, None] + phases[:, None]).sum(axis=0)
    return replace(imu, gyro=imu.gyro + 0.1 * motion[:, :3], accel=imu.accel + motion[:, 3:])


def errors_in_sigmas(floor, noise):
    truth = np.repeat([noise.gyro, noise.accel], 3)
    return (floor.density - truth) / floor.sigma


@pytest.mark.parametrize(("name", "imu"), [("room", {}), ("warehouse", {"gyro_noise": 2e-3, "accel_noise": 1e-2})])
def test_density_of_a_walk_is_unbiased_and_within_its_sigma(name, imu):
    errors = np.concatenate(
        [
            errors_in_sigmas(white_floor(even_stretches(batch)), noise)
            for batch, noise in (recorded(name, seed, **imu) for seed in range(8))
        ]
    )
    low, high = stats.chi2.ppf([0.0005, 0.9995], len(errors)) / len(errors)
    assert low < np.mean(errors**2) < high
    assert abs(errors.mean()) < 3.3 / np.sqrt(len(errors))


def test_density_of_a_drive_is_unbiased_and_within_its_sigma():
    errors = []
    for seed in range(8):
        floor = white_floor(even_stretches(driven(np.random.default_rng(seed))))
        assert floor.flat.all() and floor.calm > 0.97
        errors.append((floor.density - np.repeat([2e-4, 2e-3], 3)) / floor.sigma)
    assert np.mean(np.square(errors)) < stats.chi2.ppf(0.9995, 48) / 48


def test_sigma_is_that_of_a_mean_of_tapered_windows():
    """The density of many short records scatters as each of them says."""
    floors = [
        white_floor(even_stretches(resting_imu(np.random.default_rng(seed), duration=4.0, rate=200.0)))
        for seed in range(60)
    ]
    density, sigma = (np.stack([getattr(floor, name) for floor in floors]) for name in ("density", "sigma"))
    wide = np.stack([floor.band for floor in floors])
    full = (wide[..., 1] - wide[..., 0]) > 90.0  # the same band in all of them
    assert np.std(density[full[:, 0], 0]) / np.median(sigma[full[:, 0], 0]) == pytest.approx(1.0, abs=0.25)


def test_rest_gives_the_same_as_motion(rng):
    imu = resting_imu(rng, duration=60.0, rate=200.0)
    floor = white_floor(even_stretches(imu))
    np.testing.assert_allclose(floor.density, np.repeat([2e-4, 2e-3], 3), rtol=0.05)
    np.testing.assert_allclose(floor.band[:, 1], 100.0, rtol=0.02)


def test_vibration_is_told_from_the_floor(rng):
    """A motor that runs for most of the drive: the floor comes from the rest of it, the loud level from all of it."""
    imu = driven(rng)
    t = 1e-9 * (imu.stamps_ns - START_NS)
    shaking = np.where(t > 40.0, 1.0, 0.0)[:, None] * rng.normal(size=imu.accel.shape)
    floor = white_floor(even_stretches(replace(imu, accel=imu.accel + shaking)))
    np.testing.assert_allclose(floor.density[3:], 2e-3, rtol=0.15)
    np.testing.assert_allclose(floor.loud[3:], np.sqrt(2e-3**2 + 0.66 * 0.01), rtol=0.15)
    assert 0.2 < floor.calm < 0.45


def test_spectrum_without_a_floor_is_not_given_one(rng):
    coloured = np.cumsum(rng.normal(size=(60_000, 6)), axis=0)
    stamps = START_NS + 10_000_000 * np.arange(60_000)
    imu = ImuBatch(stamps_ns=stamps, gyro=coloured[:, :3].copy(), accel=coloured[:, 3:].copy(), received_ns=0)
    assert not white_floor(even_stretches(imu)).flat.any()


def test_start_takes_more_noise_where_it_is_seen_and_never_less(rng):
    quiet, loud = (driven(rng, gyro=g, accel=a, duration=1.0, rate=200.0) for g, a in ((1e-4, 1e-3), (1e-2, 0.2)))
    calm = noise_in_motion(quiet, CONFIG)
    assert (calm.gyro, calm.accel) == (CONFIG.gyro_noise, CONFIG.accel_noise)
    noisy = noise_in_motion(loud, CONFIG)
    assert noisy.gyro == pytest.approx(1e-2, rel=0.25) and noisy.accel == pytest.approx(0.2, rel=0.25)
    assert (noisy.gyro_walk, noisy.accel_walk) == (CONFIG.gyro_walk, CONFIG.accel_walk)


def test_start_with_few_samples_takes_the_configured_noise(rng):
    imu = resting_imu(rng, duration=0.1, rate=200.0)
    assert noise_in_motion(imu, CONFIG).gyro == CONFIG.gyro_noise
    with pytest.raises(DataError, match="20 IMU samples in a row"):
        white_floor(even_stretches(imu))

"""A real drive of 470 s with its real IMU: smoothing with noisy fixes, start in motion, and honest predictions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def drives():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        from benchmarks import imu_drive, imu_gnss

        yield imu_drive, imu_gnss


@pytest.fixture(scope="module")
def drive(drives, shared_data):
    folder = shared_data / "kitti_00"
    if not (folder / "imu.txt").exists():
        pytest.skip(f"{folder} is not there")
    return drives[0].Drive.read(folder)


def test_filled_gaps_are_found(drive):
    assert len(drive.imu) == 46967 - 1257
    assert (~drive.measured).sum() == 13
    longest = np.sort(np.diff(drive.imu.stamps_ns))[::-1]
    assert longest[7] > 1.5e9
    assert longest[8] < 0.02e9


def test_smoothing_halves_the_error_of_the_fixes(drives, drive):
    tools = drives[0]
    fixes = drive.noisy(0)
    task = tools.Task.of(drive, fixes, last=200)
    keys = np.arange(200)
    solution = tools.smooth(task)[1]
    assert solution.status == "converged"
    some = tools.Drive(
        imu=drive.imu,
        stamps_ns=drive.stamps_ns[:200],
        fixes=drive.fixes[:200],
        measured=drive.measured[:200],
        truth=drive.truth[:200],
    )
    batch = solution.values.at(keys).position
    assert tools.rmse(some, batch) < 0.4 * tools.rmse(some, fixes[:200])
    online = tools.smooth_online(task).estimate(keys).position
    np.testing.assert_allclose(online, batch, atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_predictions_over_cuts_are_as_good_as_they_say(drives, drive, seed):
    _, bench = drives
    fixes = drive.noisy(seed)
    lag, sigma = bench.lag_of(drive, fixes)
    assert 0.01 < lag < 0.12  # the truth's own rotation says 0.06
    assert sigma < 0.03
    truth, _ = drive.aligned(drive.fixes)
    summary = bench.cut_summary(bench.cut_rows(drive.shifted(lag), fixes, truth))
    low, high = summary["band"]
    assert low < summary["mean_nees"] < high


@pytest.mark.slow
def test_noise_of_the_imu_is_what_the_fixes_say(drives, drive):
    """Neither half nor double of any density explains the noisy fixes much better; those of gaps explain them best."""
    from benchmarks.imu_likelihood import log_likelihood

    tools, fixes = drives[0], drive.noisy(0)
    taken = log_likelihood(drive, fixes, tools.NOISE, tools.CONFIG)
    for name in ("gyro", "accel", "gyro_walk", "accel_walk"):
        for factor in (0.5, 2.0):
            other = replace(tools.NOISE, **{name: factor * getattr(tools.NOISE, name)})
            assert log_likelihood(drive, fixes, other, tools.CONFIG) < taken + 1.5
    for name in ("held_gyro_noise", "held_accel_noise"):
        for factor in (0.5, 2.0):
            other = replace(tools.CONFIG, **{name: factor * getattr(tools.CONFIG, name)})
            assert log_likelihood(drive, fixes, tools.NOISE, other) < taken

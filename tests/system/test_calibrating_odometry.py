"""Whole runs that begin with a mounting off by 3 deg and 10 cm and a clock off by 15 ms, and estimate both along.

Some of the clocks also drift, and carry the offset away by as much again.
"""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from heliograph.cli.main import main
from heliograph.data import Rig
from heliograph.io.files.extrinsic import write_extrinsic
from heliograph.sim import simulate
from heliograph.sim.write import write_recording
from online_trials import CONFIG, online_trial, scenario

LEVER_UP, DRIFT = "lever arm along imu z", "clock drift"


def nees_limit(trials, share=0.995):
    return chi2.ppf(share, 8 * trials) / trials


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_general_motion_finds_mounting_and_clock(seed):
    trial = online_trial("calibration", seed, duration=14.0)
    assert np.linalg.norm(trial.error[:3]) < np.radians(0.3)
    assert np.linalg.norm(trial.error[3:6]) < 0.03
    assert abs(trial.error[6]) < 0.0015
    assert trial.found.kept_names == (DRIFT,)
    assert np.all(trial.found.sigma[:7] < trial.prior_sigma[:7] / 10.0)
    assert (trial.found.imu_drift, trial.found.sigma[7]) == (0.0, pytest.approx(trial.prior_sigma[7]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["calibration", "planar"])
@pytest.mark.parametrize("drift", [300e-6, -300e-6])
def test_fast_drift_is_followed(kind, drift):
    """The offset changes by 7.5 ms, a hundred times what it is known to; a constant one ends 4 ms or 50 sigmas off."""
    wide = replace(CONFIG, filter=replace(CONFIG.filter, time_drift_sigma_ppm=300.0))
    trial = online_trial(kind, 1, duration=25.0, drift=drift, config=wide)
    assert abs(trial.error[6]) < min(0.5e-3, 3.0 * trial.found.sigma[6])
    assert abs(trial.error[7]) < min(60e-6, 3.0 * trial.found.sigma[7])
    assert DRIFT not in trial.found.kept_names
    assert trial.nees < chi2.ppf(0.999, 8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["calibration", "planar"])
def test_drift_of_a_common_clock_is_found_in_two_minutes(kind):
    trial = online_trial(kind, 1, duration=120.0, drift=50e-6)
    assert abs(trial.error[6]) < min(0.2e-3, 3.0 * trial.found.sigma[6])
    assert abs(trial.error[7]) < 3.0 * trial.found.sigma[7]
    assert trial.found.sigma[7] < 2e-6
    assert trial.nees < chi2.ppf(0.999, 8)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "duration"), [("calibration", 14.0), ("calibration", 28.0), ("planar", 18.0)])
def test_errors_drawn_from_the_prior_fit_the_covariance(kind, duration):
    """From above as chi-square demands; below, the uncertainty given back when the map is begun anew is cautious."""
    nees = [online_trial(kind, seed, duration=duration, drawn=True).nees for seed in range(20, 25)]
    assert 0.1 * 8.0 < np.mean(nees) < nees_limit(len(nees))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_planar_motion_leaves_the_vertical_lever_arm_alone(seed):
    trial = online_trial("planar", seed, duration=18.0)
    assert trial.found.kept_names == (LEVER_UP, DRIFT)
    assert trial.found.sigma[5] == pytest.approx(trial.prior_sigma[5], rel=1e-3)
    assert trial.error[5] == pytest.approx(trial.first_error[5], abs=2e-4)
    turn = trial.R_imu_lidar @ trial.error[:3]
    assert np.linalg.norm(turn[:2]) < np.radians(0.3)
    assert np.linalg.norm(trial.error[3:5]) < 0.03
    assert abs(trial.error[6]) < 0.0015


@pytest.mark.slow
def test_straight_drive_moves_no_rotation_and_no_lever_arm():
    """Nothing turns, so neither is told; the filter as it was would settle somewhere with a small sigma."""
    trial = online_trial("straight", 1, duration=8.0)
    assert set(trial.found.kept_names) >= {f"lever arm along imu {axis}" for axis in "xyz"}
    np.testing.assert_allclose(trial.error[3:6], trial.first_error[3:6], atol=2e-3)
    np.testing.assert_allclose(trial.found.sigma[3:6], trial.prior_sigma[3:6], rtol=1e-2)


@pytest.mark.slow
def test_run_reports_what_it_estimated_only_when_told_to(tmp_path, capsys):
    short = scenario("calibration", 6.0).varied(imu={"clock_offset": 0.015})
    recording = write_recording(tmp_path / "drive", short, 4).folder
    true = simulate(short, 4).rig
    mounting = tmp_path / "mounting.toml"
    write_extrinsic(mounting, Rig(T_imu_lidar=true.T_imu_lidar, source="true"), {})
    told = ["run", str(recording), "--extrinsic", str(mounting), "--quiet", "--set", "cloud.target_points=1500"]
    on = ["--set", "filter.estimate_mounting=true", "--set", "filter.estimate_time_offset=true"]
    assert main([*told, "-o", str(tmp_path / "off")]) == 0
    assert main([*told, *on, "-o", str(tmp_path / "on")]) == 0
    capsys.readouterr()
    plain, facts = (json.loads((tmp_path / name / "run.json").read_text()) for name in ("off", "on"))
    assert "online_calibration" not in plain
    found = facts["online_calibration"]
    assert abs(found["imu_offset_s"] - 0.015) < 0.0015
    assert found["kept_at_start"] == ["clock drift"]
    assert (found["imu_drift_ppm"], found["sigma_imu_drift_ppm"]) == (0.0, pytest.approx(50.0))
    texts = [(tmp_path / name / "scans.csv").read_text() for name in ("off", "on")]
    rows = [list(csv.DictReader(text.splitlines())) for text in texts]
    assert "imu_offset" not in rows[0][0]
    assert float(rows[1][-1]["imu_offset"]) == pytest.approx(found["imu_offset_s"], rel=1e-5)
    assert float(rows[1][0]["sigma_lever_arm_x"]) == pytest.approx(0.1)
    assert int(float(rows[1][0]["directions_kept"])) == 8
    assert float(rows[1][-1]["sigma_imu_drift_ppm"]) == pytest.approx(50.0)
    assert int(rows[1][-1]["end_ns"]) == found["reference_ns"]

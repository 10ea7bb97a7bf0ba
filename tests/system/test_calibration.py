"""Calibration of whole simulated recordings: the bars, honest sigmas, and a run that gets its accuracy back."""

import functools
import json

import numpy as np
import pytest

from calibration_trials import nees_band, recording_trial
from heliograph.calibration import calibrate
from heliograph.cli.main import main
from heliograph.config import RunConfig
from heliograph.data import Rig
from heliograph.io.files.extrinsic import write_extrinsic
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.write import write_recording

pytestmark = pytest.mark.slow

ROTATION, LEVER, OFFSET = np.radians(0.2), 0.01, 5e-4


@functools.cache
def trials_of(scenario):
    return [recording_trial(scenario, seed) for seed in range(100, 106)]


@pytest.mark.parametrize("scenario", ["calibration", "planar"])
def test_calibration_of_recordings_keeps_to_the_bars(scenario):
    for trial in trials_of(scenario):
        assert np.all(np.abs(trial.error[:3]) < ROTATION)
        assert np.linalg.norm(trial.error[3:6]) < LEVER
        assert abs(trial.error[6]) < OFFSET
        names = [axis.name for axis in trial.result.axes if axis.verdict == "not excited"]
        assert names == ([] if scenario == "calibration" else ["lever arm along z"])


@pytest.mark.parametrize("scenario", ["calibration", "planar"])
def test_calibration_of_recordings_keeps_to_its_sigmas(scenario):
    trials = trials_of(scenario)
    low, high = nees_band(sum(trial.told for trial in trials), len(trials), share=0.999)
    assert low < sum(trial.nees for trial in trials) / len(trials) < high


def test_calibration_without_any_start_finds_a_mounting_upside_down():
    rpy = {"rotation_deg": (120.0, 170.0), "lever_arm": (0.1, 0.2)}
    sensors = simulate(SCENARIOS["calibration"].varied(mount=rpy, imu={"clock_offset": -0.015}), 5)
    nothing = Rig(
        T_imu_lidar=np.eye(4), source="unknown", known=False, sigma_rotation=float(np.pi), sigma_translation=0.3
    )
    found = calibrate(iter(sensors), nothing, RunConfig())
    error = np.linalg.inv(found.rig.T_imu_lidar) @ sensors.rig.T_imu_lidar
    assert np.linalg.norm(so3.log(error[:3, :3])) < ROTATION
    assert np.linalg.norm(error[:3, 3]) < LEVER
    assert not found.kept


def test_run_with_the_calibration_gets_its_accuracy_back(tmp_path, capsys):
    exact = SCENARIOS["calibration"]
    late = exact.varied(imu={"clock_offset": 0.025, "clock_drift_ppm": -45.0})
    sensors = simulate(late, 4)
    wrong = sensors.rig.T_imu_lidar.copy()
    wrong[:3, :3] = wrong[:3, :3] @ so3.exp([0.05, -0.05, 0.04])
    wrong[:3, 3] += [0.15, -0.2, 0.1]
    write_extrinsic(tmp_path / "wrong.toml", Rig(T_imu_lidar=wrong, source="wrong"), {})
    late_drive, drive = (
        write_recording(tmp_path / "late", late, 4).folder,
        write_recording(tmp_path / "d", exact, 4).folder,
    )

    def ate(recording, *options):
        out = tmp_path / "run"
        assert main(["run", str(recording), "-o", str(out), "--overwrite", "--quiet", *map(str, options)]) == 0
        capsys.readouterr()
        assert main(["evaluate", str(out), str(recording), "--json"]) == 0
        return json.loads(capsys.readouterr().out)["absolute"]["rmse"]

    command = ["calibrate", str(late_drive), "--extrinsic", str(tmp_path / "wrong.toml"), "-o", str(tmp_path / "c")]
    assert main([*command, "--quiet"]) == 0
    true, before = ate(drive), ate(late_drive, "--extrinsic", tmp_path / "wrong.toml")
    after = ate(late_drive, "--extrinsic", tmp_path / "c" / "extrinsic.toml")
    assert before > 10.0 * true
    assert after < 1.2 * true + 5e-4

"""`heliograph calibrate` on a recording small enough for every run: its files, its words, its refusals."""

import errno
import json

import numpy as np
import pytest

from heliograph.atomic import output_error
from heliograph.io.files.extrinsic import read_extrinsic, write_extrinsic
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.write import write_recording

SCENARIO = SCENARIOS["planar"].thinned(beams=16, columns=180, duration=9.0)
LATE = SCENARIO.varied(imu={"clock_offset": 0.012, "clock_drift_ppm": -30.0})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("calibrate") / "drive", LATE, 2).folder


@pytest.fixture(scope="module")
def calibrated(folder, tmp_path_factory):
    """The command's standard output as JSON, and the folder it wrote."""
    sensors, out = simulate(LATE, 2), tmp_path_factory.mktemp("found")
    wrong = sensors.rig.T_imu_lidar.copy()
    wrong[:3, :3] = wrong[:3, :3] @ so3.exp([0.04, -0.03, 0.02])
    wrong[:3, 3] += [0.1, -0.1, 0.2]
    start = type(sensors.rig)(T_imu_lidar=wrong, source="wrong")
    write_extrinsic(out / "wrong.toml", start, {})
    return sensors, start, out


def test_calibrate_writes_what_run_takes_and_says_what_it_could_not_tell(call, folder, calibrated):
    sensors, start, out = calibrated
    few = ("--set", "calibration.passes=4")  # the start is a few degrees off, not half a turn
    code, text, _ = call("calibrate", folder, "--extrinsic", out / "wrong.toml", "-o", out / "c", "--json", *few)
    assert code == 0
    facts = json.loads(text)
    verdicts = {axis["name"]: axis["verdict"] for axis in facts["axes"]}
    assert verdicts["lever arm along z"] == "not excited"
    assert verdicts["rotation about x"] == verdicts["rotation about y"] == verdicts["clock offset"] == "observed"
    assert "lever arm along (" in facts["kept"][0]
    rig = read_extrinsic(out / "c" / "extrinsic.toml")
    np.testing.assert_allclose(rig.T_imu_lidar, facts["T_imu_lidar"], atol=1e-9)
    assert rig.T_imu_lidar[2, 3] == pytest.approx(start.T_imu_lidar[2, 3], abs=1e-3)
    now = np.int64(rig.clock.reference_ns)
    assert rig.clock.offset == pytest.approx(float(sensors.clock.offset_at(now)), abs=5e-4)
    assert {e["axis"]: e["rate_rms"] > 0.1 for e in facts["excitation"]} == {"x": False, "y": False, "z": True}
    assert (out / "c" / "calibration.json").exists()
    code, _, error = call("calibrate", folder, "-o", out / "c")
    assert code == 2
    assert "holds a calibration already" in error


def test_calibrate_refuses_in_one_line(call, folder, tmp_path):
    for arguments, message in [
        (("calibrate", tmp_path / "none"), "none"),
        (("calibrate", folder, "--duration", "1"), "are too few to calibrate with"),
        (("calibrate", folder, "--set", "calibration.passses=3"), "did you mean 'calibration.passes'"),
        (("calibrate", folder, "--set", "calibration.prior_lever=0"), "prior_lever"),
    ]:
        code, _, error = call(*arguments)
        assert code == 2
        assert error.startswith("error: ")
        assert len(error.splitlines()) == 1
        assert message in error


@pytest.mark.parametrize("options", [(), ("--noise",)])
def test_folder_that_cannot_be_written_is_refused_before_the_work(call, folder, tmp_path, monkeypatch, options):
    (tmp_path / "file").write_text("mine")

    def work(*_, **__):
        raise AssertionError("calibrated for nothing")

    monkeypatch.setattr("heliograph.calibration.calibrate", work)
    monkeypatch.setattr("heliograph.calibration.noise.calibrate_noise", work)
    code, _, error = call("calibrate", folder, "-o", tmp_path / "file", *options)
    assert (code, error.count("\n")) == (2, 1)
    assert "it is a file, not a folder" in error
    assert (tmp_path / "file").read_text() == "mine"
    assert call("calibrate", tmp_path / "none", *options)[0] == 2
    assert not (tmp_path / "none_calibration").exists()


def test_calibration_is_told_although_the_disk_filled_up_meanwhile(call, folder, monkeypatch):
    def full(path, *_, **__):
        raise output_error(path, OSError(errno.ENOSPC, "full"))

    monkeypatch.setattr("heliograph.io.files.extrinsic.write_extrinsic", full)
    code, text, error = call("calibrate", folder, "--set", "calibration.passes=1")
    assert code == 2
    assert "the disk is full" in error
    assert "clock offset" in text
    assert "written to" not in text

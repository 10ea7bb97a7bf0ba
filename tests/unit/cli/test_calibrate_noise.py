"""`heliograph calibrate --noise`: its files, its words, its refusals, and that `run` takes what it writes."""

import csv
import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from heliograph.config import ImuConfig
from heliograph.config_toml import load_config
from heliograph.sim.messages import Messages
from imu_noise import START_NS, resting_imu

FILES = {"noise.toml", "noise.json", "noise.csv", "noise_gyro.svg", "noise_accel.svg"}
LOUD = {"white": 2.5e-3, "walk": 1.5e-3}


def recorded(folder, imu):
    """Write samples as a recording that holds nothing else."""
    messages = Messages()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=messages.store)
        for stamp, data in zip(
            imu.stamps_ns.tolist(), messages.imu(imu.stamps_ns, imu.gyro, imu.accel, "imu"), strict=True
        ):
            writer.write(topic, stamp, data)
    return folder


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    imu = resting_imu(np.random.default_rng(3), duration=150.0, rate=50.0, gyro=LOUD, accel={"white": 2e-3})
    return recorded(tmp_path_factory.mktemp("rest") / "table", imu)


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    imu = resting_imu(np.random.default_rng(4), duration=60.0, rate=50.0)
    t = 1e-9 * (imu.stamps_ns - START_NS)[:, None]
    imu = replace(imu, gyro=imu.gyro + 0.3 * np.sin(2.0 * t), accel=imu.accel + np.sin(3.0 * t))
    return recorded(tmp_path_factory.mktemp("drive") / "drive", imu)


def test_rest_writes_its_files_and_a_table_of_the_axes(call, resting, tmp_path):
    code, out, err = call("calibrate", resting, "--noise")
    assert (code, err) == (0, "")
    folder = tmp_path / "table_calibration"
    assert {path.name for path in folder.iterdir()} == FILES
    lines = out.splitlines()
    assert lines[0] == "150.0 s at 50 Hz; read from 150.0 s at rest from 0.0 s on"
    assert [line[:7] for line in lines[2:10]] == [
        "gyro   ", "gyro x ", "gyro y ", "gyro z ", "accel  ", "accel x", "accel y", "accel z",
    ]  # fmt: skip
    assert "±" in lines[3] and "not seen (<" in lines[7]
    for name in FILES:
        if name.endswith(".svg"):
            ElementTree.parse(folder / name)
    with (folder / "noise.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["tau_s"]) == pytest.approx(0.02)
    assert all(float(r["gyro_x_low"]) < float(r["gyro_x"]) < float(r["gyro_x_high"]) for r in rows)


def test_json_is_one_object_and_the_same_as_the_file(call, resting, tmp_path):
    code, out, _ = call("calibrate", resting, "--noise", "--json", "-o", "out")
    facts = json.loads(out)
    assert code == 0 and facts == json.loads((tmp_path / "out" / "noise.json").read_text())
    assert facts["evidence"] == "rest"
    found = facts["densities"]["gyro"]
    assert abs(found["white"] - 2.5e-3) < 4.0 * found["white_sigma"]
    assert abs(found["walk"] - 1.5e-3) < 4.0 * found["walk_sigma"]
    assert len(facts["axes"]) == 6
    unseen = facts["axes"][3]["K"]
    assert unseen["value"] is None and unseen["sigma"] is None and unseen["upper"] > 0.0


def test_configuration_raises_what_is_loud_and_leaves_what_is_not_seen(call, resting, tmp_path):
    call("calibrate", resting, "--noise", "--quiet", "-o", "out")
    config, default = load_config(tmp_path / "out" / "noise.toml").imu, ImuConfig()
    assert config.gyro_noise == pytest.approx(2.5e-3, rel=0.05)
    assert config.gyro_walk == pytest.approx(1.5e-3, rel=0.5)
    assert (config.accel_noise, config.accel_walk) == (default.accel_noise, default.accel_walk)
    text = (tmp_path / "out" / "noise.toml").read_text()
    assert "# accel_walk: not seen in this recording, not above" in text


def test_motion_is_read_from_its_spectrum_and_says_so(call, moving, tmp_path):
    code, out, _ = call("calibrate", moving, "--noise", "-o", "out")
    assert code == 0
    assert "read from the spectrum above the motion" in out.splitlines()[0]
    assert "info: nothing in these 60 s rests" in out
    facts = json.loads((tmp_path / "out" / "noise.json").read_text())
    assert facts["evidence"] == "motion" and "rest" not in facts
    assert facts["densities"]["accel"]["white"] == pytest.approx(2e-3, rel=0.1)
    assert facts["densities"]["accel"]["walk"] is None and facts["densities"]["accel"]["walk_upper"] is None
    load_config(tmp_path / "out" / "noise.toml")


def test_quiet_says_nothing_about_a_good_rest(call, resting):
    assert call("calibrate", resting, "--noise", "--quiet", "-o", "out") == (0, "", "")


def test_earlier_result_is_kept_unless_told_otherwise(call, resting, tmp_path):
    call("calibrate", resting, "--noise", "-q", "-o", "out")
    before = (tmp_path / "out" / "noise.json").stat().st_mtime_ns
    code, _, err = call("calibrate", resting, "--noise", "-q", "-o", "out")
    assert code == 2 and "add --overwrite" in err and len(err.splitlines()) == 1
    assert (tmp_path / "out" / "noise.json").stat().st_mtime_ns == before
    assert call("calibrate", resting, "--noise", "-q", "-o", "out", "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--duration", "0.2"), "11 IMU samples in a row; a spectrum needs at least 40"),
        (("--imu-topic", "/imu/dta"), "did you mean '/imu/data'"),
        (("--set", "imu.gyro_nose=1"), "did you mean 'imu.gyro_noise'"),
    ],
)
def test_mistakes_end_in_one_line(call, resting, arguments, words):
    code, out, err = call("calibrate", resting, "--noise", *arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert words in err


def test_recording_without_imu_is_refused(call, tmp_path):
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    (clouds / "0.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{axes}end_header\n1 2 3\n")
    code, _, err = call("calibrate", clouds, "--noise")
    assert code == 2 and "no IMU topic" in err and "record a sensor_msgs/Imu" in err


def test_plain_table_is_a_recording_too(call, tmp_path):
    imu = resting_imu(np.random.default_rng(8), duration=30.0, rate=50.0)
    columns = np.column_stack([imu.stamps_ns * 1e-9, imu.gyro, imu.accel])
    header = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
    np.savetxt(tmp_path / "desk.csv", columns, delimiter=",", header=header, comments="", fmt="%.9f")
    code, out, _ = call("calibrate", "desk.csv", "--noise")
    assert code == 0 and out.startswith("30.0 s at 50 Hz; read from 30.0 s at rest")
    assert (tmp_path / "desk_calibration" / "noise.toml").exists()
    code, _, err = call("run", "desk.csv")
    assert code == 2 and "no LiDAR topic" in err and "--sensors imu" in err
    (tmp_path / "notes.txt").write_text("buy milk\n")
    code, _, err = call("calibrate", "notes.txt", "--noise")
    assert code == 2 and "notes.txt" in err and len(err.splitlines()) == 1


def test_run_takes_the_configuration(call, resting, moving, tmp_path, monkeypatch):
    monkeypatch.setattr("heliograph.report.write_report", lambda _: [])
    call("calibrate", resting, "--noise", "-q", "-o", "noise")
    code, _, err = call(
        "run", moving, "--sensors", "imu", "-q", "-o", "run", "--duration", "3", "--config", "noise/noise.toml"
    )
    assert code == 0, err
    assert load_config(tmp_path / "run" / "config.toml").imu.gyro_noise == pytest.approx(2.5e-3, rel=0.05)

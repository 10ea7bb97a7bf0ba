"""`heliograph check`: what it prints, what it returns, and when it refuses."""

import json

import numpy as np
import pytest

from heliograph.checks import IMU_CHECKS
from heliograph.io import open_recording
from heliograph.io.bags.rosbag import RosbagSource
from heliograph.sim import find_scenario
from heliograph.sim.write import write_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scenario = find_scenario("room").thinned(beams=16, columns=128, duration=9.0).varied(walk={"rest": 1.0})
    return write_recording(tmp_path_factory.mktemp("check") / "room", scenario, seed=4).folder


def test_check_of_a_sound_recording_ends_well(call, recording):
    code, out, err = call("check", recording, "--imu")
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == "verdict: ok, nothing to mend"
    for title in ("gyroscope axes", "accelerometer unit", "gaps", "vibration", "prediction"):
        assert title in out


def test_check_prints_one_json_object(call, recording, tmp_path):
    code, out, err = call("check", recording, "--imu", "--json")
    report = json.loads(out)
    assert (code, err) == (0, "") and report["verdict"] == "ok"
    assert len(report["findings"]) == len(IMU_CHECKS)
    assert {"code", "title", "verdict", "evidence", "remedy", "numbers", "stamps_ns"} <= set(report["findings"][0])
    assert report["facts"]["samples"] == 1801 and report["facts"]["scans"] > 80
    assert list(tmp_path.iterdir()) == []  # it only reads


@pytest.mark.slow
def test_check_gives_the_same_twice_and_at_any_number_of_threads(call, recording):
    assert len({call("check", recording, "--json", "--threads", n)[1] for n in (1, 1, 2)}) == 1


def test_bad_verdict_exits_0_and_names_the_first_remedy(call, recording, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")  # sentences are lines all the same
    with open_recording(recording) as opened:
        T = opened.rig.T_imu_lidar
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]
    turned = tmp_path / "turned.toml"
    turned.write_text(f"[T_imu_lidar]\nrotation = {R.tolist()}\ntranslation = {T[:3, 3].tolist()}\n")
    code, out, _ = call("check", recording, "--imu", "--quiet", "--extrinsic", turned)
    assert code == 0
    verdict, first = out.splitlines()
    assert verdict.startswith("verdict: fail, gyroscope axes: x and y swapped")
    assert first.startswith("first: the mounting is wrong, not the IMU")


@pytest.mark.slow
def test_part_of_a_recording_is_checked(call, recording):
    facts = json.loads(call("check", recording, "--json", "--start", 2, "--duration", 5)[1])["facts"]
    assert facts["samples"] == pytest.approx(1000, abs=2) and facts["lidar_seconds"] < 5.0


def test_imu_alone_is_checked(call, recording, monkeypatch):
    begin = RosbagSource.__init__

    def blind(self, *arguments, **options):
        begin(self, *arguments, **options)
        self.topics = tuple(topic for topic in self.topics if topic.kind != "lidar")

    monkeypatch.setattr(RosbagSource, "__init__", blind)
    code, out, _ = call("check", recording, "--json")
    report = json.loads(out)
    found = {finding["code"]: finding for finding in report["findings"]}
    assert code == 0 and report["verdict"] == "ok" and report["facts"]["scans"] == 0
    assert found["imu-gaps"]["verdict"] == "ok" and found["gyro-axes"]["verdict"] == "unknown"
    assert "no LiDAR topic" in found["gyro-axes"]["evidence"]
    assert call("check", recording)[1].splitlines()[-1].endswith("7 of 17 checks could not tell")


@pytest.mark.parametrize(("arguments", "words"), [
    (("nowhere.mcap",), ("nowhere.mcap",)),
    (("room", "--imu-topic", "/nothing"), ("/nothing", "/imu/data")),
    (("a_run",), ("a_run", "no verdicts", "run it again")),
    (("clouds",), ("no IMU",)),
    (("room", "--set", "input.accel_unit=stone"), ("accel_unit",)),
])  # fmt: skip
def test_check_refuses_in_one_line(call, recording, tmp_path, arguments, words):
    (tmp_path / "room").symlink_to(recording)
    (tmp_path / "a_run").mkdir()
    (tmp_path / "a_run" / "run.json").write_text("{}")
    (tmp_path / "clouds").mkdir()
    for k in range(3):
        rows = np.array2string(np.random.default_rng(k).random((4, 3)).ravel()).strip("[]").split()
        header = (
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\nPOINTS 4\nDATA ascii\n"
        )
        lines = "\n".join(" ".join(rows[i : i + 3]) for i in range(0, 12, 3))
        (tmp_path / "clouds" / f"{k:06d}.pcd").write_text(header + lines + "\n")
    code, out, err = call("check", *arguments)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1 and all(word in err for word in words), err


def test_interrupted_check_returns_130(call, recording, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("heliograph.io.recording.Recording.imu_record", interrupt)
    assert call("check", recording)[:2] == (130, "")

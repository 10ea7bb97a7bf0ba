"""`heliograph check` on recordings spoilt as files: through the reader with all that it infers and repairs."""

import json

import doctor
import pytest

from heliograph.cli.main import main
from heliograph.sim import find_scenario
from heliograph.sim.write import write_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scenario = find_scenario("room").thinned(beams=16, columns=256, duration=14.0).varied(walk={"rest": 1.5})
    return write_recording(tmp_path_factory.mktemp("spoilt") / "room", scenario, seed=6).folder


@pytest.fixture
def checked(recording, tmp_path, capsys):
    """Rewrite the recording, check it, and return the report with its findings by code."""

    def run(change):
        folder = doctor.rewrite(recording, tmp_path / "spoilt", change)
        capsys.readouterr()
        assert main(["check", str(folder), "--imu", "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        return report, {finding["code"]: finding for finding in report["findings"]}

    return run


def swapped(message):
    rate = message.angular_velocity
    rate.x, rate.y, rate.z = -rate.x, rate.z, rate.y
    return message


def in_degrees(message):
    for axis in "xyz":
        rate = message.angular_velocity
        setattr(rate, axis, getattr(rate, axis) * 57.29577951308232)
    return message


def in_milli_g(message):
    for axis in "xyz":
        force = message.linear_acceleration
        setattr(force, axis, getattr(force, axis) / 9.80665e-3)
    return message


class Late:
    """Delays the IMU's header stamps by nanoseconds, after ``begin_s`` only."""

    def __init__(self, by_ns, begin_s=-1.0):
        self.by_ns, self.begin_s, self.first = by_ns, begin_s, None

    def __call__(self, topic, at, message):
        self.first = at if self.first is None else self.first
        if topic == doctor.IMU and (at - self.first) * 1e-9 > self.begin_s:
            stamp = message.header.stamp
            total = stamp.sec * 1_000_000_000 + stamp.nanosec + self.by_ns
            stamp.sec, stamp.nanosec = divmod(total, 1_000_000_000)
        yield topic, at, message


@pytest.mark.slow
def test_unit_that_the_reader_converts_is_told(checked):
    report, found = checked(doctor.on_imu(doctor.imu_in_g))
    assert report["verdict"] == "warn" and report["worst"]["code"] == "accel-unit"
    assert "in g" in found["accel-unit"]["evidence"] and "converts" in found["accel-unit"]["evidence"]
    assert found["imu-prediction"]["verdict"] == "ok"


@pytest.mark.slow
def test_swapped_axes_are_named(checked):
    report, found = checked(doctor.on_imu(swapped))
    assert report["worst"]["code"] == "gyro-axes"
    assert found["gyro-axes"]["evidence"].startswith("y and z swapped, x reversed")
    assert "(x, y, z) = (-x, z, y)" in report["worst"]["remedy"]


@pytest.mark.slow
@pytest.mark.parametrize(("change", "code", "words"), [
    (doctor.on_imu(in_degrees), "gyro-unit", "deg/s"),
    (doctor.on_imu(in_milli_g), "accel-unit", "in mg"),
    (Late(40_000_000), "clock-offset", "ms"),
    (Late(200_000_000, 7.0), "imu-clock", "jump once"),
    (Late(-200_000_000, 7.0), "imu-clock", "jump once"),
    (doctor.Gap(6.0, 6.3), "imu-gaps", "a gap of 0.3"),
])  # fmt: skip
def test_spoilt_file_is_told_for_what_it_is(checked, change, code, words):
    report, found = checked(change)
    assert report["worst"]["code"] == code, report["worst"]
    assert words in found[code]["evidence"]


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["velodyne", "hesai", "livox-custom", "no-time"])
@pytest.mark.parametrize("place", ["warehouse", "tunnel", "demo"])
def test_sound_files_raise_no_alarm(place, layout, tmp_path, capsys):
    scenario = find_scenario(place).thinned(beams=32, columns=256, duration=20.0)
    folder = write_recording(tmp_path / "sound", scenario, seed=11, layout=layout).folder
    assert main(["check", str(folder), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    told = [f for f in report["findings"] if f["verdict"] in ("warn", "fail")]
    assert report["verdict"] == "ok", told

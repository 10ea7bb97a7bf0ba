"""The examples run, and show what they promise."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from heliograph.cli.main import app
from heliograph.config import RunConfig
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Symbol, load_graph
from heliograph.lie import se3
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.write import write_recording
from heliograph.slam import KEYFRAMES, KeyframeStore
from heliograph.testing import assert_local_map, assert_odometry, assert_sink, assert_source

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def _run(name, *arguments):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "MPLBACKEND": "Agg"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def _numbers(pattern, text):
    return [float(value) for value in re.findall(pattern, text)]


def test_examples_are_short():
    for script in EXAMPLES.glob("*.py"):
        assert len(script.read_text().splitlines()) <= 60, script.name


def test_run_from_python_tracks_every_scan(tmp_path, short_recording):
    text = _run("run_from_python.py", short_recording, tmp_path / "out.tum")
    scans = int(re.search(r"(\d+) scans", text)[1])
    assert f"'tracked': {scans - 1}" in text
    assert len((tmp_path / "out.tum").read_text().splitlines()) == scans + 1


def test_localize_in_map_finds_the_robot_in_the_third_query():
    text = _run("localize_in_map.py")
    assert text.count(": localised") == 6
    assert max(_numbers(r"([\d.]+) mm off", text)) < 20.0


def test_side_by_side_favours_both_sensors(tmp_path):
    text = _run("side_by_side.py", tmp_path / "figure.png", 8)
    lidar, imu, both = _numbers(r"at most ([\d.]+) m", text)
    assert both < 0.02
    assert both < 0.5 * min(lidar, imu)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


@pytest.mark.slow
def test_deskew_ablation_thins_the_map_with_the_imu():
    rows = [line.split() for line in _run("deskew_ablation.py", 8).splitlines()[1:]]
    thickness = {row[0]: float(row[-1]) for row in rows}
    error = {row[0]: float(row[-2]) for row in rows}
    assert thickness["imu"] < 0.8 * thickness["off"]
    assert error["imu"] < min(error["off"], error["constant"])


def test_own_local_map_tracks():
    text = _run("own_local_map.py", 5)
    scans, matches = _numbers(r"(\d+) (?:scans|matches)", text)
    assert scans > 40
    assert matches > 1000


def test_factor_graph_shows_the_textbook():
    text = _run("factor_graph.py")
    assert "x0 = 0.167" in text
    assert "x1 = 10.333" in text
    assert _numbers(r"gives in by ([\d.]+) m", text) == [0.02]


def test_filter_or_smoother_agree_until_the_loop_closes():
    text = _run("filter_or_smoother.py")
    assert max(_numbers(r"differ by ([\d.e+-]+)", text)) < 1e-12
    least, most = _numbers(r"([\d.]+) (?:to|m)\b", text)[-2:]
    assert 1e-5 < least < most
    assert most > 1.0


def test_imu_and_fixes_are_smoothed_from_a_start_in_motion():
    text = _run("imu_gnss.py")
    assert text.startswith("converged")
    assert _numbers(r"within ([\d.]+) m", text)[0] < 0.7
    bias, sigma = _numbers(r"([\d.]+)(?= \+-|\ rad)", text)
    assert abs(bias - 0.004) < 4.0 * sigma


def test_online_lio_lets_the_false_loop_go():
    text = _run("online_lio.py")
    assert _numbers(r"within ([\d.]+) m", text)[0] < 1.0
    assert text.endswith("let go: X30 to X70\n")


@pytest.mark.slow
def test_tunnel_degeneracy_points_along_the_tunnel(tmp_path):
    text = _run("tunnel_degeneracy.py", tmp_path / "figure.png", 20)
    assert _numbers(r"cosine ([\d.]+)", text)[0] > 0.99
    assert int(re.search(r"(\d+) of", text)[1]) > 50


def test_own_local_map_obeys_the_law(rng, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    from own_local_map import CubeMap

    assert_local_map(CubeMap, rng)


@pytest.mark.parametrize("name", ["own_odometry", "own_source", "own_sink"])
def test_examples_of_seams_are_a_page(name):
    assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) <= 40


def test_own_odometry_obeys_the_law_and_follows_the_walk(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    from own_odometry import make

    scenario = SCENARIOS["room"].thinned(beams=16, columns=128, duration=4.0).varied(walk={"rest": 1.0})
    drive = simulate(scenario, seed=1)
    assert_odometry(lambda: make(RunConfig(), drive.rig), list(drive))
    odometry = make(RunConfig(), drive.rig)
    results = [result for message in drive for result in odometry.add(message)]
    truth = drive.truth.pose(np.array([result.end_ns for result in results]))
    moved = se3.inverse(truth[0]) @ truth[-1]
    found = se3.inverse(results[0].T_odom_imu) @ results[-1].T_odom_imu
    assert np.linalg.norm(moved[:3, 3]) > 0.5
    assert np.linalg.norm(se3.local(found, moved)[3:]) < 0.1


def test_own_source_obeys_the_law_and_runs(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    from own_source import SimulatedDrive

    assert_source(lambda: SimulatedDrive(1.0))
    scans = int(re.search(r"(\d+) scans", _run("own_source.py", 3))[1])
    assert scans == 29


def test_own_sink_obeys_the_law_and_writes_geojson(monkeypatch, tmp_path, short_recording):
    monkeypatch.syspath_prepend(EXAMPLES)
    from own_sink import GeoJsonPath

    assert_sink(lambda: GeoJsonPath(tmp_path / "path.geojson"))
    assert _run("own_sink.py", short_recording, tmp_path / "drive.geojson").startswith("ok")
    feature = json.loads((tmp_path / "drive.geojson").read_text())
    assert feature["geometry"]["type"] == "LineString" and len(feature["geometry"]["coordinates"]) >= 2


def test_align_clouds_names_the_corridor_blind():
    text = _run("align_clouds.py")
    assert "room: converged" in text and "corridor: degenerate" in text
    (x,) = _numbers(r"not observable: translation along \(([-+.\d]+),", text)
    assert abs(x) > 0.98


def test_ros2_node_runs_on_a_recorded_stream_without_ros(short_recording, monkeypatch):
    """The messages are those that rosbags makes of the file: the fields that rclpy's have too."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    monkeypatch.syspath_prepend(EXAMPLES)
    from heliograph.io import open_recording
    from ros2_node import Bridge

    with open_recording(short_recording) as recording:
        rig = recording.rig
    store, results, states = get_typestore(Stores.ROS2_HUMBLE), [], []
    bridge = Bridge(rig, results.append, max_waiting=99)
    with bridge.live, AnyReader([short_recording], default_typestore=store) as reader:
        for connection, _, data in reader.messages():
            if connection.msgtype.endswith(("/PointCloud2", "/Imu")):
                found = reader.deserialize(data, connection.msgtype)
                if connection.msgtype.endswith("/Imu"):
                    states.append(bridge.on_imu(found))
                else:
                    bridge.on_points(found)
    statuses = [result.status for result in results]
    assert len(statuses) >= 38
    assert set(statuses[1:]) == {"tracked"}
    assert bridge.live.pose().stamp_ns >= results[-1].end_ns


def _ros_stand_in(messages, heard):
    """Modules with the names that a node imports: spinning plays recorded messages to who subscribed, then Ctrl-C."""

    class Node:
        def __init__(self, name):
            self.callbacks = {}

        def create_publisher(self, kind, topic, depth):
            return SimpleNamespace(publish=heard.append)

        def create_subscription(self, kind, topic, callback, depth):
            self.callbacks[kind] = callback

        def get_logger(self):
            return SimpleNamespace(info=heard.append)

    def odometry(child_frame_id):
        pose = SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())
        return SimpleNamespace(header=SimpleNamespace(), pose=SimpleNamespace(pose=pose), child_frame_id=child_frame_id)

    def spin(node):
        """A recorded stream has no pace: this one waits for the start, which takes a second of messages."""
        clouds, patience = 0, time.monotonic() + 60.0
        for message in messages:
            kind = type(message).__name__.split("__")[-1]
            node.callbacks[kind](message)
            clouds += kind == "PointCloud2"
            while sum(isinstance(h, str) for h in heard) < clouds - 15 and time.monotonic() < patience:
                time.sleep(0.002)
        raise KeyboardInterrupt

    modules = {
        "rclpy": {"init": lambda: None, "create_node": Node, "spin": spin},
        "rclpy.executors": {"ExternalShutdownException": type("ExternalShutdownException", (Exception,), {})},
        "nav_msgs.msg": {"Odometry": odometry},
        "sensor_msgs.msg": {"Imu": "Imu", "PointCloud2": "PointCloud2"},
    }
    found = {"nav_msgs": ModuleType("nav_msgs"), "sensor_msgs": ModuleType("sensor_msgs")}
    for name, contents in modules.items():
        found[name] = ModuleType(name)
        vars(found[name]).update(contents)
    return found


def test_ros2_node_publishes_poses_at_the_rate_of_the_imu_and_ends_when_interrupted(short_recording, monkeypatch):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    monkeypatch.syspath_prepend(EXAMPLES)
    import ros2_node

    with AnyReader([short_recording], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        messages = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.msgtype.endswith(("/PointCloud2", "/Imu"))
        ]
    heard = []
    for name, module in _ros_stand_in(messages, heard).items():
        monkeypatch.setitem(sys.modules, name, module)
    ros2_node.main()
    lines, poses = [h for h in heard if isinstance(h, str)], [h for h in heard if not isinstance(h, str)]
    assert any("tracked" in line for line in lines)
    assert len(poses) > 2 * len(lines)
    imu = {(m.header.stamp.sec, m.header.stamp.nanosec) for m in messages if hasattr(m, "angular_velocity")}
    assert {(p.header.stamp.sec, p.header.stamp.nanosec) for p in poses} <= imu
    orientation = poses[-1].pose.pose.orientation
    assert np.linalg.norm([orientation.x, orientation.y, orientation.z, orientation.w]) == pytest.approx(1.0)
    assert poses[-1].header.frame_id == "odom" and poses[-1].child_frame_id


@pytest.fixture(scope="module")
def walked_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("walked")
    write_recording(out / "drive", SCENARIOS["room"].thinned(beams=16, columns=128, duration=13.0), seed=1)
    done = CliRunner().invoke(app, ["run", str(out / "drive"), "-o", str(out / "run"), "--quiet"])
    assert done.exit_code == 0, done.output
    return out / "run"


def _keyframes(run):
    store = KeyframeStore.open(run / KEYFRAMES)
    stamps = np.array(store.stamps_ns)
    store.close()
    values = load_graph(run / "graph.npz", factors=SENSOR_FACTORS)[1]
    return stamps, values.at(Symbol("X")(np.arange(len(stamps)))).matrix


def test_barometer_holds_the_height_whatever_the_weather(walked_run, tmp_path):
    stamps, T = _keyframes(walked_run)
    height = 150.0 + T[:, 2, 3]
    pressure = 101_325.0 * (1.0 - height / 44_330.8) ** (1.0 / 0.190263)
    table = np.column_stack([1e-9 * stamps, pressure])
    np.savetxt(tmp_path / "pressure.csv", table, delimiter=",", header="stamp,pressure", fmt="%.9f")
    text = _run("barometer.py", walked_run, tmp_path / "pressure.csv")
    assert text.startswith("converged")
    above, before, after = _numbers(r"(-?[\d.]+) m\b", text)
    assert above == pytest.approx(T[-1, 2, 3], abs=0.005)
    assert after < before


def test_own_sensor_places_its_beacon(walked_run, tmp_path, rng):
    stamps, T = _keyframes(walked_run)
    beacon = np.array([4.0, -3.0, 1.0])
    distance = np.linalg.norm(T[:, :3, :3] @ [0.0, 0.0, 0.2] + T[:, :3, 3] - beacon, axis=1)
    distance[::5] += 3.0  # echoes
    table = np.column_stack([1e-9 * stamps, distance + 0.01 * rng.standard_normal(len(stamps))])
    np.savetxt(tmp_path / "ranges.csv", table, delimiter=",", header="stamp,range", fmt="%.9f")
    text = _run("own_sensor.py", walked_run, tmp_path / "ranges.csv", 4.8, -2.2, 1.5)
    assert text.startswith("converged")
    found = np.array(_numbers(r"(-?[\d.]+) \+-", text))
    sigma = np.array(_numbers(r"\+- ([\d.]+)", text))
    assert (np.abs(found - beacon) < 3.0 * sigma).all()
    assert sigma.min() < 0.5

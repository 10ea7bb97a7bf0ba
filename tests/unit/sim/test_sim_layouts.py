"""Recordings on disk: what each driver's layout holds, read back with the field's own reader."""

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from heliograph.errors import ConfigError, OutputError
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate
from heliograph.sim.layouts import LAYOUTS, find_layout
from heliograph.sim.scenario import from_toml
from heliograph.sim.write import write_recording

SMALL = SCENARIOS["warehouse"].thinned(beams=8, columns=64, duration=0.45)
SEED = 7
FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}

# Fields with offset and PointField datatype, and the bytes of a point: from the drivers' sources, typed here by hand.
WANTED_FIELDS = {
    "ouster": (
        "x 0 7, y 4 7, z 8 7, intensity 16 7, t 20 6, reflectivity 24 4, ring 26 4, ambient 28 4, range 32 6",
        48,
    ),
    "velodyne": ("x 0 7, y 4 7, z 8 7, intensity 12 7, ring 16 4, time 18 7", 22),
    "velodyne-negative": ("x 0 7, y 4 7, z 8 7, intensity 12 7, ring 16 4, time 18 7", 22),
    "hesai": ("x 0 7, y 4 7, z 8 7, intensity 12 7, ring 16 4, timestamp 18 8", 26),
    "robosense": ("x 0 7, y 4 7, z 8 7, intensity 12 7, ring 16 4, timestamp 18 8", 26),
    "livox-pointcloud2": ("x 0 7, y 4 7, z 8 7, intensity 12 7, tag 16 2, line 17 2, timestamp 18 8", 26),
    "no-time": ("x 0 7, y 4 7, z 8 7, intensity 12 7", 16),
}


@pytest.fixture(scope="module")
def sweeps():
    return list(simulate(SMALL, SEED).sweeps())


@pytest.fixture(scope="module", params=LAYOUTS)
def recorded(request, tmp_path_factory):
    out = tmp_path_factory.mktemp(request.param)
    recording = write_recording(out, SMALL, SEED, layout=request.param)
    with AnyReader([out], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        messages = [(c.topic, stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages()]
    return request.param, recording, messages


def columns(message):
    """Points of a message as (xyz, absolute nanoseconds or None), independent of the writer's own tables."""
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    if hasattr(message, "timebase"):
        xyz = np.array([(p.x, p.y, p.z) for p in message.points], np.float32)
        return xyz, message.timebase + np.array([p.offset_time for p in message.points], np.int64)
    fields = {f.name: (FORMATS[f.datatype], f.offset) for f in message.fields}
    dtype = np.dtype(
        {
            "names": list(fields),
            "formats": [f for f, _ in fields.values()],
            "offsets": [o for _, o in fields.values()],
            "itemsize": message.point_step,
        }
    )
    points = np.frombuffer(message.data, dtype)
    assert len(points) == message.height * message.width
    assert message.row_step == message.width * message.point_step
    xyz = np.stack([points[a] for a in "xyz"], axis=1)
    if "t" in fields:
        return xyz, stamp + points["t"].astype(np.int64)
    if "time" in fields:
        return xyz, stamp + np.round(points["time"].astype(np.float64) * 1e9).astype(np.int64)
    if "timestamp" in fields:
        scale = 1e9 if points["timestamp"].max() < 1e12 else 1.0
        return xyz, np.round(points["timestamp"] * scale).astype(np.int64)
    return xyz, None


def sort_rows(*arrays):
    order = np.lexsort(arrays[0].T)
    return [a[order] for a in arrays]


def test_every_layout_holds_the_same_points_and_times(recorded, sweeps):
    name, _, messages = recorded
    clouds = [m for topic, _, m in messages if topic == "/points"]
    assert len(clouds) == len(sweeps) == 4
    for cloud, sweep in zip(clouds, sweeps, strict=True):
        xyz, times = columns(cloud)
        valid = np.isfinite(xyz).all(axis=1) & (xyz != 0.0).any(axis=1)
        scan = sweep.scan()
        want_xyz, want_times = sort_rows(scan.points, scan.stamp_ns + scan.offsets_ns.astype(np.int64))
        if times is None:
            np.testing.assert_array_equal(sort_rows(xyz[valid])[0], want_xyz)
            continue
        got_xyz, got_times = sort_rows(xyz[valid], times[valid])
        np.testing.assert_array_equal(got_xyz, want_xyz)
        assert np.abs(got_times - want_times).max() <= (0 if name in ("ouster", "livox-custom") else 500)


def test_fields_are_the_drivers_own(recorded):
    name, _, messages = recorded
    cloud = next(m for topic, _, m in messages if topic == "/points")
    if name not in WANTED_FIELDS:
        assert LAYOUTS[name].message_type.endswith("/msg/CustomMsg")
        assert cloud.point_num == len(cloud.points) == 8 * 64
        return
    fields, step = WANTED_FIELDS[name]
    assert ", ".join(f"{f.name} {f.offset} {f.datatype}" for f in cloud.fields) == fields
    assert cloud.point_step == step


def test_header_stamp_means_what_the_driver_means(recorded, sweeps):
    name, _, messages = recorded
    cloud = next(m for topic, _, m in messages if topic == "/points")
    stamp = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
    last = int(sweeps[0].offsets_ns[-1]) if name in ("velodyne-negative", "robosense") else 0
    assert stamp == sweeps[0].stamp_ns + last


def test_messages_are_in_causal_order(recorded, sweeps):
    _, _, messages = recorded
    stamps = [stamp for _, stamp, _ in messages]
    assert stamps == sorted(stamps)
    ends = [stamp for topic, stamp, _ in messages if topic == "/points"]
    assert ends == [sweep.end_ns for sweep in sweeps]


def test_imu_messages_carry_the_samples_and_no_orientation(recorded):
    _, recording, messages = recorded
    gyro, accel = simulate(SMALL, SEED).imu()
    imu = [m for topic, _, m in messages if topic == "/imu/data"]
    assert len(imu) == recording.imu_samples
    np.testing.assert_array_equal([[getattr(m.angular_velocity, a) for a in "xyz"] for m in imu], gyro)
    np.testing.assert_array_equal([[getattr(m.linear_acceleration, a) for a in "xyz"] for m in imu], accel)
    assert all(m.orientation_covariance[0] == -1.0 for m in imu)


def test_tf_static_links_imu_and_lidar(recorded):
    _, _, messages = recorded
    edges = next(m for topic, _, m in messages if topic == "/tf_static").transforms
    T = {}
    for edge in edges:
        q, t = edge.transform.rotation, edge.transform.translation
        T[edge.child_frame_id] = np.eye(4)
        T[edge.child_frame_id][:3, :3] = so3.from_quaternion([q.x, q.y, q.z, q.w])
        T[edge.child_frame_id][:3, 3] = t.x, t.y, t.z
    cloud = next(m for topic, _, m in messages if topic == "/points")
    T_imu_lidar = np.linalg.inv(T["imu_link"]) @ T[cloud.header.frame_id]
    np.testing.assert_allclose(T_imu_lidar, simulate(SMALL, SEED).rig.T_imu_lidar, atol=1e-12)


def test_ground_truth_has_a_row_an_imu_sample(recorded):
    _, recording, _ = recorded
    truth = simulate(SMALL, SEED)
    for path, T in (
        (recording.groundtruth_imu, truth.truth.pose(truth.imu_stamps_ns)),
        (recording.groundtruth_lidar, truth.truth.lidar_pose(truth.imu_stamps_ns)),
    ):
        rows = np.loadtxt(path)
        assert rows.shape == (recording.imu_samples, 8)
        np.testing.assert_allclose(rows[:, 1:4], T[:, :3, 3], atol=1e-9)
        np.testing.assert_allclose(so3.from_quaternion(rows[:, 4:]), T[:, :3, :3], atol=1e-8)
        seconds = path.read_text().splitlines()[1].split()[0]
        assert seconds == f"{truth.imu_stamps_ns[0] // 10**9}.{truth.imu_stamps_ns[0] % 10**9:09d}"


def test_scenario_file_reads_back_equal(recorded):
    assert from_toml(recorded[1].scenario.read_text()) == SMALL


def test_file_alone_opens_like_the_folder(recorded):
    _, recording, messages = recorded
    with AnyReader([recording.recording]) as reader:
        assert reader.message_count == len(messages)


def test_same_seed_gives_the_same_file(tmp_path):
    first, again = (write_recording(tmp_path / name, SMALL, SEED) for name in ("a", "b"))
    assert first.recording.read_bytes() == again.recording.read_bytes()
    other = write_recording(tmp_path / "c", SMALL, SEED + 1)
    assert first.recording.read_bytes() != other.recording.read_bytes()


def test_tf_static_can_be_left_out(tmp_path):
    recording = write_recording(tmp_path, SMALL.varied(mount={"tf_static": False}), SEED)
    with AnyReader([recording.recording]) as reader:
        assert [c.topic for c in reader.connections if c.msgcount] == ["/imu/data", "/gnss/fix", "/points"]


def test_progress_counts_the_sweeps(tmp_path):
    seen = []
    write_recording(tmp_path, SMALL, SEED, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(k + 1, 4) for k in range(4)]


def test_existing_recording_is_kept_unless_told_otherwise(tmp_path):
    write_recording(tmp_path, SMALL, SEED)
    with pytest.raises(OutputError, match="already"):
        write_recording(tmp_path, SMALL, SEED)
    write_recording(tmp_path, SMALL, SEED, overwrite=True)


def test_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(OutputError, match="taken"):
        write_recording(tmp_path / "taken", SMALL, SEED)


def test_unknown_layout_is_named_with_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'velodyne'"):
        find_layout("velodine")

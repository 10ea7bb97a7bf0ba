"""Captures and packet topics, with the vendors' packages where they are installed."""

import shutil
import struct
import sys

import numpy as np
import pytest

from heliograph.errors import DataError, FormatError, MissingDependencyError
from heliograph.io.packets.pcap import open_pcap
from heliograph.io.packets.pcapfile import datagram_sizes, is_cut
from heliograph.io.packets.topics import OusterPackets, VelodynePackets
from heliograph.io.raw import RawCloud, RawImu
from heliograph.io.recording import open_recording
from heliograph.io.registry import PacketContext

EMPTY = PacketContext(files=(), topics=(), texts={})
OS0, OS1 = "OS-0-32-U1_v2.2.0_1024x10", "OS-1-128_v2.3.0_1024x10"


@pytest.fixture
def ouster():
    return pytest.importorskip("ouster.sdk.core", reason="ouster-sdk is an extra: pip install --no-deps ouster-sdk")


@pytest.fixture
def velodyne():
    return pytest.importorskip("velodyne_decoder", reason="an extra: pip install heliograph[velodyne]")


def all_messages(source):
    return list(source.messages(frozenset(topic.name for topic in source.topics)))


def ethernet(payload, fragment=0, vlan=False, protocol=17):
    udp = struct.pack(">HHHH", 2368, 2368, len(payload) + 8, 0) + payload
    ip = struct.pack(">BBHHHBBHII", 0x45, 0, 20 + len(udp), 1, fragment, 64, protocol, 0, 1, 2)
    return bytes(12) + (b"\x81\x00\x00\x01" if vlan else b"") + b"\x08\x00" + ip + udp


def pcap(packets, order="<", link=1):
    head = struct.pack(order + "IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    return head + b"".join(struct.pack(order + "IIII", i, 0, len(p), len(p)) + p for i, p in enumerate(packets))


@pytest.mark.parametrize("order", ["<", ">"])
def test_datagram_sizes_are_counted_without_decoding(tmp_path, order):
    packets = [ethernet(bytes(1206)), ethernet(bytes(1206), vlan=True), ethernet(bytes(48)), ethernet(b"", protocol=6)]
    packets += [ethernet(bytes(100), fragment=185), b"\x00" * 20]
    (tmp_path / "a.pcap").write_bytes(pcap(packets, order))
    assert datagram_sizes(tmp_path / "a.pcap") == {1206: 2, 48: 1}
    (tmp_path / "b.pcap").write_bytes(pcap(packets, order)[:-10])
    assert datagram_sizes(tmp_path / "b.pcap") == {1206: 2, 48: 1}
    assert not is_cut(tmp_path / "a.pcap")
    assert is_cut(tmp_path / "b.pcap")


def test_capture_of_an_unknown_sensor_says_what_is_missing(tmp_path):
    (tmp_path / "a.pcap").write_bytes(pcap([ethernet(bytes(1080))] * 3))
    with pytest.raises(FormatError, match=r"packets of 1080 bytes: not Velodyne's, and no Ouster metadata \.json"):
        open_pcap([tmp_path / "a.pcap"])


def test_file_that_only_calls_itself_pcap_is_refused(tmp_path):
    (tmp_path / "a.pcap").write_text("hello world")
    with pytest.raises(FormatError, match="is not a pcap file"):
        open_pcap([tmp_path / "a.pcap"])


def test_other_paths_are_not_captures(tmp_path):
    (tmp_path / "a.bag").touch()
    assert open_pcap([tmp_path / "a.bag"]) is None
    assert open_pcap([tmp_path]) is None


def test_missing_packages_name_the_install_command(tmp_path, shared_data, monkeypatch):
    monkeypatch.setitem(sys.modules, "velodyne_decoder", None)
    monkeypatch.setitem(sys.modules, "ouster.sdk", None)
    formats = shared_data / "formats"
    with pytest.raises(MissingDependencyError, match=r"pip install 'heliograph\[velodyne\]'"):
        open_pcap([formats / "sample_velodyne_hdl32.pcap"])
    with pytest.raises(MissingDependencyError, match="pip install --no-deps 'ouster-sdk"):
        open_pcap([formats / f"{OS0}.pcap"])
    with pytest.raises(MissingDependencyError, match=r"heliograph\[velodyne\]"):
        VelodynePackets(EMPTY)


def test_ouster_packets_without_metadata_say_where_they_may_lie(tmp_path):
    context = PacketContext(files=(tmp_path / "a.bag",), topics=(), texts={})
    with pytest.raises(DataError, match=r"a std_msgs/String topic 'metadata' in the bag, or one \.json"):
        OusterPackets(context)


@pytest.mark.real
@pytest.mark.parametrize(("name", "scans", "rings", "samples"), [(OS0, 1, 32, 10), (f"{OS1}_lb_n3", 3, 128, 30)])
def test_ouster_capture_holds_points_and_si_samples(shared_data, ouster, name, scans, rings, samples):
    source = open_pcap([shared_data / "formats" / f"{name}.pcap"])
    assert [topic.count for topic in source.topics] == [scans, samples]
    messages = all_messages(source)
    clouds = [message for message in messages if isinstance(message, RawCloud)]
    inertial = [message for message in messages if isinstance(message, RawImu)]
    assert (len(clouds), len(inertial)) == (scans, samples)
    for cloud in clouds:
        offsets = cloud.columns["t"]
        assert offsets.min() == 0
        assert (np.diff(offsets.astype(np.int64)) >= 0).all()
        assert offsets.max() == pytest.approx(99.9e6, rel=0.01)
        assert set(np.unique(cloud.columns["ring"])) <= set(range(rings))
        distance = np.linalg.norm([cloud.columns[axis] for axis in "xyz"], axis=0)
        assert 0.1 < distance.min() < distance.max() < 300
        assert abs(cloud.stamp_ns - inertial[0].stamp_ns) < 1_000_000_000
    assert np.linalg.norm(np.mean([sample.accel for sample in inertial], axis=0)) == pytest.approx(9.8, abs=1.0)
    assert np.median(np.diff([sample.stamp_ns for sample in inertial])) == pytest.approx(10e6, rel=1e-3)
    T_imu_lidar, _ = source.factory_T_imu_lidar()
    np.testing.assert_allclose(T_imu_lidar[:3, 3], [-0.006253, 0.011775, -0.007645], rtol=0, atol=1e-12)
    assert source.events == []


@pytest.mark.real
def test_ouster_metadata_are_found_by_the_packets(shared_data, ouster, tmp_path):
    formats = shared_data / "formats"
    capture = shutil.copy(formats / f"{OS1}_lb_n3.pcap", tmp_path / "drive.pcap")
    with pytest.raises(FormatError, match="no Ouster metadata"):
        open_pcap([capture])
    shutil.copy(formats / f"{OS0}.json", tmp_path / "first.json")
    with pytest.raises(FormatError, match=r"fit none of the metadata files beside it \(first\.json\)"):
        open_pcap([capture])
    shutil.copy(formats / f"{OS1}.json", tmp_path / "second.json")
    (tmp_path / "other.json").write_text("[1, 2]")
    assert "second.json" in open_pcap([capture]).description
    shutil.copy(formats / f"{OS1}.json", tmp_path / "third.json")
    with pytest.raises(FormatError, match=r"several metadata files fit it \(second\.json, third\.json\)"):
        open_pcap([capture])
    assert "third.json" in open_pcap([capture, tmp_path / "third.json"]).description


@pytest.mark.real
@pytest.mark.parametrize(("name", "scans", "rings"), [("hdl32", 3, 31), ("vlp16_gps", 4, 16)])
def test_velodyne_capture_holds_points_timed_from_the_sweeps_start(shared_data, velodyne, name, scans, rings):
    source = open_pcap([shared_data / "formats" / f"sample_velodyne_{name}.pcap"])
    clouds = all_messages(source)
    assert len(clouds) == scans == source.topics[0].count
    for cloud in clouds[:-1]:
        assert len(np.unique(cloud.columns["ring"])) == rings
        assert -1e-6 < cloud.columns["time"].min() < 1e-4
        assert cloud.columns["time"].max() == pytest.approx(0.105, abs=0.01)
    steps = np.diff([cloud.stamp_ns for cloud in clouds])
    np.testing.assert_allclose(steps, 105e6, rtol=0.1)
    # The sensor's clock: 12.9 s and 0.37 s behind the recorder's in these two files, less the sweep itself.
    behind = clouds[0].received_ns - clouds[0].stamp_ns
    assert behind == pytest.approx(13.02e9 if name == "hdl32" else 0.47e9, rel=0.01)
    assert source.events == []


@pytest.mark.real
@pytest.mark.parametrize("name", ["sample_velodyne_hdl32", OS0])
def test_capture_cut_short_gives_its_readable_part(shared_data, velodyne, ouster, tmp_path, name):
    whole = (shared_data / "formats" / f"{name}.pcap").read_bytes()
    (tmp_path / f"{name}.pcap").write_bytes(whole[: len(whole) * 2 // 3])
    metadata = shared_data / "formats" / f"{name}.json"
    if metadata.exists():
        shutil.copy(metadata, tmp_path)
    source = open_pcap([tmp_path / f"{name}.pcap"])
    messages = all_messages(source)
    clouds = [message for message in messages if isinstance(message, RawCloud)]
    assert clouds
    assert [event.code for event in source.events] == ["truncated"]


@pytest.mark.real
def test_ouster_packet_bag_opens_as_a_recording(shared_data, ouster):
    with open_recording(shared_data / "formats" / "512x10_raw.bag") as recording:
        measurements = list(recording.stream())
        assert recording.sensors == {"lidar", "imu"}
        assert "Ouster" in recording.rig.source
    scans = [m for m in measurements if hasattr(m, "offsets_ns")]
    assert len(scans) == 1
    assert scans[0].end_ns - scans[0].stamp_ns == pytest.approx(99.8e6, rel=0.01)
    assert sum(len(m) for m in measurements if hasattr(m, "gyro")) == 10


def velodyne_scan(packets, encoding):
    """Encode a VelodyneScan message of ``(stamp_ns, data)``."""
    frame = b"velodyne_front"
    if encoding == "cdr":
        out = bytearray(
            b"\x00\x01\x00\x00" + struct.pack("<II", 5, 6) + struct.pack("<I", len(frame) + 1) + frame + b"\0"
        )
    else:
        out = bytearray(struct.pack("<III", 1, 5, 6) + struct.pack("<I", len(frame)) + frame)

    def align():
        if encoding == "cdr":
            out.extend(bytes(-len(out) % 4))

    align()
    out += struct.pack("<I", len(packets))
    for stamp_ns, data in packets:
        align()
        out += struct.pack("<II", stamp_ns // 10**9, stamp_ns % 10**9) + data
    return memoryview(bytes(out))


@pytest.mark.real
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_velodyne_packet_topic_gives_the_sweeps_of_the_capture(shared_data, velodyne, encoding):
    capture = shared_data / "formats" / "sample_velodyne_vlp16_gps.pcap"
    packets = [(round(stamp * 1e9), data) for stamp, data in velodyne.util.iter_pcap(capture) if len(data) == 1206]
    decoder = VelodynePackets(EMPTY)
    clouds = []
    for start in range(0, len(packets), 75):
        message = velodyne_scan(packets[start : start + 75], encoding)
        clouds += decoder.decode("/velodyne_packets", packets[start][0], message, encoding)
    clouds += decoder.finish()
    expected = all_messages(open_pcap([capture]))
    assert [len(cloud.columns["x"]) for cloud in clouds] == [len(cloud.columns["x"]) for cloud in expected]
    for cloud, wanted in zip(clouds, expected, strict=True):
        assert cloud.frame_id == "velodyne_front"
        assert cloud.topic == "/velodyne_packets"
        np.testing.assert_array_equal(cloud.columns["x"], wanted.columns["x"])
        np.testing.assert_array_equal(cloud.columns["time"], wanted.columns["time"])
        assert abs(cloud.stamp_ns - packets[0][0]) < 1_000_000_000  # the host's clock, not the sensor's


@pytest.mark.real
def test_packet_messages_cut_short_are_data_errors(shared_data, velodyne, ouster):
    packets = velodyne_scan([(0, bytes(1206))] * 3, "ros1")
    with pytest.raises(DataError, match="need more than"):
        VelodynePackets(EMPTY).decode("/velodyne_packets", 0, packets[:-1], "ros1")
    metadata = (shared_data / "formats" / f"{OS0}.json").read_text()
    decoder = OusterPackets(PacketContext(files=(), topics=(), texts={"/ouster/metadata": metadata}))
    message = struct.pack("<I", 8448) + bytes(8000)
    with pytest.raises(DataError, match="packet of 8448 bytes is cut to 8000"):
        decoder.decode("/ouster/lidar_packets", 0, memoryview(message), "ros1")

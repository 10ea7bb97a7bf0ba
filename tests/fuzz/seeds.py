"""Small sound inputs of every kind that is read, made by the simulator and by the writers of Heliograph itself."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import Reader
from tests.bags import T0, VELODYNE, drive, sweep

from heliograph.cli.main import main
from heliograph.graph import ISAM2, Between, Diagonal, FactorGraph, Isotropic, OutlierRejection, Prior, Values
from heliograph.graph.files.archive import save_graph
from heliograph.io.files.clouds import write_cloud
from heliograph.lie import SE3

__all__ = ["make_seeds"]

SCENARIO = """
name = "fuzz"
place = "room"
[walk]
speed = 0.5
duration = 1.0
rest = 0.5
ramp = 0.3
[lidar]
beams = 16
columns = 72
min_range = 0.3
max_range = 40.0
[imu]
rate = 100.0
"""

PLAN = """
[[remove_box]]
low = [1.0, 2.0, 0.5]
high = [2.0, 3.0, 1.5]
[[forbid_loop]]
query = 2
match = 0
"""


def make_seeds(folder: Path) -> Path:
    """Write all seeds into an empty folder and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    _recordings(folder)
    _clouds(folder)
    _tables(folder)
    _graphs(folder)
    _smoothers(folder)
    (folder / "plan.toml").write_text(PLAN)
    settings = ("slam.keyframe_distance=0.03", "output.keyframe_distance=0.05", "output.keep_submaps=true")
    words = [word for setting in settings for word in ("--set", setting)]
    assert main(["run", str(folder / "ouster.mcap"), "-o", str(folder / "run"), "-q", "--threads", "1", *words]) == 0
    assert main(["loops", str(folder / "run"), "--add", "0", "2"]) == 0
    for name in ("report.html", "map.png"):  # large, and read by nobody
        (folder / "run" / name).unlink()
    return folder


def loose_mcap(messages: Iterable[tuple[str, str, int, bytes]]) -> bytes:
    """Return an MCAP file without chunks, compression and checksums, so that its bytes are the messages' own."""

    def record(opcode: int, body: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(body)) + body

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    out, known = b"\x89MCAP0\r\n" + record(1, text("ros2") + text("")), dict[str, int]()
    parts = [out]
    for number, (topic, kind, received_ns, data) in enumerate(messages):
        if topic not in known:
            key = known[topic] = len(known) + 1
            parts.append(record(3, struct.pack("<H", key) + text(kind) + text("ros2msg") + struct.pack("<I", 0)))
            parts.append(record(4, struct.pack("<HH", key, key) + text(topic) + text("cdr") + struct.pack("<I", 0)))
        parts.append(record(5, struct.pack("<HIQQ", known[topic], number, received_ns, received_ns) + data))
    parts += [record(0x0F, struct.pack("<I", 0)), record(2, struct.pack("<QQI", 0, 0, 0)), b"\x89MCAP0\r\n"]
    return b"".join(parts)


def _recordings(folder: Path) -> None:
    (folder / "scenario.toml").write_text(SCENARIO)
    for layout in ("ouster", "livox-custom"):
        bag = folder / f"bag_{layout}"
        assert main(["simulate", str(folder / "scenario.toml"), "-o", str(bag), "-q", "--layout", layout]) == 0
        with Reader(bag) as reader:
            messages = [(c.topic, c.msgtype, t, bytes(data)) for c, t, data in reader.messages()]
        (folder / f"{layout}.mcap").write_bytes(loose_mcap(messages))
        soon = messages[0][2] + 350_000_000  # what is only read through need not be long
        (folder / f"short-{layout}.mcap").write_bytes(loose_mcap(m for m in messages if m[2] < soon))
    short = ("-o", str(folder / "bag_short"), "-q", "--duration", "0.3")
    assert main(["simulate", str(folder / "scenario.toml"), *short]) == 0
    shutil.copy(folder / "bag_short" / "recording.mcap", folder / "chunked.mcap")
    shutil.copy(folder / "bag_ouster" / "groundtruth_imu.tum", folder / "poses.tum")
    bag = drive(5)
    bag.ros1(folder / "plain.bag")
    bag.ros1(folder / "bz2.bag", "bz2")
    bag.ros1(folder / "lz4.bag", "lz4")
    for storage, compression in (("sqlite3", ""), ("sqlite3", "message"), ("mcap", "file")):
        name = f"{storage}_{compression}"
        bag.ros2(folder / name, storage=storage, compression=compression)
    shutil.copy(next((folder / "sqlite3_").glob("*.db3")), folder / "plain.db3")
    shutil.copy(next((folder / "mcap_file").glob("*.zstd")), folder / "packed.mcap.zstd")


def _clouds(folder: Path) -> None:
    points = np.stack([sweep(VELODYNE)[axis] for axis in "xyz"], axis=1).astype(np.float32)
    intensity = np.arange(len(points), dtype=np.float32)
    for suffix in ("ply", "pcd", "las", "laz"):
        write_cloud(folder / f"cloud.{suffix}", points, intensity)
    rows = [f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points[:60].tolist()]
    (folder / "cloud.xyz").write_text("\n".join(rows) + "\n")
    header = (
        "ply\nformat ascii 1.0\nelement vertex 60\nproperty float x\nproperty float y\nproperty double z\nend_header\n"
    )
    (folder / "ascii.ply").write_text(header + "\n".join(rows) + "\n")
    fields = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\nPOINTS 60\n"
    (folder / "ascii.pcd").write_text(fields + "DATA ascii\n" + "\n".join(rows) + "\n")
    packed = points[:60].T.tobytes()
    literal = b"".join(bytes([len(packed[i : i + 32]) - 1]) + packed[i : i + 32] for i in range(0, len(packed), 32))
    sizes = struct.pack("<II", len(literal), len(packed))
    (folder / "packed.pcd").write_bytes(fields.encode() + b"DATA binary_compressed\n" + sizes + literal)
    clouds = folder / "clouds"
    clouds.mkdir()
    for k in range(4):
        write_cloud(clouds / f"{k:04d}.pcd", points, intensity)
    (clouds / "times.txt").write_text("".join(f"{1_700_000_000 + k / 10:.3f}\n" for k in range(4)))
    _kitti(folder / "kitti", points, intensity)
    (folder / "velodyne.pcap").write_bytes(_velodyne())


def _velodyne(packets: int = 160) -> bytes:
    """Return a capture of a VLP-16 at ten turns a second: twelve blocks of two firings a packet."""
    capture, azimuth = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)], 0
    for number in range(packets):
        blocks = b""
        for _ in range(12):
            returns = b"".join(struct.pack("<HB", 2000 + azimuth % 700 + 10 * laser, laser) for laser in range(32))
            blocks += b"\xff\xee" + struct.pack("<H", azimuth) + returns
            azimuth = (azimuth + 40) % 36_000
        payload = blocks + struct.pack("<I", 1_000_000 + 1_327 * number) + b"\x37\x22"
        udp = struct.pack(">HHHH", 2368, 2368, len(payload) + 8, 0) + payload
        ip = struct.pack(">BBHHHBBHII", 0x45, 0, 20 + len(udp), 1, 0, 64, 17, 0, 1, 2)
        frame = bytes(12) + b"\x08\x00" + ip + udp
        received_us = 1_327 * number
        capture.append(struct.pack("<IIII", 1_700_000_000, received_us, len(frame), len(frame)) + frame)
    return b"".join(capture)


def _kitti(folder: Path, points: np.ndarray, intensity: np.ndarray) -> None:
    data = folder / "velodyne_points" / "data"
    data.mkdir(parents=True)
    (folder / "oxts" / "data").mkdir(parents=True)
    dates = "".join(f"2011-09-26 13:02:2{k}.594360375\n" for k in range(4))
    for name in ("timestamps_start.txt", "timestamps.txt", "timestamps_end.txt"):
        (folder / "velodyne_points" / name).write_text(dates)
    (folder / "oxts" / "timestamps.txt").write_text(dates)
    for k in range(4):
        np.column_stack([points, intensity]).astype(np.float32).tofile(data / f"{k:010d}.bin")
        (folder / "oxts" / "data" / f"{k:010d}.txt").write_text(" ".join(["0.1"] * 30) + "\n")
    (folder / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0.1 0.2 0.3\n")


def _tables(folder: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [f"{T0 + 5_000_000 * k},{','.join(f'{v:.5f}' for v in rng.normal(size=6))}" for k in range(300)]
    (folder / "imu.csv").write_text("time_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n" + "\n".join(rows) + "\n")
    turns = "".join(f"1 0 0 {k} 0 1 0 {k * k / 30} 0 0 1 {k % 3}\n" for k in range(30))
    (folder / "poses.kitti").write_text(turns)
    _positions(folder)
    (folder / "params.yaml").write_text(
        "common:\n  lid_topic: /points\n  time_offset_lidar_to_imu: 0.01\nmapping:\n  extrinsic_T: [0.1, 0.2, 0.3]\n"
        "  extrinsic_R: [1, 0, 0,\n                0, 1, 0,\n                0, 0, 1]\n"
    )
    (folder / "extrinsic.toml").write_text(
        "[T_imu_lidar]\ntranslation = [0.1, 0.0, 0.05]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\n"
        "[clock]\noffset = 0.001\ndrift_ppm = 1.0\nreference_ns = 1700000000000000000\n"
    )
    (folder / "config.toml").write_text('sensors = "auto"\nthreads = 1\n[input]\nstart = 0.1\n[map]\nvoxel = 0.5\n')


def _positions(folder: Path) -> None:
    """Fixes of every kind, speeds, and points to be tied to."""
    rows = [f"{1_700_000_000 + k / 5:.2f},48.1{k:04d},11.6,520.{k:02d},1.0,1.0,2.0,fix" for k in range(30)]
    head = "stamp,latitude,longitude,height,sigma_east,sigma_north,sigma_up,solution\n"
    (folder / "fixes.csv").write_text(head + "\n".join(rows) + "\n")
    sentences = [f"GPGGA,1200{k:02d}.00,4806.{k:04d},N,01136.0000,E,4,12,0.8,520.0,M,47.0,M,," for k in range(30)]
    sentences.insert(0, "GPRMC,120000.00,A,4806.0000,N,01136.0000,E,0.0,0.0,141123,,")
    sentences.append("GPGST,120029.00,1.0,0.5,0.5,0.0,0.02,0.02,0.04")
    (folder / "fixes.nmea").write_text("".join(f"${line}*{_parity(line):02X}\r\n" for line in sentences))
    head = "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
    rows = [
        f"2023/11/14 12:00:{k:02d}.000   48.1{k:04d}   11.6000   520.0   1  12   0.01   0.01   0.02" for k in range(30)
    ]
    (folder / "fixes.pos").write_text(head + "\n".join(rows) + "\n")
    rows = [f"{1_700_000_000 + k / 50:.3f},{k / 100},0.0,0.0" for k in range(60)]
    (folder / "wheels.csv").write_text("stamp,vx,vy,vz\n" + "\n".join(rows) + "\n")
    (folder / "control.csv").write_text(
        "id,easting,northing,height,map_x,map_y,map_z,sigma,role\nA,0,0,0,0.1,0,0,0.02,control\n"
        "B,1,0,0,1,0.1,0,0.02,control\nC,,,,0,1,0,,check\n"
    )


def _parity(sentence: str) -> int:
    value = 0
    for letter in sentence.encode():
        value ^= letter
    return value


def _graphs(folder: Path) -> None:
    edges = "".join(f"EDGE_SE2 {k} {k + 1} 1.0 0.0 0.3 10 0 0 10 0 50\n" for k in range(20))
    vertices = "".join(f"VERTEX_SE2 {k} {k}.1 0.2 0.{k:02d}\n" for k in range(21))
    (folder / "graph.g2o").write_text(f"{vertices}{edges}EDGE_SE2 0 20 5.0 1.0 0.1 10 0 0 10 0 50\n")
    information = " ".join("10" if i == j else "0" for i in range(6) for j in range(i, 6))
    spatial = "".join(f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1\n" for k in range(12))
    spatial += "".join(f"EDGE_SE3:QUAT {k} {k + 1} 1 0 0.1 0 0 0.1 0.99 {information}\n" for k in range(11))
    (folder / "spatial.g2o").write_text(spatial + "FIX 0\n")
    toro = "".join(f"VERTEX2 {k} {k} 0 0.1\n" for k in range(8))
    toro += "".join(f"EDGE2 {k} {k + 1} 1 0 0.1 10 0 10 50 0 0\n" for k in range(7))
    (folder / "graph.toro").write_text(toro)
    graph, values = chain(12)
    save_graph(folder / "graph.npz", graph, values)


def chain(count: int, seed: int = 1) -> tuple[FactorGraph, Values]:
    """Return poses in a row with a loop, and their start."""
    rng = np.random.default_rng(seed)
    poses = SE3.exp(rng.normal(size=(count, 6)))
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(count), poses)
    step = Diagonal(np.full(6, 0.1))
    graph.add(Prior(0, poses[0], Isotropic(0.1)))
    keys = np.arange(count - 1)
    graph.add(Between(keys, keys + 1, poses[:-1].inverse() @ poses[1:], step))
    graph.add(Between(0, count - 1, poses[0].inverse() @ poses[-1], step))
    return graph, values


def _smoothers(folder: Path) -> None:
    graph, values = chain(12)
    plain = ISAM2()
    plain.update(graph, values)
    plain.save(folder / "plain.isam2")
    robust = ISAM2(outliers=OutlierRejection())
    robust.update(graph, values)
    more, new = FactorGraph(), Values()
    rng = np.random.default_rng(4)
    new.insert(np.arange(12, 40), SE3.exp(rng.normal(size=(28, 6))))
    for k in range(11, 39):
        more.add(Between(k, k + 1, SE3.exp(rng.normal(size=6)), Diagonal(np.full(6, 0.1))))
    for i, j in ((0, 30), (3, 25), (1, 28)):
        more.add(Between(i, j, SE3.exp(rng.normal(size=6)), Diagonal(np.full(6, 0.1))))
    robust.update(more, new)
    robust.marginalize([2, 3])
    robust.save(folder / "robust.isam2")
    bounded = ISAM2()
    bounded.update(*chain(60, seed=2))
    extra = FactorGraph()
    extra.add(Between(5, 50, SE3.exp(np.full(6, 0.3)), Diagonal(np.full(6, 0.1))))
    bounded.update(extra, max_variables=6)
    bounded.save(folder / "open.isam2")

"""Simulated recordings as files: an MCAP in ROS 2 form, ground truth beside it, and the scenario that made them."""

from __future__ import annotations

import heapq
import re
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from heliograph.atomic import output_error
from heliograph.errors import FormatError, OutputError
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.lie import se3, so3
from heliograph.sim.layouts import SimulatedLayout, find_layout
from heliograph.sim.messages import Messages
from heliograph.sim.scenario import Scenario, from_toml, to_toml
from heliograph.sim.simulate import EPOCH_NS, Simulation

__all__ = ["SimulatedRecording", "read_simulation", "write_recording"]

_Message = tuple[int, int, str, bytes | memoryview]
_TYPES = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/gnss/fix": "sensor_msgs/msg/NavSatFix",
}
_POINTS = "/points"
_WHEELS = "/wheels/odometry"
_IMU_FRAME = "imu_link"
_BODY_FRAME = "base_link"
_ANTENNA_FRAME = "gnss"
_MAX_QUEUE = 64  # messages that wait to be written: about three sweeps with their IMU samples


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRecording:
    """What `write_recording` wrote.

    Parameters
    ----------
    folder : Path
        Holds everything below; itself a ROS 2 bag.
    recording, groundtruth_imu, groundtruth_lidar, scenario : Path
        The files.
    sweeps, imu_samples : int
        Messages written.
    duration : float
        Length of the recording [s].
    """

    folder: Path
    recording: Path
    groundtruth_imu: Path
    groundtruth_lidar: Path
    scenario: Path
    sweeps: int
    imu_samples: int
    duration: float


def write_recording(
    out_dir: Path | str,
    scenario: Scenario,
    seed: int,
    *,
    layout: str = "ouster",
    threads: int = 1,
    compress: bool = True,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SimulatedRecording:
    """Simulate a scenario and write it as a recording.

    Parameters
    ----------
    out_dir : Path
        Made if absent; afterwards it holds ``recording.mcap``, ``metadata.yaml``, ``groundtruth_imu.tum``,
        ``groundtruth_lidar.tum`` (world frame, one row an IMU sample), ``scenario.toml``, and of a scenario with
        wheels ``wheels.csv``.
    scenario : Scenario
        What to simulate.
    seed : int
        The same seed gives the same files, in every layout the same points.
    layout : str
        Key of `heliograph.sim.layouts.LAYOUTS`: which driver's message the points are written as.
    threads : int
        For ray casting.
    compress : bool
        Compress the MCAP's chunks with zstd.
    overwrite : bool
        Replace a recording that is there already.
    progress : callable, optional
        Called with (sweeps done, sweeps in all) after each sweep.

    Raises
    ------
    ConfigError
        If the layout is unknown.
    OutputError
        If the folder cannot be written, or holds a recording and ``overwrite`` is false.
    """
    chosen = find_layout(layout)
    simulation = Simulation(scenario, seed, threads=threads)
    folder = Path(out_dir)
    if (folder / "recording.mcap").exists() and not overwrite:
        raise OutputError(f"{folder} holds a recording already; choose another folder or overwrite it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweeps = _write_files(folder, simulation, chosen, compress=compress, progress=progress)
    except OSError as error:
        raise output_error(folder, error) from error
    return SimulatedRecording(
        folder=folder,
        recording=folder / "recording.mcap",
        groundtruth_imu=folder / "groundtruth_imu.tum",
        groundtruth_lidar=folder / "groundtruth_lidar.tum",
        scenario=folder / "scenario.toml",
        sweeps=sweeps,
        imu_samples=len(simulation.imu_stamps_ns),
        duration=simulation.duration_ns * 1e-9,
    )


def read_simulation(folder: Path | str) -> Simulation | None:
    """Return the simulation that a recording of `write_recording` was made by, None where the folder holds none.

    Raises
    ------
    FormatError
        ``scenario.toml`` cannot be read, or does not begin with the seed.
    ConfigError
        It is no scenario.
    """
    path = Path(folder) / "scenario.toml"
    if not path.is_file():
        return None
    try:
        text = plain_file(path, SETTINGS).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    found = re.match(r"# seed (\d{1,18})\b", text)
    if found is None:
        raise FormatError(path, "does not begin with the line '# seed N' that it was written with")
    return Simulation(from_toml(text), int(found[1]))


def _write_files(
    folder: Path,
    simulation: Simulation,
    layout: SimulatedLayout,
    *,
    compress: bool,
    progress: Callable[[int, int], None] | None,
) -> int:
    """Write all files aside and move them into ``folder`` at the end, so that it never holds half a recording."""
    with TemporaryDirectory(prefix=".simulate-", dir=folder) as scratch:
        aside = Path(scratch) / "recording"  # the writer wants a new folder and names the file after it
        sweeps = _write_bag(aside, simulation, layout, compress=compress, progress=progress)
        stamps, truth = simulation.imu_stamps_ns, simulation.truth
        _write_tum(aside / "groundtruth_imu.tum", "imu", stamps, truth.pose(stamps))
        _write_tum(aside / "groundtruth_lidar.tum", "lidar", stamps, truth.lidar_pose(stamps))
        if simulation.scenario.wheels.rate > 0.0:
            (aside / "wheels.csv").write_text(simulation.wheels().csv(), encoding="utf-8")
        note = f"# seed {simulation.seed}, layout {layout.name}\n"
        (aside / "scenario.toml").write_text(note + to_toml(simulation.scenario), encoding="utf-8")
        for file in sorted(aside.iterdir()):
            file.replace(folder / file.name)
    return sweeps


def _write_bag(
    folder: Path,
    simulation: Simulation,
    layout: SimulatedLayout,
    *,
    compress: bool,
    progress: Callable[[int, int], None] | None,
) -> int:
    """Write the bag into ``folder``, which must not exist; return the number of sweeps."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if compress:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    messages = Messages()
    total, done = simulation.sweep_count(), 0
    pending: deque[Future[None]] = deque()
    with writer, ThreadPoolExecutor(max_workers=1) as pool:
        types = {**_TYPES, _POINTS: layout.message_type}
        if simulation.scenario.wheels.rate > 0.0:
            types[_WHEELS] = "nav_msgs/msg/Odometry"
        connections = {
            topic: writer.add_connection(
                topic,
                kind,
                typestore=messages.store,
                offered_qos_profiles=[_latched_qos()] if topic == "/tf_static" else [],
            )
            for topic, kind in types.items()
        }
        for received_ns, _, topic, data in heapq.merge(
            _transforms(simulation, layout, messages),
            _inertial(simulation, messages),
            _fixes(simulation, messages),
            _speeds(simulation, messages),
            _clouds(simulation, layout, messages),
            key=lambda message: message[:2],
        ):
            # Compression takes about as long as the simulation, so it runs beside it, at most a few sweeps behind.
            pending.append(pool.submit(writer.write, connections[topic], received_ns, data))
            if len(pending) > _MAX_QUEUE:
                pending.popleft().result()
            if topic == _POINTS:
                done += 1
                if progress is not None:
                    progress(done, total)
        for written in pending:
            written.result()
    return done


def _latched_qos() -> Qos:
    """Return the quality of service that late subscribers to /tf_static rely on."""
    forever = QosTime(sec=9223372036, nsec=854775807)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


def _transforms(simulation: Simulation, layout: SimulatedLayout, messages: Messages) -> Iterator[_Message]:
    if not simulation.scenario.mount.tf_static:
        return
    mounting = simulation.mounting
    edges = [
        (_BODY_FRAME, _IMU_FRAME, se3.from_rotation_translation(mounting.R_body_imu, np.zeros(3))),
        (_BODY_FRAME, layout.frame_id, mounting.T_body_lidar),
        (
            _BODY_FRAME,
            _ANTENNA_FRAME,
            se3.from_rotation_translation(np.eye(3), np.array(simulation.scenario.gnss.antenna)),
        ),
    ]
    yield EPOCH_NS, 0, "/tf_static", messages.transforms(EPOCH_NS, edges)


def _inertial(simulation: Simulation, messages: Messages) -> Iterator[_Message]:
    serialised = messages.imu(simulation.imu_clock_ns, *simulation.imu(), _IMU_FRAME)
    for received_ns, data in zip(simulation.imu_stamps_ns.tolist(), serialised, strict=True):
        yield received_ns, 1, "/imu/data", data


def _fixes(simulation: Simulation, messages: Messages) -> Iterator[_Message]:
    for fix in simulation.fixes():
        yield fix.received_ns, 2, "/gnss/fix", messages.fix(fix)


def _speeds(simulation: Simulation, messages: Messages) -> Iterator[_Message]:
    if simulation.scenario.wheels.rate == 0.0:
        return
    log = simulation.wheels()
    for stamp_ns, v_body in zip(log.stamps_ns.tolist(), log.v_body, strict=True):
        yield stamp_ns, 4, _WHEELS, messages.odometry(stamp_ns, v_body, _BODY_FRAME)


def _clouds(simulation: Simulation, layout: SimulatedLayout, messages: Messages) -> Iterator[_Message]:
    for sweep in simulation.sweeps():
        yield sweep.end_ns, 3, _POINTS, messages.cloud(layout, layout.pack(sweep, layout.dtype))


def _write_tum(path: Path, body: str, stamps_ns: NDArray[np.int64], T_world_body: NDArray[np.float64]) -> None:
    """Write ``stamp x y z qx qy qz qw`` rows: seconds with 9 decimals, metres, unit quaternion."""
    rows = np.hstack([T_world_body[:, :3, 3], so3.to_quaternion(T_world_body[:, :3, :3])])
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# T_world_{body}: stamp [s] x y z [m] qx qy qz qw; exact, one row an IMU sample\n")
        for stamp, row in zip(stamps_ns.tolist(), rows.tolist(), strict=True):
            seconds = f"{stamp // 10**9}.{stamp % 10**9:09d}"
            file.write(seconds + " " + " ".join(f"{value:.9f}" for value in row) + "\n")

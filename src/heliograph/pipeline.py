"""Recording -> odometry -> sinks, on one page."""

from __future__ import annotations

import os
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from heliograph.account import Account, Clock
from heliograph.arrays import Stamps
from heliograph.calibration import align_mounting
from heliograph.checkpoint import Checkpoints, Keeper
from heliograph.checks import RunWatch
from heliograph.config import GnssConfig, RunConfig
from heliograph.data import (
    Event,
    GnssFix,
    ImuBatch,
    Message,
    Rig,
    Scan,
    SensorRepair,
    Source,
    WheelSpeeds,
)
from heliograph.errors import CalibrationError, ConfigError, DataError
from heliograph.io.files.fixes import read_fixes
from heliograph.io.files.poses import is_pose_file, read_poses
from heliograph.io.files.wheels import read_wheel_speeds
from heliograph.io.prefetch import prefetch
from heliograph.io.recording import Recording
from heliograph.odometry import FilterOdometry, Odometry, PoseFileOdometry, make_odometry
from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary
from heliograph.repair import RepairedSource, find_repairs
from heliograph.slam import NoSlam, SlamSession

__all__ = ["run", "sensors_in_use", "thread_count"]


def run(
    recording: Source,
    config: RunConfig,
    *,
    sinks: Sequence[Sink] = (),
    stop: Callable[[], bool] = lambda: False,
    odometry: Odometry | None = None,
    opening_seconds: float = 0.0,
    folder: Path | None = None,
    checkpoints: Checkpoints | None = None,
) -> RunSummary:
    """Estimate the trajectory of a recording and hand each scan's result to the sinks.

    Parameters
    ----------
    recording : Source
        As `heliograph.io.open_recording` returns it; read once.
    config : RunConfig
    sinks : sequence of Sink
        Each gets every message, every result, and at the end the summary.
    stop : callable
        Asked after each message; True ends the run early with what is there.
    odometry : Odometry, optional
        An estimator of one's own; by default the one that ``config.odometry`` names.
    opening_seconds : float
        What opening the recording took, for the account [s].
    folder : Path, optional
        Where keyframes and the graph's files are kept; without one they are gone when the run has ended.
    checkpoints : Checkpoints, optional
        Where the run's state is kept now and then; where one was found, the run goes on from it. For an odometry and
        sinks that have a state (`heliograph.snapshots.Part`).

    Raises
    ------
    DataError
        No scan came out of the recording.
    OutputError
        A sink could not write. After any failure, every sink has been closed with what was done till then.
    """
    if config.gnss.use and config.gnss.file:
        read_fixes(config.gnss.file, near_ns=1)  # what is wrong with it is told before the work begins
    speeds = wheel_speeds(recording, config)
    clock, source, repairs = Clock(opening_seconds), recording, tuple[SensorRepair, ...]()
    mends = config.input.repair and odometry is None and not is_pose_file(config.odometry)
    earlier = None if checkpoints is None else checkpoints.found
    if earlier is not None:
        repairs, mends = tuple(earlier["repairs"]), earlier["watchful"]
        source = RepairedSource(recording, repairs) if repairs else recording
    elif mends and any(event.code == "clock-mismatch" for event in recording.events):
        source, repairs, _ = repaired(recording, config, clock, sure=True)
        mends = False
    keeper = Keeper(checkpoints, repairs, watchful=mends)
    account = attempt(source, config, sinks, clock, speeds, stop=stop, odometry=odometry, folder=folder, keeper=keeper)
    if account.suspicious:  # the data contradict each other: see whether that can be mended, and begin anew
        source, repairs, cause = repaired(recording, config, clock)
        for sink in sinks:
            sink.restart()
        keeper = keeper.anew(repairs)
        account = attempt(
            source,
            config,
            sinks,
            clock,
            speeds,
            stop=stop,
            odometry=odometry,
            folder=folder,
            keeper=keeper,
            cause=cause,
        )
    summary = replace(account.summary, repairs=repairs)
    account.close(summary)  # 7. every sink ends with what it has; a failure goes on from here
    return summary


def attempt(
    recording: Source,
    config: RunConfig,
    sinks: Sequence[Sink],
    clock: Clock,
    speeds: WheelSpeeds | None,
    *,
    stop: Callable[[], bool],
    odometry: Odometry | None,
    folder: Path | None,
    keeper: Keeper,
    cause: str = "",
) -> Account:
    """Run once through a recording; a watchful one ends when its data contradict each other.

    ``cause`` says why they do, where nothing could be mended.
    """
    sensors, threads = sensors_in_use(recording, config), thread_count(config)
    watchful = keeper.watchful and recording.repeatable
    account = Account(sinks, clock, RunWatch(sensors, config.check), watchful=watchful)
    # 0. align the sensors where nothing tells
    rig, found = keeper.mounting or mounted(recording, config, sensors, threads, clock, stop)
    odometry = odometry or chosen_odometry(config, rig, sensors, threads)
    chosen_ns = odometry.chosen_ns if isinstance(odometry, PoseFileOdometry) else None
    with back_end(folder, config, sensors, rig, keeper.keyframes, chosen_ns) as slam:
        if speeds is not None:
            slam.observe_speeds(speeds)
            if isinstance(odometry, FilterOdometry):
                odometry.observe_speeds(speeds)
        keeper.follow(account, odometry, slam, rig, found)
        if cause:
            account.tally.add_events((Event(code="imu-cause", message=cause, severity="error"),))
        with account.until_the_end(), closing(messages(recording, sensors, threads)) as stream:
            stream_of_run = islice(with_side_fixes(stream, config.gnss), keeper.messages, None)
            for message in clock.each("reading", stream_of_run):  # 1. the recording's messages, in causal order
                account.observe(message, slam)
                with clock("odometry"):
                    results = odometry.add(message)  # 2. none, one or several scans are ready
                with clock("graph"):
                    slam.add(results)  # 3. keyframes, and the graph of them
                account.add(results)  # 4. count and write them
                ends = account.suspicious or stop()
                with clock("checkpoints"):
                    keeper.passed(message, results, interrupted=ends and not account.suspicious)
                if ends:
                    account.interrupted = not account.suspicious
                    break
            with clock("odometry"):
                results = odometry.finish()  # 5. nothing more comes: the scans that were waiting for it
            with clock("graph"):
                slam.finish(results)
            account.add(results)
        account.end()
        if account.suspicious:
            return account
        account.tally.add_events((*unsolved(recording.events, found), *odometry.events, *slam.events))
        account.conclude(sensors, odometry, slam, config)  # 6. how good is it, and where has it been after all
        if sensors == {"lidar", "imu"}:
            account.summary = replace(account.summary, rig=rig)
    return account


def repaired(
    recording: Source, config: RunConfig, clock: Clock, *, sure: bool = False
) -> tuple[Source, tuple[SensorRepair, ...], str]:
    """Return the recording as it can be mended, and how; itself, nothing and the likely cause where it cannot."""
    with clock("repairs"):
        repairs, cause = find_repairs(recording, config, threads=thread_count(config), sure=sure)
    mended: Source = RepairedSource(recording, repairs) if repairs else recording
    return mended, repairs, cause


@contextmanager
def back_end(
    folder: Path | None,
    config: RunConfig,
    sensors: frozenset[str],
    rig: Rig,
    keyframes: int | None = None,
    chosen_ns: Stamps | None = None,
) -> Iterator[SlamSession | NoSlam]:
    """Yield the back-end of a run; without a LiDAR, or where it is switched off, one that does nothing.

    Its store is empty, or holds the ``keyframes`` of a run that is taken up again. What another system chose as
    keyframes, at ``chosen_ns``, are keyframes.
    """
    given = is_pose_file(config.odometry)
    if not config.slam.graph or "lidar" not in sensors:
        doubted = given and "lidar" in sensors
        yield NoSlam(("nothing compared the poses of the file with the clouds (--no-graph)",) if doubted else ())
        return
    with ExitStack() as stack:
        path = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="heliograph_")))
        kept = folder is not None
        session = SlamSession(
            path, config, poses_given=given, chosen_ns=chosen_ns, kept=kept, antenna_imu=rig.antenna_imu,
            keyframes=keyframes,
        )  # fmt: skip
        stack.callback(session.release)  # also where the run begins anew, or ends in an error
        yield session


def mounted(
    recording: Source,
    config: RunConfig,
    sensors: frozenset[str],
    threads: int,
    clock: Clock,
    stop: Callable[[], bool],
) -> tuple[Rig, tuple[Event, ...]]:
    """Return the recording's rig, or one found from the motion where no source gave it, with what to say."""
    if recording.rig.known or sensors != {"lidar", "imu"}:
        return recording.rig, ()
    if not recording.repeatable:
        raise CalibrationError(
            "the mounting of the LiDAR on the IMU is not known, and a source that is read once only leaves no way to "
            "find it; give T_imu_lidar"
        )

    def from_the_start() -> Iterator[Message]:
        with closing(messages(recording, sensors, threads)) as stream:
            for message in stream:
                if stop():
                    return
                yield message

    with clock("mounting"):
        alignment = align_mounting(from_the_start, config, threads=threads)
    return alignment.rig, alignment.events


def chosen_odometry(config: RunConfig, rig: Rig, sensors: frozenset[str], threads: int) -> Odometry:
    """Return the odometry that ``config.odometry`` names, or the poses of another system where it names a file."""
    path = Path(config.odometry)
    if not is_pose_file(config.odometry):
        return make_odometry(config, rig, sensors, threads)
    body = "imu" if "imu" in sensors else "lidar"
    trajectory = read_poses(path, stamped=True, frame="odom", body=body)
    return PoseFileOdometry(trajectory, config, rig.T_imu_lidar if "imu" in sensors else np.eye(4))


def unsolved(events: Sequence[Event], found: Sequence[Event]) -> list[Event]:
    """Return the recording's events and the alignment's, without the question that the latter has answered."""
    return [event for event in events if not found or event.code != "unknown-mount"] + list(found)


def sensors_in_use(recording: Source, config: RunConfig) -> frozenset[str]:
    """Return the sensors to estimate with: those asked for, or all that the recording holds.

    Raises
    ------
    DataError
        One that was asked for is not in the recording.
    """
    if config.sensors == "auto":
        return recording.sensors & {"lidar", "imu"}
    asked = frozenset(name.strip() for name in config.sensors.split(",") if name.strip())
    if not asked or asked - {"lidar", "imu"}:
        raise ConfigError(f"sensors = '{config.sensors}' is not one of auto, 'lidar,imu', lidar, imu")
    if missing := sorted(asked - recording.sensors):
        held = ", ".join(sorted(recording.sensors)) or "none"
        raise DataError(
            f"sensors '{config.sensors}' were asked for, but the recording holds no {missing[0]} (it holds: {held})"
        )
    return asked


def thread_count(config: RunConfig) -> int:
    """Return the number of threads to use; 0 in the configuration means min(2, cores)."""
    if config.threads < 0:
        raise ConfigError(f"threads = {config.threads} is negative; 0 means min(2, cores)")
    return config.threads or min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


def wheel_speeds(recording: Source, config: RunConfig) -> WheelSpeeds | None:
    """Return the speeds of a topic, or of the file beside the recording, on its clock; None where none is named."""
    if config.wheels.topic and not config.wheels.file:
        if not isinstance(recording, Recording):
            raise DataError(f"wheels.topic {config.wheels.topic}: a live source has none; give wheels.file")
        return recording.speeds(config.wheels)
    if not config.wheels.file:
        return None
    speeds, late_ns = read_wheel_speeds(config.wheels.file), round(1e9 * config.wheels.clock_offset)
    return replace(speeds, stamps_ns=speeds.stamps_ns - late_ns, received_ns=speeds.received_ns - late_ns)


def with_side_fixes(stream: Iterator[Message], config: GnssConfig) -> Iterator[Message]:
    """Yield a recording's messages with the fixes of a file, where one is named, in place of its own."""
    if not config.use or not config.file:
        yield from stream
        return
    fixes: deque[GnssFix] | None = None
    for message in stream:
        if fixes is None:
            fixes = deque(_on_the_recordings_clock(config, message.received_ns))
        while fixes and fixes[0].received_ns <= message.received_ns:
            yield fixes.popleft()
        if not isinstance(message, GnssFix):
            yield message
    yield from fixes or ()


def _on_the_recordings_clock(config: GnssConfig, near_ns: int) -> list[GnssFix]:
    late_ns = round(1e9 * config.clock_offset)
    fixes = read_fixes(config.file, near_ns=near_ns + late_ns)
    return [replace(fix, stamp_ns=fix.stamp_ns - late_ns, received_ns=fix.stamp_ns - late_ns) for fix in fixes]


def messages(recording: Source, sensors: frozenset[str], threads: int) -> Generator[Message, None, None]:
    """Yield the messages of the sensors in use; with a second thread, decoding runs ahead of the estimation."""
    stream = recording.stream()
    if threads > 1:
        stream = prefetch(stream)
    wanted = (*((Scan,) if "lidar" in sensors else ()), *((ImuBatch,) if "imu" in sensors else ()), GnssFix)
    try:
        for message in stream:
            if isinstance(message, wanted):
                yield message
    finally:
        if isinstance(stream, Generator):
            stream.close()

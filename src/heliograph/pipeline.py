"""Recording -> odometry -> sinks, on one page."""

from __future__ import annotations

import os
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliograph.calibration import align_mounting
from heliograph.checks import Finding, RunWatch
from heliograph.config import GnssConfig, RunConfig
from heliograph.data import (
    Event,
    GnssFix,
    GraphAccount,
    ImuBatch,
    Message,
    Rig,
    Scan,
    ScanResult,
    SensorRepair,
    Source,
    WheelSpeeds,
)
from heliograph.errors import CalibrationError, ConfigError, DataError
from heliograph.io.files.fixes import read_fixes
from heliograph.io.files.poses import is_pose_file, read_poses
from heliograph.io.files.wheels import read_wheel_speeds
from heliograph.io.prefetch import prefetch
from heliograph.odometry import Odometry, PoseFileOdometry, make_odometry
from heliograph.output.blind_spans import BlindSpan
from heliograph.output.final_poses import FinalPoses
from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary, Tally, doubts_of, judge
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

    Raises
    ------
    DataError
        No scan came out of the recording.
    OutputError
        A sink could not write. After any failure, every sink has been closed with what was done till then.
    """
    if config.gnss.use and config.gnss.file:
        read_fixes(config.gnss.file, near_ns=1)  # what is wrong with it is told before the work begins
    speeds = wheel_speeds(config)
    clock, source, repairs = Clock(opening_seconds), recording, tuple[SensorRepair, ...]()
    mends = config.input.repair and odometry is None and not is_pose_file(config.odometry)
    if mends and any(event.code == "clock-mismatch" for event in recording.events):
        source, repairs = repaired(recording, config, clock, sure=True)
        mends = False
    account = attempt(source, config, sinks, clock, speeds, stop=stop, odometry=odometry, folder=folder, watchful=mends)
    if account.suspicious:  # the data contradict each other: see whether that can be mended, and begin anew
        source, repairs = repaired(recording, config, clock)
        for sink in sinks:
            sink.restart()
        account = attempt(
            source, config, sinks, clock, speeds, stop=stop, odometry=odometry, folder=folder, watchful=False
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
    watchful: bool,
) -> Account:
    """Run once through a recording; a watchful one ends when its data contradict each other."""
    sensors, threads = sensors_in_use(recording, config), thread_count(config)
    account = Account(sinks, clock, RunWatch(sensors, config.check), watchful=watchful and recording.repeatable)
    rig, found = mounted(recording, config, sensors, threads, clock, stop)  # 0. align the sensors where nothing tells
    odometry = odometry or chosen_odometry(config, rig, sensors, threads)
    with back_end(folder, config, sensors, rig) as slam:
        if speeds is not None:
            slam.observe_speeds(speeds)
        with account.until_the_end(), closing(messages(recording, sensors, threads)) as stream:
            for message in clock.each(
                "reading", with_side_fixes(stream, config.gnss)
            ):  # 1. the recording's messages, in causal order
                account.observe(message, slam)
                with clock("odometry"):
                    results = odometry.add(message)  # 2. none, one or several scans are ready
                with clock("graph"):
                    slam.add(results)  # 3. keyframes, and the graph of them
                account.add(results)  # 4. count and write them
                if account.suspicious or stop():
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
    return account


def repaired(
    recording: Source, config: RunConfig, clock: Clock, *, sure: bool = False
) -> tuple[Source, tuple[SensorRepair, ...]]:
    """Return the recording as it can be mended, and how; itself and nothing where it cannot."""
    with clock("repairs"):
        repairs = find_repairs(recording, config, threads=thread_count(config), sure=sure)
    mended: Source = RepairedSource(recording, repairs) if repairs else recording
    return mended, repairs


@contextmanager
def back_end(
    folder: Path | None, config: RunConfig, sensors: frozenset[str], rig: Rig
) -> Iterator[SlamSession | NoSlam]:
    """Yield the back-end of a run; without a LiDAR, or where it is switched off, one that does nothing."""
    given = is_pose_file(config.odometry)
    if not config.slam.graph or "lidar" not in sensors:
        doubted = given and "lidar" in sensors
        yield NoSlam(("nothing compared the poses of the file with the clouds (--no-graph)",) if doubted else ())
        return
    with ExitStack() as stack:
        path = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="heliograph_")))
        kept = folder is not None
        session = SlamSession(path, config, poses_given=given, kept=kept, antenna_imu=rig.antenna_imu)
        stack.callback(session.store.close)  # also where the run begins anew, or ends in an error
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


def wheel_speeds(config: RunConfig) -> WheelSpeeds | None:
    """Return the speeds of the file beside the recording, on the recording's clock; None where none is named."""
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


class Clock:
    """Adds up the wall time of each stage."""

    def __init__(self, opening_seconds: float = 0.0) -> None:
        self.seconds: dict[str, float] = {"opening": opening_seconds}
        self._start = time.perf_counter() - opening_seconds

    @property
    def wall(self) -> float:
        """Seconds since the recording was opened."""
        return time.perf_counter() - self._start

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a block."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start

    def each(self, stage: str, items: Iterator[Message]) -> Iterator[Message]:
        """Yield ``items``, timing how long each took to come."""
        while True:
            with self(stage):
                item = next(items, None)
            if item is None:
                return
            yield item


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


class Account:
    """What a run has come to so far: results counted and handed to the sinks, time spent, and what ended it.

    Parameters
    ----------
    sinks : sequence of Sink
    clock : Clock
    watch : RunWatch
        Sees messages and results, and gives the verdicts.
    watchful : bool
        Whether the run is to end where the watch finds that the data contradict each other.
    """

    def __init__(self, sinks: Sequence[Sink], clock: Clock, watch: RunWatch, *, watchful: bool) -> None:
        self.clock, self.tally, self.watch = clock, Tally(), watch
        self.summary = RunSummary()
        self.interrupted = False
        self._watchful = watchful
        self.failure: Exception | None = None
        self._sinks = sinks

    @contextmanager
    def until_the_end(self) -> Iterator[None]:
        """Note what ends the block early, Ctrl-C or a failure: what is there by then stays, and is valid."""
        try:
            yield
        except KeyboardInterrupt:
            self.interrupted = True
        except Exception as error:
            self.failure = error

    def observe(self, message: Message, slam: SlamSession | NoSlam) -> None:
        """Show a message to the back-end, to the checks and to the sinks."""
        slam.observe(message)
        self.watch.observe(message)
        with self.clock("writing"):
            for sink in self._sinks:
                sink.observe(message)

    def add(self, results: Sequence[ScanResult]) -> None:
        """Count the results, let the checks look at them, and hand them to the sinks."""
        with self.clock("checks"):
            for result in results:
                self.watch.add(result)
        with self.clock("writing"):
            for result in results:
                self.tally.add(result)
                for sink in self._sinks:
                    sink.add(result)

    @property
    def suspicious(self) -> bool:
        """Whether the run's data contradict each other so early that it had better begin anew."""
        return self._watchful and not self.interrupted and self.failure is None and self.watch.contradicted

    def end(self) -> None:
        """Let the checks look at what the end cut off."""
        with self.clock("checks"):
            try:
                self.watch.close()
            except Exception as error:  # what a check cannot cope with must not cost the result
                self.failure = self.failure or error

    def conclude(
        self, sensors: frozenset[str], odometry: Odometry, slam: SlamSession | NoSlam, config: RunConfig
    ) -> None:
        """Make the run's summary: what was counted, the verdict, the timings, and where it has been after all."""
        tally, graph, moved = self.tally, None, None
        try:
            graph, moved = slam.close(), slam.moved()
        except Exception as error:
            self.failure = self.failure or error
        final = None if moved is None else FinalPoses(**moved._asdict())
        T_map_odom = np.asarray(odometry.leveling(), dtype=np.float64)
        blind = tally.blind.all(T_map_odom[:3, :3])
        gap = None if final is None else tally.gap(final)
        findings, failure = self._verdicts(blind, odometry, graph, gap), self.failure
        status, reasons = judge(
            tally.statuses,
            sensors=sensors,
            held=tally.held,
            against_imu=tally.against_imu,
            interrupted=self.interrupted,
            blind=blind,
            budget=config.check.max_blind_growth,
            doubts=(*slam.doubts, *doubts_of(findings, tally.summary().events)),
        )
        self.summary = tally.summary(
            status=status,
            reasons=reasons,
            interrupted=self.interrupted,
            sensors=tuple(name for name in ("lidar", "imu") if name in sensors),
            blind_spans=blind,
            weakest_direction=T_map_odom[:3, :3] @ tally.weakest[1],
            wall_seconds=self.clock.wall,
            seconds=dict(self.clock.seconds),
            T_map_odom=T_map_odom,
            **({} if final is None else {"final_poses": final, "start_end_gap": gap}),
            findings=findings,
            graph=graph,
            start=odometry.start,
            failure="" if failure is None else str(failure) or type(failure).__name__,
        )

    def _verdicts(
        self, blind: Sequence[BlindSpan], odometry: Odometry, graph: GraphAccount | None, gap: float | None
    ) -> tuple[Finding, ...]:
        counted = self.tally.summary()
        with self.clock("checks"):
            try:
                return self.watch.verdicts(
                    start=odometry.start,
                    graph=graph,
                    blind=[(str(span), span.growth) for span in blind],
                    level_sigma=counted.level.sigma if counted.level.known else float("nan"),
                    distance=counted.distance,
                    gap=counted.start_end_gap if gap is None else gap,
                )
            except Exception as error:
                self.failure = self.failure or error
                return ()

    def close(self, summary: RunSummary) -> None:
        """Close every sink, also after one of them failed; then raise what failed, of a sink before of the run.

        Raises
        ------
        DataError
            Nothing failed, but no scan came out of the recording.
        """
        closing_failure: Exception | None = None
        for sink in self._sinks:
            try:
                sink.close(summary)
            except Exception as error:
                closing_failure = closing_failure or error
        failure = closing_failure or self.failure
        if failure is None and not self.tally.scans and not self.interrupted:
            failure = DataError("no scan came out of the recording; `heliograph info` shows what it holds")
        if failure is not None:
            raise failure

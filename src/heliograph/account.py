"""What a run has come to so far, and where its time went."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from heliograph.checks import Finding, RunWatch
from heliograph.config import RunConfig
from heliograph.data import GraphAccount, Message, ScanResult
from heliograph.errors import DataError
from heliograph.odometry import Odometry
from heliograph.output.blind_spans import BlindSpan
from heliograph.output.final_poses import FinalPoses
from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary, Tally, doubts_of, judge
from heliograph.slam import NoSlam, SlamSession
from heliograph.snapshots import PART, Snapshot, require

__all__ = ["Account", "Clock"]

_STATE = {"tally": PART, "watch": PART, "seconds": {str: float}, "wall": float, "sinks": [dict], "resumed": [int]}


class Clock:
    """Adds up the wall time of each stage."""

    def __init__(self, opening_seconds: float = 0.0) -> None:
        self.seconds: dict[str, float] = {"opening": opening_seconds}
        self._start = time.perf_counter() - opening_seconds

    @property
    def wall(self) -> float:
        """Seconds since the recording was opened."""
        return time.perf_counter() - self._start

    def add(self, seconds: dict[str, float], wall: float) -> None:
        """Count the time that an earlier part of the run took."""
        self._start -= wall
        for stage, spent in seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + spent

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
        self.resumed: tuple[int, ...] = ()
        """Scans that were done each time that the run was taken up again."""

    def snapshot(self) -> Snapshot:
        """Return what was counted and written, with the state of every sink."""
        return {
            "tally": self.tally.snapshot(),
            "watch": self.watch.snapshot(),
            "seconds": self.clock.seconds,
            "wall": self.clock.wall,
            "sinks": [sink.snapshot() for sink in self._sinks],
            "resumed": self.resumed,
        }

    def restore(self, snapshot: Snapshot) -> None:
        """Take up what another run of the same recording had come to; its time counts too.

        Raises
        ------
        DataError
            It is none of a run with such sinks.
        """
        require(self, snapshot, _STATE)
        self.tally.restore(snapshot["tally"])
        self.watch.restore(snapshot["watch"])
        self.clock.add(snapshot["seconds"], snapshot["wall"])
        if len(snapshot["sinks"]) != len(self._sinks):
            raise DataError("the state of a run is one with other sinks")
        for sink, state in zip(self._sinks, snapshot["sinks"], strict=True):
            sink.restore(state)
        self.resumed = (*snapshot["resumed"], self.tally.scans)

    @contextmanager
    def until_the_end(self) -> Iterator[None]:
        """Note what ends the block early, Ctrl-C or a failure: what is there by then stays, and is valid."""
        try:
            yield
        except Exception as error:
            self.failure = error
        except GeneratorExit:
            raise
        except BaseException:  # Ctrl-C, and signals that ask for the end a second time, which are no exceptions of ours
            self.interrupted = True

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
            unsteady=tally.unsteady,
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
            resumed=self.resumed,
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

"""The law of sinks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from heliograph.data import ImuBatch, Scan, ScanResult
from heliograph.lie import se3
from heliograph.odometry import pose_result
from heliograph.output import FinalPoses, RunSummary, Sink
from heliograph.testing.bits import bits

__all__ = ["assert_sink"]

_START_NS, _SCAN_NS, _IMU_NS = 1_700_000_000_000_000_000, 100_000_000, 10_000_000
_SCANS = 12


def assert_sink(make_sink: Callable[[], Sink]) -> None:
    """Assert that a sink stands whatever a run may do: its end, a failure, no scan at all, poses that moved.

    It gets messages and results as the pipeline hands them over: each message before the results that it makes ready,
    results in time order, each once, `close` last and once. It must raise nothing and change nothing of what it gets,
    for others get it too.

    Parameters
    ----------
    make_sink : callable
        Returns a new sink, ready for a run.
    """
    results = _results()
    summary = _summary(results)
    stamps = np.array([result.end_ns for result in results])
    poses = np.stack([result.T_odom_imu for result in results])
    moved = FinalPoses(stamps_ns=stamps, T_odom_imu=poses, T_map_imu=poses @ se3.exp([0.0, 0.0, 0.1, 1.0, 0.0, 0.0]))
    _assert_stands(make_sink(), results, summary, "a whole run")
    _assert_stands(make_sink(), results, _summary(results, final_poses=moved), "a run whose poses moved")
    _assert_stands(make_sink(), results[:3], _summary(results[:3], failure="the disk is full"), "a run that failed")
    _assert_stands(make_sink(), results[:3], _summary(results[:3], interrupted=True), "a run that Ctrl-C ended")
    _assert_stands(make_sink(), (), _summary(()), "a run without a scan")
    empty = [pose_result(_scan(0, points=0), 0, np.eye(4), status="empty")]
    _assert_stands(make_sink(), empty, _summary(empty), "a run of one empty scan")


def _assert_stands(sink: Sink, results: Sequence[ScanResult], summary: RunSummary, case: str) -> None:
    before = [bits(result) for result in results]
    verb = "observe"
    try:
        for index in range(_SCANS):
            verb = "observe"
            for message in (_batch(index), _scan(index)):
                sink.observe(message)
            verb = "add"
            for result in results[index : index + 1]:
                sink.add(result)
        verb = "close"
        sink.close(summary)
    except Exception as error:
        raise AssertionError(f"{case}: {verb} raised {type(error).__name__}: {error}") from error
    for result, as_given in zip(results, before, strict=True):
        assert bits(result) == as_given, f"{case}: the sink changed result {result.index}"


def _results() -> list[ScanResult]:
    """Return the results of a straight drive at 1 m/s."""
    results: list[ScanResult] = []
    for index in range(_SCANS):
        T = se3.exp([0.0, 0.0, 0.0, 0.1 * index, 0.0, 0.0])
        results.append(pose_result(_scan(index), index, T, before=results[-1] if results else None))
    return results


def _summary(results: Sequence[ScanResult], **changes: object) -> RunSummary:
    values = {"scans": len(results), "distance": 0.1 * len(results), "statuses": {"tracked": len(results)}}
    return RunSummary(**(values | changes))  # type: ignore[arg-type]


def _scan(index: int, points: int = 200) -> Scan:
    stamp = _START_NS + index * _SCAN_NS
    cloud = np.random.default_rng(index).uniform(-5.0, 5.0, (points, 3)).astype(np.float32)
    return Scan(
        stamp_ns=stamp,
        header_stamp_ns=stamp,
        received_ns=stamp + _SCAN_NS,
        end_ns=stamp + _SCAN_NS - 1,
        points=cloud,
        offsets_ns=np.zeros(points, dtype=np.int32),
        intensity=np.full(points, 7.0, dtype=np.float32),
    )


def _batch(index: int) -> ImuBatch:
    stamps = np.arange(_START_NS + index * _SCAN_NS, _START_NS + (index + 1) * _SCAN_NS, _IMU_NS)
    force = np.tile([0.0, 0.0, 9.81], (len(stamps), 1))
    return ImuBatch(stamps_ns=stamps, gyro=np.zeros_like(force), accel=force, received_ns=int(stamps[-1]))

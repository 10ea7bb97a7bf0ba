"""The law of odometries."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from heliograph.data import ImuBatch, Message, Scan, ScanResult, StartAccount
from heliograph.odometry import Odometry
from heliograph.testing.bits import bits

__all__ = ["assert_odometry"]

_GAP = (0.4, 0.6)  # part of the messages that a recorder lost, as shares of their number


def assert_odometry(make_odometry: Callable[[], Odometry], messages: Sequence[Message]) -> None:
    """Assert that an odometry's results are causal, in order, each scan once, and the same live and from a file.

    It is run on the messages as they are, with the IMU's samples one by one as a live driver gives them, beside another
    instance that gets the same messages, with a stretch in the middle missing, and with no message at all.

    Parameters
    ----------
    make_odometry : callable
        Returns a new odometry that has seen nothing.
    messages : sequence of Message
        Some seconds of a recording in the order in which they were received. With scans, each must come to a result.
    """
    scans = [message for message in messages if isinstance(message, Scan)]
    results = _followed(make_odometry(), messages, "the messages as they are")
    if scans:
        _assert_each_scan_once(results, scans, "the messages as they are")
    assert results, "no result came of all messages"
    live = _followed(make_odometry(), _one_by_one(messages), "the IMU's samples one by one")
    _assert_same(live, results, "with the IMU's samples one by one")
    _assert_two_do_not_mix(make_odometry, messages, results)
    begin, end = (int(share * len(messages)) for share in _GAP)
    broken = [*messages[:begin], *messages[end:]]
    case = f"messages {begin} to {end} missing"
    results = _followed(make_odometry(), broken, case)
    if scans:
        _assert_each_scan_once(results, [message for message in broken if isinstance(message, Scan)], case)
    nothing = make_odometry()
    _assert_rotation(nothing.leveling(), "leveling before any message")
    assert not nothing.finish(), "an odometry without a message has results"


def _followed(odometry: Odometry, messages: Sequence[Message], case: str) -> list[ScanResult]:
    """Return all results, having watched events and the end."""
    results, events = [], list(odometry.events)
    for message in messages:
        results += odometry.add(message)
        assert list(odometry.events[: len(events)]) == events, f"{case}: an event was taken back or changed"
        events = list(odometry.events)
    results += odometry.finish()
    assert list(odometry.events[: len(events)]) == events, f"{case}: finish took an event back or changed it"
    events = list(odometry.events)
    assert not odometry.finish(), f"{case}: a second finish has results"
    assert list(odometry.events) == events, f"{case}: a second finish adds events"
    _assert_rotation(odometry.leveling(), f"{case}: leveling")
    assert odometry.start is None or isinstance(odometry.start, StartAccount), f"{case}: start is no StartAccount"
    _assert_order(results, case)
    return results


def _assert_order(results: Sequence[ScanResult], case: str) -> None:
    for before, result in zip([None, *results[:-1]], results, strict=True):
        where = f"{case}, result {result.index}"
        assert result.index == (0 if before is None else before.index + 1), f"{where}: indices are not 0, 1, 2 ..."
        assert before is None or result.end_ns > before.end_ns, f"{where}: ends no later than the one before"
        assert len(result.path) > 0, f"{where}: the path is empty"
        assert int(result.path.stamps_ns[-1]) == result.end_ns, f"{where}: the path does not end at the scan's end"
        np.testing.assert_allclose(
            result.path.T_frame_body[-1], result.T_odom_imu, atol=1e-6, err_msg=f"{where}: the path's last pose"
        )
        for name in ("T_odom_imu", "T_odom_imu_header"):
            _assert_pose(getattr(result, name), f"{where}: {name}")
        covariance = result.pose_covariance
        assert np.isfinite(covariance).all(), f"{where}: the covariance is not finite"
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-9, err_msg=f"{where}: the covariance's symmetry")


def _assert_each_scan_once(results: Sequence[ScanResult], scans: Sequence[Scan], case: str) -> None:
    stamps = [result.header_stamp_ns for result in results]
    expected = [scan.header_stamp_ns for scan in scans]
    assert stamps == expected, f"{case}: {len(scans)} scans gave {len(results)} results, not one each in their order"


def _assert_two_do_not_mix(
    make_odometry: Callable[[], Odometry], messages: Sequence[Message], expected: Sequence[ScanResult]
) -> None:
    pair: list[tuple[Odometry, list[ScanResult]]] = [(make_odometry(), []), (make_odometry(), [])]
    for message in messages:
        for odometry, results in pair:
            results += odometry.add(message)
    for odometry, results in pair:
        _assert_same([*results, *odometry.finish()], expected, "beside another instance")


def _assert_same(results: Sequence[ScanResult], expected: Sequence[ScanResult], case: str) -> None:
    assert len(results) == len(expected), f"{case}: {len(results)} results, not {len(expected)}"
    for a, b in zip(results, expected, strict=True):
        for field in dataclasses.fields(ScanResult):
            if field.name != "timings":
                same = bits(getattr(a, field.name)) == bits(getattr(b, field.name))
                assert same, f"{case}: {field.name} of result {b.index} is not the same to the bit"


def _one_by_one(messages: Sequence[Message]) -> list[Message]:
    """Return the messages with each IMU batch cut into its samples."""
    cut: list[Message] = []
    for message in messages:
        if not isinstance(message, ImuBatch):
            cut.append(message)
            continue
        for k in range(len(message)):
            one = slice(k, k + 1)
            arrays = {name: getattr(message, name)[one] for name in ("stamps_ns", "gyro", "accel")}
            cut.append(dataclasses.replace(message, **arrays))
    return cut


def _assert_pose(T: np.ndarray, case: str) -> None:
    assert T.shape == (4, 4), f"{case} has shape {T.shape}, not (4, 4)"
    assert np.isfinite(T).all(), f"{case} is not finite"
    _assert_rotation(np.block([[T[:3, :3], np.zeros((3, 1))], [T[3:]]]), case)


def _assert_rotation(T: np.ndarray, case: str) -> None:
    assert np.shape(T) == (4, 4), f"{case} has shape {np.shape(T)}, not (4, 4)"
    np.testing.assert_array_equal(T[3], [0.0, 0.0, 0.0, 1.0], err_msg=f"{case}: last row")
    np.testing.assert_array_equal(T[:3, 3], 0.0, err_msg=f"{case} moves")
    R = T[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6, err_msg=f"{case} is no rotation")
    assert np.linalg.det(R) > 0.0, f"{case} is a reflection"

"""The law of sources."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence

import numpy as np

from heliograph.data import GnssFix, ImuBatch, Message, Rig, Scan, Source
from heliograph.testing.bits import bits

__all__ = ["assert_source"]

_KINDS: dict[str, type] = {"lidar": Scan, "imu": ImuBatch, "gnss": GnssFix}
_SOME = 5  # messages read before a stream is dropped


def assert_source(make_source: Callable[[], Source]) -> None:
    """Assert that a source streams its sensors in causal order with stamps that fit, anew where it says that it can.

    Parameters
    ----------
    make_source : callable
        Returns the source, freshly opened, with some seconds of data; it is closed, once even twice.
    """
    source = make_source()
    try:
        _assert_description(source)
        first = _read(source, "the first stream")
        _assert_order(first)
        held = frozenset(name for name, kind in _KINDS.items() if any(isinstance(m, kind) for m in first))
        assert held == source.sensors, f"sensors is {sorted(source.sensors)}, but the stream holds {sorted(held)}"
        if source.repeatable:
            _assert_same(_read(source, "the second stream"), first, "the second stream")
    finally:
        source.close()
        source.close()
    source = make_source()
    try:
        stream = source.stream()
        begun = [message for message, _ in zip(stream, range(_SOME), strict=False)]
        _assert_same(begun, first[:_SOME], "a stream of a source opened again")
        _drop(stream)
        if source.repeatable:
            _assert_same(_read(source, "a stream after one dropped"), first, "a stream after one that was dropped")
    finally:
        source.close()


def _assert_description(source: Source) -> None:
    assert isinstance(source.rig, Rig), f"rig is a {type(source.rig).__name__}, not a Rig"
    R = source.rig.T_imu_lidar[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6, err_msg="the rig's rotation is none")
    assert isinstance(source.sensors, frozenset), "sensors is no frozenset"
    unknown = sorted(source.sensors - set(_KINDS))
    assert source.sensors and not unknown, f"sensors names {unknown or 'nothing'}; there are {sorted(_KINDS)}"
    assert isinstance(source.repeatable, bool), "repeatable is neither True nor False"


def _read(source: Source, case: str) -> list[Message]:
    """Return a whole stream, having watched the events."""
    messages, events = [], list(source.events)
    for message in source.stream():
        assert isinstance(message, tuple(_KINDS.values())), f"{case} yields a {type(message).__name__}"
        messages.append(message)
    assert messages, f"{case} is empty"
    codes = [event.code for event in source.events]
    assert all(event.code in codes for event in events), f"{case}: a warning of opening is gone when it has been read"
    return messages


def _assert_order(messages: Sequence[Message]) -> None:
    received, last = None, dict.fromkeys(_KINDS.values(), None)
    for number, message in enumerate(messages):
        case = f"message {number} ({type(message).__name__})"
        assert received is None or message.received_ns >= received, f"{case} was received before the one before it"
        received = message.received_ns
        begin, end = _span(message, case)
        before = last[type(message)]
        assert before is None or begin > before, f"{case} is stamped no later than the one before of its kind"
        last[type(message)] = end


def _span(message: Message, case: str) -> tuple[int, int]:
    """Return the first and the last stamp of a message by which its kind is ordered."""
    if isinstance(message, ImuBatch):
        assert len(message) > 0, f"{case} is empty"
        assert (np.diff(message.stamps_ns) > 0).all(), f"{case}: stamps do not increase"
        return int(message.stamps_ns[0]), int(message.stamps_ns[-1])
    if isinstance(message, Scan):
        assert (message.offsets_ns >= 0).all(), f"{case}: a point is earlier than the sweep's start"
        latest = message.stamp_ns + int(message.offsets_ns.max(initial=0))
        assert message.end_ns >= latest, f"{case} ends at {message.end_ns} ns, before its last point at {latest} ns"
        assert np.isfinite(message.points).all(), f"{case}: points must be finite"
    return message.stamp_ns, message.stamp_ns


def _assert_same(found: Sequence[Message], expected: Sequence[Message], case: str) -> None:
    assert len(found) == len(expected), f"{case} has {len(found)} messages, not {len(expected)}"
    for number, (a, b) in enumerate(zip(found, expected, strict=True)):
        assert bits(a) == bits(b), f"{case}: message {number} differs"


def _drop(stream: Iterator[Message]) -> None:
    if isinstance(stream, Generator):
        stream.close()

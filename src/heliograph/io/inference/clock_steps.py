"""Stamps that jump: one message with a wild stamp is left out, a clock that was set anew is followed.

What tells them from a pause is the order and the times in which the messages were recorded: across a pause both run on,
a stamp that jumps alone is a fault of its clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from heliograph.data import Event
from heliograph.io.raw import RawCloud, RawImu, RawMessage

__all__ = ["ClockFollower"]

_JUMP_NS = 800_000_000  # of a stamp against the times of reception that no queue explains [ns]
_SMALL_NS = 100_000_000  # least step of a clock that is told from a queue by more than its size [ns]
_ALIKE_NS = 20_000_000  # by which two sensors may show the same step differently [ns]
_KNOWN = 8  # messages after which the least delay of a topic is known
_KNOWN_WELL = 20  # and after which a smaller step shows
_LASTING = 3  # messages in a row that make a jump a step of the clock
_LASTING_SMALL, _FAST_NS = 10, 50_000_000  # the same of a small one, for messages that follow each other sooner [ns]


@dataclass(slots=True)
class _Topic:
    """Where one topic's clock is: its last stamp and time of reception as corrected, and by how much it was set.

    The least time from stamp to reception tells a clock that was set forwards from messages that a queue has lost.
    """

    period_ns: int
    stamp_ns: int
    received_ns: int
    least_lag_ns: int
    passed: int = 1
    shift_ns: int = 0
    held: list[RawCloud | RawImu] = field(default_factory=list)


class ClockFollower:
    """Passes messages on in the order in which they were recorded, in clocks that do not jump.

    Parameters
    ----------
    periods_ns : dict of str to int
        Topics to follow, and the usual time from one message to the next [ns].
    """

    def __init__(self, periods_ns: dict[str, int]) -> None:
        self._periods = periods_ns
        self._topics: dict[str, _Topic] = {}
        self._recorder_ns = 0
        self._recorder_last: int | None = None
        self._steps: list[tuple[str, int, int]] = []  # topic, by how much, at which stamp
        self._outliers: dict[str, int] = {}

    def followed(self, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
        """Yield the messages; of a jump that has not shown yet what it is, the first few later."""
        for message in messages:
            received = self._received(message.received_ns)
            if not isinstance(message, RawCloud | RawImu) or message.topic not in self._periods:
                yield message
                continue
            if received != message.received_ns:
                message = replace(message, received_ns=received)
            topic = self._topics.get(message.topic)
            if topic is None:
                lag_ns = received - message.stamp_ns
                self._topics[message.topic] = _Topic(self._periods[message.topic], message.stamp_ns, received, lag_ns)
                yield message
            elif self._jumps(topic, message):
                yield from self._hold(topic, message)
            else:
                held, topic.held = topic.held, []
                if held and abs(_apart(topic, held[0])) <= _JUMP_NS:  # no step: what a queue brought in another order
                    yield from (self._passed(topic, waiting) for waiting in held)
                elif held:
                    self._outliers[message.topic] = self._outliers.get(message.topic, 0) + len(held)
                yield self._passed(topic, message)

    def events(self) -> list[Event]:
        """Return what was followed and what was left out, one event each."""
        found = []
        for name, count in self._outliers.items():
            text = f"{name}: {count} messages with a stamp far off those before and after them were left out"
            found.append(Event(code="stamp-outlier", message=text, count=count))
        for name, step_ns, at_ns in self._steps:
            text = (
                f"{name}: the clock was set by {step_ns * 1e-9:+.3f} s in mid-recording; the messages go on, and "
                f"stamps after it stay in the clock before it: subtract {-step_ns * 1e-9:+.3f} s to find a message "
                "there - keep NTP and PTP from stepping the clock while recording"
            )
            found.append(Event(code="clock-step", message=text, stamp_ns=at_ns, severity="error"))
        return found

    def _received(self, received_ns: int) -> int:
        """Return a time of reception as a recorder's clock that was not set back would have shown it."""
        last = self._recorder_last
        if last is not None and received_ns + self._recorder_ns < last - _JUMP_NS:
            self._recorder_ns = last - received_ns
        corrected = received_ns + self._recorder_ns
        self._recorder_last = corrected if last is None else max(last, corrected)
        return corrected

    def _jumps(self, topic: _Topic, message: RawCloud | RawImu) -> bool:
        step = message.stamp_ns + topic.shift_ns - topic.stamp_ns
        lag_ns = message.received_ns - message.stamp_ns - topic.shift_ns
        apart = _apart(topic, message)
        if abs(apart) <= _JUMP_NS:
            return _jumps_little(topic, step, lag_ns, apart)
        early = topic.passed >= _KNOWN and lag_ns < topic.least_lag_ns - _JUMP_NS // 2
        return early or not 0 < step < 2 * _JUMP_NS

    def _hold(self, topic: _Topic, message: RawCloud | RawImu) -> Iterator[RawMessage]:
        """Hold a message that jumped; when enough follow it alike, the clock was set, and they are passed on."""
        if topic.held:
            first = topic.held[-1]
            apart = (message.stamp_ns - first.stamp_ns) - (message.received_ns - first.received_ns)
            if abs(apart) > _JUMP_NS:  # not even like the one before: that one stood alone
                self._outliers[message.topic] = self._outliers.get(message.topic, 0) + len(topic.held)
                topic.held = []
        topic.held.append(message)
        first = topic.held[0]
        small = abs(_apart(topic, first)) <= _JUMP_NS
        if len(topic.held) < (_LASTING_SMALL if small and topic.period_ns < _FAST_NS else _LASTING):
            return
        if small:  # the quickest delivery before and after tells it better than the times of two messages
            shift_ns = min(held.received_ns - held.stamp_ns for held in topic.held) - topic.least_lag_ns
        else:
            steps = max(1, round((first.received_ns - topic.received_ns) / topic.period_ns))
            shift_ns = topic.stamp_ns + steps * topic.period_ns - first.stamp_ns
        alike = [other.shift_ns for other in self._topics.values() if abs(other.shift_ns - shift_ns) < _ALIKE_NS]
        shift_ns = alike[0] if alike else shift_ns
        self._steps.append((message.topic, topic.shift_ns - shift_ns, first.stamp_ns))
        topic.shift_ns, held, topic.held = shift_ns, topic.held, []
        for waiting in held:
            yield self._passed(topic, waiting)

    def _passed(self, topic: _Topic, message: RawCloud | RawImu) -> RawCloud | RawImu:
        if topic.shift_ns:
            message = replace(message, stamp_ns=message.stamp_ns + topic.shift_ns)
        # A message that is a little late does not turn the topic's clock back.
        topic.stamp_ns = max(topic.stamp_ns, message.stamp_ns)
        topic.received_ns = max(topic.received_ns, message.received_ns)
        topic.passed += 1
        topic.least_lag_ns = min(topic.least_lag_ns, message.received_ns - message.stamp_ns)
        return message


def _apart(topic: _Topic, message: RawCloud | RawImu) -> int:
    """Return by how much more a topic's stamps have run on since its last message than times of reception [ns]."""
    return message.stamp_ns + topic.shift_ns - topic.stamp_ns - (message.received_ns - topic.received_ns)


def _jumps_little(topic: _Topic, step_ns: int, lag_ns: int, apart_ns: int) -> bool:
    """Whether a stamp shows a clock that was set by less than a queue may take.

    No queue delivers sooner than ever before, nor makes stamps run backwards while messages arrive evenly.
    """
    if abs(apart_ns) < _SMALL_NS or topic.passed < _KNOWN_WELL:
        return False
    return bool(topic.held) or (lag_ns < topic.least_lag_ns - _SMALL_NS if apart_ns > 0 else step_ns < 0)

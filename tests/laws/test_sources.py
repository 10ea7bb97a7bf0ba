"""The law of sources holds for recordings, and catches who breaks it."""

from dataclasses import replace

import numpy as np
import pytest

from fakes import FakeRecording
from heliograph.data import Event, ImuBatch, Scan
from heliograph.io import open_recording
from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording
from heliograph.testing import assert_source


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scenario = SCENARIOS["room"].thinned(beams=4, columns=64, duration=1.5)
    return write_recording(tmp_path_factory.mktemp("source") / "room", scenario, seed=1).folder


@pytest.mark.parametrize("sensors", ["auto", "lidar", "imu"])
def test_recording_obeys_the_law_of_sources(recording, sensors):
    if sensors == "auto":
        assert_source(lambda: open_recording(recording))
        return
    with open_recording(recording, sensors=sensors) as opened:
        held = opened.sensors
    assert sensors in held
    assert_source(lambda: open_recording(recording, sensors=sensors))


class Good(FakeRecording):
    def __init__(self, scans=10):
        super().__init__(scans)

    def changed(self, messages):
        return messages

    def stream(self):
        yield from self.changed(list(super().stream()))


class Reordered(Good):
    def changed(self, messages):
        return [*messages[:4], messages[5], messages[4], *messages[6:]]


class Repeating(Good):
    def changed(self, messages):
        return [*messages[:6], messages[5], *messages[6:]]


class Early(Good):
    """Points before the sweep's start, where offsets would have to be negative."""

    def changed(self, messages):
        return [replace(m, offsets_ns=np.full(len(m), -5, np.int32)) if isinstance(m, Scan) else m for m in messages]


class Short(Good):
    """The sweep ends before its last point."""

    def changed(self, messages):
        late = 200_000_000
        return [replace(m, offsets_ns=np.full(len(m), late, np.int32)) if isinstance(m, Scan) else m for m in messages]


class Holes(Good):
    def changed(self, messages):
        return [
            replace(m, points=np.full((len(m), 3), np.nan, np.float32)) if isinstance(m, Scan) else m for m in messages
        ]


class Silent(Good):
    """Says that it has an IMU, and has none."""

    def changed(self, messages):
        return [m for m in messages if not isinstance(m, ImuBatch)]


class ReadOnce(Good):
    """Says that it can be read again, and is then empty."""

    done = False

    def changed(self, messages):
        first, self.done = not self.done, True
        return messages if first else messages[:3]


class Growing(Good):
    """Goes on where it was left: the second stream has other stamps."""

    runs = 0

    def changed(self, messages):
        self.runs += 1
        return [replace(m, received_ns=m.received_ns + self.runs) for m in messages]


class Foreign(Good):
    def changed(self, messages):
        return [*messages, "end"]


class Denying(Good):
    """Takes back what opening had to say."""

    def __init__(self):
        super().__init__()
        self.events = [Event(code="opened", message="slowly")]

    def changed(self, messages):
        self.events = []
        return messages


class Nameless(Good):
    def __init__(self):
        super().__init__()
        self.sensors = frozenset({"radar"})


class ClosedOnce(Good):
    def close(self):
        assert not self.closed or not hasattr(self, "shut"), "closed already"
        self.shut = True


def test_law_of_sources_accepts_one_that_is_read_once():
    class Live(Good):
        repeatable, begun = False, False

        def changed(self, messages):
            assert not self.begun, "read twice"
            self.begun = True
            return messages

    assert_source(Good)
    assert_source(Live)


@pytest.mark.parametrize(
    ("violator", "words"),
    [
        (Reordered, "received before"),
        (Repeating, "no later than the one before"),
        (Early, "earlier than the sweep's start"),
        (Short, "before its last point"),
        (Holes, "points must be finite"),
        (Silent, "sensors is"),
        (ReadOnce, "second stream has 3 messages"),
        (Growing, "message 0 differs"),
        (Foreign, "yields a str"),
        (Denying, "warning of opening is gone"),
        (Nameless, "sensors names"),
        (ClosedOnce, "closed already"),
    ],
)
def test_law_of_sources_catches(violator, words):
    with pytest.raises(AssertionError, match=words):
        assert_source(violator)

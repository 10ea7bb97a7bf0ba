"""A source of one's own, arrays from any place as a recording: python own_source.py [SECONDS]."""

import sys
from collections.abc import Iterator

from heliograph.config import RunConfig
from heliograph.data import Event, Message, Rig
from heliograph.pipeline import run
from heliograph.sim import SCENARIOS, simulate


class SimulatedDrive:
    """A `heliograph.io.Source` that needs no file; `heliograph.testing.assert_source` checks such a class.

    A live driver yields the same records: `Scan` and `ImuBatch` in SI units, as they come in.
    """

    sensors = frozenset({"lidar", "imu"})
    repeatable = True  # a live stream says False: it cannot be read twice

    def __init__(self, seconds: float) -> None:
        self.drive = simulate(SCENARIOS["room"].thinned(columns=256, duration=seconds), seed=1)
        self.rig: Rig = self.drive.rig
        self.events: list[Event] = []

    def stream(self) -> Iterator[Message]:
        kinds = {"Scan": "lidar", "ImuBatch": "imu"}
        return (message for message in self.drive if kinds.get(type(message).__name__) in self.sensors)

    def close(self) -> None:
        """Nothing is held open."""


if __name__ == "__main__":
    summary = run(SimulatedDrive(float([*sys.argv, "8"][1])), RunConfig())
    print(f"{summary.status}: {summary.scans} scans, {summary.distance:.2f} m")

"""Where results go: files, a viewer, a test's list; `heliograph.testing.assert_sink` is the law."""

from __future__ import annotations

from typing import Protocol

from heliograph.data import Message, ScanResult
from heliograph.output.summary import RunSummary
from heliograph.snapshots import Snapshot

__all__ = ["Sink"]


class Sink(Protocol):
    """Takes what a run produces, in order. Inherit from it to get verbs that do nothing, then write the ones you need.

    Examples
    --------
    >>> class Heights(Sink):
    ...     def __init__(self) -> None:
    ...         self.heights: list[float] = []
    ...
    ...     def add(self, result: ScanResult) -> None:
    ...         self.heights.append(float(result.T_odom_imu[2, 3]))
    """

    def observe(self, message: Message) -> None:  # noqa: ARG002
        """Take a message of the recording, before the odometry gets it."""
        return

    def add(self, result: ScanResult) -> None:  # noqa: ARG002
        """Take one scan's result; results come in time order, each once."""
        return

    def restart(self) -> None:
        """Forget all that came: the recording was found to be faulty, and comes again from the start, mended."""
        return

    def snapshot(self) -> Snapshot:
        """Return what the next results depend on, for a run that goes on after it was cut off."""
        return {}

    def restore(self, snapshot: Snapshot) -> None:  # noqa: ARG002
        """Take up what `snapshot` of an earlier one returned, in place of all that came before it."""
        return

    def close(self, summary: RunSummary) -> None:  # noqa: ARG002
        """Finish, whatever ended the run: its end, Ctrl-C, or a failure of this or another sink."""
        return

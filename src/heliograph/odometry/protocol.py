"""What every odometry does; `heliograph.testing.assert_odometry` is its law."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Event, Message, ScanResult, StartAccount

__all__ = ["Odometry"]


class Odometry(Protocol):
    """Causal estimation: messages go in as they were received, results come out when they are ready.

    Inherit from it to get the verbs that have an answer for those who know nothing about the matter.

    Attributes
    ----------
    events : list of Event
        What a user should know, beside the events of single results. It grows only.
    start : StartAccount or None
        How it began; None as long as it has not, or where it does not tell.
    """

    events: list[Event]
    start: StartAccount | None = None

    @abstractmethod
    def add(self, message: Message) -> list[ScanResult]:
        """Take one message and return the results that it made ready, in time order; often none.

        What is returned is the same, to the bit, however the IMU's samples are cut into batches.
        """
        ...

    def finish(self) -> list[ScanResult]:
        """Return the results still waiting: the stream has ended. A second call returns none."""
        return []

    def leveling(self) -> NDArray[np.float64]:
        """Return ``T_leveled_odom`` (4, 4): the rotation that puts z up by all that was learnt about gravity."""
        return np.eye(4)

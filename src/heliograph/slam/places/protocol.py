"""What a place recogniser must do; `heliograph.testing.assert_loop_detector` is its law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Mask, Points, freeze

__all__ = ["Descriptor", "LoopDetector", "PlaceMatch"]

Descriptor = NDArray[np.uint8]
"""What is kept of a keyframe, (D,) bytes: the same length for every keyframe of one detector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceMatch:
    """An earlier keyframe that looks like the query, and where the query would then be.

    Parameters
    ----------
    index : int
        The keyframe's, as it was added.
    score : float
        Likeness in [0, 1]; it ranks, and decides nothing.
    T_match_query : (4, 4) float64
        Guess of the query in the match's frame, both levelled: z up, x along the body's heading.
    yaw_only : bool
        Whether only the turn about the vertical was estimated; the translation is then zero.
    """

    index: int
    score: float
    T_match_query: Array
    yaw_only: bool = False

    def __post_init__(self) -> None:
        freeze(self)


@runtime_checkable
class LoopDetector(Protocol):
    """Descriptors of the keyframes so far, and the search among them.

    Clouds are in the keyframe's levelled body frame: z up, x along the body's heading, the origin at the IMU. They may
    be a single scan's or those of a local map of the last keyframes.
    """

    def describe(self, points_level: Points) -> Descriptor:
        """Return the descriptor of a cloud (N, 3); NaN is left out, and an empty cloud has one too."""
        ...

    def add(self, index: int, descriptor: Descriptor) -> None:
        """Remember a keyframe by its index and descriptor: one just made, or one out of a store."""
        ...

    def query(self, points_level: Points, *, allowed: Mask, top: int) -> tuple[PlaceMatch, ...]:
        """Return at most ``top`` of the ``allowed`` keyframes, the most alike first.

        Parameters
        ----------
        points_level : (N, 3) float32
            The query [m].
        allowed : (K,) bool
            One entry a keyframe, in the order in which they were added.
        top : int
            Largest number of matches.
        """
        ...

    def __len__(self) -> int:
        """Return the number of keyframes that were added."""
        ...

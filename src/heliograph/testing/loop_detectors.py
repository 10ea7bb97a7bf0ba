"""The law of loop detectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from heliograph.arrays import Array, Points
from heliograph.lie import se3, so3
from heliograph.slam.places import LoopDetector, PlaceMatch

__all__ = ["assert_loop_detector"]

_PLACES = 6


def assert_loop_detector(make_detector: Callable[[], LoopDetector], rng: np.random.Generator) -> None:
    """Assert that a detector finds the yards it was shown, turned too, and nothing that it may not find.

    Each yard has walls of its own. The turn of its guess must be right to 15 degrees and, unless it says that only the
    turn was estimated, the position to 1.5 m. Descriptors have one length and come back from bytes; empty clouds and
    NaN are no error; the same questions have the same answers.

    Parameters
    ----------
    make_detector : callable
        Returns a new, empty detector.
    rng : numpy.random.Generator
        Draws yards and poses.
    """
    detector, twin = make_detector(), make_detector()
    yards = [_yard(rng) for _ in range(_PLACES)]
    nothing = np.zeros((0, 3), dtype=np.float32)
    found = detector.query(yards[0], allowed=np.zeros(0, dtype=bool), top=3)
    assert found == (), f"an empty detector finds {len(found)} places"
    descriptors = [detector.describe(yard) for yard in yards]
    for k, descriptor in enumerate(descriptors):
        assert descriptor.dtype == np.uint8 and descriptor.ndim == 1, "a descriptor is bytes, (D,) uint8"
        assert len(descriptor) == len(descriptors[0]), "descriptors differ in length"
        detector.add(10 * k, descriptor)
        twin.add(10 * k, np.frombuffer(descriptor.tobytes(), dtype=np.uint8))
    assert len(detector) == _PLACES, f"{_PLACES} keyframes were added, and its length is {len(detector)}"
    assert len(detector.describe(nothing)) == len(descriptors[0]), "an empty cloud has another descriptor"
    detector.query(np.full((5, 3), np.nan, dtype=np.float32), allowed=np.ones(_PLACES, dtype=bool), top=2)
    for k, yard in enumerate(yards):
        _assert_found(detector, twin, k, yard, rng)


def _assert_found(detector: LoopDetector, twin: LoopDetector, k: int, yard: Points, rng: np.random.Generator) -> None:
    everything = np.ones(_PLACES, dtype=bool)
    yaw = rng.uniform(-np.pi, np.pi)
    T_match_query = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, yaw), np.zeros(3))
    seen = se3.act(se3.inverse(T_match_query), yard).astype(np.float32)
    found = detector.query(seen, allowed=everything, top=3)
    assert 0 < len(found) <= 3, f"asked for 3 places it returns {len(found)}"
    assert found[0].index == 10 * k, f"yard {k} turned by {np.degrees(yaw):.0f} degrees is taken for {found[0].index}"
    scores = [match.score for match in found]
    assert scores == sorted(scores, reverse=True), f"scores do not descend: {scores}"
    _assert_guess(found[0], T_match_query, k)
    again = twin.query(seen, allowed=everything, top=3)
    assert [m.index for m in again] == [m.index for m in found], "descriptors out of bytes rank otherwise"
    others = np.arange(_PLACES) != k
    assert all(m.index != 10 * k for m in detector.query(seen, allowed=others, top=_PLACES)), (
        "a forbidden place is found"
    )
    assert detector.query(seen, allowed=np.zeros(_PLACES, dtype=bool), top=3) == (), "all are forbidden, some are found"


def _assert_guess(match: PlaceMatch, T_match_query: Array, k: int) -> None:
    d = se3.log(se3.inverse(T_match_query) @ match.T_match_query)
    turned, moved = float(np.degrees(np.linalg.norm(d[:3]))), float(np.linalg.norm(d[3:]))
    assert turned < 15.0, f"the guess for yard {k} is turned by {turned:.0f} degrees"
    assert match.yaw_only or moved < 1.5, f"the guess for yard {k} is off by {moved:.1f} m"


def _yard(rng: np.random.Generator) -> Points:
    """Return a floor, and walls of random length and direction about 4 to 16 m away."""
    parts = [np.column_stack([rng.uniform(-15.0, 15.0, (3000, 2)), np.full(3000, -1.5)])]
    for _ in range(7):
        middle, along = rng.uniform(4.0, 16.0), rng.uniform(-np.pi, np.pi)
        at = middle * np.array([np.cos(along), np.sin(along)])
        length, way, height = rng.uniform(3.0, 9.0), rng.uniform(-np.pi, np.pi), rng.uniform(1.0, 5.0)
        s, z = rng.uniform(-length / 2.0, length / 2.0, 1500), rng.uniform(-1.5, height, 1500)
        parts.append(np.column_stack([at[0] + s * np.cos(way), at[1] + s * np.sin(way), z]))
    return np.ascontiguousarray(np.concatenate(parts), dtype=np.float32)

"""The law of loop detectors holds for ours, and catches who breaks it."""

import dataclasses

import numpy as np
import pytest

from heliograph.config import PlacesConfig
from heliograph.slam.places import BirdsEyeDetector, ScanContextDetector, make_detector
from heliograph.testing import assert_loop_detector


@pytest.mark.parametrize("method", ["birds-eye", "scan-context"])
@pytest.mark.parametrize("seed", range(5))
def test_detectors_obey_the_law(method, seed):
    config = PlacesConfig(method=method, max_range=40.0)
    assert_loop_detector(lambda: make_detector(config), np.random.default_rng(seed))


class Turned(BirdsEyeDetector):
    """Guesses the turn the wrong way round."""

    def query(self, points_level, *, allowed, top):
        found = super().query(points_level, allowed=allowed, top=top)
        return tuple(dataclasses.replace(m, T_match_query=np.linalg.inv(m.T_match_query)) for m in found)


class Trespassing(ScanContextDetector):
    """Finds what it may not."""

    def query(self, points_level, *, allowed, top):
        return super().query(points_level, allowed=np.ones_like(allowed), top=top)


@pytest.mark.parametrize(("kind", "words"), [(Turned, "turned by"), (Trespassing, "forbidden")])
def test_law_catches_a_detector_that_breaks_it(kind, words, rng):
    config = PlacesConfig(max_range=40.0)
    with pytest.raises(AssertionError, match=words):
        assert_loop_detector(lambda: kind(config), rng)

"""A back-end that is told to look at twins of a place accepts none of them, and still closes what was walked twice."""

import pytest
from benchmarks.loop_misled import run_misled
from benchmarks.loop_worlds import corridors


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(10))
def test_false_candidates_are_not_believed(seed):
    row = run_misled(corridors(seed), 0.02, 0.2, seed)
    assert row["told"] > 10 and row["naive"] > 0  # the contrast: a gate by distance and fitness takes them
    assert row["false"] == 0

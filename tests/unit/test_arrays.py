"""The checks at the boundary: what passes untouched, what is copied, what is refused; and the freezing of records."""

from dataclasses import dataclass

import numpy as np
import pytest

from heliograph.arrays import (
    as_array,
    as_batch,
    as_points,
    as_pose,
    as_stamps,
    broadcast,
    freeze,
    frozen,
    require_finite,
)
from heliograph.errors import DataError

CLOUD = np.zeros((4, 3), np.float32)


def test_checks_pass_what_fits_without_a_copy():
    T, v = np.eye(4), np.zeros((2, 5, 3))
    assert as_points("points", CLOUD) is CLOUD
    assert as_pose("T", T) is T
    assert as_batch("v", v, (3,)) is v
    assert as_array("v", v, np.float64, (None, 5, 3)) is v


def test_checks_make_memory_contiguous_and_lists_arrays():
    assert as_points("points", np.asfortranarray(CLOUD)).flags.c_contiguous
    assert as_batch("v", [0, 0, 1], (3,)).dtype == np.float64
    assert as_batch("v", np.zeros(3, np.float32), (3,)).dtype == np.float64
    assert as_stamps("t", [1, 2]).dtype == np.int64


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: as_points("p", CLOUD.astype(float)), r"p has dtype float64, expected \(N, 3\) float32"),
        (lambda: as_points("p", CLOUD[:, :2]), r"p has shape \(4, 2\), expected \(N, 3\) float32"),
        (lambda: as_array("k", np.zeros(2), np.float64, (3,)), r"k has shape \(2,\), expected \(3,\) float64"),
        (lambda: as_pose("T", np.diag([1.0, 1.0, np.inf, np.nan])), "T holds 2 values that are not finite"),
        (lambda: as_batch("v", [True, False, True], (3,)), "v has dtype bool"),
        (lambda: as_batch("v", [[1.0], [1.0, 2.0]], (3,)), "v is a list that makes no array"),
        (lambda: as_stamps("t", np.zeros(2)), "t has dtype float64, expected whole nanoseconds"),
        (lambda: broadcast("a and b", (2,), (3,)), r"the batches of a and b have shapes \(2,\), \(3,\)"),
    ],
)
def test_checks_name_what_came_and_what_is_wanted(check, message):
    with pytest.raises(DataError, match=message):
        check()


def test_finite_numbers_whose_squares_overflow_are_finite():
    large = np.full((4, 4), 1e300)
    assert require_finite("T", large) is large


def test_frozen_leaves_the_callers_array_writeable():
    mine = np.zeros(3)
    view = frozen("v", mine, np.float64, (3,))
    mine[0] = 1.0
    assert view[0] == 1.0
    assert not view.flags.writeable


@dataclass(frozen=True, slots=True)
class Record:
    array: np.ndarray
    several: tuple[object, ...]
    named: dict[str, object]

    def __post_init__(self):
        freeze(self)


def test_freeze_reaches_arrays_in_tuples_and_mappings_and_leaves_the_rest():
    mine = np.zeros(3)
    record = Record(mine, (np.ones(2), "text"), {"x": np.ones(2), "y": 1})
    for array in (record.array, record.several[0], record.named["x"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
    assert (record.several[1], record.named["y"]) == ("text", 1)
    assert mine.flags.writeable

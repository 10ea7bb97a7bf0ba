"""Stamps without a declared unit."""

import numpy as np
import pytest

from heliograph.io.files.stamps import UNITS, parse_stamps, stamp_unit

EPOCH_NS = 1_700_000_000_123_456_789


@pytest.mark.parametrize("unit", UNITS)
def test_stamps_since_1970_tell_their_unit_by_size(unit):
    stamps = [EPOCH_NS + i * 5_000_000 for i in range(10)]
    words = [str(ns // 10 ** UNITS[unit]) for ns in stamps]
    assert stamp_unit(words) == unit


@pytest.mark.parametrize(
    ("words", "unit"),
    [
        (["0.0", "0.005", "0.010"], "s"),
        (["0", "5", "10"], "ms"),
        (["0", "5000", "10000"], "us"),
        (["0", "5000000", "10000000"], "ns"),
        (["46534.478", "46536.397", "46536.407", "46536.417"], "s"),
        (["7"], "s"),
        ([], "s"),
    ],
)
def test_relative_stamps_tell_their_unit_by_their_step(words, unit):
    assert stamp_unit(words) == unit


def test_stamps_are_converted_exactly():
    assert parse_stamps(["1700000000.123456789"])[0][0] == EPOCH_NS
    assert parse_stamps([str(EPOCH_NS)]) == (np.array([EPOCH_NS]), "ns")
    assert parse_stamps(["1700000000123456.789"], "us")[0][0] == EPOCH_NS
    assert parse_stamps(["1700000000123456"], "us")[0][0] == EPOCH_NS - 789
    assert parse_stamps(["-2"], "ms")[0][0] == -2_000_000
    assert parse_stamps(["1.7e18"])[0][0] == 1_700_000_000_000_000_000


def test_stamps_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match="abc"):
        parse_stamps(["abc"])

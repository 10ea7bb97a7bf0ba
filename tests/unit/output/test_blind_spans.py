"""Stretches along which one direction was not seen: where they begin and end, and what they cost in metres."""

from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.output.blind_spans import BlindSpans
from heliograph.output.summary import judge

X, Y, Z = TO_MAP = np.eye(3)
STATUSES = {"tracked": 60, "degenerate": 40}


def result(index, *, blind, sigma):
    """A scan a metre after the last, with a sigma along x."""
    T, P = np.eye(4), np.zeros((6, 6))
    T[0, 3], P[3, 3], P[4, 4] = index, sigma**2, 0.01**2
    status = "degenerate" if blind else "tracked"
    return SimpleNamespace(index=index, end_ns=100 * index, status=status, T_odom_imu=T, pose_covariance=P,
                           weak_direction=X if blind else Z)  # fmt: skip


def spans_of(blind, *, sigma=lambda k: 0.02 + 0.01 * k, R=TO_MAP):
    spans = BlindSpans()
    for k in range(60):
        spans.add(result(k, blind=k in blind, sigma=sigma(k)))
    return spans.all(R)


def test_a_stretch_has_its_ends_its_length_and_its_sigmas_before_and_after():
    (span,) = spans_of(range(10, 30))
    assert (span.first, span.last, span.begin_ns, span.end_ns) == (10, 29, 1000, 2900)
    assert span.distance == pytest.approx(20.0)
    assert (span.sigma_before, span.sigma_after) == (pytest.approx(0.11), pytest.approx(0.31))
    assert span.growth == pytest.approx(np.sqrt(0.31**2 - 0.11**2))
    assert "20.0 m" in str(span)
    assert "0.61 m after" in str(span)


def test_glimpses_do_not_part_a_stretch_and_longer_sights_do():
    assert [(s.first, s.last) for s in spans_of({10, 11, 14, 20})] == [(10, 20)]
    assert [(s.first, s.last) for s in spans_of({10, 11, 30, 59})] == [(10, 11), (30, 30), (59, 59)]


def test_directions_are_turned_to_the_map_frame():
    (span,) = spans_of({10}, R=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(span.direction, Y)


@pytest.mark.parametrize(("budget", "status"), [(0.1, "degraded"), (0.5, "ok")])
def test_a_run_is_degraded_by_metres_and_not_by_how_often_it_was_blind(budget, status):
    blind = spans_of(range(10, 30))
    found, reasons = judge(STATUSES, sensors=("lidar", "imu"), blind=blind, budget=budget)
    assert found == status
    assert len(reasons) == (status == "degraded")
    assert not reasons or "scans 10 to 29" in reasons[0]


def test_an_odometry_without_sigmas_is_judged_by_how_often_it_was_blind():
    blind = spans_of(range(10, 30), sigma=lambda _: 0.0)
    found, reasons = judge(STATUSES, sensors=("lidar", "imu"), blind=blind, budget=0.1)
    assert found == "degraded"
    assert "40%" in reasons[0]

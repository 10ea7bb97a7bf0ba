"""What a run knows of up, against draws of it."""

import json

import numpy as np
import pytest

from fakes import make_result
from heliograph.cli.closing import closing_lines
from heliograph.lie import s2, so3
from heliograph.output.level import Level
from heliograph.output.summary import Tally

G = 9.80665


def tilted(rng):
    """A gravity off the vertical by a fraction of a degree, and the covariance of its direction."""
    direction = so3.exp(0.005 * rng.normal(size=3)) @ [0.0, 0.0, -1.0]
    root = 0.02 * rng.normal(size=(2, 2))
    return G * direction, root @ root.T


def levelled(g_odom):
    return so3.from_two_vectors(g_odom, np.array([0.0, 0.0, -1.0]))


def test_level_covers_what_another_gravity_does_to_positions_and_rotations(rng):
    g, P = tilted(rng)
    level = Level.of_gravity(g, P, 30.0)
    p, R = np.array([30.0, -12.0, 2.0]), so3.exp(rng.normal(size=3))
    d = rng.multivariate_normal(np.zeros(2), P, 20_000)
    down = np.broadcast_to([0.0, 0.0, -1.0], (len(d), 3))
    others = so3.from_two_vectors(G * s2.retract(np.broadcast_to(g / G, (len(d), 3)), d), down)
    shifts = levelled(g).T @ others @ p - p
    turns = so3.log(R.T @ levelled(g).T @ others @ R)
    scale = np.trace(np.cov(shifts.T))
    np.testing.assert_allclose(level.of_positions(p[None])[0], np.cov(shifts.T), atol=0.04 * scale)
    # Levelling turns about gravity too, to second order; that part is free.
    scale = np.trace(np.cov(turns.T))
    np.testing.assert_allclose(level.of_rotations(R[None])[0], np.cov(turns.T), atol=0.04 * scale)


def test_level_of_a_straight_way_is_told_in_degrees_and_metres():
    level = Level.of_gravity(np.array([0.0, 0.0, -G]), np.diag([np.radians(0.5), np.radians(0.2)]) ** 2, 52.0)
    assert level.sigma == pytest.approx(np.radians(0.5))
    assert level.sigma_position == pytest.approx(0.4538, abs=1e-3)
    assert level.sentence() == "level known to 0.5 deg: +- 0.45 m of height at 52 m from the start"


@pytest.mark.parametrize("g", [0.0, G])
def test_level_of_an_odometry_without_gravity_is_not_known(g):
    level = Level.of_gravity(np.array([0.0, 0.0, -g]), np.zeros((2, 2)), 10.0)
    assert not level.known
    assert level.sentence() == ""


def test_tally_takes_the_last_gravity_and_the_farthest_place():
    tally = Tally()
    for index in (0, 9, 4):
        covariance = np.zeros((17, 17))
        covariance[15:17, 15:17] = np.eye(2) / (1.0 + index) ** 2
        tally.add(make_result(index, covariance=covariance))
    level = tally.summary().level
    assert level.reach == pytest.approx(0.9)
    assert level.sigma == pytest.approx(0.2)


def test_closing_lines_say_the_level(tmp_path):
    facts = {
        "timings": {"wall_ms_per_scan": 1.0},
        "weakest": {"eigenvalue": None},
        "peak_memory_mb": None,
        "distance_m": 52.0,
        "duration_s": 30.0,
        "scans": 300,
        "start_end_gap_m": 52.0,
        "level": {"sentence": "level known to 0.5 deg: +- 0.45 m of height at 52 m from the start"},
        "files": [],
        "status": "ok",
        "reasons": [],
    }
    assert facts["level"]["sentence"] in closing_lines(json.loads(json.dumps(facts)), tmp_path)

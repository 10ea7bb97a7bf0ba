"""Which scans become keyframes: by way, turn, rest, and by what they see that the last one did not."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import SlamConfig
from heliograph.data import Scan
from heliograph.lie import se3
from heliograph.odometry.pose_result import pose_result
from heliograph.slam import KeyframeSelector

NS = 10**9


def room(rng, centre):
    """Return points on the walls of a room of six metres about a point."""
    p = rng.uniform(-3.0, 3.0, (3000, 3))
    side = rng.integers(0, 2, 3000)
    p[np.arange(3000), side] = np.sign(p[np.arange(3000), side]) * 3.0
    return (p + centre).astype(np.float32)


def result(index, seconds, T, points):
    stamp = round(seconds * NS) + NS
    scan = Scan(
        stamp_ns=stamp, header_stamp_ns=stamp, received_ns=stamp, end_ns=stamp, points=points,
        offsets_ns=np.zeros(len(points), np.int32), intensity=None, ring=None, has_point_times=False,
    )  # fmt: skip
    return pose_result(scan, index, T)


def picked(moves, clouds, seconds=None, **settings):
    """Return which scans become keyframes, of poses moved by tangents and their clouds."""
    selector = KeyframeSelector(replace(SlamConfig(), **settings))
    seconds = seconds or [0.1 * k for k in range(len(moves))]
    rows = enumerate(zip(moves, seconds, clouds, strict=True))
    return [selector.add(result(k, s, se3.exp(np.array(move)), cloud)) is not None for k, (move, s, cloud) in rows]


def along(*metres):
    return [[0.0, 0.0, 0.0, x, 0.0, 0.0] for x in metres]


def seen_from(rng, moves):
    """Return one room as seen from poses that do not turn."""
    return [room(rng, -np.array(move[3:])) for move in moves]


def test_way_turn_and_rest_make_keyframes(rng):
    moves = along(0.0, 0.6, 1.1)
    assert picked(moves, seen_from(rng, moves)) == [True, False, True]
    turn = [[0.0, 0.0, angle, 0.0, 0.0, 0.0] for angle in (0.0, 0.1, 0.2)]
    assert picked(turn, [room(rng, np.zeros(3))] * 3, keyframe_overlap=0.0) == [True, False, True]
    rest = along(0.0, 0.0, 0.0)
    assert picked(rest, seen_from(rng, rest), seconds=[0.0, 15.0, 21.0]) == [True, False, True]


@pytest.mark.parametrize(("overlap", "expected"), [(0.3, [True, False, True]), (0.0, [True, False, False])])
def test_scan_that_sees_another_room_is_a_keyframe(rng, overlap, expected):
    moves = along(0.0, 0.3, 0.6)
    clouds = [*seen_from(rng, moves[:2]), room(rng, [6.5, 0.0, 0.0])]
    assert picked(moves, clouds, keyframe_overlap=overlap) == expected


def test_scan_that_sees_little_near_by_is_none_for_that(rng):
    moves = along(0.0, 0.3)
    clouds = [room(rng, np.zeros(3)), room(rng, [6.5, 0.0, 0.0])[:50]]
    assert picked(moves, clouds) == [True, False]


def test_what_another_system_chose_is_a_keyframe_however_close(rng):
    cloud, seconds = room(rng, np.zeros(3)), [0.0, 0.1, 0.15, 0.25]
    chosen = NS + np.array([0, 1, 10**6 * 250], dtype=np.int64) + [0, 100_000_000, 0]
    selector = KeyframeSelector(SlamConfig(), poses_given=True, chosen_ns=chosen)
    rows = [selector.add(result(k, s, np.eye(4), cloud)) is not None for k, s in enumerate(seconds)]
    assert rows == [True, True, False, True]

"""Registration of local maps: evidence for right and wrong places, windows, blur, reach, and the order of a search."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.config import LoopConfig
from heliograph.errors import DataError
from heliograph.lie import se3, so3
from heliograph.slam.loops import (
    LocalMaps,
    LoopStart,
    Submaps,
    judge,
    local_map,
    loop_align_config,
    rank_places,
    verify,
    within_reach,
)
from heliograph.slam.loops.sharpness import joined_blur
from heliograph.slam.loops.tangent import near
from heliograph.slam.loops.verify import window_end
from heliograph.slam.places import PlaceMatch, level_pose

CONFIG = LoopConfig(before=2, after=2, apart=5)


def wall(rng, a, b, height, count):
    s, z = rng.random(count), rng.uniform(0.0, height, count)
    return np.column_stack([a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), z])


def hall(rng):
    corners = [(0, 0), (12, 0), (12, 9), (4, 9), (4, 7), (0, 7)]
    parts = [wall(rng, a, b, 3.0, 2500) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
    parts += [wall(rng, a, b, 2.0, 900) for a, b in (((3, 2), (5, 3)), ((5, 3), (5, 4)), ((8, 5), (9, 7)))]
    parts.append(np.column_stack([rng.uniform(0, 12, 4000), rng.uniform(0, 9, 4000), np.zeros(4000)]))
    return np.concatenate(parts)


class Walk:
    """Keyframes that go round twice; odometry is off by ``drift`` (a motion in the world) on the second round."""

    def __init__(self, rng, *, drift=None, sigma=0.02):
        self.world, self.sigma = hall(rng), sigma
        angles = np.linspace(0.0, 4.0 * np.pi, 24, endpoint=False)
        self.T_true = [
            se3.from_rotation_translation(
                so3.from_rpy(0.02, -0.03, a + np.pi / 2), [6 + 2 * np.cos(a), 4 + 1.5 * np.sin(a), 1.2]
            )
            for a in angles
        ]
        off = np.eye(4) if drift is None else drift
        self.T = [T if k < 12 else off @ T for k, T in enumerate(self.T_true)]
        self.clouds = [
            (se3.act(se3.inverse(T), self.world[rng.random(len(self.world)) < 0.4]) + rng.normal(0, 0.01, 3)).astype(
                np.float32
            )
            for T in self.T_true
        ]

    def points(self, index):
        return self.clouds[index]

    def T_odom_imu(self, index):
        return self.T[index]

    def relative(self, a, b):
        return se3.inverse(self.T[a]) @ self.T[b], (b - a) * np.diag(np.repeat([self.sigma / 5, self.sigma], 3) ** 2)

    def truth(self, match, query):
        return se3.inverse(self.T_true[match]) @ self.T_true[query]


def maps_of(walk, config=CONFIG):
    return LocalMaps(walk, loop_align_config(config))


def test_walk_is_what_the_protocol_asks_for(rng):
    assert isinstance(Walk(rng), Submaps)


def test_right_place_is_registered_and_only_waits_for_company(rng):
    walk = Walk(rng, drift=se3.exp([0.0, 0.0, 0.03, 0.25, -0.2, 0.1]), sigma=0.1)
    evidence = verify(15, 3, maps_of(walk), (), walk.relative, newest=15, config=CONFIG)
    assert near(evidence.T_match_query, walk.truth(3, 15), 0.05, 0.5)
    assert evidence.status == "converged"
    assert evidence.overlap > 0.8
    assert evidence.blind == ()
    assert evidence.blur_after < 0.25 < 1.0 < evidence.blur_before
    assert (judge(evidence, CONFIG).verdict, judge(evidence, CONFIG).reason) == ("held", "alone")


def test_shift_and_doubt_are_told_level_and_in_height(rng):
    """The body is tilted: height is along gravity, not along its z axis."""
    walk = Walk(rng, drift=se3.exp([0.0, 0.0, 0.0, 0.3, 0.0, 0.2]), sigma=0.1)
    evidence = verify(15, 3, maps_of(walk), (), walk.relative, newest=15, config=CONFIG)
    assert abs(evidence.shift_level - 0.3) < 0.03
    assert abs(evidence.shift_up - 0.2) < 0.03
    np.testing.assert_allclose([evidence.doubt_level, evidence.doubt_up], 0.1 * np.sqrt(12), rtol=1e-6)


def test_guess_of_a_detector_reaches_what_odometry_cannot(rng):
    walk = Walk(rng, drift=se3.exp([0.0, 0.0, 2.5, 6.0, -3.0, 0.0]), sigma=3.0)
    guess = LoopStart(source="place", T_match_query=walk.truth(3, 15) @ se3.exp([0, 0, 0.1, 0.2, 0.3, 0.0]))
    evidence = verify(15, 3, maps_of(walk), (guess,), walk.relative, newest=15, config=CONFIG)
    assert evidence.source == "place"
    assert evidence.starts == 2
    assert near(evidence.T_match_query, walk.truth(3, 15), 0.1, 1.0)


def test_pose_that_odometry_excludes_is_refused_however_well_it_fits(rng):
    walk = Walk(rng, drift=se3.exp([0.0, 0.0, 0.0, 0.5, 0.4, 0.0]), sigma=0.01)
    evidence = verify(15, 3, maps_of(walk), (), walk.relative, newest=15, config=CONFIG)
    assert evidence.overlap > 0.8
    assert judge(evidence, CONFIG).reason == "odometry"


def test_excluded_guess_is_not_tried_but_for_one_by_hand(rng):
    walk = Walk(rng, sigma=0.01)
    far = walk.truth(3, 15) @ se3.exp([0.0, 0.0, 1.0, 3.0, 0.0, 0.0])
    for source, tried in (("place", 1), ("hand", 2)):
        start = LoopStart(source=source, T_match_query=far)
        found = verify(15, 3, maps_of(walk), (start,), walk.relative, newest=15, config=CONFIG)
        assert found.starts == tried


def test_start_near_another_is_tried_once(rng):
    walk = Walk(rng)
    start = LoopStart(source="place", T_match_query=walk.truth(3, 15) @ se3.exp([0.01, 0, 0, 0.1, 0, 0]))
    assert verify(15, 3, maps_of(walk), (start,), walk.relative, newest=15, config=CONFIG).starts == 1


def test_short_local_maps_are_enough_where_the_way_is_known_and_they_overlap(rng):
    walk = Walk(rng, sigma=0.015)
    walk.clouds[13:16] = [cloud[cloud[:, 0] > -1.0] for cloud in walk.clouds[13:16]]
    far = CONFIG.max_smear
    config = LoopConfig(before=5, after=5, apart=5, fine_smear=1e-3)
    for least, longer in ((0.3, False), (1.0, True)):  # an overlap that the short maps do not have
        maps = maps_of(walk, config)
        asked = replace(config, min_overlap=least)
        evidence = verify(15, 3, maps, (), walk.relative, newest=15, config=asked, sure=True)
        assert near(evidence.T_match_query, walk.truth(3, 15), 0.05, 0.5)
        assert maps.holds(15, 13, 15)
        assert maps.holds(15, window_end(15, 10, walk.relative, far), 15) == longer
    assert window_end(15, 10, walk.relative, far) < 13


def test_keyframes_out_of_order_are_named(rng):
    walk = Walk(rng)
    with pytest.raises(DataError, match="query 3, match 15 of 0 to 20"):
        verify(3, 15, maps_of(walk), (), walk.relative, newest=20, config=CONFIG)


def test_local_map_is_in_its_centres_frame_and_kept(rng):
    walk = Walk(rng)
    together = local_map(walk, 3, range(2, 5))
    assert len(together) == sum(len(walk.clouds[k]) for k in range(2, 5))
    expected = se3.act(se3.inverse(walk.T[3]) @ walk.T[4], walk.clouds[4])
    np.testing.assert_allclose(together[-len(walk.clouds[4]) :], expected, atol=1e-5)
    maps = maps_of(walk)
    assert maps.around(3, 2, 4) is maps.around(3, 2, 4)
    first = maps.around(3, 2, 4)
    maps.clear()
    assert maps.around(3, 2, 4) is not first


@pytest.mark.parametrize(("end", "smear", "reached"), [(0, 10.0, 0), (0, 1e-6, 8), (20, 1e-6, 12), (9, 1e-6, 9)])
def test_window_reaches_as_far_as_odometry_vouches_and_two_in_any_case(rng, end, smear, reached):
    assert window_end(10, end, Walk(rng).relative, smear) == reached


def test_window_is_shorter_the_worse_the_odometry(rng):
    lengths = [10 - window_end(10, 0, Walk(rng, sigma=s).relative, 0.15) for s in (0.01, 0.03, 0.2)]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[0] > lengths[-1] == 2


def test_blur_is_nothing_for_walls_on_walls_and_grows_with_the_gap(rng):
    a, b = (hall(rng).astype(np.float32) for _ in range(2))
    blurs = [joined_blur(a, b, se3.exp([0, 0, 0, d, d, 0]), 0.5) for d in (0.0, 0.05, 0.15)]
    assert abs(blurs[0]) < 0.2
    assert blurs == sorted(blurs)
    assert blurs[-1] > 0.3
    assert np.isnan(joined_blur(a, b, se3.exp([0, 0, 0, 100.0, 0, 0]), 0.5))


def test_reach_knows_heights_and_doubts():
    p = np.array([[5.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 0.0, 3.6]])
    none, much = np.zeros((3, 3)), np.full((3, 3), 4.0)
    assert within_reach(np.zeros(3), p, none).tolist() == [True, False, False]
    assert within_reach(np.zeros(3), p, much).tolist() == [True, True, True]


def test_places_that_odometry_allows_come_first_and_keep_their_order(rng):
    walk = Walk(rng, sigma=0.02)

    def place(index, score, T_match_query, yaw_only=False):
        T = level_pose(walk.T[index]) @ T_match_query @ se3.inverse(level_pose(walk.T[15]))
        return PlaceMatch(index=index, score=score, T_match_query=T, yaw_only=yaw_only)

    twin = place(4, 0.9, walk.truth(4, 15) @ se3.exp([0, 0, 0, 8.0, 0, 0]))
    far = place(9, 0.85, walk.truth(9, 15) @ se3.exp([0, 0, 0, 8.0, 0, 0]))
    right = [place(3, 0.8, walk.truth(3, 15)), place(2, 0.7, walk.truth(2, 15)), place(5, 0.6, np.eye(4), True)]
    assert [p.index for p in rank_places(15, [far, twin, *right], walk, walk.relative, CONFIG)] == [3, 2, 5, 4, 9]
    few = LoopConfig(before=2, after=2, candidates=2)
    assert [p.index for p in rank_places(15, [twin, *right], walk, walk.relative, few)] == [3, 2]

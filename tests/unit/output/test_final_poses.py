"""Poses that moved: rigid where all move alike, through every keyframe, smooth between, whatever odom's origin."""

import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.output import FinalPoses
from states import random_pose

SECOND = 1_000_000_000


def make_poses(rng, count=8, size=0.05, origin=None):
    """A drive on a bend with keyframes at uneven times, each moved a little."""
    stamps = np.cumsum(rng.integers(SECOND // 2, 2 * SECOND, count)).astype(np.int64)
    T_odom_imu = np.stack([se3.exp([0, 0, 0.1 * k, 1.0 * k, 0.2 * k, 0]) for k in range(count)])
    T_map_imu = T_odom_imu @ se3.exp(size * rng.normal(size=(count, 6)))
    if origin is not None:
        T_odom_imu = origin @ T_odom_imu
    return FinalPoses(stamps_ns=stamps, T_odom_imu=T_odom_imu, T_map_imu=T_map_imu)


def body_at(final, stamps):
    """Poses of a body that stands at the third keyframe all the time, moved by the correction."""
    return final.T_map_odom(stamps) @ final.T_odom_imu[2]


def test_final_poses_pass_through_every_keyframe(rng):
    final = make_poses(rng)
    found = final.T_map_odom(final.stamps_ns) @ final.T_odom_imu
    np.testing.assert_allclose(found, final.T_map_imu, atol=1e-12)
    assert final.rigid is None


def test_final_poses_stay_outside_the_keyframes(rng):
    final = make_poses(rng)
    ends = final.stamps_ns[[0, -1]]
    far = final.T_map_odom(ends + np.array([-SECOND, SECOND]))
    np.testing.assert_array_equal(far, final.T_map_odom(ends))


def test_final_poses_have_no_jump_and_no_kink(rng):
    final, step = make_poses(rng), 1000
    for stamp in final.stamps_ns:
        before, at, after = body_at(final, stamp + np.array([-step, 0, step]))
        assert np.abs(se3.local(before, after)).max() < 1e-5
        kink = se3.local(at, after) + se3.local(at, before)
        assert np.abs(kink).max() < 1e-9, "the velocity of the correction jumps at a keyframe"


def test_final_poses_move_a_stretch_rigidly_whose_ends_move_alike(rng):
    final = make_poses(rng)
    moved = np.array(final.T_map_imu)
    moved[4] = moved[3] @ se3.inverse(final.T_odom_imu[3]) @ final.T_odom_imu[4]
    final = FinalPoses(stamps_ns=final.stamps_ns, T_odom_imu=final.T_odom_imu, T_map_imu=moved)
    between = np.linspace(final.stamps_ns[3], final.stamps_ns[4], 20).astype(np.int64)
    expected = np.broadcast_to(final.T_map_odom(final.stamps_ns[3:4]), (20, 4, 4))
    np.testing.assert_allclose(final.T_map_odom(between), expected, atol=1e-12)


def test_final_poses_do_not_overshoot(rng):
    count = 9
    poses = np.stack([se3.exp([0, 0, 0, k, 0, 0]) for k in range(count)])
    moved = poses.copy()
    moved[4:, 1, 3] += 0.5  # one step sideways, as a closed loop makes it
    final = FinalPoses(stamps_ns=SECOND * np.arange(count), T_odom_imu=poses, T_map_imu=moved)
    sideways = final.T_map_odom(np.arange(0, 8 * SECOND, SECOND // 50))[:, 1, 3]
    assert sideways.min() >= -1e-12 and sideways.max() <= 0.5 + 1e-12
    assert (np.diff(sideways) >= -1e-12).all()


def test_final_poses_do_not_depend_on_where_odom_begins(rng):
    origin = random_pose(np.random.default_rng(1), 2000.0)
    near, far = (make_poses(np.random.default_rng(3), origin=place) for place in (None, origin))
    stamps = np.linspace(near.stamps_ns[0], near.stamps_ns[-1], 50).astype(np.int64)
    np.testing.assert_allclose(far.T_map_odom(stamps) @ origin, near.T_map_odom(stamps), atol=1e-8)


def test_final_poses_that_move_as_one_are_rigid(rng):
    T_map_odom = random_pose(rng, 3.0)
    np.testing.assert_array_equal(FinalPoses.moved_by(T_map_odom).rigid, T_map_odom)
    still = make_poses(rng, size=0.0)
    assert np.abs(still.rigid - np.eye(4)).max() < 1e-12
    together = FinalPoses(
        stamps_ns=still.stamps_ns, T_odom_imu=still.T_odom_imu, T_map_imu=T_map_odom @ still.T_odom_imu
    )
    np.testing.assert_allclose(together.rigid, T_map_odom, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stamps_ns": np.array([5, 5], np.int64)}, "increase"),
        ({"T_map_imu": np.tile(np.eye(4), (3, 1, 1))}, "shape"),
        ({"T_map_imu": np.full((2, 4, 4), np.nan)}, "not finite"),
    ],
)
def test_final_poses_refuse_what_is_none(changes, words):
    poses = np.tile(np.eye(4), (2, 1, 1))
    values = {"stamps_ns": np.array([0, 5], np.int64), "T_odom_imu": poses, "T_map_imu": poses}
    with pytest.raises(DataError, match=words):
        FinalPoses(**(values | changes))


def test_final_poses_need_a_keyframe():
    empty = np.zeros((0, 4, 4))
    with pytest.raises(DataError, match="no keyframe"):
        FinalPoses(stamps_ns=np.zeros(0, np.int64), T_odom_imu=empty, T_map_imu=empty)

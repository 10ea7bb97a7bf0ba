"""What the detectors promise beyond their law: sizes, errors, guesses of the whole pose, levelling."""

import numpy as np
import pytest

from heliograph.config import PlacesConfig
from heliograph.errors import ConfigError, DataError
from heliograph.lie import se3, so3
from heliograph.slam.places import BirdsEyeDetector, ScanContextDetector, body_guess, level_points, level_pose


def yard(rng, walls=8):
    parts = [np.column_stack([rng.uniform(-20, 20, (4000, 2)), np.full(4000, -1.5)])]
    for _ in range(walls):
        at, way = rng.uniform(-14, 14, 2), rng.uniform(-np.pi, np.pi)
        s, z = rng.uniform(-4, 4, 1500), rng.uniform(-1.5, rng.uniform(1, 5), 1500)
        parts.append(np.column_stack([at[0] + s * np.cos(way), at[1] + s * np.sin(way), z]))
    return np.concatenate(parts)


@pytest.mark.parametrize("kind", [BirdsEyeDetector, ScanContextDetector])
def test_descriptors_stay_below_two_kilobytes(kind, rng):
    assert kind().describe(yard(rng).astype(np.float32)).nbytes <= 2048


def test_birds_eye_guess_is_right_from_another_position_turned_and_raised(rng):
    for _ in range(5):
        detector, world = BirdsEyeDetector(), yard(rng)
        detector.add(3, detector.describe(world.astype(np.float32)))
        T = se3.from_rotation_translation(
            so3.from_rpy(0.0, 0.0, rng.uniform(-np.pi, np.pi)), [*rng.uniform(-3, 3, 2), rng.uniform(-1, 1)]
        )
        seen = se3.act(se3.inverse(T), world).astype(np.float32)
        (match,) = detector.query(seen, allowed=np.array([True]), top=1)
        d = se3.log(se3.inverse(T) @ match.T_match_query)
        assert np.degrees(np.linalg.norm(d[:3])) < 5.0
        assert np.linalg.norm(d[3:]) < 1.0
        assert match.score > 0.4


def test_birds_eye_guess_holds_for_a_narrow_view(rng):
    world = yard(rng, walls=14)
    ahead = world[np.abs(np.arctan2(world[:, 1], world[:, 0])) < np.radians(34)]
    T = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, 0.2), [0.5, 1.0, 0.0])
    moved = se3.act(se3.inverse(T), world)
    seen = moved[np.abs(np.arctan2(moved[:, 1], moved[:, 0])) < np.radians(34)]
    detector = BirdsEyeDetector()
    detector.add(0, detector.describe(ahead.astype(np.float32)))
    (match,) = detector.query(seen.astype(np.float32), allowed=np.array([True]), top=1)
    d = se3.log(se3.inverse(T) @ match.T_match_query)
    assert np.linalg.norm(d[3:]) < 1.0
    assert np.degrees(np.linalg.norm(d[:3])) < 6.0


def test_descriptor_of_other_settings_is_refused_with_both_sizes(rng):
    small = BirdsEyeDetector(PlacesConfig(size=64))
    with pytest.raises(DataError, match=r"keyframe 7 has 1936 bytes and this detector's have 1296.*describe"):
        small.add(7, BirdsEyeDetector().describe(yard(rng).astype(np.float32)))


def test_mask_of_wrong_length_is_refused(rng):
    detector = BirdsEyeDetector()
    with pytest.raises(DataError, match="allowed has 2 entries for 0 keyframes"):
        detector.query(yard(rng).astype(np.float32), allowed=np.array([True, False]), top=1)


@pytest.mark.parametrize("size", [90, 8, 136])
def test_picture_of_unfit_size_is_refused(size):
    with pytest.raises(ConfigError, match="size"):
        PlacesConfig(size=size)


def test_detector_keeps_more_keyframes_than_its_first_table_holds(rng):
    detector = ScanContextDetector()
    for k in range(200):
        detector.add(k, np.full(1200, k, np.uint8))
    (match,) = detector.query(yard(rng).astype(np.float32), allowed=np.arange(200) == 150, top=5)
    assert match.index == 150


def test_levelling_takes_heading_and_position_out_and_keeps_the_tilt(rng):
    tilt = so3.from_rpy(0.2, -0.3, 0.0)
    for heading in (-2.0, 0.0, 3.0):
        T = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, heading) @ tilt, rng.normal(size=3))
        level = level_pose(T)
        np.testing.assert_allclose(level[:3, :3], tilt, atol=1e-12)
        np.testing.assert_allclose(level[:3, 3], 0.0)
        points = rng.normal(size=(5, 3)).astype(np.float32)
        np.testing.assert_allclose(level_points(points, T), points @ tilt.T, atol=1e-5)


def test_guess_between_levelled_frames_comes_back_to_the_bodies(rng):
    T_odom_match, T_odom_query = (
        se3.from_rotation_translation(so3.from_rpy(*rng.uniform(-0.4, 0.4, 2), rng.uniform(-3, 3)), rng.normal(size=3))
        for _ in range(2)
    )
    T_match_query = se3.inverse(T_odom_match) @ T_odom_query
    guess = level_pose(T_odom_match) @ T_match_query @ se3.inverse(level_pose(T_odom_query))
    np.testing.assert_allclose(guess[:3, 2], [0, 0, 1], atol=1e-12)  # between levelled frames there is only a turn
    np.testing.assert_allclose(body_guess(guess, T_odom_match, T_odom_query), T_match_query, atol=1e-12)

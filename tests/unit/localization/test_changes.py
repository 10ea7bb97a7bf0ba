"""What was taken away is gone, what was put there is new, and what stayed is neither."""

import numpy as np
from kidnapped import mapped, off, walk, woken

from heliograph.lie import se3
from heliograph.localization import ChangeWatch, Localizer, map_of_keyframes
from heliograph.maps import transformed

FIRST = 42
BOX = np.stack(np.meshgrid(*[np.arange(-0.5, 0.51, 0.1)] * 3), axis=-1).reshape(-1, 3)
BOX = BOX[np.abs(BOX).max(axis=1) > 0.45]


def placed(T_imu, ahead):
    """Return a box in front of a pose, world frame."""
    return transformed((BOX + np.array([ahead, 0.0, 0.0])).astype(np.float32), np.ascontiguousarray(T_imu))


def seen_with(cloud, T_true, box):
    """Return a cloud with a box in it: what lies behind the box is hidden."""
    there = transformed(box, np.ascontiguousarray(se3.inverse(T_true)))
    ways = there / np.linalg.norm(there, axis=1, keepdims=True)
    r = np.linalg.norm(cloud, axis=1)
    behind = ((cloud / r[:, None]) @ ways.T).max(axis=1) > np.cos(0.06)
    hidden = behind & (r > np.linalg.norm(there, axis=1).min())
    return np.ascontiguousarray(np.concatenate([cloud[~hidden], there]), dtype=np.float32)


def looked(saved, clouds, T):
    watch = ChangeWatch(saved)
    for cloud, pose in zip(clouds, T, strict=True):
        watch.look(np.ascontiguousarray(pose), cloud)
    return watch.changes()


def test_changes_are_what_was_taken_away_and_what_was_put_there():
    clouds, T = mapped()
    again = [k.points_imu for k in walk().keyframes[FIRST : FIRST + 6]], walk().T_true[FIRST : FIRST + 6]
    box = placed(again[1][5], 3.0)
    without = map_of_keyframes(clouds, T)
    with_box = map_of_keyframes([seen_with(c, pose, box) for c, pose in zip(clouds, T, strict=True)], T)
    same = looked(without, *again)
    taken = looked(with_box, *again)
    put = looked(without, [seen_with(c, pose, box) for c, pose in zip(*again, strict=True)], again[1])
    middle = box.mean(axis=0)

    def near(points):
        return int((np.linalg.norm(points - middle, axis=1) < 1.0).sum())

    assert near(taken.gone) > 20 and near(same.gone) == 0
    assert near(put.new) > 20 and near(same.new) == 0
    assert max(s.gone for s in same.submaps) < 0.02 < max(s.gone for s in taken.submaps)


def test_localizer_tracks_where_a_fifth_of_the_scene_has_moved():
    results, T_true = woken(FIRST, 8)
    rng = np.random.default_rng(2)
    moved = []
    for result in results:
        points = result.points_imu.copy()
        sector = np.abs(np.arctan2(points[:, 1], points[:, 0]) - 1.0) < 0.2 * np.pi  # a fifth of the view
        points[sector] *= rng.uniform(0.6, 0.9)
        moved.append(points)
    results, _ = woken(FIRST, 8, clouds=moved)
    localizer = Localizer(map_of_keyframes(*mapped()))
    found = [localizer.add(result) for result in results]
    assert [one.state for one in found[3:]] == ["localised"] * 5
    assert max(off(one.T_map_imu, T) for one, T in zip(found[3:], T_true[3:], strict=True)) < 0.05

"""The output map: the same as adding everything up at once, until keyframes move; bounded memory, whole files."""

from dataclasses import replace

import numpy as np
import pytest

from fakes import make_result, pose
from heliograph.config import OutputConfig
from heliograph.errors import OutputError
from heliograph.lie import se3
from heliograph.maps import GlobalMap
from heliograph.output import FinalPoses, read_submaps
from heliograph.output.map_writer import MapWriter
from states import random_pose

CONFIG = OutputConfig(map_voxel=0.2, keyframe_distance=1.0)
STILL = FinalPoses.moved_by(np.eye(4))


def drive(count, *, step=0.3, points=400, seed=0):
    """Scans of the same walls from a body that moves along x."""
    rng = np.random.default_rng(seed)
    walls = rng.uniform(-8.0, 8.0, (points, 3))
    for k in range(count):
        T = pose(step * k)
        seen = (walls + rng.normal(scale=0.01, size=walls.shape) - T[:3, 3]).astype(np.float32)
        yield make_result(k, T_odom_imu=T, points_imu=seen, intensity=rng.uniform(0, 9, points).astype(np.float32))


def filled(path, results, *, threaded=False, **config):
    writer = MapWriter(path / "submaps.bin", CONFIG if not config else replace(CONFIG, **config), threaded=threaded)
    for result in results:
        writer.add(result)
    return writer


def at_once(results):
    whole = GlobalMap(0.2)
    for result in results:
        whole.insert(result.points_imu, result.intensity, result.T_odom_imu)
    return whole


@pytest.mark.parametrize("threaded", [False, True])
def test_map_writer_equals_adding_up_at_once(tmp_path, threaded):
    writer, whole = filled(tmp_path, drive(20), threaded=threaded), at_once(drive(20))
    points, intensity = writer.points(STILL)
    np.testing.assert_allclose(points, whole.points(), rtol=2e-7, atol=1e-7)  # a unit in the last place
    np.testing.assert_allclose(intensity, whole.intensity(), rtol=1e-6)
    assert len(list(read_submaps(writer.path))) >= 4
    writer.release(keep=False)
    assert not writer.path.exists()


def test_map_writer_within_one_keyframe_gives_the_same_bits(tmp_path):
    writer, whole = filled(tmp_path, drive(4, step=0.2)), at_once(drive(4, step=0.2))
    points, intensity = writer.points(STILL)
    assert points.tobytes() == whole.points().tobytes() and intensity.tobytes() == whole.intensity().tobytes()
    writer.release(keep=False)


def test_map_writer_turns_the_whole_where_all_moves_alike(tmp_path, rng):
    T_map_odom = random_pose(rng, 3.0)
    writer, whole = filled(tmp_path, drive(20)), at_once(drive(20))
    points, _ = writer.points(FinalPoses.moved_by(T_map_odom))
    np.testing.assert_allclose(points, se3.act(T_map_odom, whole.points()), atol=2e-6)
    writer.release(keep=False)


def test_map_writer_moves_each_submap_with_its_keyframe(tmp_path):
    """Two keyframes move apart by more than the cloud is wide: each half of the map is where its keyframe is."""
    writer = filled(tmp_path, drive(8, step=0.25, points=50), keyframe_distance=1.0)
    [first] = read_submaps(writer.path)
    stamps = np.array([first.stamp_ns, first.stamp_ns + 400_000_000])
    odom = np.stack([first.T_odom_imu, pose(1.0)])
    moved = np.stack([pose(0.0, 40.0), pose(1.0, -40.0)])
    points, _ = writer.points(FinalPoses(stamps_ns=stamps, T_odom_imu=odom, T_map_imu=moved))
    upper, lower = points[points[:, 1] > 0.0], points[points[:, 1] < 0.0]
    for half, y, some in ((upper, 40.0, range(4)), (lower, -40.0, range(4, 8))):
        expected = at_once([result for k, result in enumerate(drive(8, step=0.25, points=50)) if k in some]).points()
        order = [np.lexsort(np.round(cloud, 3).T) for cloud in (half, expected)]
        assert len(half) == len(expected)
        np.testing.assert_allclose(half[order[0]], expected[order[1]] + np.float32([0.0, y, 0.0]), atol=1e-5)
    writer.release(keep=False)


def test_map_writer_weighs_what_comes_to_lie_in_one_cube(tmp_path):
    """A thousand points at one place and one at another, moved into one cube: the mean is where the thousand are."""
    clouds = np.full((999, 3), 0.05, np.float32), np.float32([[0.1, 0.05, 0.05]])
    results = [
        make_result(k, T_odom_imu=pose(5.0 * k), points_imu=cloud, intensity=None) for k, cloud in enumerate(clouds)
    ]
    writer = filled(tmp_path, results)
    stamps = np.array([result.end_ns for result in results])
    final = FinalPoses(
        stamps_ns=stamps, T_odom_imu=np.stack([pose(0.0), pose(5.0)]), T_map_imu=np.stack([pose(0.0), pose(0.03)])
    )
    points, _ = writer.points(final)
    np.testing.assert_allclose(points, [[0.05 + 0.08 / 1000, 0.05, 0.05]], atol=1e-6)
    writer.release(keep=False)


def test_map_writer_memory_does_not_grow_with_the_submaps_on_disk(tmp_path):
    writer = MapWriter(tmp_path / "submaps.bin", CONFIG)
    sizes = []
    for k, result in enumerate(drive(400, step=1.0)):
        writer.add(result)
        if k >= 10:
            sizes.append(writer.nbytes)
    assert len(set(sizes)) == 1
    assert writer.path.stat().st_size > 100 * 400 * 10 and sum(1 for _ in read_submaps(writer.path)) == 399
    writer.release(keep=False)


@pytest.mark.parametrize(
    ("config", "submaps"),
    [
        ({"keyframe_distance": 0.9, "keyframe_interval": 100.0}, 3),
        ({"keyframe_distance": 100.0, "keyframe_interval": 0.5}, 2),
        ({"keyframe_distance": 100.0, "keyframe_interval": 100.0}, 0),
    ],
)
def test_map_writer_cuts_by_distance_or_time(tmp_path, config, submaps):
    writer = filled(tmp_path, drive(12), **config)
    assert sum(1 for _ in read_submaps(writer.path)) == submaps
    writer.release(keep=True)
    assert sum(1 for _ in read_submaps(writer.path)) == submaps + 1


def test_map_writer_cuts_by_angle(tmp_path):
    turning = [make_result(k, T_odom_imu=se3.exp([0, 0, 0.2 * k, 0, 0, 0])) for k in range(7)]
    writer = filled(tmp_path, turning, keyframe_angle_deg=20.0)
    assert sum(1 for _ in read_submaps(writer.path)) == 3
    writer.release(keep=False)


@pytest.mark.parametrize("threaded", [False, True])
def test_map_writer_on_a_full_disk_fails_once_and_keeps_the_points(tmp_path, full_disk, threaded):
    writer, failures = MapWriter(tmp_path / "submaps.bin", CONFIG, threaded=threaded), []
    with full_disk(30_000):
        for result in drive(20):
            try:
                writer.add(result)
            except OutputError as error:
                failures.append(str(error))
        points, _ = writer.points(STILL)
    assert len(failures) == 1 and "submaps.bin" in failures[0]
    assert len(points) == len(at_once(drive(20)))
    writer.release(keep=False)


def along_a_wall(count, *, drift, seed=0):
    """Scans of a wall in y = 0 with noise of 2 cm, whose odometry drifts sideways by ``drift`` a scan."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        wall = np.column_stack([rng.uniform(-3.0, 3.0, 3000), rng.normal(0.0, 0.02, 3000), rng.uniform(0, 1, 3000)])
        seen = (wall - [0.0, -2.0, 0.0]).astype(np.float32)
        yield make_result(k, T_odom_imu=pose(0.5 * k, -2.0 + drift * k), points_imu=seen, intensity=None)


def wall_of(tmp_path, final, *, threaded=False, drift=0.004):
    writer = filled(tmp_path, along_a_wall(30, drift=drift), threaded=threaded, map_voxel=0.1)
    points, _ = writer.points(final)
    writer.release(keep=False)
    return points


@pytest.mark.parametrize("threaded", [False, True])
def test_map_writer_makes_a_wall_one_sheet_where_the_poses_moved(tmp_path, threaded):
    """The odometry drifts by 0.12 m; the keyframes end where the wall is in y = 0, a border between cubes."""
    results = list(along_a_wall(30, drift=0.004))
    odom = np.stack([result.T_odom_imu for result in results])
    moved = odom.copy()
    moved[:, 1, 3] = -2.0
    stamps = np.array([result.end_ns for result in results])
    final = FinalPoses(stamps_ns=stamps, T_odom_imu=odom, T_map_imu=moved)
    points = wall_of(tmp_path, final, threaded=threaded)
    off = np.abs(points[:, 1])
    assert np.median(off) < 5e-3 and np.percentile(off, 95) < 0.02
    assert len(points) < 1.3 * 10 * 10 * (6.0 + 0.5 * 29)
    assert np.median(np.abs(wall_of(tmp_path, STILL)[:, 1])) > 0.03


def test_map_writer_gives_the_same_bits_with_a_second_thread(tmp_path):
    one, two = (wall_of(tmp_path, STILL, threaded=threaded, drift=0.0) for threaded in (False, True))
    assert one.tobytes() == two.tobytes() and np.median(np.abs(one[:, 1])) < 2e-3


def test_map_writer_without_surfaces_writes_the_cubes_means(tmp_path):
    results = list(along_a_wall(2, drift=0.0))
    writer = filled(tmp_path, results, map_voxel=0.1, surface_thickness=0.0, keyframe_distance=9.0)
    whole = GlobalMap(0.1)
    for result in results:
        whole.insert(result.points_imu, None, result.T_odom_imu)
    assert writer.points(STILL)[0].tobytes() == whole.points().tobytes()
    writer.release(keep=False)

"""The written map against the surfaces of the simulated world, whose walls lie on borders of the map's grid."""

import numpy as np
import pytest

from heliograph.config import OutputConfig, RunConfig
from heliograph.lie import se3
from heliograph.metrics import align
from heliograph.odometry import make_odometry
from heliograph.output import FinalPoses
from heliograph.output.map_writer import MapWriter
from heliograph.sim import SCENARIOS, simulate

# The IMU starts at (5.0, 1.4, 1.4) in a room whose walls are at 0 and 10, 0 and 7, 0 and 2.8 m: all on the grid.
ROOM = SCENARIOS["room"]
FAST = ROOM.thinned(beams=16, columns=360, duration=20.0)


def written_map(folder, scenario, *, seed=1, **output):
    """Points of the map that a run writes, in the world; the world."""
    simulation = simulate(scenario, seed)
    records = list(simulation)
    odometry = make_odometry(RunConfig(), simulation.rig, frozenset({"lidar", "imu"}), 2)
    writer = MapWriter(folder / "submaps.bin", OutputConfig(**output), threaded=True)
    results = [result for record in records for result in odometry.add(record)] + odometry.finish()
    for result in results:
        writer.add(result)
    points, _ = writer.points(FinalPoses.moved_by(np.eye(4)))
    writer.release(keep=False)
    truth = simulation.truth.pose(np.array([result.end_ns for result in results]))
    T_world_odom = align(np.stack([result.T_odom_imu for result in results]), truth)
    return se3.act(T_world_odom, points.astype(np.float64)), simulation.world


def assert_on_the_surfaces(points, world):
    off = world.distance(points)
    assert np.median(off) <= 3e-3
    assert np.percentile(off, 95) <= 0.02
    assert np.mean(off > 0.05) < 5e-3


def assert_walls_are_single(points):
    """Of what lies by the walls above the furniture, next to nothing is off by half of the noise."""
    high = points[(points[:, 2] > 2.2) & (points[:, 2] < 2.65)]
    for axis, at in ((0, 0.0), (0, 10.0), (1, 0.0), (1, 7.0)):
        clear = np.abs(high[:, 1 - axis] - (3.5, 5.0)[axis]) < (3.2, 4.7)[axis]  # of the walls beside it
        off = np.abs(high[clear, axis] - at)
        assert np.sum(off < 0.08) > 200
        assert np.mean(off[off < 0.08] > 0.01) < 0.01, (axis, at)


def test_map_of_a_room_on_the_grid_lies_on_its_surfaces(tmp_path):
    assert ROOM.lidar.range_noise == 0.02
    points, world = written_map(tmp_path, FAST)
    assert_on_the_surfaces(points, world)
    assert_walls_are_single(points)


def test_map_of_cells_alone_has_double_walls(tmp_path):
    """What the test above is there to find."""
    points, world = written_map(tmp_path, FAST, surface_thickness=0.0)
    assert np.median(world.distance(points)) > 6e-3
    with pytest.raises(AssertionError):
        assert_walls_are_single(points)


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [0.0, 17.2])
@pytest.mark.parametrize("seed", [1, 2])
def test_map_of_a_whole_walk_lies_on_the_surfaces_however_the_grid_is_turned(tmp_path, yaw_deg, seed):
    scenario = ROOM.varied(mount={"rig_rpy_deg": (0.0, 0.0, yaw_deg)})
    points, world = written_map(tmp_path, scenario, seed=seed)
    assert_on_the_surfaces(points, world)
    assert_walls_are_single(points)


@pytest.mark.slow
def test_map_of_the_warehouse_lies_on_its_surfaces(tmp_path):
    points, world = written_map(tmp_path, SCENARIOS["warehouse"].thinned(duration=60.0))
    assert_on_the_surfaces(points[::5], world)

"""Registration of two clouds: poses, statuses, the textbook's numbers, and every bad input."""

from dataclasses import replace

import numpy as np
import pytest
from tests import scenes

from heliograph.config import AlignConfig
from heliograph.errors import ConfigError, DataError
from heliograph.lie import se3, so3
from heliograph.registration import align, prepare_cloud
from heliograph.registration.align_levels import METHODS, level_matches
from heliograph.testing import assert_alignment

SURFACES = ("gicp", "vgicp", "point-to-plane")


def _room_pair(seed=0, distance=0.8, angle=0.2):
    rng = np.random.default_rng(seed)
    truth = scenes.random_motion(rng, distance, angle)
    return scenes.corner_room(rng), scenes.moved(scenes.corner_room(rng), truth), truth


@pytest.mark.parametrize("method", SURFACES)
def test_align_keeps_the_law(method):
    assert_alignment(lambda a, b, **more: align(a, b, method=method, **more), np.random.default_rng(3))


@pytest.mark.parametrize(("method", "distance", "angle"), [
    *((m, 2e-3, 1e-3) for m in SURFACES), ("point-to-point", 0.05, 0.02)
])  # fmt: skip
def test_align_finds_the_pose(method, distance, angle):
    target, source, truth = _room_pair()
    result = align(target, source, method=method)
    error = se3.log(se3.inverse(truth) @ result.T_target_source)
    assert result.T_target_source is not None
    assert np.linalg.norm(error[3:]) < distance and np.linalg.norm(error[:3]) < angle
    assert result.overlap_source > 0.95 and result.overlap_target > 0.95
    assert 0 < result.inliers <= result.matches <= result.elements


def test_align_settles_from_a_metre_and_fifteen_degrees():
    rng = np.random.default_rng(5)
    target, source, truth = _room_pair(5, 0.3, 0.1)
    for _ in range(10):
        result = align(target, source, start=truth @ scenes.random_motion(rng, 1.0, np.radians(15.0)))
        assert result.status == "converged"
        assert np.linalg.norm(se3.log(se3.inverse(truth) @ result.T_target_source)) < 5e-3


def test_align_covariance_holds_its_errors():
    squares = []
    for seed in range(40):
        target, source, truth = _room_pair(seed, 0.2, 0.05)
        result = align(target, source)
        error = se3.log(se3.inverse(result.T_target_source) @ truth)
        squares.append(error @ np.linalg.solve(result.covariance, error) / 6.0)
    assert 0.1 < np.mean(squares) < 3.0  # optimistic sigmas would show as a large mean


def test_align_by_some_of_the_elements_finds_the_same_with_the_same_covariance():
    target, source, truth = _room_pair(2, 0.2, 0.05)
    whole, some = (align(target, source, config=AlignConfig(max_elements=n)) for n in (0, 1000))
    assert 300 < some.matches <= 1000 < 2 * whole.matches and some.status == "converged"
    assert np.linalg.norm(se3.log(se3.inverse(truth) @ some.T_target_source)[3:]) < 3e-3
    ratio = np.diag(some.covariance) / np.diag(whole.covariance)
    assert (ratio > 0.5).all() and (ratio < 2.0).all()


def test_align_does_not_depend_on_threads():
    target, source, _ = _room_pair()
    one, many = (align(target, source, threads=t) for t in (1, 5))
    assert one.T_target_source.tobytes() == many.T_target_source.tobytes()
    assert one.covariance.tobytes() == many.covariance.tobytes()


def test_align_leaves_arrays_alone_and_takes_prepared_clouds():
    target, source, _ = _room_pair()
    target.flags.writeable = source.flags.writeable = False
    once = align(target, source)
    a, b = prepare_cloud(target), prepare_cloud(source)
    assert a.points is target or np.shares_memory(a.points, target)
    again = align(a, b)
    assert again.T_target_source.tobytes() == once.T_target_source.tobytes()


def test_align_of_far_coordinates_in_double_precision():
    target, source, truth = _room_pair()
    shift_t, shift_s = np.array([4.5e5, 5.4e6, 120.0]), np.array([4.5e5, 5.4e6, 119.0])
    start = np.eye(4)
    start[:3, 3] = shift_t - shift_s
    far = align(target.astype(np.float64) + shift_t, source.astype(np.float64) + shift_s, start=start)
    near = far.T_target_source.copy()
    near[:3, 3] += near[:3, :3] @ shift_s - shift_t
    assert np.linalg.norm(se3.log(se3.inverse(truth) @ near)) < 5e-3


def test_align_names_a_corridor_blind_and_keeps_its_start():
    rng = np.random.default_rng(1)
    truth = se3.exp([0.02, -0.03, 0.05, 0.0, 0.1, -0.05])
    start = np.eye(4)
    start[0, 3] = 0.37
    target, source = (scenes.corridor(rng, 20000).astype(np.float32) for _ in range(2))
    result = align(target, scenes.moved(source, truth), start=start)
    assert result.status == "degenerate" and result.T_target_source is not None
    (blind,) = result.observability.blind
    assert blind.kind == "translation" and abs((result.T_target_source[:3, :3] @ blind.direction)[0]) > 0.999
    assert abs(result.T_target_source[0, 3] - 0.37) < 0.02
    error = se3.log(se3.inverse(truth) @ result.T_target_source)
    assert np.abs(error[[0, 1, 2, 4, 5]]).max() < 0.02
    sigma_x = np.sqrt(blind.direction @ result.covariance[3:, 3:] @ blind.direction)
    assert sigma_x == pytest.approx(AlignConfig().start_sigma, rel=0.05)


def test_align_without_overlap_has_a_status_and_no_pose():
    target, source, _ = _room_pair()
    start = np.eye(4)
    start[0, 3] = 500.0
    result = align(target, source, start=start)
    assert result.status == "no overlap" and result.T_target_source is None and result.covariance is None
    assert "elements" in result.reason and result.as_dict()["T_target_source"] is None


def test_align_counts_nothing_for_nan():
    target, source, _ = _room_pair()
    holed = np.concatenate([np.full((50, 3), np.nan, np.float32), source, np.full((9, 3), np.inf, np.float32)])
    a, b = align(target, source), align(target, holed)
    np.testing.assert_allclose(a.T_target_source, b.T_target_source, atol=1e-12)


LINE = np.linspace(0.0, 5.0, 100)[:, None].astype(np.float32) * np.float32([1.0, 2.0, 0.5])


@pytest.mark.parametrize(("cloud", "words"), [
    (np.zeros((0, 3), np.float32), "source has 0 finite points of 0"),
    (np.ones((1, 3), np.float32), "source has 1 finite points of 1"),
    (np.full((50, 3), np.nan, np.float32), "source has 0 finite points of 50"),
    (LINE, "one line"),
    (np.ones((50, 3), np.float32), "one line or place"),
    (np.ones((50, 4), np.float32), r"shape \(50, 4\)"),
    (np.ones((50, 3), np.int32), "dtype int32"),
])  # fmt: skip
def test_align_refuses_a_bad_cloud(cloud, words):
    target, _, _ = _room_pair()
    with pytest.raises(DataError, match=words) as caught:
        align(target, cloud)
    assert "\n" not in str(caught.value)


def test_align_refuses_millimetres():
    target, source, _ = _room_pair()
    with pytest.raises(DataError, match="millimetres"):
        align(target, source * np.float32(1000.0))


@pytest.mark.parametrize(("start", "words"), [
    (2.0 * np.eye(4), "no rotation"),
    (np.diag([1.0, 1.0, -1.0, 1.0]), "det R = -1"),
    (np.full((4, 4), np.nan), "finite"),
    (np.eye(3), "4x4"),
])  # fmt: skip
def test_align_refuses_a_start_that_is_no_motion(start, words):
    target, source, _ = _room_pair()
    with pytest.raises(DataError, match=words):
        align(target, source, start=start)


def test_align_refuses_unknown_methods():
    target, source, _ = _room_pair()
    with pytest.raises(ConfigError, match="did you mean 'gicp'"):
        align(target, source, method="gicpp")
    with pytest.raises(ConfigError, match="cubes"):
        align(target, source, method="vgicp", config=AlignConfig(voxel=0.0))


def test_residuals_of_the_textbook():
    # p' = (2.1, 0.3) beside the wall x = 2, whose nearest point is q = (2, 0): 0.1 across it, 0.316 to the point.
    side = np.arange(-8.0, 9.0) * 0.65
    wall = np.stack(np.meshgrid([2.0], side, side, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
    config = AlignConfig(voxel=0.0, neighbours=9, kernel=0.0)
    p = np.array([[2.1, 0.3, 0.0], [2.1, 3.0, 0.0], [2.1, 0.0, 3.0]], np.float32)
    target, source = prepare_cloud(wall, config), prepare_cloud(p, AlignConfig(voxel=0.0, neighbours=3))
    methods = ("point-to-plane", "point-to-point")
    plane, point = (level_matches(target, source, np.eye(4), m, 0, 0.0, config, 1)[0] for m in methods)
    assert abs(plane[6]) == pytest.approx(0.1, abs=1e-6)
    assert point[6] == pytest.approx(np.sqrt(0.1), abs=1e-6)
    assert round(point[6], 3) == 0.316


def _two_walls():
    rng = np.random.default_rng(7)
    walls = [((2.5, 0, 0), (2.5, 0, 0)), ((0, 2.5, 0), (0, 2.5, 0))]
    clouds = [np.concatenate([scenes.patch(rng, c, u, (0, 0, 1), 1500) for c, u in walls]) for _ in range(2)]
    truth = se3.exp([0.0, 0.0, np.radians(4.0), 0.2, -0.15, 0.0])
    return clouds[0].astype(np.float32), scenes.moved(clouds[1], truth), truth


def test_two_walls_settle_in_six_iterations_by_planes_and_more_by_points():
    target, source, truth = _two_walls()
    config = AlignConfig(voxel=0.0, gate=1.0, kernel=0.0, iterations=100, tolerance=1e-3, tolerance_deg=0.01)
    plane = align(target, source, method="point-to-plane", config=config)
    point = align(target, source, method="point-to-point", config=config)
    in_plane = [2, 3, 4]  # heading, x and y: the walls say nothing of the height
    error = se3.log(se3.inverse(truth) @ plane.T_target_source)
    assert np.abs(error[in_plane]).max() < 5e-3
    assert [str(d.kind) for d in plane.observability.blind] == ["translation"]
    # A blind direction is taken back to the start by a second round of at most three steps.
    assert plane.iterations <= 6 + 3 < point.iterations
    strict, loose = (align(target, source, method=m, config=replace(config, remap=False)).iterations
                     for m in ("point-to-plane", "point-to-point"))  # fmt: skip
    assert strict <= 6 < loose


def test_align_looks_further_where_it_sees_only_the_ground():
    """From a turn so wide that no wall finds a partner the ground alone is left; the walls weigh more."""
    rng = np.random.default_rng(3)

    def yard():
        ground = scenes.patch(rng, (0, 0, -1.5), (25, 0, 0), (0, 25, 0), 8000)
        walls = [((24, 3, 2), (0, 3, 0)), ((-4, 23, 2), (3, 0, 0))]
        return np.concatenate([ground, *(scenes.patch(rng, c, u, (0, 0, 4), 6000) for c, u in walls)])

    truth = se3.exp([0.0, 0.0, 0.1, 0.3, -0.2, 0.0])
    target, source = yard().astype(np.float32), scenes.moved(yard(), truth)
    start = se3.retract(truth, [0.0, 0.0, np.radians(15.0), 0.3, 0.2, 0.0])
    result = align(target, source, start=start)
    assert result.status == "converged", result.reason
    assert np.abs(se3.log(se3.inverse(truth) @ result.T_target_source)).max() < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_align_result_is_plain_json(method):
    import json

    target, source, _ = _room_pair()
    text = json.dumps(align(target, source, method=method).as_dict(), allow_nan=True)
    assert json.loads(text)["method"] == method


@pytest.mark.parametrize("start", [[[1.0, 2.0], [3.0]], "x", [["a"] * 4] * 4])
def test_a_start_that_is_no_matrix_is_one_line(start):
    target, source, _ = _room_pair()
    with pytest.raises((DataError, ConfigError), match="start"):
        align(target, source, start=start)


def test_align_turns_with_the_frames():
    target, source, truth = _room_pair()
    X = so3.exp([0.3, -0.2, 1.0])
    turned = (target.astype(np.float64) @ X.T).astype(np.float32)
    T = np.eye(4)
    T[:3, :3] = X
    a = align(turned, source, start=T)
    assert np.linalg.norm(se3.log(se3.inverse(T @ truth) @ a.T_target_source)) < 5e-3

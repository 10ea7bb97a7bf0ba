"""Control points and tapes: a bent run comes back, held-out points say so, a wrong point is told from right ones."""

from pathlib import Path

import numpy as np
import pytest

from heliograph.cli.survey import _tape
from heliograph.data import ImuBatch, Keyframe, Trajectory
from heliograph.errors import ConfigError, DataError, HeliographError
from heliograph.graph import Between, Diagonal, FactorGraph, Prior, Symbol, Values, solve
from heliograph.io.files.clouds import write_cloud
from heliograph.io.files.poses import read_poses
from heliograph.io.files.tum import write_tum
from heliograph.lie import SE3, se3
from heliograph.output.survey_files import remove_survey
from heliograph.slam import KEYFRAMES, KeyframeStore
from heliograph.survey import deliver
from heliograph.survey.control import TapeLength, read_control_points, tied
from heliograph.survey.coordinates import find_coordinate_system
from heliograph.survey.placed_run import PlacedRun

pytest.importorskip("pyproj")

X = Symbol("X")
K = 41
START_NS = 1_750_000_000_000_000_000
STAMPS_NS = START_NS + np.arange(K, dtype=np.int64) * 10**9
ORIGIN_DEG = np.array([52.0, 11.0, 80.0])
SYSTEM = find_coordinate_system("EPSG:25832", ORIGIN_DEG)
STEP_SIGMA = np.array([5e-4, 5e-4, 2e-3, 0.01, 0.01, 0.01])


def true_way():
    """A walk around a yard of 100 m, in east-north-up."""
    angle = 2.0 * np.pi * np.arange(K) / (K - 1)
    T = np.tile(np.eye(4), (K, 1, 1))
    T[:, :3, :3] = se3.exp(np.stack([0 * angle, 0 * angle, angle, 0 * angle, 0 * angle, 0 * angle], axis=-1))[:, :3, :3]
    T[:, :3, 3] = np.stack([50.0 * np.sin(angle), 50.0 - 50.0 * np.cos(angle), 0.5 * np.sin(2.0 * angle)], axis=-1)
    return T


def bent_run(folder, seed=4):
    """A run of that way as an odometry has it: it begins in a frame of its own and drifts."""
    rng, T = np.random.default_rng(seed), true_way()
    graph, values = FactorGraph(), Values()
    graph.add(Prior(X(0), SE3(np.eye(4)), Diagonal(np.full(6, 1e-4))))
    pose = np.eye(4)
    values.insert(X(0), SE3(pose))
    for k in range(1, K):
        step = se3.inverse(T[k - 1]) @ T[k] @ se3.exp(STEP_SIGMA * rng.normal(size=6))
        graph.add(Between(X(k - 1), X(k), SE3(np.ascontiguousarray(step)), Diagonal(STEP_SIGMA)))
        pose = pose @ step
        values.insert(X(k), SE3(np.ascontiguousarray(pose)))
    values = solve(graph, values, "lm", initial="given").values
    T_files = np.ascontiguousarray(values.at(X(np.arange(K))).matrix[:, :4, :4])
    run = PlacedRun(
        folder=Path(folder), facts={"graph": {}, "status": "ok"}, stamps_ns=STAMPS_NS, graph=graph, values=values,
        origin_deg=None, T_files_imu=T_files,
    )  # fmt: skip
    write_tum(run.folder / "trajectory.tum", Trajectory(stamps_ns=STAMPS_NS, T_frame_body=T_files), "test")
    return run


MARKS = {"A": 0, "B": 8, "C": 16, "D": 24, "E": 32}
CHECKS = {"F": 4, "G": 20, "H": 28}
HELD = slice(0, 33)  # keyframes between marks; behind the last one the run drifts as it did


def table(folder, *, wrong=None, sigma=0.01):
    """Marks 2 m beside the way, told by the time when the body stood beside them."""
    T, rows = true_way(), ["id,easting,northing,height,sigma,stamp,arm_x,arm_y,arm_z,role"]
    for name, k in {**MARKS, **CHECKS}.items():
        p = SYSTEM.from_enu(se3.act(T[k], np.array([[0.0, 2.0, -1.5]])))[0]
        if name == wrong:
            p[0] += 0.4
        role = "check" if name in CHECKS else "control"
        rows.append(f"{name},{p[0]:.5f},{p[1]:.5f},{p[2]:.5f},{sigma},{1e-9 * STAMPS_NS[k]:.3f},0,2,-1.5,{role}")
    path = Path(folder) / "marks.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def residuals(rows, kind, which):
    return np.array([getattr(row, which) for row in rows if row.kind == kind])


def test_control_points_place_and_straighten_a_run(tmp_path):
    run = bent_run(tmp_path)
    solved, rows = tied(run, read_control_points(table(tmp_path), run), [], SYSTEM)
    before, after = residuals(rows, "check", "before"), residuals(rows, "check", "after")
    assert np.linalg.norm(before, axis=1).max() > 0.1
    assert np.linalg.norm(after, axis=1).max() < 0.08
    assert not any(row.suspect for row in rows)
    at = solved.T_enu_map @ solved.T_map_imu
    assert np.linalg.norm((at - true_way())[HELD, :3, 3], axis=1).max() < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_sigmas_of_a_tied_run_are_true(tmp_path, seed):
    run = bent_run(tmp_path, seed)
    solved, _ = tied(run, read_control_points(table(tmp_path, sigma=1e-3), run), [], SYSTEM)
    position, _ = solved.sigmas()
    off = (solved.T_enu_map @ solved.T_map_imu)[:, :3, 3] - true_way()[:, :3, 3]
    assert 0.3 < np.sqrt(((off / position) ** 2).mean()) < 1.6


def test_a_wrong_point_is_told_from_the_right_ones(tmp_path):
    run = bent_run(tmp_path)
    _, rows = tied(run, read_control_points(table(tmp_path, wrong="C"), run), [], SYSTEM)
    assert min(rows, key=lambda row: row.chance).name == "C"
    assert next(row for row in rows if row.name == "C").suspect


def test_what_is_delivered_is_the_solved_run(tmp_path):
    run = bent_run(tmp_path)
    beside = np.array([[0.0, 2.0, -1.5]], np.float32)
    write_cloud(tmp_path / "map.ply", se3.act(run.T_files_imu, beside).reshape(-1, 3).astype(np.float32), None)
    (tmp_path / "config.toml").write_text("")
    store = KeyframeStore.create(tmp_path / KEYFRAMES)
    for k in range(K):
        store.append(Keyframe(
            index=k, stamp_ns=int(STAMPS_NS[k]), T_odom_imu=run.T_files_imu[k], v_odom=np.zeros(3),
            gyro_bias=np.zeros(3), accel_bias=np.zeros(3), g_odom=np.zeros(3), step_covariance=np.zeros((6, 6)),
            lidar_information=np.zeros((6, 6)), points_imu=beside, intensity=None, imu=ImuBatch.joined([]),
        ))  # fmt: skip
    store.close()
    solved, _ = tied(run, read_control_points(table(tmp_path), run), [], SYSTEM)
    deliver(solved, "EPSG:25832", None)
    rows = np.loadtxt(tmp_path / f"trajectory_{SYSTEM.tag}.csv", delimiter=",", skiprows=2)
    off = SYSTEM.to_enu(rows[:, 1:4]) - true_way()[:, :3, 3]
    assert np.linalg.norm(off[HELD], axis=1).max() < 0.1
    laspy = pytest.importorskip("laspy")
    points = SYSTEM.to_enu(np.asarray(laspy.read(tmp_path / f"map_{SYSTEM.tag}.laz").xyz))
    truth = se3.act(true_way(), beside.astype(np.float64)).reshape(-1, 3)[HELD]
    assert np.linalg.norm(points[None] - truth[:, None], axis=-1).min(axis=1).max() < 0.12
    assert len(read_poses(tmp_path / "trajectory.tum", stamped=True).stamps_ns) == K
    deliver(solved, "EPSG:25832", None, tile=50.0)  # in place of the one file, which would be of before
    assert not (tmp_path / f"map_{SYSTEM.tag}.laz").exists()
    assert (tmp_path / f"map_{SYSTEM.tag}" / "index.json").is_file()
    deliver(solved, "local", None)  # another system stands beside it, and goes with the run too
    with pytest.raises(ConfigError, match="no edge of a tile"):
        deliver(solved, "local", None, tile=0.5)
    (tmp_path / "map_mine.laz").write_text("")
    remove_survey(tmp_path)  # as a run that replaces this one does
    assert not [
        path
        for path in tmp_path.iterdir()
        if SYSTEM.tag in path.name or path.suffix in (".gpx", ".kml", ".sbet", ".smrmsg")
    ]
    assert (tmp_path / "map_mine.laz").exists()


def test_a_tape_holds_two_ends_that_have_no_coordinates(tmp_path):
    run, T = bent_run(tmp_path), true_way()
    path = table(tmp_path)
    with path.open("a") as file:
        for name, k in (("P", 2), ("Q", 38)):
            file.write(f"{name},,,,,{1e-9 * STAMPS_NS[k]:.3f},0,0,0,\n")
    length = float(np.linalg.norm(T[2, :3, 3] - T[38, :3, 3]))
    tapes = [TapeLength(a="P", b="Q", length=length, sigma=0.003)]
    _, rows = tied(run, read_control_points(path, run), tapes, SYSTEM)
    (row,) = (row for row in rows if row.kind == "tape")
    assert abs(row.after[0]) < 0.01
    assert abs(row.after[0]) < abs(row.before[0])
    assert not row.suspect
    wrong = [TapeLength(a="P", b="Q", length=length + 3.0, sigma=0.003)]
    _, rows = tied(run, read_control_points(path, run), wrong, SYSTEM)
    assert next(row for row in rows if row.kind == "tape").suspect
    with pytest.raises(DataError, match="ends at 'Z'"):
        tied(run, read_control_points(path, run), [TapeLength(a="P", b="Z", length=1.0)], SYSTEM)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: [*rows, rows[1]], "point A is there twice"),
        (lambda rows: [rows[0].replace("id,", "mark,"), *rows[1:]], "no column id"),
        (lambda rows: [rows[0], rows[1].replace("637", "", 1), *rows[2:]], "km from the run"),
        (lambda rows: [*rows[:2], ",".join(["B", "1.0", "", "2.0", *rows[2].split(",")[4:]]), *rows[3:]], "all three"),
        (lambda rows: [*rows[:2], rows[2].replace(f"{1e-9 * STAMPS_NS[8]:.3f}", "12.0"), *rows[3:]], "not within"),
    ],
)  # fmt: skip
def test_tables_that_cannot_be_are_refused_in_one_line(tmp_path, change, message):
    run, path = bent_run(tmp_path), table(tmp_path)
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    with pytest.raises(HeliographError, match=message) as caught:
        tied(run, read_control_points(path, run), [], SYSTEM)
    assert "\n" not in str(caught.value)


def test_a_point_far_from_the_way_is_refused(tmp_path):
    run, path = bent_run(tmp_path), tmp_path / "marks.csv"
    path.write_text("id,easting,northing,height,map_x,map_y,map_z\nA,637284.5,5762914.2,91.0,9000.0,0.0,0.0\n")
    with pytest.raises(DataError, match="from the way of the run"):
        read_control_points(path, run)


def test_points_on_a_line_do_not_place_a_run(tmp_path):
    run, path = bent_run(tmp_path), table(tmp_path)
    rows = path.read_text().splitlines()
    path.write_text("\n".join([*rows[:3], *rows[6:]]) + "\n")
    with pytest.raises(DataError, match="three are needed"):
        tied(run, read_control_points(path, run), [], SYSTEM)


@pytest.mark.parametrize(
    "text", ["A,B", "A,B,nan", "A,B,-1", "A,B,0", "A,B,1e999", "A,B,2.0,0", "A,B,2.0,nan", "A,B,2,1,1"]
)
def test_tapes_that_measure_nothing_are_refused(text):
    with pytest.raises(ConfigError, match="give two points and metres"):
        _tape(text)

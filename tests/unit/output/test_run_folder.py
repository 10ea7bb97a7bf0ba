import csv
import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes import IMU_STEP_NS, PERIOD_NS, START_NS, FakeOdometry, FakeRecording, make_batch, make_result
from heliograph.config import OutputConfig, RunConfig
from heliograph.data import ImuBatch
from heliograph.errors import MissingDependencyError, OutputError
from heliograph.io.files.clouds import read_cloud
from heliograph.io.files.tum import read_tum
from heliograph.output import FinalPoses, RunSummary, read_submaps
from heliograph.output.map_file import write_map
from heliograph.output.run_folder import RunFolder
from heliograph.pipeline import run


def make_folder(path, *, T_imu_body=None, output=None, **changes):
    values = {
        "name": "test",
        "config": "threads = 1\n",
        # Cubes so small that no two points share one.
        "output": OutputConfig(**({"map_voxel": 1e-3, "keyframe_distance": 1.0} | (output or {}))),
        "T_imu_body": np.eye(4) if T_imu_body is None else T_imu_body,
        "facts": lambda: {"versions": {"heliograph": "9.9"}},
    }
    return RunFolder(path, **(values | changes))


def run_into(folder, scans=10, odometry=None):
    return run(FakeRecording(scans), RunConfig(threads=1), sinks=[folder], odometry=odometry or FakeOdometry())


def test_run_folder_writes_the_files_of_the_contract(tmp_path):
    folder = make_folder(tmp_path / "out")
    run_into(folder)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "trajectory.tum", "odometry.tum", "trajectory_imu_rate.tum", "map.ply", "scans.csv", "config.toml", "run.json",
    }  # fmt: skip
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert facts["status"] == "ok" and facts["scans"] == 10 and facts["versions"] == {"heliograph": "9.9"}
    assert set(facts["files"]) == {path.name for path in (tmp_path / "out").iterdir()}
    assert (tmp_path / "out" / "config.toml").read_text() == "threads = 1\n"


def test_run_folder_rows_stand_at_the_header_stamps(tmp_path):
    folder = make_folder(tmp_path / "out")
    run_into(folder)
    rows = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_array_equal(rows.stamps_ns, START_NS + PERIOD_NS * np.arange(10))
    np.testing.assert_allclose(rows.T_frame_body[:, 0, 3], 0.1 * np.arange(10), atol=1e-9)
    first = (tmp_path / "out" / "trajectory.tum").read_text().splitlines()[0]
    assert first.startswith("# heliograph 9.9: T_map_imu") and "header stamp" in first
    assert (tmp_path / "out" / "odometry.tum").read_text().splitlines()[1:] == (
        tmp_path / "out" / "trajectory.tum"
    ).read_text().splitlines()[1:]


def test_run_folder_imu_rate_has_one_row_a_sample_even_at_scan_ends(tmp_path):
    folder = make_folder(tmp_path / "out")
    run_into(folder, scans=5)
    rows = read_tum(tmp_path / "out" / "trajectory_imu_rate.tum")
    np.testing.assert_array_equal(rows.stamps_ns, START_NS + IMU_STEP_NS * np.arange(50))


def test_run_folder_imu_rate_leaves_out_poses_between_samples(tmp_path):
    batch = make_batch(0)
    sparse = ImuBatch(
        stamps_ns=batch.stamps_ns[1::3].copy(), gyro=batch.gyro[1::3], accel=batch.accel[1::3], received_ns=0
    )
    with make_folder(tmp_path / "out") as folder:
        folder.observe(sparse)
        folder.add(make_result(0))
    rows = read_tum(tmp_path / "out" / "trajectory_imu_rate.tum")
    np.testing.assert_array_equal(rows.stamps_ns, batch.stamps_ns[1::3])


def test_run_folder_without_imu_has_no_imu_rate_file(tmp_path):
    folder = make_folder(tmp_path / "out")
    recording = FakeRecording(3, sensors=frozenset({"lidar"}))
    run(recording, RunConfig(threads=1), sinks=[folder], odometry=FakeOdometry())
    assert not (tmp_path / "out" / "trajectory_imu_rate.tum").exists()


def test_run_folder_writes_the_body_that_was_asked_for(tmp_path):
    T_imu_lidar = np.eye(4)
    T_imu_lidar[:3, 3] = 0.0, 0.5, 0.2
    run_into(make_folder(tmp_path / "out", output={"body": "lidar"}, T_imu_body=T_imu_lidar))
    rows = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_allclose(rows.T_frame_body[:, 1:3, 3], np.tile([0.5, 0.2], (10, 1)), atol=1e-9)
    assert "T_map_lidar" in (tmp_path / "out" / "trajectory.tum").read_text().splitlines()[0]


def test_run_folder_levels_poses_map_and_table_alike(tmp_path):
    angle = 0.1
    T = np.eye(4)
    T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    run_into(make_folder(tmp_path / "flat"))
    run_into(make_folder(tmp_path / "turned"), odometry=FakeOdometry(T_leveled_odom=T))
    for name in ("trajectory.tum", "odometry.tum", "trajectory_imu_rate.tum"):
        before, after = (read_tum(tmp_path / folder / name) for folder in ("flat", "turned"))
        np.testing.assert_allclose(after.T_frame_body, T @ before.T_frame_body, atol=1e-8)
        heads = [(tmp_path / folder / name).read_text().splitlines()[0] for folder in ("flat", "turned")]
        assert heads[0] == heads[1]
    before, after = (read_cloud(tmp_path / folder / "map.ply").points for folder in ("flat", "turned"))
    np.testing.assert_allclose(after, before @ T[:3, :3].T, atol=1e-5)
    with (tmp_path / "turned" / "scans.csv").open() as file:
        row = next(csv.DictReader(file))
    direction = [float(row[f"weak_direction_{axis}"]) for axis in "xyz"]
    np.testing.assert_allclose(direction, T[:3, :3] @ [1, 0, 0], atol=1e-6)
    # The first scan is 0.1 m along x, where the tilt about y lifts and lowers it: it is that of gravity along x.
    variance = np.diag(np.arange(4.0, 7.0) ** 2 * 1e-6) + np.diag([0.0, 0.0, (0.1 * 16e-3) ** 2])
    variance = T[:3, :3] @ variance @ T[:3, :3].T
    sigma = [float(row[f"sigma_position_{axis}"]) for axis in "xyz"]
    np.testing.assert_allclose(sigma, np.sqrt(np.diag(variance)), rtol=1e-6)


def test_scans_csv_has_a_row_a_scan_with_verdict_stages_and_sigmas(tmp_path):
    run_into(make_folder(tmp_path / "out"))
    with (tmp_path / "out" / "scans.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["index"]) for row in rows] == list(range(10))
    assert rows[0]["verdict"] == "first" and rows[5]["verdict"] == "tracked"
    assert float(rows[3]["ms_match"]) == 2.0 and float(rows[3]["ms_total"]) == 3.0
    assert float(rows[3]["sigma_gyro_bias_x"]) == pytest.approx(10e-3)
    assert float(rows[3]["eigenvalue_translation_max"]) == pytest.approx(0.5)


def test_scans_csv_gains_a_column_for_a_stage_that_comes_later(tmp_path):
    class Later(FakeOdometry):
        def finish(self):
            return [make_result(i, timings={"match": 1.0, "fallback": 4.0}) for i in (8, 9)]

    run_into(make_folder(tmp_path / "out"), odometry=Later())
    with (tmp_path / "out" / "scans.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["ms_fallback"]) == 4.0 and float(rows[0]["ms_fallback"]) == 0.0


def test_run_folder_crash_leaves_what_was_streamed(tmp_path):
    folder = make_folder(tmp_path / "out")
    with folder:
        for index in range(60):
            folder.add(make_result(index))
        assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 50  # flushed every 50 scans
        assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "running"
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 60


def test_run_folder_killed_leaves_valid_files(tmp_path):
    """SIGKILL gives no chance to tidy up: what was handed to the system by then must be whole."""
    script = """
import os, signal, sys
sys.path[:0] = sys.argv[2:]
from pathlib import Path
from test_run_folder import make_folder
from fakes import make_result
folder = make_folder(Path(sys.argv[1]))
for index in range(75):
    folder.add(make_result(index))
os.kill(os.getpid(), signal.SIGKILL)
"""
    here = Path(__file__).resolve()
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "out"), str(here.parent), str(here.parents[2])],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 50
    submaps = list(read_submaps(tmp_path / "out" / "submaps.bin"))
    assert len(submaps) == 7 and sum(submap.cells.counts.sum() for submap in submaps) == 7 * 10 * 50
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "running"


def moved(results, sideways):
    """The same poses, and the end of the run moved to the side by so much, the begin left."""
    stamps = np.array([result.end_ns for result in results])
    T_odom_imu = np.stack([result.T_odom_imu for result in results])
    T_map_imu = T_odom_imu.copy()
    T_map_imu[:, 1, 3] += sideways * np.linspace(0.0, 1.0, len(results)) ** 2
    return FinalPoses(stamps_ns=stamps, T_odom_imu=T_odom_imu, T_map_imu=T_map_imu)


def test_run_folder_writes_trajectories_map_and_table_where_the_poses_ended(tmp_path):
    results = [make_result(index) for index in range(40)]
    final = moved(results[::5], 2.0)
    for name, poses in (("before", None), ("after", final)):
        with make_folder(tmp_path / name) as folder:
            for index, result in enumerate(results):
                folder.observe(make_batch(index))
                folder.add(result)
            folder.close(RunSummary(scans=40, final_poses=poses))
    for name in ("trajectory.tum", "trajectory_imu_rate.tum"):
        before, after = (read_tum(tmp_path / folder / name) for folder in ("before", "after"))
        expected = final.T_map_odom(before.stamps_ns) @ before.T_frame_body
        np.testing.assert_allclose(after.T_frame_body, expected, atol=2e-9)
        np.testing.assert_array_equal(after.stamps_ns, before.stamps_ns)
    speed = np.diff(after.T_frame_body[:, 1, 3]) / np.diff(after.stamps_ns * 1e-9)
    assert speed.max() > 0.5 and np.abs(np.diff(speed)).max() < 0.1, "the path has a kink"
    assert (tmp_path / "before" / "odometry.tum").read_bytes() == (tmp_path / "after" / "odometry.tum").read_bytes()
    clouds = []
    for folder in ("before", "after"):
        cloud = read_cloud(tmp_path / folder / "map.ply")
        clouds.append(cloud.points[np.lexsort((cloud.points[:, 0], cloud.columns["stamp"]))])
    keyframes = [10 * (index // 10) for index in range(40)]
    shift = final.T_map_odom(np.array([results[k].end_ns for k in keyframes]))[:, 1, 3]
    np.testing.assert_allclose(clouds[1][:, 1] - clouds[0][:, 1], np.repeat(shift, 50), atol=2e-3)
    with (tmp_path / "after" / "scans.csv").open() as file:
        last = list(csv.DictReader(file))[-1]
    assert float(last["position_y"]) == pytest.approx(final.T_map_odom(np.array([results[-1].end_ns]))[0, 1, 3])


def test_run_folder_poses_that_did_not_move_change_no_bit(tmp_path):
    results = [make_result(index) for index in range(20)]
    for name, poses in (("before", None), ("after", moved(results, 0.0))):
        with make_folder(tmp_path / name) as folder:
            for result in results:
                folder.add(result)
            folder.close(RunSummary(scans=20, final_poses=poses))
    for name in ("trajectory.tum", "odometry.tum", "map.ply", "scans.csv"):
        assert (tmp_path / "before" / name).read_bytes() == (tmp_path / "after" / name).read_bytes(), name


def test_run_folder_keeps_the_submaps_when_asked(tmp_path):
    run_into(make_folder(tmp_path / "out", output={"keep_submaps": True}))
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert "submaps.bin" in facts["files"]
    assert sum(s.cells.counts.sum() for s in read_submaps(tmp_path / "out" / "submaps.bin")) == 500


def test_run_folder_makes_room_for_the_map_with_what_it_was_made_of(tmp_path, monkeypatch):
    def only_beside_nothing(path, *arguments):
        if (path.parent / "submaps.bin").exists():
            raise OutputError(f"cannot write {path}: the disk is full")
        return write_map(path, *arguments)

    monkeypatch.setattr("heliograph.output.run_folder.write_map", only_beside_nothing)
    run_into(make_folder(tmp_path / "out"))
    assert len(read_cloud(tmp_path / "out" / "map.ply")) == 500


def test_run_folder_map_that_cannot_be_put_together_leaves_the_submaps(tmp_path, monkeypatch):
    def no_room(writer, final):
        raise MemoryError("no room")

    monkeypatch.setattr("heliograph.output.map_writer.MapWriter.blocks", no_room)
    with pytest.raises(MemoryError):
        run_into(make_folder(tmp_path / "out"), scans=30)
    assert sum(s.cells.counts.sum() for s in read_submaps(tmp_path / "out" / "submaps.bin")) == 1500
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert "no room" in facts["failure"] and "submaps.bin" in facts["files"] and "map.ply" not in facts["files"]


@pytest.mark.parametrize("threaded", [False, True])
def test_run_folder_on_a_disk_full_of_submaps_saves_the_map_and_says_so(tmp_path, full_disk, threaded):
    class Standing(FakeOdometry):
        """Sees the same 500 points from one place, in scan after scan."""

        def add(self, message):
            cloud = np.random.default_rng(0).uniform(-5, 5, (500, 3)).astype(np.float32)
            changes = {"points_imu": cloud, "intensity": None, "T_odom_imu": np.eye(4)}
            return [replace(result, **changes) for result in super().add(message)]

    folder = make_folder(tmp_path / "out", threaded=threaded, output={"keyframe_interval": 0.2})
    with full_disk(50_000), pytest.raises(OutputError, match=r"cannot write .*submaps\.bin"):
        run_into(folder, scans=100, odometry=Standing())
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert "submaps.bin" in facts["failure"]
    assert 5 < len(read_tum(tmp_path / "out" / "trajectory.tum")) == facts["scans"] < 20
    assert not (tmp_path / "out" / "submaps.bin").exists()
    assert set(facts["files"]) == {path.name for path in (tmp_path / "out").iterdir()}
    assert len(read_cloud(tmp_path / "out" / "map.ply")) == facts["map_points"] == 500


def test_run_folder_refuses_an_earlier_run_without_overwrite(tmp_path):
    run_into(make_folder(tmp_path / "out"))
    with pytest.raises(OutputError, match="--overwrite"):
        make_folder(tmp_path / "out")
    folder = make_folder(tmp_path / "out", overwrite=True, has_map=False)
    run_into(folder, scans=4)
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == 4
    assert not (tmp_path / "out" / "map.ply").exists(), "the earlier run's map must not stay beside the new trajectory"


def test_run_folder_without_a_result_leaves_nothing(tmp_path):
    with pytest.raises(Exception, match="no scan"):
        run_into(make_folder(tmp_path / "out"), scans=0)
    assert not (tmp_path / "out").exists()


def test_run_folder_failing_finisher_does_not_cost_the_account(tmp_path):
    def broken(record):
        raise OutputError("cannot write report.html: the disk is full")

    folder = make_folder(tmp_path / "out", finishers=(broken,))
    with pytest.raises(OutputError, match="full"):
        run_into(folder)
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert "full" in facts["failure"] and facts["scans"] == 10
    assert len(read_cloud(tmp_path / "out" / "map.ply")) == 500


def test_run_folder_keeps_lost_scans_out_of_the_map(tmp_path):
    class Losing(FakeOdometry):
        def finish(self):
            return [make_result(9, status="lost")]

    run_into(make_folder(tmp_path / "out"), odometry=Losing())
    assert len(read_cloud(tmp_path / "out" / "map.ply")) == 9 * 50


def test_run_json_holds_no_nan(tmp_path):
    class Unmatched(FakeOdometry):
        def finish(self):
            return [make_result(9, rms=float("nan"))]

    run_into(
        make_folder(tmp_path / "out", facts=lambda: {"ratio": np.float64("nan"), "rows": np.eye(2)}),
        odometry=Unmatched(),
    )
    text = (tmp_path / "out" / "run.json").read_text()
    assert "NaN" not in text and json.loads(text)["ratio"] is None and json.loads(text)["rows"] == [[1, 0], [0, 1]]


def test_run_folder_map_format_without_its_package_fails_before_the_run(tmp_path, monkeypatch):
    def absent(*arguments, **keywords):
        raise MissingDependencyError("LAZ needs laspy; pip install 'heliograph[las]'")

    monkeypatch.setattr("heliograph.output.run_folder.write_cloud", absent)
    with pytest.raises(MissingDependencyError, match="laspy"):
        make_folder(tmp_path / "out", output={"map_format": "laz"})
    assert not (tmp_path / "out").exists()


def test_run_folder_writes_a_laz_map(tmp_path):
    laspy = pytest.importorskip("laspy")
    run_into(make_folder(tmp_path / "out", output={"map_format": "laz"}))
    assert laspy.read(tmp_path / "out" / "map.laz").header.point_count == 500

import csv
import json

import numpy as np
import pytest

from fakes import IMU_STEP_NS, PERIOD_NS, START_NS, FakeMap, FakeOdometry, FakeRecording, make_batch, make_result
from heliograph.config import RunConfig
from heliograph.data import ImuBatch
from heliograph.errors import MissingDependencyError, OutputError
from heliograph.io.files.clouds import read_cloud
from heliograph.io.files.tum import read_tum
from heliograph.output.run_folder import RunFolder
from heliograph.pipeline import run


def make_folder(path, **changes):
    values = {
        "name": "test",
        "config": "threads = 1\n",
        "body": "imu",
        "T_imu_body": np.eye(4),
        "global_map": FakeMap(),
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
    run_into(make_folder(tmp_path / "out", body="lidar", T_imu_body=T_imu_lidar))
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
    variance = T[:3, :3] @ np.diag(np.arange(4.0, 7.0) ** 2 * 1e-6) @ T[:3, :3].T
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


def test_run_folder_refuses_an_earlier_run_without_overwrite(tmp_path):
    run_into(make_folder(tmp_path / "out"))
    with pytest.raises(OutputError, match="--overwrite"):
        make_folder(tmp_path / "out")
    folder = make_folder(tmp_path / "out", overwrite=True, global_map=None)
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
        make_folder(tmp_path / "out", map_format="laz")
    assert not (tmp_path / "out").exists()


def test_run_folder_writes_a_laz_map(tmp_path):
    laspy = pytest.importorskip("laspy")
    run_into(make_folder(tmp_path / "out", map_format="laz"))
    assert laspy.read(tmp_path / "out" / "map.laz").header.point_count == 500

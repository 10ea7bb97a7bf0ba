"""The benchmark harness: short adapters, tables that are those of the results, frames and shifts undone."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from heliograph.data import Trajectory
from heliograph.graph import solve, write_g2o
from heliograph.graph.files.worlds import grid_walk, manhattan
from heliograph.lie import SE2, SE3, se3

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def harness(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks import accuracy, rivals, table

    return accuracy, rivals, table


def _walk(n=400):
    stamps = 1_000_000_000 + 50_000_000 * np.arange(n, dtype=np.int64)
    t = (stamps - stamps[0]) * 1e-9
    turn = np.stack([0.05 * np.sin(2 * t), 0.05 * np.cos(3 * t), 0.3 * t + 0.2 * np.sin(t)], axis=1)
    T = se3.exp(np.concatenate([turn, np.zeros((n, 3))], axis=1))
    T[:, :3, 3] = np.stack([2.0 * t, np.sin(t), 0.1 * np.cos(t)], axis=1)
    return Trajectory(stamps_ns=stamps, T_frame_body=T, frame="world", body="imu")


def test_adapters_are_short(harness):
    for folder in ("rivals", "graph_rivals"):
        for file in (ROOT / "benchmarks" / folder).glob("*.py"):
            assert len(file.read_text().splitlines()) <= 60, file.name


def test_accuracy_undoes_frame_and_time_shift(harness):
    accuracy = harness[0]
    truth = _walk()
    T_imu_lidar = se3.exp([0.1, -0.2, 0.5, 0.8, -0.3, 0.8])
    lidar = Trajectory(
        stamps_ns=truth.stamps_ns + 37_000_000,
        T_frame_body=truth.T_frame_body @ T_imu_lidar,
        frame="odom",
        body="lidar",
    )
    errors = accuracy.accuracy(accuracy.in_imu_frame(lidar, T_imu_lidar), truth)
    assert errors.shift_ms == pytest.approx(-37.0, abs=0.2)
    assert errors.ate_m < 1e-3
    assert errors.rpe_rotation_deg < 0.02 < errors.rpe_rotation_unshifted_deg
    mistaken = Trajectory(stamps_ns=lidar.stamps_ns, T_frame_body=lidar.T_frame_body, frame="odom", body="imu")
    assert accuracy.accuracy(accuracy.in_imu_frame(mistaken, T_imu_lidar), truth).ate_m > 0.1


def test_accuracy_agrees_with_evo(harness, rng):
    pytest.importorskip("evo", reason="evo needs Python 3.11")
    accuracy = harness[0]
    truth = _walk()
    noisy = se3.retract(truth.T_frame_body, 0.01 * rng.normal(size=(len(truth), 6)))
    estimate = Trajectory(stamps_ns=truth.stamps_ns, T_frame_body=noisy)
    ours = accuracy.accuracy(estimate, truth, shift=0.01)
    assert accuracy.evo_ate(estimate, truth, 0.01) == pytest.approx(ours.ate_m, abs=1e-6)


def test_tables_are_those_of_the_results(harness, tmp_path):
    table = harness[2]
    results = ROOT / "benchmarks" / "results"
    table.write_table(results, tmp_path / "BENCHMARKS.md")
    assert (tmp_path / "BENCHMARKS.md").read_text() == (ROOT / "benchmarks" / "BENCHMARKS.md").read_text()
    (tmp_path / "README.md").write_text((ROOT / "README.md").read_text())
    table.write_readme(results, tmp_path / "README.md")
    assert (tmp_path / "README.md").read_text() == (ROOT / "README.md").read_text()


def test_results_keep_the_bars(harness):
    rows = [json.loads(line) for line in (ROOT / "benchmarks" / "results" / "kitti.jsonl").read_text().splitlines()]
    ours = next(row for row in rows if row["system"] == "heliograph")
    rivals = [row for row in rows if row["system"] != "heliograph"]
    assert ours["rpe_rotation_deg"] <= 1.1 * min(row["rpe_rotation_deg"] for row in rivals)
    assert ours["ate_m"] <= 1.1 * np.median([row["ate_m"] for row in rivals])


@pytest.fixture
def graph_harness(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks import graph, graph_scale, graph_table

    return graph, graph_scale, graph_table


@pytest.mark.parametrize("make", [manhattan, grid_walk])
def test_graph_harness_scores_every_solution_alike(graph_harness, rng, tmp_path, make):
    graph = graph_harness[0]
    file = graph.prepare(make(80, rng).file, tmp_path / "world.g2o")
    assert len(file.missing_ids) == 0
    group = SE2 if file.dimension == 2 else SE3
    solution = solve(file.graph(), file.values())
    T = solution.values.block(group)[1].matrix
    assert graph.chi2(file, T) == pytest.approx(solution.chi2, rel=1e-9)
    assert graph.chi2(file, file.values().block(group)[1].matrix) == pytest.approx(solution.initial_chi2, rel=1e-9)


def test_graph_harness_runs_our_program_in_a_process_of_its_own(graph_harness, rng, tmp_path):
    graph = graph_harness[0]
    write_g2o(tmp_path / "world.g2o", manhattan(60, rng).file)
    programs = {"heliograph": Path(sys.executable)}
    ours = graph.SOLVERS[:2]
    rows = graph.compare({"world": tmp_path / "world.g2o"}, ours, tmp_path / "work", programs, runs=2)
    assert [row["options"] for row in rows] == [["lm"], ["gn"]]
    assert all(row["reached"] and row["runs"] == 2 and row["seconds"] > 0.0 for row in rows)
    assert rows[0]["chi2"] == pytest.approx(rows[1]["chi2"], rel=1e-4)


def test_graph_tables_say_where_the_bar_is_missed(graph_harness):
    _, scale, tables = graph_harness
    from benchmarks.table import _table

    def row(system, seconds, chi2=10.0, *, reached=True, options=("lm",), graph="a", poses=100):
        return {
            "graph": graph, "poses": poses, "edges": 200, "system": system, "options": list(options), "runs": 7,
            "failed": False, "version": "1", "seconds": seconds, "iterations": 3, "chi2": chi2, "reached": reached,
            "peak_mb": 60.0 + poses / 10, "base_mb": 60.0,
        }  # fmt: skip

    rows = [row("heliograph", 1.0), row("gtsam", 3.0), row("ceres", 1.5, 99.0, reached=False)]
    text = tables.graph_section(rows, _table)
    assert "| gtsam 1 lm | 3000.00 | 0.33 |" in text and "Kept on every graph" in text
    assert "| a | ceres 1 lm | 1500.00 | 3 | 99 | no |" in text
    assert "Missed on a (0.67)" in tables.graph_section([*rows, row("g2o", 1.5)], _table)
    sizes = (10_000, 100_000)
    grown = [row("heliograph", n**1.2, graph=f"manhattan_{n}", poses=n) for n in sizes]
    text = tables.scale_section(grown, _table)
    assert "exponent 1.20" in text and "bare program with 1.00" in text
    assert scale.exponent(sizes, [n**1.2 for n in sizes]) == pytest.approx(1.2)


def test_incremental_adapter_replays_a_graph(harness, tmp_path):
    from benchmarks import graph_incremental, incremental_table, table

    programs = {"heliograph": Path(sys.executable), "rivals": tmp_path / "none", "ceres": tmp_path / "none"}
    rows = graph_incremental.measure_incremental_scale(tmp_path, programs, count=300)
    assert [row["updates"] for row in rows] == [300, 300]
    assert len(rows[0]["deciles_bytes_a_pose"]) == 10
    assert "heliograph | 300" in incremental_table.incremental_scale_section(rows, table._table)
    write_g2o(tmp_path / "small.g2o", manhattan(150, np.random.default_rng(3)).file)
    rows = graph_incremental.compare_incremental(tmp_path, ["small"], tmp_path / "work", programs, runs=2)
    assert [row["skip"] for row in rows] == [1, 10]
    for row in rows:
        assert row["chi2"] == pytest.approx(row["batch_chi2"], rel=0.05)
        assert row["p50_ms"] <= row["p99_ms"] <= row["max_ms"]
    assert "small" in incremental_table.incremental_section(rows, table._table)


def test_calibration_section_judges_the_sigmas(harness):
    from benchmarks.calibrate import calibration_section

    def rows(nees):
        return [
            {
                "motion": "planar",
                "seed": seed,
                "error": [1e-4, 0.0, 0.0, 3e-3, 4e-3, 0.0, -2e-4, 1e-6],
                "verdicts": ["observed"] * 5 + ["not excited"] + ["observed"] * 2,
                "nees": nees,
                "told": 7,
                "cpu_s": 1.0,
            }
            for seed in range(20)
        ]

    honest = calibration_section(rows(7.0), harness[2]._table)
    assert "| planar | 20 | lever arm [mm] | 5.0000 | 5.0000 | 5.0000 |" in honest
    assert "| planar | 20 | offset [ms] | 0.2000 |" in honest
    assert "inside the band" in honest and "axes not excited: 1" in honest
    assert "OUTSIDE" in calibration_section(rows(11.0), harness[2]._table)
    assert "OUTSIDE" in calibration_section(rows(4.0), harness[2]._table)


def test_preintegration_benchmark_measures_and_tells(harness, tmp_path):
    from benchmarks import imu, imu_table, table

    rows = imu.measure(tmp_path, tmp_path / "none", runs=1)
    assert [row["system"] for row in rows] == ["heliograph", "heliograph"]
    assert all(0.0 < row["us_a_sample"] < 100.0 for row in rows)
    rows.append({**rows[0], "system": "gtsam", "us_a_sample": 10.0 * max(row["us_a_sample"] for row in rows)})
    text = imu_table.preintegration_section(rows, table._table)
    assert "takes 0.10 of gtsam's faster loop (bar: 0.2)" in text


def test_results_of_the_real_drive_keep_the_bars():
    rows = [json.loads(line) for line in (ROOT / "benchmarks" / "results" / "imu_gnss.jsonl").read_text().splitlines()]
    error = {(row["system"], row["method"]): row["rmse_m"] for row in rows if row["method"] != "cuts"}
    for method in ("batch", "incremental"):
        assert error["heliograph", method] <= 0.5 * rows[0]["noisy_rmse_m"]
        assert error["heliograph", method] <= 1.02 * error["gtsam", method]
    cuts = next(row for row in rows if row["method"] == "cuts")
    low, high = cuts["band"]
    assert low <= cuts["mean_nees"] <= high
    assert cuts["cuts"] == 20


def test_runs_that_come_back_are_scored_by_their_revisits_gap_and_kink(harness):
    from benchmarks import loop_runs

    lap = np.array([(x, 0.0, 0.0) for x in range(40)] + [(40.0 - x, 8.0, 0.0) for x in range(40)], float)
    T = np.tile(np.eye(4), (220, 1, 1))
    T[:, :3, 3] = np.vstack([lap, lap, lap[:60]]) + np.r_[np.zeros(80), np.full(140, 0.5)][:, None] * [0.0, 1.0, 0.0]
    groups = loop_runs._groups(T)
    assert [min(group) for group in groups] == [80] and len(groups[0]) == 140  # the leg beside is 8 m off
    T[80:, 2, 3] += 3.0
    assert [min(group) for group in loop_runs._groups(T)] == [160]  # the storey above is another place
    stamps = 10**9 * np.arange(220, dtype=np.int64)
    true = Trajectory(stamps_ns=stamps, T_frame_body=T, frame="world", body="imu")
    moved = np.array([np.eye(4)] * 220)
    moved[110:, 0, 3] = 0.02
    bent = Trajectory(stamps_ns=stamps, T_frame_body=moved @ T, frame="map", body="imu")
    assert loop_runs._gap(bent, true) == pytest.approx(0.02) and loop_runs._kink(true, bent) == pytest.approx(0.02)

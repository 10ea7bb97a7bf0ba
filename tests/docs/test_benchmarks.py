"""The benchmark harness: short adapters, tables that are those of the results, frames and shifts undone."""

import json
from pathlib import Path

import numpy as np
import pytest

from heliograph.data import Trajectory
from heliograph.lie import se3

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
    for file in (ROOT / "benchmarks" / "rivals").glob("*.py"):
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

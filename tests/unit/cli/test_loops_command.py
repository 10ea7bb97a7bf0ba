"""A run on another system's poses closes its loops, and `heliograph loops` lists, explains, revokes and adds them."""

import csv
import errno
import json
import shutil

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.cli.main import main
from heliograph.io.files.clouds import read_cloud, write_cloud
from heliograph.io.files.tum import read_tum

DRIFT = ("slam.pose_position_sigma=0.02", "slam.pose_rotation_sigma_deg=0.2")
SETTINGS = [word for setting in ("loops.apart=15", *DRIFT) for word in ("--set", setting)]


@pytest.fixture(scope="module")
def walk():
    return drifting_walk()


@pytest.fixture(scope="module")
def keyframes(walk, tmp_path_factory):
    """Return a folder as another system leaves it: clouds, their times, and its poses."""
    folder = tmp_path_factory.mktemp("others")
    (folder / "Scans").mkdir()
    for keyframe in walk.keyframes:
        write_cloud(folder / "Scans" / f"{keyframe.index:06d}.pcd", keyframe.points_imu)
    np.savetxt(folder / "times.txt", 1e9 + np.arange(len(walk.keyframes)), fmt="%.3f")
    rows = np.stack([keyframe.T_odom_imu[:3].ravel() for keyframe in walk.keyframes])
    np.savetxt(folder / "poses.txt", rows, fmt="%.9f")
    return folder


@pytest.fixture(scope="module")
def run(keyframes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    code = main([
        "run", str(keyframes), "--odometry", str(keyframes / "poses.txt"), "-o", str(folder), "--quiet",
        *SETTINGS,
    ])  # fmt: skip
    assert code == 0
    return folder


@pytest.fixture
def copy(run, tmp_path):
    return shutil.copytree(run, tmp_path / "copy")


def poses(folder, name="trajectory.tum"):
    return read_tum(folder / name).T_frame_body


def test_run_on_poses_of_another_system_closes_the_loop(walk, run):
    facts = json.loads((run / "run.json").read_text())
    assert facts["status"] == "ok" and facts["graph"]["keyframes"] == len(walk.keyframes)
    assert facts["graph"]["loops"]["accepted"] > 3
    assert {"loops.csv", "graph.g2o", "graph.npz"} <= set(facts["files"])
    assert walk.error(poses(run)) < 0.5 * walk.error(poses(run, "odometry.tum"))
    np.testing.assert_allclose(poses(run, "odometry.tum")[5], walk.keyframes[5].T_odom_imu, atol=1e-6)


def test_graph_of_a_run_solves_to_what_it_says(run, call):
    code, out, err = call("solve", run / "graph.g2o", "--json")
    result = json.loads(out)
    assert code == 0, err
    assert result["final_chi2"] <= result["initial_chi2"] * (1.0 + 1e-6) + 1e-6
    assert result["initial_chi2"] < 1.1 * result["final_chi2"] + 1e-3


def test_loops_lists_what_stands(run, call):
    code, out, _ = call("loops", run)
    assert code == 0 and "accepted: enough loops agree" in out
    assert "candidates" in out.splitlines()[-2] + out.splitlines()[-1]
    code, out, _ = call("loops", run, "--json")
    entries = json.loads(out)
    assert code == 0 and [entry["number"] for entry in entries] == list(range(len(entries)))


def test_loops_explains_one_with_a_picture(copy, call):
    number = next(e["number"] for e in json.loads(call("loops", copy, "--json")[1]) if e["verdict"] == "accepted")
    code, out, _ = call("loops", copy, "--explain", number)
    assert code == 0 and "overlap" in out and "sigma of the loop" in out
    assert (copy / f"loop_{number}.png").read_bytes().startswith(b"\x89PNG")


def test_revoking_all_loops_gives_the_odometry_back(copy, call):
    accepted = [e["number"] for e in json.loads(call("loops", copy, "--json")[1]) if e["verdict"] == "accepted"]
    code, out, _ = call("loops", copy, *[word for number in accepted for word in ("--revoke", number)])
    assert code == 0 and "0 loops stand" in out
    np.testing.assert_allclose(poses(copy), poses(copy, "odometry.tum"), atol=1e-6)
    assert json.loads((copy / "run.json").read_text())["graph"]["loops"]["accepted"] == 0


def test_loop_is_added_by_hand_and_taken_back(run, copy, call):
    entry = next(e for e in json.loads(call("loops", copy, "--json")[1]) if e["verdict"] == "accepted")
    before = poses(copy)
    code, out, err = call("loops", copy, "--add", entry["query"] - 1, entry["match"])
    assert code == 0, err
    assert "added by hand" in out
    number = len(json.loads(call("loops", copy, "--json")[1])) - 1
    code, out, _ = call("loops", copy, "--revoke", number)
    assert code == 0 and "revoked by hand" in out
    np.testing.assert_allclose(poses(copy), before, atol=2e-3)


@pytest.mark.slow
def test_walls_are_made_thin_on_request_and_stay_so(walk, run, copy, call):
    code, out, err = call("loops", copy, "--refine", "planes")
    assert code == 0 and "planes" in out, err
    facts = json.loads((copy / "run.json").read_text())["graph"]["refined"]
    moved = np.abs(poses(copy) - poses(run)).max()
    assert facts["refined"] == ("walls are thinner" in out) == (moved > 1e-4)
    if facts["refined"]:
        assert facts["thickness_after_m"] < facts["thickness_before_m"]
    assert walk.error(poses(copy)) < 1.2 * walk.error(poses(run)) + 0.02
    loop = json.loads(call("loops", copy, "--json")[1])[0]["number"]
    assert call("loops", copy, "--revoke", loop)[0] == 0  # begins without it, from where the files are
    assert "refined" not in json.loads((copy / "run.json").read_text())["graph"]
    assert call("loops", copy, "--refine", "spheres")[0] == 2


def test_files_of_a_changed_run_tell_the_same(copy, call):
    accepted = [e["number"] for e in json.loads(call("loops", copy, "--json")[1]) if e["verdict"] == "accepted"]
    code, _, err = call("loops", copy, *[word for number in accepted for word in ("--revoke", number)])
    assert code == 0, err
    facts = json.loads((copy / "run.json").read_text())
    T = poses(copy)
    assert facts["start_end_gap_m"] == pytest.approx(np.linalg.norm(T[-1, :3, 3] - T[0, :3, 3]), abs=1e-5)
    assert facts["map_points"] == len(read_cloud(copy / "map.ply").points)
    with (copy / "scans.csv").open(newline="") as file:
        rows = [[float(row[f"position_{axis}"]) for axis in "xyz"] for row in csv.DictReader(file)]
    np.testing.assert_allclose(rows, T[:, :3, 3], atol=1e-5)


@pytest.mark.parametrize("broken", ["write_graph_files", "write_map", "rewrite_scans", "write_text"])
def test_change_that_cannot_be_written_changes_nothing(copy, call, monkeypatch, broken):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left")

    before = {path.name: path.read_bytes() for path in copy.iterdir() if path.is_file()}
    number = next(e["number"] for e in json.loads(call("loops", copy, "--json")[1]) if e["verdict"] == "accepted")
    monkeypatch.setattr(f"heliograph.revision.{broken}", full)
    code, _, err = call("loops", copy, "--revoke", number)
    assert code == 2 and "the disk is full" in err and len(err.splitlines()) == 1
    assert {path.name: path.read_bytes() for path in copy.iterdir() if path.is_file()} == before
    assert not list(copy.glob(".*"))


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        (("--explain", 100000), "there is no loop 100000"),
        (("--revoke", 100000), "there is no loop 100000"),
        (("--add", 0, 100000), "a loop joins two of the keyframes"),
        (("--add", 3, 3), "a loop joins two of the keyframes"),
    ],
)
def test_loops_says_what_is_wrong_in_one_line(copy, call, options, cause):
    before = (copy / "trajectory.tum").read_bytes()
    code, _, err = call("loops", copy, *options)
    assert code == 2 and cause in err and len(err.splitlines()) == 1
    assert (copy / "trajectory.tum").read_bytes() == before


def test_loops_refuses_what_is_no_run(tmp_path, call):
    code, _, err = call("loops", tmp_path)
    assert code == 2 and "is no folder of a run" in err and len(err.splitlines()) == 1


@pytest.mark.parametrize("damage", ["loops.csv", "graph.npz", "keyframes/journal.jsonl", "config.toml"])
def test_loops_names_the_file_that_is_missing(copy, call, damage):
    (copy / damage).unlink()
    code, _, err = call("loops", copy)
    assert code == 2 and len(err.splitlines()) == 1
    assert damage.split("/")[0].split(".")[0] in err


def test_run_without_loops_and_without_a_graph(keyframes, tmp_path, call):
    poses_file = keyframes / "poses.txt"
    code, _, err = call("run", keyframes, "--odometry", poses_file, "-o", "a", "--no-loops", "--quiet")
    assert code == 0, err
    facts = json.loads((tmp_path / "a" / "run.json").read_text())
    assert facts["graph"]["loops"]["candidates"] == 0
    code, _, err = call("run", keyframes, "--odometry", poses_file, "-o", "b", "--no-graph", "--quiet")
    assert code == 0, err
    assert "graph" not in json.loads((tmp_path / "b" / "run.json").read_text())
    assert not (tmp_path / "b" / "keyframes").exists() and not (tmp_path / "b" / "loops.csv").exists()
    code, _, err = call("loops", "b")
    assert code == 2 and "without a graph" in err


def test_overwritten_run_leaves_no_keyframes_behind(keyframes, copy, call):
    code, _, err = call("run", keyframes, "--odometry", keyframes / "poses.txt", "-o", copy, "--no-graph", "--quiet",
                        "--overwrite")  # fmt: skip
    assert code == 0, err
    assert not (copy / "keyframes").exists() and not (copy / "graph.npz").exists()


def test_poses_that_are_missing_or_too_few_are_one_line(keyframes, tmp_path, call):
    code, _, err = call("run", keyframes, "--odometry", "nowhere.txt", "-o", "a", "--quiet")
    assert code == 2 and "nowhere.txt" in err and len(err.splitlines()) == 1
    (tmp_path / "others.tum").write_text("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n")
    code, _, err = call("run", keyframes, "--odometry", "others.tum", "-o", "b", "--quiet")
    assert code == 2 and "none of the" in err and "has a pose" in err and len(err.splitlines()) == 1

"""`heliograph merge`: runs that saw the same place become one map; what is not linked for sure stays apart."""

import json

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.cli.main import main
from heliograph.io.files.clouds import write_cloud
from heliograph.lie import se3, so3
from heliograph.revision import open_run_graph

pytestmark = pytest.mark.slow  # the fast ones are in tests/unit/merging

FIRST, SECOND = slice(0, 34), slice(24, 61)


@pytest.fixture(scope="module")
def walk():
    return drifting_walk()


@pytest.fixture(scope="module")
def elsewhere():
    return drifting_walk(place="room", laps=2.0)


def made(folder, walk, part, away):
    """Run a part of a walk by poses of another system, in a frame of its own."""
    (folder / "clouds" / "Scans").mkdir(parents=True)
    for number, keyframe in enumerate(walk.keyframes[part]):
        write_cloud(folder / "clouds" / "Scans" / f"{number:06d}.pcd", keyframe.points_imu)
    T = away @ np.stack([keyframe.T_odom_imu for keyframe in walk.keyframes[part]])
    np.savetxt(folder / "clouds" / "times.txt", 1e9 + np.arange(len(T)), fmt="%.3f")
    np.savetxt(folder / "clouds" / "poses.txt", T[:, :3].reshape(-1, 12), fmt="%.9f")
    words = ["run", str(folder / "clouds"), "--odometry", str(folder / "clouds" / "poses.txt"), "--no-loops"]
    assert main([*words, "-o", str(folder / folder.name), "--quiet"]) == 0
    return folder / folder.name


@pytest.fixture(scope="module")
def runs(walk, elsewhere, tmp_path_factory):
    top = tmp_path_factory.mktemp("runs")
    away = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, 2.0), [30.0, -5.0, 1.0])
    return {
        "one": made(top / "one", walk, FIRST, np.eye(4)),
        "two": made(top / "two", walk, SECOND, away),
        "other": made(top / "other", elsewhere, slice(None), np.eye(4)),
    }


@pytest.fixture(scope="module")
def merged(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("merged") / "all"
    assert main(["merge", *(str(run) for run in runs.values()), "-o", str(folder)]) == 0
    return folder


def test_merge_lays_runs_on_each_other_and_names_what_is_apart(walk, merged):
    facts = json.loads((merged / "run.json").read_text())
    one, two, other = facts["sessions"]
    assert one["linked"] and two["linked"] and not other["linked"]
    assert facts["status"] == "degraded" and "other" in facts["reasons"][0]
    assert two["links"] >= 4 and other["links"] == 0
    T = open_run_graph(merged).T_map_imu
    true = np.concatenate([walk.T_true[FIRST], walk.T_true[SECOND]])
    first, again = 3, two["first_keyframe"] + 20  # the same place, a lap later
    off = se3.log(se3.inverse(se3.inverse(true[first]) @ true[again]) @ se3.inverse(T[first]) @ T[again])
    assert np.linalg.norm(off[3:]) < 0.03


def test_merge_leaves_links_in_a_ledger_that_loops_revokes(call, merged):
    code, out, _ = call("loops", merged)
    assert code == 0 and "accepted" in out
    number = next(entry.number for entry in open_run_graph(merged).ledger.accepted())
    code, out, _ = call("loops", merged, "--revoke", number)
    assert code == 0 and "revoked" in out
    assert open_run_graph(merged).ledger[number].decision.verdict == "revoked"


def test_merge_of_runs_without_overlap_is_one_line(call, runs, tmp_path):
    code, _, errors = call("merge", runs["one"], runs["other"], "-o", "nothing")
    assert code == 2 and "nothing links other to one" in errors and len(errors.splitlines()) == 1
    assert not (tmp_path / "nothing").exists()


def test_merge_says_what_is_no_run(call, runs, tmp_path):
    for words in ([runs["one"]], [runs["one"], runs["one"]], [runs["one"], tmp_path]):
        code, _, errors = call("merge", *words, "-o", "nothing")
        assert code == 2 and len(errors.splitlines()) == 1

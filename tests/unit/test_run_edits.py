"""Edits by a plan: boxes, loops and sessions, always of what the run left, and one line for what is no plan."""

import json

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.cli.main import main
from heliograph.config import RunConfig
from heliograph.config_toml import dump_config
from heliograph.editing import apply_edits
from heliograph.edits import read_edits
from heliograph.errors import DataError, FormatError
from heliograph.io.files.clouds import read_cloud
from heliograph.lie import se3
from heliograph.localization import open_map
from heliograph.registration import ResidualDistribution
from heliograph.revision import open_run_graph
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.graph_files import write_graph_files
from heliograph.slam.loops import Ledger, LedgerEntry, LoopDecision, LoopEvidence

COUNT = 24


@pytest.fixture(scope="module")
def walk():
    return drifting_walk(laps=0.6)


def evidence(query, match, T):
    quiet = ResidualDistribution(rms=0.01, median=0.01, p90=0.02, p99=0.03, max=0.1, reduced_chi_square=1.0)
    return LoopEvidence(
        query=query, match=match, source="place", status="converged", T_match_query=T, covariance=1e-4 * np.eye(6),
        overlap_query=0.8, overlap_match=0.8, inliers=0.95, residuals=quiet, blind=(), weakest=1e4,
        T_match_query_odom=T, odom_covariance=1e-2 * np.eye(6), odom_mahalanobis=1.0, starts=1, agreeing=1, lead=9.0,
    )  # fmt: skip


@pytest.fixture
def run(walk, tmp_path):
    """Return the folder of two merged sessions of twelve keyframes, with one loop between them."""
    folder = tmp_path / "run"
    folder.mkdir()
    store = KeyframeStore.create(folder / "keyframes")
    for keyframe in walk.keyframes[:COUNT]:
        store.append(keyframe)
    store.close()
    T = np.ascontiguousarray(se3.inverse(walk.T_true[2]) @ walk.T_true[20])
    stands = LoopDecision(verdict="accepted", reason="clique")
    ledger = Ledger(RunConfig().loops, [LedgerEntry(number=0, evidence=evidence(20, 2, T), decision=stands)])
    back_end = BackEnd.replayed(RunConfig(), store, ledger)
    write_graph_files(folder, back_end)
    (folder / "config.toml").write_text(dump_config(RunConfig()))
    sessions = [
        {"name": "one", "first_keyframe": 0, "keyframes": 12},
        {"name": "two", "first_keyframe": 12, "keyframes": 12},
    ]
    facts = {"status": "ok", "graph": {"keyframes": COUNT}, "sessions": sessions, "T_map_odom": np.eye(4).tolist()}
    (folder / "run.json").write_text(json.dumps(facts))
    return folder


def planned(folder, text):
    plan = folder.parent / "plan.toml"
    plan.write_text(text)
    return plan


def test_edits_remove_a_box_from_the_map_and_from_localisation(run):
    apply_edits(run, planned(run, ""))
    whole = read_cloud(run / "map.ply").points
    low, high = np.quantile(whole, 0.3, axis=0), np.quantile(whole, 0.7, axis=0)
    apply_edits(run, planned(run, f"[[remove_box]]\nlow = {low.tolist()}\nhigh = {high.tolist()}\n"))
    left = read_cloud(run / "map.ply").points

    def inside(points):
        return int(((points >= low + 0.05) & (points <= high - 0.05)).all(axis=1).sum())

    assert inside(whole) > 0 and inside(left) == 0 and len(left) > 0.5 * len(whole)
    saved = open_map(run)
    points = (
        saved.submaps[0].cloud.points @ saved.submaps[0].T_map_submap[:3, :3].T + saved.submaps[0].T_map_submap[:3, 3]
    )
    assert inside(points) == 0
    apply_edits(run, planned(run, ""))
    assert np.array_equal(read_cloud(run / "map.ply").points, whole)


def test_edits_forbid_a_loop_and_give_it_back(run):
    T = open_run_graph(run).T_map_imu.copy()
    account = apply_edits(run, planned(run, "[[forbid_loop]]\nquery = 2\nmatch = 20\n"))
    assert account.accepted == 0
    assert np.abs(open_run_graph(run).T_map_imu - T).max() > 0.01
    assert apply_edits(run, planned(run, "")).accepted == 1
    assert np.abs(open_run_graph(run).T_map_imu - T).max() < 1e-6


def test_edits_drop_a_session_with_its_links(run):
    account = apply_edits(run, planned(run, '[[drop_session]]\nname = "two"\n'))
    assert account.accepted == 0
    graph = open_run_graph(run)
    assert graph.dropped(12) and not graph.dropped(11)
    assert len(graph.points(12)) == 0 < len(graph.points(11))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[remove_bax]]\nlow = [0, 0, 0]\n", "did you mean"),
        ("[[remove_box]]\nlow = [0, 0, 0]\n", "low and high"),
        ("[[remove_box]]\nlow = [0, 0, 0]\nhigh = [1, -1, 1]\n", "three greater ones"),
        (f"[[remove_box]]\nlow = [0, 0, 0]\nhigh = [1, 1, 1{400 * chr(48)}]\n", "three greater ones"),
        ("[[add_loop]]\nquery = 3\nmatch = 3\n", "two keyframes"),
        ("[remove_box]\nlow = [0, 0, 0]\n", "two brackets"),
        ("low = ", "no plan"),
    ],
)
def test_plan_that_is_none_is_told(tmp_path, text, words):
    with pytest.raises(FormatError, match=words):
        read_edits(planned(tmp_path / "x", text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[forbid_loop]]\nquery = 9\nmatch = 3\n", "no loop of keyframes 9 and 3"),
        ('[[drop_session]]\nname = "tow"\n', "no session 'tow'"),
        ("[[add_loop]]\nquery = 99\nmatch = 3\n", "keyframes 0 to 23"),
    ],
)
def test_plan_of_what_is_not_there_changes_nothing(run, text, words):
    before = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    with pytest.raises(DataError, match=words):
        apply_edits(run, planned(run, text))
    assert {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()} == before


def test_edit_command_says_what_it_did(run, capsys):
    assert main(["edit", str(run), str(planned(run, "[[forbid_loop]]\nquery = 20\nmatch = 2\n"))]) == 0
    assert "1 forbidden" in capsys.readouterr().out
    assert main(["edit", str(run), str(run / "none.toml")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1

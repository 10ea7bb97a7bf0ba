"""The lab's experiments say what the engine says, and the lesson's numbers come out."""

import json
from itertools import pairwise

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.graph import Between, FactorGraph, Isotropic, Marginals, Prior, Values, solve
from heliograph.lab import EXPERIMENTS, find_experiment
from heliograph.lab.icp import ONE_STEP, T_TRUE, two_scans
from heliograph.lab.loop import LoopRun
from heliograph.lab.side_by_side import lap
from heliograph.lie import se3
from heliograph.registration import align

QUICK = ("icp", "graph", "loop")
LESSON = {
    "sensors": ["0.15"],
    "deskew": ["0.12", "3.12", "0.20"],
    "icp": ["0.1", "0.316"],
    "graph": ["0.167", "10.33"],
    "families": [],
    "loop": ["0.020"],
    "tunnel": ["80"],
}


def readings(run, settings):
    return {reading.name: reading.value for reading in run.view(settings).readings}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_experiment_shows_the_numbers_worked_in_the_lesson(name):
    experiment = EXPERIMENTS[name]
    assert [f"{number.value:.{number.digits}f}" for number in experiment.worked()] == LESSON[name]
    assert experiment.chapter[0].isdigit()
    assert experiment.command.startswith("heliograph ")
    assert len(experiment.code.splitlines()) <= 10


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_experiment_answers_in_json_and_goes_on(name):
    experiment = EXPERIMENTS[name]
    settings = experiment.settings()
    run = experiment.begin(settings)
    first = json.dumps(run.view(settings).as_dict(), allow_nan=False)
    for _ in range(3):
        run.step(experiment.actions[0].name, settings)
    later = run.view(settings).as_dict()
    assert len(json.dumps(later, allow_nan=False)) < 400_000
    assert name == "graph" or json.dumps(later) != first
    assert later["charts"] and later["readings"] and later["message"]
    run.release()
    assert all(len(trace["x"]) == len(trace["y"]) for chart in later["charts"] for trace in chart["traces"])


@pytest.mark.parametrize("name", [*QUICK, "deskew"])
def test_experiment_has_python_that_runs(name, capsys):
    exec(compile(EXPERIMENTS[name].code, name, "exec"), {})
    assert capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if name not in (*QUICK, "deskew")])
def test_experiment_has_python_that_runs_for_whole_drives(name, capsys):
    exec(compile(EXPERIMENTS[name].code, name, "exec"), {})
    assert capsys.readouterr().out


def test_two_places_are_the_engine_and_kalmans_filter():
    experiment = find_experiment("graph")
    settings = experiment.settings({"fix_sigma": 0.5, "odometry_sigma": 2.0, "measured": 12.0})
    shown = readings(experiment.begin(settings), settings)
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], [[0.0], [10.0]])
    graph.add(Prior(0, [0.0], Isotropic(1.0)))
    graph.add(Between(0, 1, [10.0], Isotropic(2.0)))
    graph.add(Prior(1, [12.0], Isotropic(0.5)))
    solution = solve(graph, values)
    sigma = np.sqrt(np.diag(Marginals(graph, solution.values).joint([0, 1])))
    assert [shown["x0"], shown["x1"]] == solution.values.at([0, 1])[:, 0].tolist()
    assert [shown["sigma0"], shown["sigma1"]] == sigma.tolist()
    assert shown["kalman_x1"] == pytest.approx(shown["x1"], abs=1e-9)
    assert shown["kalman_sigma1"] == pytest.approx(shown["sigma1"], abs=1e-9)


def test_two_places_without_an_anchor_are_refused_in_words():
    experiment = find_experiment("graph")
    settings = experiment.settings({"prior": False, "fix": False})
    view = experiment.begin(settings).view(settings)
    assert "refuses" in view.message
    assert not view.readings


def test_icp_steps_are_align_with_one_iteration():
    experiment = find_experiment("icp")
    settings = experiment.settings()
    run = experiment.begin(settings)
    target, source = two_scans("room")
    T = T_TRUE @ se3.exp([0.0, 0.0, np.radians(6.0), 0.4, -0.2, 0.0])
    for _ in range(3):  # the next steps are below a tenth of a millimetre, and not taken
        run.step("step", settings)
        T = align(target, source, method="point-to-plane", start=T, config=ONE_STEP).T_target_source
    way = run.ways["point-to-plane"]
    np.testing.assert_array_equal(way.T, T)
    assert readings(run, settings)["off"] < 0.02
    assert way.history[0][0] > 5.0 * way.history[-1][0]


def test_icp_shows_every_residual_beside_the_others_and_planes_need_fewer_steps_than_points():
    experiment = find_experiment("icp")
    settings = experiment.settings()
    run = experiment.begin(settings)
    for _ in range(6):
        run.step("step", settings)
    off = {method: way.off()[0] for method, way in run.ways.items()}
    assert off["point-to-plane"] < 0.5 * off["point-to-point"]
    for method in run.ways:
        seen = settings | {"method": method}
        assert readings(run, seen)["off"] == off[method], "a look at another residual takes no step"
        offsets = next(chart for chart in run.view(seen).charts if chart.name == "offsets")
        assert {trace.name: trace.y[-1] for trace in offsets.traces}[method] == max(off[method], 1e-5)
        assert [trace.name for trace in offsets.traces if not trace.dashed] == [method]


def test_corridor_leaves_the_start_along_itself():
    experiment = find_experiment("icp")
    settings = experiment.settings({"scene": "corridor"})
    run = experiment.begin(settings)
    for _ in range(5):
        run.step("step", settings)
    assert "translation along" in str(readings(run, settings)["blind"])


@pytest.mark.parametrize("relinearize", ["poses that moved", "nothing"])
def test_closed_loop_hands_its_drift_out_and_touches_a_part_of_the_tree(relinearize):
    run = LoopRun({"drift": 2.0, "relinearize": relinearize})
    while run.driven < 100:
        run.drive()
    assert readings(run, {})["gap"] == pytest.approx(2.0, abs=1e-6)
    run.close()
    shown = readings(run, {})
    assert shown["gap"] < 0.001
    assert shown["given_in"] == pytest.approx(0.02, abs=1e-4)
    assert run.given_in().max() < 0.021
    assert 0 < shown["touched"] < shown["cliques"]
    assert (shown["touched"] < 0.5 * shown["cliques"]) == (relinearize == "nothing")


def test_correction_goes_down_the_tree_from_its_root():
    run = LoopRun({"drift": 2.0})
    while run.driven < 60:
        run.drive()
    assert run.ripple(run.smoother.cliques()) == []
    run.close()
    cliques = run.smoother.cliques()
    frames, now = run.ripple(cliques), run.positions()
    corrected = [{k for k in range(61) if not np.array_equal(frame[k], run.before[k])} for frame in (*frames, now)]
    # Pose 0 is fixed; each level adds its own poses, and none before its parent's.
    assert not corrected[0] and corrected[-1] == set(range(1, 61)) and len(frames) > 5
    assert all(less < more for less, more in pairwise(corrected))
    assert corrected[1] == {pivot for clique in cliques if clique.parent is None for pivot in clique.pivots}
    charts = {chart.name: chart for chart in run.view({}).charts}
    assert all(any(trace.frames for trace in charts[name].traces) for name in ("path", "tree"))
    run.drive()
    assert run.ripple(run.smoother.cliques()) == []


def test_loop_without_a_drive_cannot_be_closed():
    run = LoopRun({"drift": 2.0})
    run.close()
    assert not run.closed


def drive(name, given, steps):
    experiment = find_experiment(name)
    settings = experiment.settings(given)
    run = experiment.begin(settings)
    for _ in range(steps):
        run.step("step", settings)
    return readings(run, settings)


def test_shaken_lidar_smears_and_both_sensors_do_not():
    shown = drive("sensors", {"speed": 1.5}, 24)
    assert shown["error_fused"] < 0.02
    assert shown["error_LiDAR"] > 5.0 * shown["error_fused"]
    assert drive("sensors", {"speed": 0.2, "shake": 0.0}, 24)["error_LiDAR"] < 0.5 * shown["error_LiDAR"]


def test_way_that_matches_nothing_is_followed_no_further():
    experiment = find_experiment("sensors")
    settings = experiment.settings({"shake": 1.5, "speed": 3.0})
    run = experiment.begin(settings)
    for name, track in run.tracks.items():
        track.unmatched = 2 if name == "LiDAR" else 0
    before = {name: len(track.stamps_ns) for name, track in run.tracks.items()}
    for _ in range(3):
        run.step("step", settings)
    grown = {name: len(track.stamps_ns) - before[name] for name, track in run.tracks.items()}
    assert grown == {"LiDAR": 0, "IMU": 3, "fused": 3}
    run.step("step", settings)
    assert run.tracks["IMU"].unmatched == 0, "an IMU alone has nothing to match"


def test_raw_sweeps_make_thicker_walls_than_corrected_ones():
    shown = drive("deskew", {}, 25)
    assert shown["misplaced"] > 0.15
    assert shown["thickness_corrected"] < 0.7 * shown["thickness_raw"]


@pytest.mark.slow
def test_tunnel_blinds_one_direction_and_the_imu_carries_it():
    aided, alone = (drive("tunnel", {"imu": imu}, 80) for imu in (True, False))
    assert aided["status"] == alone["status"] == "degenerate"
    assert aided["blind"] > 30
    assert aided["ratio"] == "over 100 000" or aided["ratio"] > 80
    assert abs(aided["error"]) < 4.0 * aided["sigma"]
    assert abs(alone["error"]) > 5.0 * abs(aided["error"])


def test_lap_is_the_same_for_whoever_asks():
    np.testing.assert_array_equal(lap(1.5).imu()[0], lap(1.5).imu()[0])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"sped": 1.0}, r"no control 'sped'.*speed"),
        ({"speed": 99.0}, r"speed = 99.0 is not a number from 0.2 to 3"),
        ({"speed": True}, "not a number"),
        ({"speed": float("nan")}, "not a number"),
        ({"mode": "radar"}, "'radar' is not one of LiDAR, IMU, fused"),
    ],
)
def test_settings_that_are_none_are_refused(given, words):
    with pytest.raises(ConfigError, match=words):
        find_experiment("sensors").settings(given)


def test_switch_takes_a_truth_value_only():
    with pytest.raises(ConfigError, match="neither true nor false"):
        find_experiment("tunnel").settings({"imu": "yes"})


def test_experiment_that_is_none_is_told_with_its_neighbour():
    with pytest.raises(ConfigError, match=r"'tunel' is unknown.*tunnel"):
        find_experiment("tunel")

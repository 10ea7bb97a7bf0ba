"""`heliograph solve`: the contract, on small graphs."""

import functools
import json

import numpy as np
import pytest

from heliograph.graph import (
    Between,
    FactorGraph,
    Isotropic,
    Prior,
    Values,
    load_graph,
    read_pose_graph,
    save_graph,
    write_g2o,
    write_toro,
)
from heliograph.graph.files.worlds import grid_walk, manhattan, with_false_loops
from heliograph.lie import SE2

KEYS = {"initial_chi2", "final_chi2", "iterations", "status", "solve_seconds", "warnings", "start", "chi2_per_dof"}


@pytest.fixture
def solve(call):
    return functools.partial(call, "solve")


@pytest.fixture
def city(tmp_path, rng):
    """A world whose file has all vertices, at their odometry."""
    world = manhattan(120, rng, sigmas=(0.02, 0.05))
    write_g2o(tmp_path / "city.g2o", world.file.with_values(world.file.odometry_values()))
    return world


def facts(result):
    code, out, err = result
    assert code == 0, err
    return json.loads(out), err


def test_solve_tells_in_a_few_lines(solve, city):
    code, out, err = solve("city.g2o")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == f"120 poses in the plane, {119 + city.loops} edges, 1 held"
    assert lines[1] == "start: file"
    assert lines[2].startswith("chi2 ") and "a degree of freedom" in lines[2]
    assert "Levenberg-Marquardt" in lines[3]
    assert lines[-1] == "status: converged"


def test_solve_json_is_one_object(solve, city):
    found, _ = facts(solve("city.g2o", "--json"))
    assert set(found) >= KEYS
    assert found["final_chi2"] < found["initial_chi2"]
    assert found["final_chi2"] == pytest.approx(found["degrees_of_freedom"], rel=0.3)
    assert found["degrees_of_freedom"] == 3 * (119 + city.loops) - 3 * 119
    assert found["solve_seconds"] == found["seconds"]["total"]
    assert found["written"] == []


def test_all_solvers_and_starts_reach_one_optimum(solve, city):
    best = facts(solve("city.g2o", "--json"))[0]["final_chi2"]
    for options in (["--solver", "gn"], ["--solver", "dogleg"], ["--init", "odometry"], ["--init", "chordal"]):
        assert facts(solve("city.g2o", "--json", *options))[0]["final_chi2"] == pytest.approx(best, rel=1e-4)


REPLAY_KEYS = {
    *("updates", "update_seconds", "mean_ms", "p50_ms", "p99_ms", "max_ms", "reeliminated", "relinearized"),
    *("last_update_chi2", "finish_seconds", "bytes_per_pose"),
}


def test_isam2_replays_from_odometry_and_ends_at_the_optimum(solve, city):
    best = facts(solve("city.g2o", "--json"))[0]["final_chi2"]
    found, err = facts(solve("city.g2o", "--json", "--solver", "isam2", "-o", "out.g2o"))
    assert err == ""
    assert set(found) >= KEYS | REPLAY_KEYS
    assert found["final_chi2"] == pytest.approx(best, rel=1e-6)
    assert found["final_chi2"] <= found["last_update_chi2"] < found["initial_chi2"]
    assert found["updates"] == 120 and found["status"] == "converged"
    assert found["solve_seconds"] == pytest.approx(found["update_seconds"] + found["finish_seconds"])
    assert found["p50_ms"] <= found["p99_ms"] <= found["max_ms"]
    assert found["init"] == "odometry"
    assert (found["relinearize_skip"], found["relinearize_threshold"], found["wildfire"]) == (1, 0.1, 1e-3)
    assert facts(solve("out.g2o", "--json"))[0]["initial_chi2"] == pytest.approx(best, rel=1e-4)


def test_isam2_does_not_look_at_the_vertices(solve, city, tmp_path):
    write_g2o(tmp_path / "bare.g2o", city.file)
    write_g2o(tmp_path / "true.g2o", city.file.with_values(truth_of(city)))
    results = []
    for name in ("bare.g2o", "true.g2o"):
        found, err = facts(solve(name, "--solver", "isam2", "--json"))
        assert err == ""
        results.append((found["last_update_chi2"], found["reeliminated"]))
    assert results[0] == results[1]


def test_isam2_takes_its_thresholds(solve, city):
    options = ("city.g2o", "--json", "--solver", "isam2")
    usual = facts(solve(*options))[0]
    exact = facts(solve(*options, "--relinearize-threshold", 0, "--wildfire", 0))[0]
    rare = facts(solve(*options, "--relinearize-skip", 50))[0]
    assert rare["relinearized"] < exact["relinearized"]
    assert exact["reeliminated"] > usual["reeliminated"]
    assert "an update" in solve("city.g2o", "--solver", "isam2")[1]


def truth_of(world):
    values = Values()
    values.insert(np.arange(len(world.truth)), world.truth)
    return values


def test_output_is_the_graph_with_solved_poses(solve, city, tmp_path):
    found, _ = facts(solve("city.g2o", "-o", "out.g2o", "--json"))
    assert found["written"] == ["out.g2o"]
    before, after = read_pose_graph(tmp_path / "city.g2o"), read_pose_graph(tmp_path / "out.g2o")
    assert (before.tables[1].numbers == after.tables[1].numbers).all()
    again, _ = facts(solve("out.g2o", "--json"))
    assert again["initial_chi2"] == pytest.approx(found["final_chi2"], rel=1e-6)
    assert again["final_chi2"] == pytest.approx(found["final_chi2"], rel=1e-4)


def test_file_without_vertices_starts_from_odometry_and_says_so(solve, city, tmp_path):
    write_g2o(tmp_path / "bare.g2o", city.file)
    found, err = facts(solve("bare.g2o", "-o", "full.g2o", "--json"))
    assert "no variable has a vertex line in bare.g2o" in err
    assert found["init"] == "odometry"
    assert found["final_chi2"] == pytest.approx(facts(solve("city.g2o", "--json"))[0]["final_chi2"], rel=1e-4)
    assert len(read_pose_graph(tmp_path / "full.g2o").missing_ids) == 0
    lines = (tmp_path / "city.g2o").read_text().splitlines(keepends=True)
    (tmp_path / "some.g2o").write_text("".join(lines[1:]))
    found, err = facts(solve("some.g2o", "--json"))
    assert "1 of 120 variables lack a vertex line" in err
    assert "lack" not in solve("some.g2o", "--init", "odometry")[2]


def test_toro_and_archives_are_read_and_written(solve, rng, tmp_path):
    world = grid_walk(60, rng)
    file = world.file.with_values(world.file.odometry_values())
    write_toro(tmp_path / "in.graph", file)
    write_g2o(tmp_path / "in.g2o", file)
    want = facts(solve("in.g2o", "--json"))[0]["final_chi2"]
    assert facts(solve("in.graph", "-o", "a.npz", "--json"))[0]["final_chi2"] == pytest.approx(want, rel=1e-4)
    found, _ = facts(solve("a.npz", "-o", "b.g2o", "--json"))
    assert found["initial_chi2"] == pytest.approx(want, rel=1e-4)
    assert facts(solve("b.g2o", "--json"))[0]["final_chi2"] == pytest.approx(want, rel=1e-4)
    assert facts(solve("in.graph", "-o", "c.graph", "--json"))[0]["final_chi2"] == pytest.approx(want, rel=1e-4)
    assert facts(solve("c.graph", "--json"))[0]["initial_chi2"] == pytest.approx(want, rel=1e-4)
    assert len(load_graph(tmp_path / "a.npz")[0]) == len(world.i)


@pytest.mark.parametrize("solver", ["isam2", "lm"])
def test_false_loops_are_let_go_and_listed(solve, rng, tmp_path, solver):
    world = manhattan(150, rng)
    spoilt = with_false_loops(world, 0.3, rng)
    write_g2o(tmp_path / "spoilt.g2o", spoilt.file)
    write_g2o(tmp_path / "clean.g2o", world.file)
    found, _ = facts(solve("spoilt.g2o", "--solver", solver, "--robust", "gnc", "--json"))
    clean, _ = facts(solve("clean.g2o", "--json"))
    false = {tuple(pair) for pair in zip(spoilt.i[spoilt.false].tolist(), spoilt.j[spoilt.false].tolist(), strict=True)}
    assert false <= {tuple(pair) for pair in found["let_go"]}
    assert len(found["let_go"]) <= len(false) + 3
    assert found["status"] == "converged"
    assert found["final_chi2"] <= 1.001 * clean["final_chi2"] and found["chi2_per_dof"] < 1.3
    assert f"let go: {len(found['let_go'])} edges: " in solve("spoilt.g2o", "--solver", solver, "--robust", "gnc")[1]


def test_robust_kernel_holds_false_loops_off(solve, rng, tmp_path):
    world = manhattan(120, rng, sigmas=(0.005, 0.01))
    file = with_false_loops(world, 0.1, rng).file
    truth = Values()
    truth.insert(np.arange(120), world.truth)
    write_g2o(tmp_path / "spoilt.g2o", file.with_values(truth))

    def error():
        solved = read_pose_graph(tmp_path / "out.g2o").values().block(SE2)[1]
        return np.abs(solved.translation - world.truth.translation).max()

    facts(solve("spoilt.g2o", "-o", "out.g2o", "--json"))
    assert error() > 1.0
    found, _ = facts(solve("spoilt.g2o", "-o", "out.g2o", "--overwrite", "--robust", "geman-mcclure:3", "--json"))
    assert error() < 0.5
    assert found["robust"] == "geman-mcclure:3" and found["final_cost"] < found["final_chi2"]


def test_output_is_replaced_only_when_told(solve, city, tmp_path):
    (tmp_path / "out.g2o").write_text("mine")
    code, _, err = solve("city.g2o", "-o", "out.g2o")
    assert code == 2 and "out.g2o exists already; choose another with -o or add --overwrite" in err
    assert (tmp_path / "out.g2o").read_text() == "mine"
    facts(solve("city.g2o", "-o", "out.g2o", "--overwrite", "--json"))
    assert (tmp_path / "out.g2o").read_text() != "mine"


def test_fixed_poses_stay(solve, tmp_path):
    edge = "EDGE_SE2 {} {} 1 0 0 1 0 0 1 0 1\n"
    text = (
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 4 0 0\nFIX 0 2\n" + edge.format(0, 1) + edge.format(1, 2)
    )
    (tmp_path / "in.g2o").write_text(text)
    found, _ = facts(solve("in.g2o", "-o", "out.g2o", "--json"))
    assert found["held"] == 2
    x = read_pose_graph(tmp_path / "out.g2o").values().at([0, 1, 2]).translation[:, 0]
    np.testing.assert_allclose(x, [0.0, 2.0, 4.0], atol=1e-6)
    assert found["final_chi2"] == pytest.approx(2.0, rel=1e-6)


def test_plot_is_written(solve, city, tmp_path):
    assert facts(solve("city.g2o", "--plot", "city.png", "--json"))[0]["written"] == ["city.png"]
    assert (tmp_path / "city.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.g2o"], "cannot be read"),
        (["none.npz"], "cannot be read"),
        (["city.g2o", "--robust", "hubert"], "did you mean 'huber'"),
        (["city.g2o", "--robust", "huber:x"], "the width 'x'"),
        (["city.g2o", "--robust", "gncc"], "did you mean 'gnc'"),
        (["city.g2o", "--robust", "gnc:7"], "'7' is no probability"),
        (["city.g2o", "--robust", "gnc", "--solver", "gn"], "takes --solver lm"),
        (["city.g2o", "--robust", "gnc-gm", "--solver", "isam2"], "truncated cost"),
        (["city.g2o", "--robust", "huber:-1"], "the width '-1'"),
        (["city.g2o", "--solver", "newton"], "newton"),
        (["city.g2o", "--solver", "isam2", "--init", "chordal"], "isam2 starts poses"),
        (["city.g2o", "--solver", "isam2", "--relinearize-skip", "0"], "relinearize-skip"),
        (["city.g2o", "-o", "no/where.g2o"], "there is no folder no"),
        (["city.g2o", "--plot", "p.xyz"], "use .png"),
        (["bad.g2o"], "line 1"),
        (["fixed.g2o", "-o", "out.graph"], "TORO has no word for the 1 fixed poses"),
        (["a.npz", "--robust", "huber"], "an archive holds the kernels"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(solve, city, tmp_path, arguments, message):
    (tmp_path / "bad.g2o").write_text("EDGE_SE2 0 1 1 0\n")
    (tmp_path / "fixed.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nFIX 0\n")
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE2.identity((2,)))
    graph.add(Prior(0, SE2.identity(), Isotropic(1.0)))
    graph.add(Between(0, 1, SE2.identity(), Isotropic(1.0)))
    save_graph(tmp_path / "a.npz", graph, values)
    code, out, err = solve(*arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and err.startswith("error: ") and message in err


@pytest.mark.real
@pytest.mark.parametrize("name", ["M3500", "intel", "kitti_00", pytest.param("sphere2500", marks=pytest.mark.slow)])
def test_isam2_reaches_the_optimum_of_public_graphs(solve, shared_data, name):
    file = shared_data / "posegraphs" / f"{name}.g2o"
    best = facts(solve(file, "--json"))[0]["final_chi2"]
    found, _ = facts(solve(file, "--json", "--solver", "isam2"))
    assert found["final_chi2"] == pytest.approx(best, rel=2e-4)


@pytest.mark.real
def test_public_graph_reaches_its_optimum(solve, shared_data):
    found, err = facts(solve(shared_data / "posegraphs" / "kitti_00.g2o", "--json"))
    assert found["final_chi2"] == pytest.approx(98.3221, rel=1e-4)
    assert "no variable has a vertex line" in err


BAD = "EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nROBOTLASER1 0 1\n"


def test_repairs_are_options_and_said(solve, tmp_path):
    (tmp_path / "bad.g2o").write_text(BAD)
    code, out, err = solve("bad.g2o")
    assert (code, out) == (2, "") and err.count("\n") == 1 and "--skip-unknown" in err
    code, out, err = solve("bad.g2o", "--skip-unknown")
    assert (code, out) == (2, "") and err.count("\n") == 1 and "--repair-information" in err
    found, err = facts(solve("bad.g2o", "--skip-unknown", "--repair-information", "clamp", "--json"))
    assert found["edges"] == 2
    assert "passed over: lines of unknown tags, ROBOTLASER1 (1)" in found["notes"]
    assert any("1 of 2 information matrices" in note and "clamped" in note for note in found["notes"])
    assert "note: 1 of 2 information matrices" in err
    skipped, _ = facts(solve("bad.g2o", "--skip-unknown", "--repair-information", "skip", "--json"))
    assert skipped["edges"] == 1
    (tmp_path / "bare.g2o").write_text("EDGE_SE2 0 1 1 0 0\n")
    assert facts(solve("bare.g2o", "--missing-information", "identity", "--json"))[0]["edges"] == 1


def test_limits_are_options(solve, city):
    loose = facts(solve("city.g2o", "--tolerance", "0.5", "--json"))[0]
    tight = facts(solve("city.g2o", "--tolerance", "1e-12", "--json"))[0]
    assert loose["iterations"] < tight["iterations"] and loose["final_chi2"] > tight["final_chi2"]
    found, err = facts(solve("city.g2o", "--max-iterations", "1", "--json"))
    assert (found["iterations"], found["status"]) == (1, "max_iterations")
    assert err.startswith("warning: the solver ended as max_iterations after 1 iterations")
    code, _, err = solve("city.g2o", "--solver", "isam2", "--tolerance", "1")
    assert code == 2 and err.count("\n") == 1 and "for the other solvers" in err


def test_poor_end_is_one_warning_and_no_error(solve, rng, tmp_path):
    file = with_false_loops(manhattan(120, rng), 0.3, rng).file
    write_g2o(tmp_path / "spoilt.g2o", file.with_values(file.odometry_values()))
    code, out, err = solve("spoilt.g2o")
    assert code == 0 and err.count("\n") == 1
    assert err.startswith("warning: the cost is ") and "honest noise gives about 1" in err
    assert out.splitlines()[-1].startswith("status: ")


def test_file_with_everything_fixed_has_nothing_to_do(solve, tmp_path):
    (tmp_path / "held.g2o").write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nFIX 0 1\n"
    )
    code, out, err = solve("held.g2o", "-o", "out.g2o")
    assert (code, err) == (0, "")
    assert "start: nothing to estimate: every variable is held" in out
    assert (tmp_path / "out.g2o").exists()


def test_four_lines_with_a_prior_are_solved(solve, tmp_path):
    text = (
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 2.5\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2 0 0 0 0 1 0 0 1 0 1\n"
    )
    (tmp_path / "four.g2o").write_text(text)
    found, _ = facts(solve("four.g2o", "--json"))
    assert found["final_chi2"] == pytest.approx(0.0, abs=1e-18)


def test_fixed_landmarks_anchor_at_the_command_line(solve, tmp_path):
    text = "VERTEX_SE2 0 0.5 0.3 0.1\nVERTEX_XY 10 4 1\nVERTEX_XY 11 3 -2\nVERTEX_XY 12 -1 3\n"
    text += "".join(f"EDGE_SE2_XY 0 {k} {p} 1 0 1\n" for k, p in ((10, "4 1"), (11, "3 -2"), (12, "-1 3")))
    (tmp_path / "points.g2o").write_text(text + "FIX 10 11 12\n")
    found, err = facts(solve("points.g2o", "--json"))
    assert err == "" and found["held"] == 3
    assert found["final_chi2"] == pytest.approx(0.0, abs=1e-12)

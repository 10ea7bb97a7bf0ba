"""The solver as users call it: a poor end is doubted, replayed where that helps, and said."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import Between, FactorGraph, Isotropic, Landmark, Prior, SolverSettings, Values, solve
from heliograph.graph.files.park import park
from heliograph.graph.files.worlds import drive, manhattan, with_false_loops
from heliograph.graph.incremental.replay import replay, replay_steps
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2


@pytest.fixture(scope="module")
def lost():
    """A park in which batch estimation from odometry ends in a wrong valley."""
    file = park(1500, np.random.default_rng(5), sigmas=(0.08, 0.1, 0.2)).file
    return file.graph(), file.odometry_values()


def test_wrong_valley_of_a_landmark_graph_is_left_by_a_replay(lost):
    graph, values = lost
    stuck = solve(graph, values, initial="given")
    assert stuck.cost > 3.0 * stuck.degrees_of_freedom
    assert any("a degree of freedom where honest noise gives about 1" in warning for warning in stuck.warnings)
    smoother = replay(replay_steps(graph, values)).smoother
    smoother.update(iterate=1e-9)
    best = Problem(graph, smoother.estimate()).cost().chi2
    steps = []
    found = solve(graph, values, observer=steps.append)
    assert found.status == "converged" and found.warnings == ()
    assert found.chi2 == pytest.approx(best, rel=1e-5)
    assert found.start.startswith("replayed pose by pose (the ")
    assert found.iterations == len(found.steps) == found.steps[-1].number
    assert found.initial_chi2 == stuck.initial_chi2
    assert found.seconds["replay"] > 0.0
    assert found.seconds["total"] == pytest.approx(sum(s for name, s in found.seconds.items() if name != "total"))
    assert found.values.keys().tolist() == values.keys().tolist()


def test_every_method_gets_there(lost):
    graph, values = lost
    best = solve(graph, values).chi2
    for method in ("gn", "dogleg"):
        assert solve(graph, values, method).chi2 == pytest.approx(best, rel=1e-4)


def test_pose_graph_with_false_loops_is_warned_of_but_not_replayed(rng):
    file = with_false_loops(manhattan(150, rng), 0.3, rng).file
    found = solve(file.graph(), file.odometry_values())
    assert "replay" not in found.seconds
    assert "some measurements are wrong" in found.warnings[-1]


def test_graph_that_cannot_be_replayed_keeps_its_poor_end(rng):
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE2.identity((2,)))
    values.insert(7, [1.0, 1.0, 1.0, 1.0])  # no pose and no point
    graph.add(Prior(7, [0.0, 0.0, 0.0, 0.0], Isotropic(1.0)))
    graph.add(Between(0, 1, SE2.exp([0.0, 1.0, 0.0]), Isotropic(0.01)))
    values.insert(5, [0.0, 0.0])
    graph.add(Landmark([0, 1], 5, [[1.0, 1.0], [9.0, 1.0]], Isotropic(0.01)))
    graph.fix(0)
    found = solve(graph, values)
    assert found.status == "converged" and len(found.warnings) == 1
    assert "replay" not in found.seconds


def test_few_iterations_are_few(lost):
    graph, values = lost
    found = solve(graph, values, settings=SolverSettings(max_iterations=3))
    assert found.iterations == 3 and found.status == "max_iterations"
    assert "ended as max_iterations after 3 iterations" in found.warnings[0]


def test_graph_whose_variables_are_all_held_has_nothing_to_do():
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE2.identity((2,)))
    graph.add(Between(0, 1, SE2.exp([0.0, 1.0, 0.0]), Isotropic(0.5)))
    graph.fix([0, 1])
    found = solve(graph, values)
    assert (found.status, found.iterations, found.chi2) == ("converged", 0, pytest.approx(4.0))
    assert found.start == "nothing to estimate: every variable is held"
    assert found.values.at(1).matrix.tolist() == values.at(1).matrix.tolist()
    with pytest.raises(GraphError, match="it has no variables"):
        solve(FactorGraph(), Values())


def test_small_step_that_was_damped_is_no_end(rng):
    """A long drive with few loops, started off the truth: damped steps get small long before the optimum."""
    world = drive(5000, np.random.default_rng(2), loops=0.1, sigmas=(0.1, 0.1))
    chance = np.random.default_rng(7)
    off = np.cumsum(chance.normal(size=(5000, 3)) * [0.002, 0.02, 0.02], axis=0)
    values = Values()
    values.insert(np.arange(5000), world.truth.retract(off))
    graph = world.file.graph()
    found = solve(graph, values, initial="given")
    deep = solve(graph, found.values, initial="given", settings=SolverSettings(relative_decrease=1e-13))
    assert found.status == "converged"
    assert found.chi2 == pytest.approx(deep.chi2, rel=1e-5)


def test_gauss_newton_goes_over_a_ridge():
    world = drive(3000, np.random.default_rng(2), loops=0.1, sigmas=(0.1, 0.1))
    off = np.cumsum(np.random.default_rng(3).normal(size=(3000, 3)) * [0.002, 0.02, 0.02], axis=0)
    values = Values()
    values.insert(np.arange(3000), world.truth.retract(off))
    graph = world.file.graph()
    found = solve(graph, values, "gn", initial="given")
    assert found.status == "converged"
    assert any(step.gain_ratio < 0.0 and step.accepted for step in found.steps)
    assert found.chi2 == pytest.approx(solve(graph, values, initial="given").chi2, rel=1e-4)
    assert Problem(graph, found.values).cost().chi2 == pytest.approx(found.chi2)


def test_gauss_newton_that_does_not_come_down_keeps_its_lowest_values(lost):
    graph, values = lost
    found = solve(graph, values, "gn", initial="given")
    assert found.status == "diverged"
    assert found.chi2 == min(found.initial_chi2, *(step.chi2 for step in found.steps))
    assert Problem(graph, found.values).cost().chi2 == pytest.approx(found.chi2)


def test_steps_are_numbered_through_both_searches(lost):
    graph, values = lost
    numbers = [step.number for step in solve(graph, values).steps]
    assert numbers == list(range(1, len(numbers) + 1))


def test_warnings_follow_the_cost_and_not_chi2(lost):
    found = solve(*lost)
    assert replace(found, cost=10.0 * found.degrees_of_freedom).warnings
    assert not replace(found, chi2=10.0 * found.degrees_of_freedom).warnings

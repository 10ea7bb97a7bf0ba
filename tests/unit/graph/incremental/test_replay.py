"""Replays: what arrives when, from where it starts, and that the end is the batch optimum."""

import numpy as np
import pytest

from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph import (
    Between,
    FactorGraph,
    Information,
    Isotropic,
    Landmark,
    Position,
    Prior,
    Range,
    Values,
    solve,
)
from heliograph.graph.files.worlds import grid_walk, manhattan, uneven
from heliograph.graph.incremental.replay import replay, replay_steps
from heliograph.lie import SE2, SE3

STEP = SE2.exp([0.1, 1.0, 0.0])


def values_of(count, points=()):
    values = Values()
    values.insert(np.arange(count), SE2.identity((count,)))
    for key in points:
        values.insert(key, [0.0, 0.0])
    return values


def chain(*edges, held=(0,)):
    graph = FactorGraph()
    for i, j in edges:
        graph.add(Between(i, j, STEP, Isotropic(0.1)))
    if held:
        graph.fix(list(held))
    return graph


def arrivals(graph, values):
    return [[source.key for source in step.sources] for step in replay_steps(graph, values)]


@pytest.mark.parametrize("make", [manhattan, grid_walk])
def test_end_of_a_replay_is_the_batch_optimum(make, rng):
    file = make(150, rng).file
    graph, values = file.graph(), file.odometry_values()
    done = replay(replay_steps(graph, values))
    assert len(done.seconds) == len(done.reeliminated) == 150 and done.waited == 0
    assert done.smoother.update(iterate=1e-10).converged
    want = solve(graph, done.smoother.estimate(), initial="given").values
    keys = file.pose_ids
    np.testing.assert_allclose(done.smoother.estimate(keys).matrix, want.at(keys).matrix, atol=1e-6)


def test_information_from_20_to_4e8_is_no_obstacle(rng):
    """GTSAM's iSAM2 aborts on this graph at the first stop, see `tests/oracles/test_gtsam_incremental.py`."""
    file = uneven(rng).file
    graph = file.graph()
    done = replay(replay_steps(graph, file.odometry_values()))
    assert done.waited == 0
    assert done.smoother.update(iterate=1e-9).converged
    found = done.smoother.estimate()
    best = solve(graph, found, initial="given")
    assert best.initial_chi2 == pytest.approx(best.chi2, rel=1e-6)
    assert best.chi2 == pytest.approx(best.degrees_of_freedom, rel=0.2)


def test_every_factor_comes_once_with_its_last_variable(rng):
    file = manhattan(80, rng).file
    seen = 0
    for number, step in enumerate(replay_steps(file.graph(), file.odometry_values())):
        for added in step.graph.groups():
            assert (added.record.keys.max(axis=1) == number).all()
            seen += len(added.record)
    assert seen == file.edge_count


def test_start_is_the_previous_pose_in_either_direction():
    graph = chain((0, 1), (0, 2), (2, 1))
    steps = list(replay_steps(graph, values_of(3)))
    (second,) = steps[2].sources
    assert second.origin == 1  # not 0, whose edge comes first
    np.testing.assert_allclose(second.relative.matrix, STEP.inverse().matrix, atol=1e-15)


def test_values_of_the_file_are_not_used():
    graph = chain((0, 1), (1, 2))
    values = values_of(3)
    values.update([1, 2], SE2.exp([[1.0, 50.0, 50.0], [2.0, -50.0, 9.0]]))
    estimate = replay(replay_steps(graph, values)).smoother.estimate(2)
    np.testing.assert_allclose(estimate.matrix, (STEP @ STEP).matrix, atol=1e-9)


def test_poses_wait_until_something_joins_them():
    graph = chain((0, 3), (1, 2), (2, 3))
    assert arrivals(graph, values_of(4)) == [[0], [], [], [3, 2, 1]]
    done = replay(replay_steps(graph, values_of(4)))
    want = STEP.matrix @ np.linalg.inv(STEP.matrix @ STEP.matrix)
    np.testing.assert_allclose(done.smoother.estimate(1).matrix, want, atol=1e-9)


def test_components_have_roots_of_their_own():
    values = values_of(4)
    values.update(2, SE2.exp([0.0, 7.0, 0.0]))
    done = replay(replay_steps(chain((0, 1), (2, 3), held=(0, 2)), values))
    np.testing.assert_allclose(done.smoother.estimate(3).translation, [8.0, 0.05], atol=0.01)
    graph = chain((0, 1), (2, 3))
    with pytest.raises(GraphError, match=r"keys 2, 3: no chain of relative poses"):
        list(replay_steps(graph, values))
    graph.add(Prior(3, SE2.exp([0.0, 9.0, 0.0]), Isotropic(0.1)))
    assert arrivals(graph, values) == [[0], [1], [], [3, 2]]


def test_held_pose_that_is_not_the_first():
    assert arrivals(chain((0, 1), (1, 2), held=(1,)), values_of(3)) == [[], [1, 0], [2]]


def test_points_come_with_the_sighting_that_determines_them():
    graph = chain((0, 1), (1, 2))
    weak = np.diag([1.0, 0.0])
    graph.add(Landmark(0, 10, [2.0, 1.0], Information(weak)))
    graph.add(Landmark(1, 10, [1.0, 1.0], Information(np.eye(2))))
    graph.add(Landmark(0, 11, [2.0, 1.0], Information(weak)))
    graph.add(Landmark(2, 11, [0.5, 1.0], Information(weak)))
    values = values_of(3, points=(10, 11))
    assert arrivals(graph, values) == [[0], [1, 10], [2, 11]]
    steps = list(replay_steps(graph, values))
    assert [len(step.graph) for step in steps] == [0, 3, 3]
    done = replay(steps)
    done.smoother.update(iterate=1e-10)
    want = solve(graph, done.smoother.estimate(), initial="given").values
    np.testing.assert_allclose(done.smoother.estimate([10, 11]), want.at([10, 11]), atol=1e-6)


def test_what_is_undetermined_waits_for_later_steps():
    """Positions alone say where the first pose is, not where it looks: the second position does."""
    graph = chain((0, 1), (1, 2), held=())
    graph.add(Position([0, 1], [[0.0, 0.0], [1.0, 0.0]], Isotropic(0.1)))
    done = replay(replay_steps(graph, values_of(3)))
    assert done.waited == 1
    assert done.smoother.estimate([0, 1, 2]).matrix.shape == (3, 3, 3)


def test_graph_that_never_determines_its_poses_says_so():
    graph = chain((0, 1), held=())
    graph.add(Position(0, [0.0, 0.0], Isotropic(0.1)))
    with pytest.raises(UnderconstrainedError, match="rotate"):
        replay(replay_steps(graph, values_of(2)))


def test_observer_sees_every_step_and_may_end_it(rng):
    file = manhattan(30, rng).file
    seen = []

    def observer(number, result):
        seen.append((number, result.reeliminated))
        return number < 9

    done = replay(replay_steps(file.graph(), file.odometry_values()), observer=observer)
    assert len(seen) == len(done.seconds) == 10
    assert [count for _, count in seen] == done.reeliminated


def test_other_factors_and_variables_are_refused():
    graph = chain((0, 1))
    graph.add(Range(0, 1, 1.0, Isotropic(0.1)))
    with pytest.raises(GraphError, match=r"factor 1 \(keys 0, 1\): a replay has no start for Range"):
        list(replay_steps(graph, values_of(2)))
    values = values_of(2)
    values.insert(5, SE3.identity())
    with pytest.raises(GraphError, match="not of both"):
        list(replay_steps(chain((0, 1)), values))

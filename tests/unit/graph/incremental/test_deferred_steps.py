"""Deferred back-substitution: an update is short, what is read is never old, and all ends as without."""

import pickle

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.graph import ISAM2, Between, FactorGraph, ISAM2Settings, Isotropic, Prior, Values
from heliograph.graph.files.worlds import drive
from heliograph.lie import SE2

FEW = 8
N = 400


def settings(most, wildfire=1e-10):
    return ISAM2Settings(relinearize_threshold=0.05, wildfire=wildfire, max_steps=most)


def round_trip(most, n=N, every=40, smoother=None, wildfire=1e-10):
    """Yield the smoother and each update's result, of a drifting walk round a circle with loops to the round before."""
    rng = np.random.default_rng(5)
    smoother = smoother or ISAM2(settings(most, wildfire))
    step = SE2.exp(np.array([2.0 * np.pi / 100.0, 1.0, 0.0]))
    for k in range(n):
        graph, values = FactorGraph(), Values()
        if k == 0:
            start = SE2.exp(np.zeros(3))
            graph.add(Prior(0, start, Isotropic(0.01)))
        else:
            T_step = step @ SE2.exp(rng.normal(scale=(0.003, 0.02, 0.02), size=3))
            start = smoother.estimate(k - 1) @ T_step
            graph.add(Between(k - 1, k, T_step, Isotropic(0.05)))
            if k >= 100 and k % every == 0:
                graph.add(Between(k - 100, k, SE2.exp(rng.normal(scale=0.01, size=3)), Isotropic(0.01)))
        values.insert(k, start)
        yield smoother, smoother.update(graph, values)


def test_an_update_computes_at_most_max_steps_and_says_what_it_deferred():
    results = [result for _, result in round_trip(FEW)]
    behind = [result for result in results if result.deferred]
    assert behind
    assert all(result.pending and not result.settled for result in behind)
    # Beyond the limit only what is new itself, and the clique with which the limit is reached.
    assert all(result.solved <= result.reeliminated + 2 * FEW + 8 for result in behind)
    most = max(result.solved - result.reeliminated for _, result in round_trip(10_000))
    assert most > 5 * FEW


def test_what_is_read_is_never_old():
    rng = np.random.default_rng(2)
    old = 0
    for k, (smoother, result) in enumerate(round_trip(FEW)):
        if not result.deferred or k % 5:
            continue
        copy = pickle.loads(pickle.dumps(smoother))
        copy.finish()
        keys = rng.integers(0, k + 1, size=6)
        whole = copy.estimate(np.arange(k + 1)).matrix
        for key in keys.tolist():
            np.testing.assert_allclose(smoother.estimate(key).matrix, whole[key], atol=1e-7, rtol=0)
        stale = copy._state.native.delta() - smoother._state.native.delta()
        old += np.abs(stale).max() > 1e-3
    assert old > 5  # else nothing above was tested


def test_reading_much_computes_all_steps():
    *_, (smoother, result) = round_trip(FEW, n=381)
    assert result.deferred
    each = np.stack([smoother.estimate(key).matrix for key in range(381)])
    np.testing.assert_allclose(smoother.estimate(np.arange(381)).matrix, each, atol=1e-7, rtol=0)
    assert smoother._state.native.deferred == 0


def test_deferred_steps_are_taken_up_by_later_long_updates():
    """Without a reading of old poses either: what a loop defers another loop does, and an empty update all of it."""
    smoother = ISAM2(ISAM2Settings(max_steps=300))
    deferred = [result.deferred for _, result in round_trip(300, n=1000, every=5, smoother=smoother)]
    waits = np.flatnonzero(np.array(deferred) > 0)
    assert len(waits)
    # What was saved up at the start is spent by then: without what each update is granted, three of these are left.
    assert np.count_nonzero(np.diff(deferred[700:]) < 0) > 8
    result = smoother.update()
    assert result.deferred == 0
    assert smoother.update().solved == 0


def test_convergence_is_the_batch_one():
    *_, (few, _) = round_trip(FEW)
    *_, (many, _) = round_trip(10_000)
    for smoother in (few, many):
        assert smoother.update(iterate=1e-11).converged
    keys = np.arange(N)
    np.testing.assert_allclose(few.estimate(keys).matrix, many.estimate(keys).matrix, atol=1e-8, rtol=0)


@pytest.mark.parametrize(("threshold", "wildfire"), [(0.0, 1e-3), (0.1, 0.0)])
def test_nothing_is_deferred_where_exact_steps_are_asked_for(threshold, wildfire):
    smoother = ISAM2(ISAM2Settings(relinearize_threshold=threshold, wildfire=wildfire, max_steps=1))
    assert not any(result.deferred for _, result in round_trip(1, n=150, smoother=smoother))


def test_costs_are_those_of_the_estimate():
    *_, (smoother, result) = round_trip(FEW, n=381)
    assert result.deferred
    copy = pickle.loads(pickle.dumps(smoother))
    copy.finish()
    cost = smoother.update(costs=True).cost_before
    assert cost == pytest.approx(copy._state.cost(), rel=1e-9)


def test_a_stored_smoother_goes_on_to_the_bit(tmp_path):
    steps = round_trip(FEW)
    for k, (smoother, result) in enumerate(steps):  # noqa: B007
        if k > 300 and result.deferred:
            break
    smoother.save(tmp_path / "state.npz")
    other = ISAM2.load(tmp_path / "state.npz")
    pose = SE2.exp(np.array([0.06, 1.0, 0.0]))
    for one in (smoother, other):
        graph, values = FactorGraph(), Values()
        graph.add(Between(np.array([k, 20]), np.array([k + 1, k + 1]), pose, Isotropic(0.5)))
        values.insert(k + 1, one.estimate(k) @ pose)
        one.update(graph, values)
    np.testing.assert_array_equal(smoother._state.native.delta(), other._state.native.delta())
    for one in (smoother, other):
        one.finish()
    np.testing.assert_array_equal(smoother.estimate(np.arange(k)).matrix, other.estimate(np.arange(k)).matrix)


def test_a_long_drive_ends_at_the_optimum():
    """Replayed with few steps an update, then iterated, against the same with all of them."""
    from heliograph.graph.incremental.replay import replay, replay_steps

    file = drive(3000, np.random.default_rng(3), sigmas=(0.001, 0.03)).file
    costs = []
    for most in (50, 100_000):
        graph, values = file.graph(), file.odometry_values()
        smoother = replay(replay_steps(graph, values), ISAM2(ISAM2Settings(max_steps=most))).smoother
        smoother.update(iterate=1e-9)
        costs.append(smoother._state.cost())
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)


def test_relinearisation_is_limited_and_caught_up_with():
    limit, results = 64, []
    smoother = ISAM2(ISAM2Settings(relinearize_threshold=0.05, wildfire=1e-10, max_relinearized=limit))
    for _, result in round_trip(10_000, smoother=smoother):
        results.append(result)
    counts = np.array([result.relinearized for result in results])
    assert counts.max() <= limit
    assert any(result.pending for result in results)
    # A 64th of the limit an update in the long run, in quarters, which are worth an elimination.
    taken_up = np.flatnonzero(counts)[2:]
    assert len(taken_up) > 10
    assert set(np.diff(taken_up).tolist()) == {16}
    assert set(counts[taken_up[1:]].tolist()) == {limit // 4}
    assert np.all(np.cumsum(counts) <= limit + limit // 64 * np.arange(1, len(counts) + 1))
    waited = np.array([result.pending > 0 for result in results[:-1]])
    assert np.count_nonzero(counts[1:][waited] == 0) > 3
    assert smoother.update().pending == 0 or smoother.update().pending == 0
    *_, (free, _) = round_trip(10_000)
    for one in (smoother, free):
        one.update(iterate=1e-11)
    np.testing.assert_allclose(smoother.estimate(np.arange(N)).matrix, free.estimate(np.arange(N)).matrix, atol=1e-8)


@pytest.mark.parametrize("name", ["max_steps", "max_relinearized"])
def test_limits_are_at_least_one(name):
    with pytest.raises(ConfigError, match=name):
        ISAM2Settings(**{name: 0})

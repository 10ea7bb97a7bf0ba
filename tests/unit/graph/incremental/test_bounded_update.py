"""Updates whose work is bounded: a loop closure is worked through in slices and ends where the unbounded one does."""

import numpy as np
import pytest

from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph import ISAM2, Between, FactorGraph, ISAM2Settings, Isotropic, Prior, Values
from heliograph.graph.model.factor import Factor
from heliograph.lie import SE2

SETTINGS = ISAM2Settings(relinearize_threshold=0.01, wildfire=1e-6)
TURN = 2.0 * np.pi / 100.0
N = 200  # poses: twice round a circle of 100


class OwnBetween(Factor):
    variables = (SE2, SE2)
    rows = 3

    @staticmethod
    def residual(T_world_i, T_world_j, T_i_j):
        T_j_i = np.linalg.inv(T_world_j) @ T_world_i
        E = T_j_i @ T_i_j
        return np.stack([E[:, 0, 2], E[:, 1, 2], np.arctan2(E[:, 1, 0], E[:, 0, 0])], axis=1)


def graph_of(*records):
    graph = FactorGraph()
    for record in records:
        graph.add(record)
    return graph


def one(key, value):
    values = Values()
    values.insert(key, value)
    return values


def between(i, j, T_i_j, own):
    if own:
        return OwnBetween((np.array([i]), np.array([j])), data=(T_i_j.matrix[None],), noise=Isotropic(0.05))
    return Between(i, j, T_i_j, Isotropic(0.05))


def run(most, *, own=False, closures=((0, 100),), n=N, smoother=None):
    """Drifting odometry; closures come with their later pose, initial values from dead reckoning."""
    rng = np.random.default_rng(11)
    smoother = smoother or ISAM2(SETTINGS)
    results = []
    for k in range(n):
        if k == 0:
            T_world = SE2.exp(np.zeros(3))
            records = [Prior(0, T_world, Isotropic(0.01))]
        else:
            T_step = SE2.exp(np.array([TURN, 1.0, 0.0]) + rng.normal(scale=(0.004, 0.02, 0.02), size=3))
            T_world = smoother.estimate(k - 1) @ T_step
            records = [between(k - 1, k, T_step, own)]
            records += [between(i, j, SE2.exp(np.zeros(3)), own) for i, j in closures if j == k]
        results.append(smoother.update(graph_of(*records), one(k, T_world), max_variables=most))
        assert np.isfinite(smoother.estimate(k).log()).all()
    return smoother, results


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("most", [8, 25])
def test_ends_where_the_unbounded_one_ends(most, own):
    closures = ((0, 100), (20, 120), (21, 121), (60, 160))
    whole, _ = run(None, own=own, closures=closures)
    sliced, results = run(most, own=own, closures=closures)
    assert max(result.reeliminated for result in results) <= most
    assert max(result.relinearized for result in results) <= most
    assert any(result.pending > most for result in results)
    while (result := sliced.update(max_variables=most)).pending:
        assert result.reeliminated <= most
        assert result.relinearized <= most
        assert not result.settled
    assert result.settled
    keys = np.arange(N)
    for smoother in (whole, sliced):
        smoother.update(iterate=1e-11)
    np.testing.assert_allclose(sliced.estimate(keys).matrix, whole.estimate(keys).matrix, atol=1e-8, rtol=0)
    np.testing.assert_allclose(sliced.covariance(keys), whole.covariance(keys), atol=1e-8, rtol=1e-7)


def test_estimates_stay_sensible_meanwhile():
    whole, _ = run(None)
    sliced, _ = run(8)
    while sliced.update(max_variables=8).pending:
        pass
    keys = np.arange(N)
    away = whole.estimate(keys).inverse() @ sliced.estimate(keys)
    assert np.abs(away.log()).max() < 0.05


def test_estimates_are_kept_until_the_work_is_done():
    smoother, _ = run(None, n=101, closures=())
    before = smoother.estimate(np.arange(101)).matrix
    result = smoother.update(graph_of(Between(0, 100, SE2.exp(np.zeros(3)), Isotropic(0.01))), max_variables=10)
    assert result.pending > 0
    assert not result.settled
    np.testing.assert_array_equal(smoother.estimate(np.arange(101)).matrix, before)
    with pytest.raises(GraphError, match="finish"):
        smoother.covariance(3)
    smoother.finish()
    assert np.abs(smoother.estimate(np.arange(101)).matrix - before).max() > 0.01
    assert smoother.covariance(3).shape == (3, 3)


def opened():
    smoother, _ = run(None, n=120, closures=())
    result = smoother.update(graph_of(Between(0, 100, SE2.exp(np.zeros(3)), Isotropic(0.01))), max_variables=10)
    assert result.pending > 0
    return smoother


def closed(smoother):
    smoother.update(iterate=1e-11)
    return smoother.estimate(np.arange(120)).matrix


@pytest.mark.parametrize("most", [10, None])
def test_refusals_leave_the_open_work_as_it_was(most):
    expected = closed(opened())
    smoother = opened()
    pose = SE2.exp(np.zeros(3))
    with pytest.raises(UnderconstrainedError):
        smoother.update(graph_of(Between(200, 201, pose, Isotropic(0.1))), two(200, 201), max_variables=most)
    with pytest.raises(GraphError):
        smoother.update(graph_of(Between(3, 999, pose, Isotropic(0.1))), max_variables=most)
    assert 200 not in smoother
    smoother.update(max_variables=10)
    with pytest.raises(UnderconstrainedError):
        smoother.update(graph_of(Between(200, 201, pose, Isotropic(0.1))), two(200, 201), max_variables=most)
    np.testing.assert_allclose(closed(smoother), expected, atol=1e-8, rtol=0)


def two(i, j):
    values = Values()
    values.insert(np.array([i, j]), SE2.exp(np.zeros((2, 3))))
    return values


def test_a_first_slice_refuses_what_is_free():
    smoother, _ = run(None, n=120, closures=())
    graph = graph_of(Between(np.array([0, 200]), np.array([100, 201]), SE2.exp(np.zeros((2, 3))), Isotropic(0.1)))
    with pytest.raises(UnderconstrainedError, match="200"):
        smoother.update(graph, two(200, 201), max_variables=10)
    assert smoother.update().pending == 0
    assert smoother.covariance(5).shape == (3, 3)


def test_removal_while_open():
    expected = closed(run(None, n=120, closures=())[0])
    smoother, _ = run(None, n=120, closures=())
    result = smoother.update(graph_of(Between(0, 100, SE2.exp(np.zeros(3)), Isotropic(0.01))), max_variables=10)
    assert result.pending
    result = smoother.update(remove=result.factors, max_variables=10)
    np.testing.assert_allclose(closed(smoother), expected, atol=1e-8, rtol=0)


def test_saved_while_open(tmp_path):
    smoother = opened()
    smoother.save(tmp_path / "state.npz")
    again = ISAM2.load(tmp_path / "state.npz")
    for _ in range(30):
        assert smoother.update(max_variables=10).pending == again.update(max_variables=10).pending
    np.testing.assert_array_equal(again.estimate(np.arange(120)).matrix, smoother.estimate(np.arange(120)).matrix)


def test_marginalising_finishes_first():
    smoother = opened()
    smoother.marginalize(np.arange(5))
    assert smoother.covariance(7).shape == (3, 3)


@pytest.mark.parametrize("options", [{"max_variables": 0}, {"max_variables": 5, "iterate": 1e-3}])
def test_bad_bounds(options):
    with pytest.raises(GraphError, match="max_variables"):
        ISAM2().update(**options)


def test_a_refusal_in_the_middle_of_a_relinearisation():
    expected = closed(opened())
    smoother = opened()
    refused = 0
    for _ in range(60):
        result = smoother.update(max_variables=10)
        if result.pending and smoother._state.native.waiting and refused < 5:
            with pytest.raises(UnderconstrainedError):
                smoother.update(graph_of(Between(200, 201, SE2.exp(np.zeros(3)), Isotropic(0.1))), two(200, 201))
            refused += result.relinearized > 0
    assert refused > 0
    np.testing.assert_allclose(closed(smoother), expected, atol=1e-8, rtol=0)

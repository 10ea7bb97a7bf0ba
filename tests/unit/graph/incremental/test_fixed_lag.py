"""Variables that are marginalised out: what stays is as the full smoother has it, and memory does not grow."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    ISAM2,
    Between,
    Diagonal,
    FactorGraph,
    FixedLagSmoother,
    ISAM2Settings,
    Isotropic,
    LinearMotion,
    Prior,
    Values,
)
from heliograph.graph.model.key_runs import KeyRuns
from heliograph.lie import SE2

EXACT = ISAM2Settings(relinearize_threshold=0.0, wildfire=0.0)


def graph_of(*records):
    graph = FactorGraph()
    for record in records:
        graph.add(record)
    return graph


def values_of(**blocks):
    values = Values()
    for keys, value in blocks.values():
        values.insert(keys, value)
    return values


def one(key, value):
    values = Values()
    values.insert(key, value)
    return values


def motion(i, j, rng):
    F = np.array([[1.0, 0.1], [0.0, 0.98]])
    return LinearMotion(i, j, F[None], rng.normal(size=(1, 2)), Isotropic(0.3))


def linear_chain(n, seed):
    rng = np.random.default_rng(seed)
    for k in range(n):
        records = [Prior(k, rng.normal(size=(1, 2)), Isotropic(0.5))]
        if k:
            records.append(motion(k - 1, k, rng))
        if k > 3 and k % 3 == 0:
            records.append(motion(k - 4, k, rng))
        yield k, graph_of(*records), one(k, rng.normal(size=(1, 2))[0])


def assert_same(kept, full, keys, tolerance):
    np.testing.assert_allclose(kept.estimate(keys), full.estimate(keys), atol=tolerance, rtol=0)
    np.testing.assert_allclose(kept.joint(keys), full.joint(keys), atol=tolerance, rtol=0)
    np.testing.assert_allclose(kept.covariance(keys), full.covariance(keys), atol=tolerance, rtol=0)


class TestLinear:
    @pytest.mark.parametrize("lag", [5, 9, 30])
    def test_chain_is_the_full_smoother(self, lag):
        full, kept = ISAM2(EXACT), FixedLagSmoother(lag=lag, settings=EXACT)
        for k, graph, values in linear_chain(80, 1):
            full.update(graph, values)
            kept.update(graph, values, {k: float(k)})
            keys = np.arange(max(0, k - lag), k + 1)
            assert len(kept.stamps) == len(keys)
            assert_same(kept, full, keys, 1e-9)

    @pytest.mark.parametrize("seed", range(6))
    def test_grid_in_any_order(self, seed):
        rng = np.random.default_rng(seed)
        keys = np.arange(36)
        pairs = [(k, k + 1) for k in keys if k % 6 < 5] + [(k, k + 6) for k in keys if k < 30]
        graph = graph_of(Prior(keys, rng.normal(size=(36, 2)), Isotropic(1.0)), *(motion(i, j, rng) for i, j in pairs))
        values = values_of(all=(keys, rng.normal(size=(36, 2))))
        full, kept = ISAM2(EXACT), ISAM2(EXACT)
        for smoother in (full, kept):
            smoother.update(graph, values)
        left = rng.permutation(36)
        stay = set(keys.tolist())
        for part in np.array_split(left[:30], 7):
            kept.marginalize(part)
            stay -= set(part.tolist())
            assert_same(kept, full, np.array(sorted(stay)), 1e-9)
            i, j = rng.choice(sorted(stay), 2, replace=False)
            more = graph_of(motion(int(i), int(j), rng))
            for smoother in (full, kept):
                smoother.update(more)
            assert_same(kept, full, np.array(sorted(stay)), 1e-9)

    def test_summaries_of_one_variable_do_not_pile_up(self):
        rng = np.random.default_rng(3)
        kept, full = ISAM2(EXACT), ISAM2(EXACT)
        for smoother in (kept, full):
            smoother.update(graph_of(Prior(0, np.zeros((1, 2)), Isotropic(1.0))), one(0, np.zeros(2)))
        for k in range(1, 40):
            graph, values = (
                graph_of(Prior(k, rng.normal(size=(1, 2)), Isotropic(1.0)), motion(0, k, rng)),
                one(k, np.zeros(2)),
            )
            for smoother in (kept, full):
                smoother.update(graph, values)
            kept.marginalize(k)
            assert len(kept.cliques()) <= 2
        assert_same(kept, full, np.array([0]), 1e-9)

    def test_a_part_that_leaves_whole(self):
        kept = ISAM2(EXACT)
        kept.update(
            graph_of(Prior(np.array([1, 2]), np.eye(2), Isotropic(1.0))),
            values_of(a=(np.array([1, 2]), np.zeros((2, 2)))),
        )
        kept.marginalize(1)
        np.testing.assert_allclose(kept.estimate(2), [0.0, 1.0])
        kept.marginalize(2)
        assert len(kept.estimate()) == 0
        kept.update(graph_of(Prior(3, np.ones((1, 2)), Isotropic(1.0))), one(3, np.zeros(2)))
        np.testing.assert_allclose(kept.estimate(3), [1.0, 1.0])


def pose_steps(n, seed, noise=0.01):
    rng = np.random.default_rng(seed)
    step = SE2.exp(np.array([0.1, 1.0, 0.0]))
    T_world = SE2.exp(np.zeros(3))
    for k in range(n):
        records, before = [], T_world
        if k == 0:
            records.append(Prior(0, T_world, Isotropic(0.01)))
        else:
            T_world = before @ step
            for back in (1, 2):
                if k >= back:
                    T_measured = SE2.exp(np.zeros(3))
                    for _ in range(back):
                        T_measured = T_measured @ step
                    T_measured = T_measured @ SE2.exp(rng.normal(scale=noise, size=3))
                    records.append(Between(k - back, k, T_measured, Diagonal(np.full(3, noise))))
        yield k, graph_of(*records), one(k, T_world @ SE2.exp(rng.normal(scale=noise, size=3)))


class TestNonlinear:
    def test_poses_are_close_to_the_full_smoother(self):
        full, kept = ISAM2(), FixedLagSmoother(lag=20)
        for k, graph, values in pose_steps(150, 5):
            full.update(graph, values, iterate=1e-10)
            kept.update(graph, values, {k: float(k)}, iterate=1e-10)
        keys = np.arange(130, 150)
        away = (full.estimate(keys).inverse() @ kept.estimate(keys)).log()
        sigmas = np.sqrt(np.diagonal(full.covariance(keys), axis1=1, axis2=2))
        assert np.all(np.abs(away) < 0.05 * sigmas)
        assert np.all(np.abs(np.sqrt(np.diagonal(kept.covariance(keys), axis1=1, axis2=2)) / sigmas - 1.0) < 0.02)

    def test_linearisation_points_of_a_summary_stay(self):
        kept = ISAM2(EXACT)
        for _, graph, values in pose_steps(10, 6):
            kept.update(graph, values)
        kept.marginalize(np.arange(5))
        state = kept._state
        at = state._numbers(np.array([5, 6]), lambda: "asked for")
        before = state.native.linearization_point(at)
        kept.update(graph_of(Between(5, 9, SE2.exp(np.array([0.3, 3.0, 1.0])), Isotropic(0.001))), iterate=1e-9)
        np.testing.assert_array_equal(state.native.linearization_point(at), before)
        assert np.abs(state.native.delta()).max() > 1e-3

    def test_nothing_leaves_while_variables_wait(self):
        kept, most = FixedLagSmoother(lag=20), []
        for k, graph, values in pose_steps(60, 9):
            kept.update(graph, values, {k: float(k)}, max_variables=3)
            most.append(len(kept.stamps))
        assert max(most) >= 21
        kept.update()
        assert len(kept.stamps) == 21

    def test_memory_is_flat(self):
        kept = FixedLagSmoother(lag=20)
        bytes_at = {}
        T_step = SE2.exp(np.array([0.01, 1.0, 0.0]))
        noise, T_world = Isotropic(0.01), SE2.exp(np.zeros(3))
        kept.update(graph_of(Prior(0, T_world, noise)), one(0, T_world), {0: 0.0})
        for k in range(1, 6000):
            kept.update(graph_of(Between(k - 1, k, T_step, noise)), one(k, T_world), {k: float(k)})
            if k % 1000 == 0:
                bytes_at[k] = kept.bytes
        assert kept.smoother._state.native.slots <= 24
        assert len(kept.smoother._state._left.runs()) == 1
        assert bytes_at[5000] == bytes_at[2000]


class TestRefusals:
    def smoother(self):
        kept = ISAM2()
        for _, graph, values in pose_steps(8, 7):
            kept.update(graph, values)
        kept.marginalize(np.array([0, 1, 2]))
        return kept

    def test_a_key_that_left_is_no_variable(self):
        kept = self.smoother()
        pose = SE2.exp(np.zeros(3))
        with pytest.raises(GraphError, match=r"1.*marginalised out"):
            kept.update(graph_of(Between(1, 7, pose, Isotropic(0.1))))
        with pytest.raises(GraphError, match="marginalised out"):
            kept.estimate(0)
        with pytest.raises(GraphError, match="marginalised out"):
            kept.marginalize(0)
        assert len(kept.estimate()) == 5
        kept.update(graph_of(Between(7, 8, pose, Isotropic(0.1))), one(8, pose))

    def test_held_variables_stay(self):
        kept = ISAM2()
        graph = graph_of(Between(0, 1, SE2.exp(np.zeros(3)), Isotropic(0.1)))
        graph.fix(0)
        kept.update(graph, values_of(a=(np.array([0, 1]), SE2.exp(np.zeros((2, 3))))))
        with pytest.raises(GraphError, match="held"):
            kept.marginalize(0)

    @pytest.mark.parametrize("stamps", [{1: np.nan}, {9: 0.0}, ([1, 2], [0.0])])
    def test_stamps(self, stamps):
        with pytest.raises(GraphError, match="stamp"):
            FixedLagSmoother(lag=1.0).update(
                graph_of(Prior(1, np.zeros((1, 2)), Isotropic(1.0))), one(1, np.zeros(2)), stamps
            )

    def test_lag(self):
        with pytest.raises(GraphError, match="lag"):
            FixedLagSmoother(lag=0.0)

    def test_saved_after_some_left(self, tmp_path):
        kept = self.smoother()
        kept.save(tmp_path / "state.npz")
        again = ISAM2.load(tmp_path / "state.npz")
        graph, values = graph_of(Between(7, 8, SE2.exp(np.ones(3)), Isotropic(0.1))), one(8, SE2.exp(np.zeros(3)))
        for smoother in (kept, again):
            smoother.update(graph, values)
        np.testing.assert_array_equal(kept.estimate(np.arange(3, 9)).matrix, again.estimate(np.arange(3, 9)).matrix)
        with pytest.raises(GraphError, match="marginalised out"):
            again.estimate(0)


def test_key_runs():
    rng = np.random.default_rng(0)
    runs, added = KeyRuns(), set()
    for key in rng.permutation(60)[:40].tolist() * 2:
        runs.add(key)
        added.add(key)
    assert {key for key in range(-2, 70) if key in runs} == added
    assert all(b + 1 < c for (_, b), (c, _) in zip(runs.runs(), runs.runs()[1:], strict=False))
    assert KeyRuns.of(runs.runs()).runs() == runs.runs()

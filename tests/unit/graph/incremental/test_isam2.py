"""Incremental smoothing against batch solves: growth, removal, replacement, switching, kernels, components, bits."""

import numpy as np
import pytest

from heliograph.errors import ConfigError, GraphError
from heliograph.graph import (
    ISAM2,
    Between,
    FactorGraph,
    Huber,
    ISAM2Settings,
    Isotropic,
    Prior,
    Values,
    solve,
)
from heliograph.graph.incremental.tree_state import TreeState
from heliograph.graph.problem.settings import SolverSettings
from heliograph.lie import SE2, SE3
from reference.growth import distance, gauss_newton_step, growth, starts, whole

EXACT = ISAM2Settings(relinearize_threshold=0.0, wildfire=0.0)
TIGHT = SolverSettings(relative_decrease=0.0, absolute_decrease=0.0, max_iterations=200)


def fed(steps, settings=None, **options):
    smoother = ISAM2(settings)
    for step in steps:
        smoother.update(step.graph(), step.values, **options)
    return smoother


def converged(graph, values):
    for _ in range(60):
        moved = gauss_newton_step(graph, values)
        if distance(moved, values) < 1e-9:
            return moved
        values = moved
    raise AssertionError("the twin does not converge")


def bits(smoother):
    values = smoother.estimate()
    tree = smoother._state.native
    return (
        [packed.tobytes() for packed in values.packed()],
        tree.delta().tobytes(),
        tree.clique_table().variables.tolist(),
    )


@pytest.mark.parametrize(("group", "count"), [(SE2, 60), (SE3, 120), pytest.param(SE2, 300, marks=pytest.mark.slow)])
@pytest.mark.parametrize("hold", [True, False])
def test_thresholds_of_zero_make_every_update_one_whole_gauss_newton_step(group, count, hold, rng):
    steps = growth(group, count, rng, hold=hold, kernel=Huber(1.0))
    smoother, graph, values = ISAM2(EXACT), FactorGraph(), Values()
    for k, step in enumerate(steps):
        for record in step.records:
            graph.add(record)
        graph.fix(step.fixed)
        for key in step.values.keys().tolist():
            values.insert(key, step.values.at(key))
        smoother.update(step.graph(), step.values)
        values = gauss_newton_step(graph, values)
        if k % 10 == 9 or k < 20:
            assert distance(values, smoother.estimate()) < 1e-8
            values = smoother.estimate()  # rounding is not to grow over hundreds of steps
    assert distance(values, smoother.estimate()) < 1e-8


@pytest.mark.parametrize(("group", "count"), [(SE2, 250), (SE3, 80)])
def test_iterating_to_convergence_gives_the_batch_solution(group, count, rng):
    steps = growth(group, count, rng)
    smoother = ISAM2()
    for step in steps[:-1]:
        smoother.update(step.graph(), step.values)
    result = smoother.update(steps[-1].graph(), steps[-1].values, iterate=1e-9, costs=True)
    assert result.converged
    assert result.iterations > 1
    batch = converged(whole(steps), smoother.estimate())
    assert distance(batch, smoother.estimate()) < 1e-8
    found = solve(whole(steps), smoother.estimate(), "gn", initial="given", settings=TIGHT)
    assert result.cost_after == pytest.approx(found.cost, rel=1e-9)


def test_chi2_of_default_thresholds_is_near_the_optimum(rng):
    steps = growth(SE2, 200, rng)
    smoother = fed(steps)
    found = solve(whole(steps), smoother.estimate(), "gn", initial="given")
    assert found.initial_chi2 < 1.01 * found.chi2


def test_removed_factors_might_as_well_never_have_been_added(rng):
    steps = growth(SE2, 120, rng)
    smoother = ISAM2()
    numbers = [int(n) for step in steps for n in smoother.update(step.graph(), step.values).factors]
    records = [record for step in steps for record in step.records]
    loops = [k for k, record in enumerate(records) if record.kind == "Between" and np.ptp(record.keys) > 8]
    loops += [k for k, record in enumerate(records) if record.kind.startswith("Offset")]
    assert len(loops) > 15
    smoother.update(remove=[numbers[k] for k in loops], iterate=1e-11)
    batch = converged(whole(steps, leave_out=set(loops)), starts(steps))
    assert distance(batch, smoother.estimate()) < 1e-8
    assert smoother.update(costs=True).cost_after == pytest.approx(
        solve(whole(steps, leave_out=set(loops)), batch, "gn", initial="given").cost, rel=1e-9
    )


def test_replacing_a_factor_in_one_update(rng):
    steps = growth(SE3, 40, rng)
    smoother = ISAM2()
    numbers = [int(n) for step in steps for n in smoother.update(step.graph(), step.values).factors]
    records = [record for step in steps for record in step.records]
    loop = next(k for k, r in enumerate(records) if r.kind == "Between" and r.keys.max() < 40 and np.ptp(r.keys) > 3)
    i, j = records[loop].keys[0].tolist()
    new = Between(i, j, SE3.exp(0.1 * rng.normal(size=6)), Isotropic(0.3))
    graph = FactorGraph()
    graph.add(new)
    smoother.update(graph, remove=[numbers[loop]], iterate=1e-11)
    other = whole(steps, leave_out={loop})
    other.add(new)
    assert distance(converged(other, smoother.estimate()), smoother.estimate()) < 1e-8


def test_switching_loops_off_and_on(rng):
    steps = growth(SE2, 90, rng)
    smoother = ISAM2()
    numbers = [int(n) for step in steps for n in smoother.update(step.graph(), step.values).factors]
    smoother.update(iterate=1e-11)
    before = smoother.estimate()
    records = [record for step in steps for record in step.records]
    loops = [k for k, record in enumerate(records) if record.kind == "Between" and np.ptp(record.keys) > 8]
    smoother.switch([numbers[k] for k in loops], on=False)
    assert distance(before, smoother.estimate()) == 0.0  # not before the next update
    smoother.update(iterate=1e-11)
    without = converged(whole(steps, leave_out=set(loops)), before)
    assert distance(without, before) > 1e-3
    assert distance(without, smoother.estimate()) < 1e-8
    smoother.switch([numbers[k] for k in loops], on=True)
    smoother.update(iterate=1e-11)
    assert distance(before, smoother.estimate()) < 1e-8
    with pytest.raises(GraphError, match="nothing was switched"):
        smoother.switch([10**6], on=False)


def test_held_variables_stay_and_can_be_held_only_when_new(rng):
    steps = growth(SE2, 40, rng, others=False)
    steps[20].fixed = [20]
    smoother = fed(steps)
    np.testing.assert_allclose(smoother.estimate(20).matrix, steps[20].values.at(20).matrix, rtol=0.0, atol=1e-15)
    smoother.update(iterate=1e-11)
    assert distance(converged(whole(steps), starts(steps)), smoother.estimate()) < 1e-8
    graph = FactorGraph()
    graph.fix([7])
    before = bits(smoother)
    with pytest.raises(GraphError, match="new"):
        smoother.update(graph)
    assert bits(smoother) == before


def test_components_that_never_meet_and_that_meet_later(rng):
    smoother, records, values = ISAM2(), [], Values()
    for k in range(60):
        graph, new = FactorGraph(), Values()
        key = 1000 * (k % 3) + k // 3
        value = SE2.exp(np.array([0.0, 1.0 * (k // 3), 3.0 * (k % 3)]))
        new.insert(key, value)
        values.insert(key, value)
        noisy = value @ SE2.exp(rng.normal(0.0, 0.05, 3))
        record = Prior(key, noisy, Isotropic(0.1)) if k < 3 else None
        if record is None:
            record = Between(key - 1, key, SE2.exp(np.array([0.01, 1.0, 0.0])), Isotropic(0.05))
        records.append(record)
        graph.add(record)
        smoother.update(graph, new)
    assert sum(clique.parent is None for clique in smoother.cliques()) == 3
    joined = FactorGraph()
    bridge = Between(5, 1010, SE2.exp(np.array([0.0, 5.0, 3.0])), Isotropic(0.05))
    joined.add(bridge)
    smoother.update(joined, iterate=1e-12)
    assert sum(clique.parent is None for clique in smoother.cliques()) == 2
    batch = FactorGraph()
    for record in [*records, bridge]:
        batch.add(record)
    assert distance(converged(batch, values), smoother.estimate()) < 1e-8


def test_two_smoothers_side_by_side_and_one_again_give_the_same_bits(rng):
    steps = growth(SE3, 60, rng, kernel=Huber(0.5))
    other = growth(SE2, 60, rng)
    alone = bits(fed(steps))
    one, two, third = ISAM2(), ISAM2(), ISAM2()
    for a, b in zip(steps, other, strict=True):
        one.update(a.graph(), a.values)
        two.update(b.graph(), b.values)
        third.update(a.graph(), a.values)
    assert bits(one) == alone == bits(third)
    assert bits(two) == bits(fed(other))


def test_an_empty_update_changes_nothing_and_new_smoothers_are_empty():
    smoother = ISAM2()
    result = smoother.update()
    assert len(result.factors) == 0
    assert len(smoother.estimate()) == 0
    assert smoother.cliques() == ()


def test_settings_are_checked():
    with pytest.raises(ConfigError):
        ISAM2Settings(relinearize_threshold=-1.0)
    with pytest.raises(ConfigError):
        ISAM2Settings(relinearize_skip=0)


@pytest.mark.parametrize(("threshold", "passes"), [(0.1, 2), (0.0, 1), (10.0, 1)])
def test_a_loop_that_moves_much_gets_a_second_pass_where_that_is_cheap(threshold, passes):
    smoother = ISAM2(ISAM2Settings(relinearize_threshold=threshold))
    step = SE2.exp([2.0 * np.pi / 40.0 + 0.01, 1.0, 0.0])
    graph, values = FactorGraph(), Values()
    graph.add(Prior(0, SE2.identity(), Isotropic(0.01)))
    values.insert(0, SE2.identity())
    smoother.update(graph, values)
    for key in range(1, 40):
        graph, values = FactorGraph(), Values()
        graph.add(Between(key - 1, key, step, Isotropic(0.05)))
        values.insert(key, smoother.estimate(key - 1) @ step)
        smoother.update(graph, values)
    graph = FactorGraph()
    graph.add(Between(39, 0, SE2.exp([2.0 * np.pi / 40.0, 1.0, 0.0]), Isotropic(0.01)))
    assert smoother.update(graph).iterations == passes


def test_a_pass_in_one_call_is_the_pass_by_steps(rng, monkeypatch):
    steps = growth(SE3, 80, rng, kernel=Huber(1.0))
    at_once = fed(steps)
    monkeypatch.setattr(TreeState, "advance", TreeState._advance_by_steps)
    stepwise = fed(steps)
    assert bits(at_once) == bits(stepwise)


def test_single_factors_are_what_a_record_of_several_is(rng):
    steps = growth(SE3, 30, rng)
    poses = SE3.exp(0.1 * rng.normal(size=(6, 6)))
    tight = ISAM2Settings(relinearize_threshold=0.0, wildfire=0.0)
    singly, together = fed(steps, tight), fed(steps, tight)
    graph, batch = FactorGraph(), FactorGraph()
    for k in range(6):
        graph.add(Between(k, k + 20, SE3(poses.matrix[k]), Isotropic(0.2), kernel=Huber(2.0)))
    batch.add(Between(np.arange(6), np.arange(20, 26), poses, Isotropic(0.2), kernel=Huber(2.0)))
    one, other = singly.update(graph), together.update(batch)
    np.testing.assert_array_equal(one.factors, other.factors)
    assert bits(singly) == bits(together)

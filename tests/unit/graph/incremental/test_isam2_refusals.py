"""What a smoother refuses leaves it as it was, to the bit: it goes on as one that never saw it."""

import numpy as np
import pytest

from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph import (
    ISAM2,
    Between,
    Factor,
    FactorGraph,
    Huber,
    ISAM2Settings,
    Isotropic,
    Landmark,
    Position,
    Prior,
    Range,
    Values,
)
from heliograph.lie import SE2, SE3
from reference.growth import POINT, cliques_of, growth

EAGER = ISAM2Settings(relinearize_threshold=1e-4, wildfire=1e-6)
NEW = 77_000


def bits(smoother):
    tree = smoother._state.native
    keys = smoother.estimate().keys()
    numbers = np.arange(len(keys), dtype=np.int32)
    return (
        tree.linearization_point(numbers).tobytes(),
        tree.delta().tobytes(),
        cliques_of(tree),
        (tree.variables, tree.cliques, tree.factors, tree.fluid),
        smoother.joint(keys[:5]).tobytes() if len(keys) > 4 else b"",
    )


def added(*records, fix=()):
    graph = FactorGraph()
    for record in records:
        graph.add(record)
    graph.fix(list(fix))
    return graph


def started(key, value):
    values = Values()
    values.insert(key, value)
    return values


class Fails(Factor):
    """Not a number far from where it began."""

    variables = (SE2,)
    rows = 1

    @staticmethod
    def residual(T_world_i):
        x = T_world_i[:, 0, 2]
        return np.where(np.abs(x) < 1e3, x, np.nan)[:, None]


def refused_point(smoother):
    graph = added(Range(3, NEW, 2.0, Isotropic(0.1)), Between(2, 9, SE2.identity(), Isotropic(0.2)))
    with pytest.raises(UnderconstrainedError, match=str(NEW)) as caught:
        smoother.update(graph, started(NEW, np.array([1.0, 1.0])))
    assert "direction" in str(caught.value) or "degree" in str(caught.value)


def refused_again(smoother):
    with pytest.raises(GraphError, match="key 3: already in the smoother"):
        smoother.update(None, started(3, SE2.identity()))


def refused_pose(smoother):
    with pytest.raises(UnderconstrainedError, match=str(NEW)):
        smoother.update(added(Position(NEW, [1.0, 2.0], Isotropic(0.1))), started(NEW, SE2.identity()))


def refused_removal(smoother):
    point = smoother.update(
        added(Landmark(4, NEW, [1.0, 0.0], Isotropic(0.1)), Range(5, NEW, 1.0, Isotropic(0.1))),
        started(NEW, np.array([1.0, 1.0])),
    )
    before = bits(smoother)
    with pytest.raises(UnderconstrainedError, match=str(NEW)):
        smoother.update(remove=point.factors[:1])
    assert bits(smoother) == before


def refused_switch(smoother):
    loose = smoother.update(added(Prior(NEW, [1.0, 2.0], Isotropic(0.1))), started(NEW, np.zeros(2)))
    before = bits(smoother)
    smoother.switch(loose.factors, on=False)
    with pytest.raises(UnderconstrainedError, match=str(NEW)):
        smoother.update()
    assert bits(smoother) == before


def test_what_leads_out_of_all_numbers_is_told_from_what_was_not_made():
    smoother = ISAM2()
    smoother.update(added(fix=[0]), started(0, SE2.identity()))
    graph = added(Between(0, 1, SE2.identity(), Isotropic(0.1)), Position(1, [1e200, 0.0], Isotropic(1.0)))
    with pytest.raises(UnderconstrainedError, match="key 1: not determined where the update has moved it; it was made"):
        smoother.update(graph, started(1, SE2.identity()))
    assert 1 in smoother
    smoother.update(remove=[0, 1], remove_variables=[1])
    assert 1 not in smoother


def refused_evaluation(smoother):
    graph = added(Prior(NEW, SE2.identity(), Isotropic(0.1)), Fails(NEW, noise=Isotropic(1.0)))
    with pytest.raises(GraphError, match="Fails"):
        smoother.update(graph, started(NEW, SE2.exp(np.array([0.0, 5e3, 0.0]))))


def refused_number(smoother):
    graph = added(Between(2, 9, SE2.identity(), Isotropic(0.2)), Prior(NEW, SE2.identity(), Isotropic(0.1)))
    with pytest.raises(GraphError, match="nothing was changed"):
        smoother.update(graph, started(NEW, SE2.identity()), remove=[1, 10**6])


def refused_key(smoother):
    with pytest.raises(GraphError, match="without a value"):
        smoother.update(added(Between(2, 987_654, SE2.identity(), Isotropic(0.2))), Values())


REFUSALS = [refused_point, refused_again, refused_pose, refused_evaluation, refused_number, refused_key]


@pytest.mark.parametrize("settings", [None, EAGER])
@pytest.mark.parametrize("kernel", [None, Huber(0.5)])
def test_refusals_leave_no_trace(settings, kernel, rng):
    steps = growth(SE2, 70, rng, kernel=kernel)
    never, often = ISAM2(settings), ISAM2(settings)
    relinearized, spare = 0, []
    for k, step in enumerate(steps):
        removed = [spare.pop(0)] if k % 17 == 16 else []
        results = [smoother.update(step.graph(), step.values, remove=removed) for smoother in (never, often)]
        relinearized += results[0].relinearized
        spare += [int(results[0].factors[row]) for row in step.spare]
        assert results[0].factors.tolist() == results[1].factors.tolist()
        assert bits(never) == bits(often)
        if k >= 12:
            REFUSALS[k % len(REFUSALS)](often)
            assert bits(never) == bits(often)
    assert relinearized > 50
    assert never.update(costs=True).cost_after == often.update(costs=True).cost_after


@pytest.mark.parametrize("refusal", [refused_removal, refused_switch])
def test_removals_and_switches_that_leave_a_variable_free_are_refused(refusal, rng):
    smoother = ISAM2(EAGER)
    for step in growth(SE2, 30, rng):
        smoother.update(step.graph(), step.values)
    refusal(smoother)
    smoother.update(added(Between(2, 9, SE2.identity(), Isotropic(0.2))))


def test_messages_name_variables_and_what_is_free():
    smoother = ISAM2()
    smoother.update(added(Prior(0, SE3.identity(), Isotropic(0.1))), started(0, SE3.identity()))
    with pytest.raises(UnderconstrainedError) as caught:
        smoother.update(
            added(Landmark(1, POINT, np.ones(3), Isotropic(0.1)), Prior(POINT, np.zeros(3), Isotropic(0.1))),
            both(1, SE3.identity(), POINT, np.zeros(3)),
        )
    text = str(caught.value)
    assert "1" in text
    assert "3 degrees of freedom" in text
    assert "the smoother stays as it was" in text


def both(key, value, other, point):
    values = started(key, value)
    values.insert(other, point)
    return values


def test_known_keys_cannot_be_given_again(rng):
    smoother = ISAM2()
    steps = growth(SE2, 10, rng)
    for step in steps:
        smoother.update(step.graph(), step.values)
    before = bits(smoother)
    with pytest.raises(GraphError, match="already in the smoother"):
        smoother.update(steps[3].graph(), steps[3].values)
    assert bits(smoother) == before


@pytest.mark.parametrize("shape", ["star", "chain", "ring"])
@pytest.mark.parametrize("count", [3, 40])
def test_a_component_without_an_anchor_is_refused_and_one_with_it_is_not(shape, count, rng):
    smoother, graph, values = ISAM2(), FactorGraph(), Values()
    keys = np.arange(count)
    values.insert(keys, SE3.exp(rng.normal(size=(count, 6))))
    before = 0 * keys[1:] if shape == "star" else keys[:-1]
    graph.add(Between(before, keys[1:], SE3.exp(rng.normal(size=(count - 1, 6))), Isotropic(0.01)))
    if shape == "ring":
        graph.add(Between(count - 1, 0, SE3.exp(rng.normal(size=6)), Isotropic(0.01)))
    with pytest.raises(UnderconstrainedError, match="6 degrees of freedom"):
        smoother.update(graph, values)
    assert len(smoother.estimate()) == 0
    graph.add(Prior(1, SE3.identity(), Isotropic(10.0)))
    result = smoother.update(graph, values)
    assert result.reeliminated == count * result.iterations


def test_a_long_open_chain_is_not_taken_for_a_singular_one(rng):
    smoother, count = ISAM2(), 3000
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(count), SE2.exp(np.column_stack([np.zeros(count), np.arange(count), np.zeros(count)])))
    graph.add(Between(np.arange(count - 1), np.arange(1, count), SE2.exp(np.array([0.0, 1.0, 0.0])), Isotropic(5e-5)))
    graph.fix([0])
    smoother.update(graph, values)
    assert smoother.covariance(count - 1)[2, 2] > 1e9 * 5e-5**2

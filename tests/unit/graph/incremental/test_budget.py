"""What an update may do: the bounds of settings and caller, and how what was left is paid for by later updates."""

from types import SimpleNamespace

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.graph import ISAM2Settings
from heliograph.graph.incremental.budget import GRANTS, SPENDINGS, UNBOUNDED, Policy, Savings

SETTINGS = ISAM2Settings(max_steps=640, max_relinearized=1280)


def tree(*, waiting=0, fluid=0, deferred=0, longest_fluid=1.0):
    return SimpleNamespace(waiting=waiting, fluid=fluid, deferred=deferred, longest_fluid=longest_fluid)


def spent(settings=SETTINGS):
    """Return a policy that has nothing saved up."""
    policy = Policy(settings)
    policy.spend(policy.budget(tree(fluid=10_000, deferred=1)), settings.max_relinearized, settings.max_steps)
    assert policy.savings == [0, 0]
    return policy


def test_left_work_is_done_at_the_granted_rate_in_quarters():
    policy, left = spent(), tree(fluid=10_000, deferred=3)
    relinearized, steps = [], []
    for _ in range(3 * GRANTS):
        budget = policy.budget(left)
        relinearized.append(budget.relinearize)
        steps.append(budget.deferred_steps)
        policy.spend(budget, budget.relinearize, budget.deferred_steps)
        policy.end_update()
    for done, limit in ((np.array(relinearized), 1280), (np.array(steps), 640)):
        at = np.flatnonzero(done)
        np.testing.assert_array_equal(done[at], limit // SPENDINGS)
        np.testing.assert_array_equal(np.diff(at), GRANTS // SPENDINGS)
        assert at[0] == GRANTS // SPENDINGS


def test_savings_do_not_grow_beyond_one_limit():
    policy = spent()
    for _ in range(5 * GRANTS):
        policy.end_update()
    budget = policy.budget(tree(fluid=10_000, deferred=1))
    assert (budget.relinearize, budget.deferred_steps) == (1280, 640)


def test_little_work_waits_for_no_quarter():
    policy = spent()
    policy.end_update()  # 20 variables are granted
    assert policy.budget(tree(fluid=21)).relinearize == 0
    assert policy.budget(tree(fluid=20)).relinearize == 20
    assert policy.budget(tree(fluid=0)).relinearize == 0


def test_a_limit_below_the_grants_is_granted_one_variable_an_update():
    savings = Savings(5)
    savings.spend(5)
    savings.grant()
    assert savings.due(1) == 1


def test_candidates_found_by_catching_up_are_gathered():
    policy = Policy(SETTINGS)
    few = tree(fluid=1280 // GRANTS - 1, deferred=1)
    relinearized = []
    for _ in range(2 * GRANTS):
        relinearized.append(policy.budget(few).relinearize)
        policy.end_update()
    assert np.flatnonzero(relinearized).tolist() == [0, GRANTS]


@pytest.mark.parametrize(
    ("settings", "exact"),
    [
        (SETTINGS, True),
        (ISAM2Settings(relinearize_threshold=0.0, max_steps=1, max_relinearized=1), False),
        (ISAM2Settings(wildfire=0.0, max_steps=1, max_relinearized=1), False),
    ],
)
def test_exact_budgets_leave_nothing_and_cost_no_savings(settings, exact):
    policy = Policy(settings)
    budget = policy.budget(tree(fluid=7, deferred=7), exact=exact)
    assert {budget.relinearize, budget.eliminate, budget.steps, budget.deferred_steps} == {UNBOUNDED}
    before = policy.savings
    policy.spend(budget, 0, 10_000)
    assert policy.savings == before


def test_bound_of_the_caller_holds_for_relinearisation_elimination_and_steps():
    policy = Policy(SETTINGS)
    budget = policy.budget(tree(fluid=7, deferred=7), max_variables=9)
    assert (budget.relinearize, budget.eliminate, budget.steps) == (9, 9, 9)
    assert budget.farthest_first
    assert policy.budget(tree(), max_variables=100_000).steps == SETTINGS.max_steps


def test_nothing_is_relinearised_in_the_middle_of_an_elimination_or_in_a_skipped_update():
    assert Policy(SETTINGS).budget(tree(waiting=1, fluid=9), max_variables=4).relinearize == 0
    skipping = Policy(ISAM2Settings(relinearize_skip=3))
    relinearized = []
    for _ in range(6):
        relinearized.append(skipping.budget(tree(fluid=9)).relinearize > 0)
        skipping.end_update()
    assert relinearized == [False, False, True, False, False, True]


def test_only_cheap_passes_with_candidates_are_repeated():
    policy = Policy(SETTINGS)
    assert policy.repeats(tree(fluid=1), work=1e6, solved=5000)
    assert not policy.repeats(tree(fluid=0), work=1e6, solved=5000)
    assert not policy.repeats(tree(fluid=1), work=3e6, solved=5000)
    assert not policy.repeats(tree(fluid=1), work=1e6, solved=5001)
    assert not policy.repeats(tree(fluid=1, deferred=1), work=1e6, solved=5000)
    assert not Policy(ISAM2Settings(relinearize_threshold=0.0)).repeats(tree(fluid=1), work=1e6, solved=5000)


def test_what_moved_little_beyond_the_threshold_waits_for_the_next_update():
    policy, threshold = Policy(SETTINGS), SETTINGS.relinearize_threshold
    assert not policy.repeats(tree(fluid=9, longest_fluid=1.9 * threshold), work=1e6, solved=5000)
    assert policy.repeats(tree(fluid=9, longest_fluid=2.1 * threshold), work=1e6, solved=5000)


def test_restored_savings_go_on():
    policy, other = spent(), Policy(SETTINGS)
    for _ in range(20):
        policy.end_update()
    other.restore(policy.updates, policy.savings)
    left = tree(fluid=10_000, deferred=1)
    assert other.budget(left) == policy.budget(left)
    assert other.updates == 20


@pytest.mark.parametrize(
    ("updates", "savings"), [(1 << 63, [1, 1]), (3, [11, 1]), (3, [1, 1 << 70]), (3, [-1, 1]), (3, [1, 1.0])]
)
def test_savings_that_no_updates_leave_are_refused(updates, savings):
    policy = Policy(ISAM2Settings(max_relinearized=10, max_steps=20))
    with pytest.raises(ValueError, match="updates with savings"):
        policy.restore(updates, savings)
    policy.restore(3, [10, 20])
    assert (policy.updates, policy.steps.left) == (3, 20)


@pytest.mark.parametrize("name", ["relinearize_skip", "max_steps", "max_relinearized"])
def test_bounds_that_no_counter_holds_are_refused(name):
    with pytest.raises(ConfigError, match=name):
        ISAM2Settings(**{name: 1 << 64})

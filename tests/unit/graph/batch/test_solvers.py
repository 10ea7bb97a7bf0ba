"""The minimisers: where they end, that they never go up, what they report."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from heliograph.errors import ConfigError, GraphError
from heliograph.graph import (
    DCS,
    Between,
    Cauchy,
    Factor,
    FactorGraph,
    GemanMcClure,
    Huber,
    Information,
    Isotropic,
    Prior,
    SolverSettings,
    TruncatedLeastSquares,
    Tukey,
    Values,
    solve,
)
from heliograph.graph.batch.gauss_newton import gauss_newton
from heliograph.graph.batch.solve import METHODS
from heliograph.graph.files.worlds import manhattan, sphere, with_false_loops
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2, se2
from reference.normal_equations import assemble, free_scalars

KERNELS = (None, Huber(1.0), Cauchy(1.0), GemanMcClure(2.0), Tukey(4.0), DCS(1.0), TruncatedLeastSquares(3.0))
# Of the kernels that reject, so wide that no pose loses all of its factors: Gauss-Newton has nothing to hold it then.
WIDE = (*KERNELS[:4], Tukey(15.0), DCS(1.0), TruncatedLeastSquares(30.0))
EXACT = SolverSettings(max_iterations=1000, relative_decrease=1e-12, absolute_decrease=1e-24)


def small_world(seed, poses=25, *, kernel=None, false=0, spread=0.05):
    """A noisy walk with loops, some of them false, started beside the truth; pose 0 is held."""
    rng = np.random.default_rng(seed)
    world = manhattan(poses, rng)
    if false:
        world = with_false_loops(world, false, rng)
    graph, values = FactorGraph(), Values()
    d = spread * rng.normal(size=(poses, 3))
    d[0] = 0.0
    values.insert(np.arange(poses), world.truth.retract(d))
    graph.add(Between(world.i, world.j, world.T_i_j, Information(world.information), kernel=kernel))
    graph.fix(0)
    return graph, values


def true_cost(graph, values):
    problem = Problem(graph, values)
    problem.analyze()
    problem.linearize()
    return assemble(problem)


def step_between(start, end):
    return np.concatenate([a.local(b).reshape(-1) for a, b in zip(*(_blocks(v) for v in (start, end)), strict=True)])


def _blocks(values):
    return [family.unpack(packed) for family, packed in zip(values.families(), values.packed(), strict=True)]


@pytest.mark.parametrize("kernel", WIDE)
def test_methods_agree_near_the_optimum(kernel):
    graph, values = small_world(3, kernel=kernel, spread=0.01)
    found = {method: solve(graph, values, method, initial="given", settings=EXACT) for method in METHODS}
    costs = [solution.cost for solution in found.values()]
    assert np.ptp(costs) <= 1e-7 * min(costs)
    assert {method: solution.status for method, solution in found.items()} == dict.fromkeys(METHODS, "converged")


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kernel=st.sampled_from(KERNELS),
    method=st.sampled_from(["lm", "dogleg"]),
    spread=st.sampled_from([0.0, 0.1, 1.0, 10.0]),
    false=st.sampled_from([0, 5]),
)
def test_true_robust_cost_never_rises(seed, kernel, method, spread, false):
    graph, values = small_world(seed, 20, kernel=kernel, false=false, spread=spread)
    seen = []
    solution = solve(
        graph, values, method, initial="given", settings=SolverSettings(max_iterations=40), observer=seen.append
    )
    costs = [solution.initial_cost, *(step.cost for step in seen)]
    assert np.all(np.diff(costs) <= 0.0)
    assert [step.accepted for step in seen] == (np.diff(costs) < 0.0).tolist()
    assert solution.initial_cost == pytest.approx(true_cost(graph, values)[2], rel=1e-9)
    assert solution.cost == pytest.approx(true_cost(graph, solution.values)[2], rel=1e-9)
    assert solution.cost == costs[-1]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kernel", WIDE)
def test_gain_ratio_is_the_true_decrease_over_the_models(method, kernel):
    graph, values = small_world(5, kernel=kernel, spread=0.02)
    seen = []
    once = SolverSettings(max_iterations=1, initial_damping=0.1)
    solution = solve(graph, values, method, initial="given", settings=once, observer=seen.append)
    H, g, cost = true_cost(graph, values)
    assert seen[0].accepted
    d = step_between(values, solution.values)
    predicted = -2.0 * g @ d - d @ H @ d
    assert seen[0].gain_ratio == pytest.approx((cost - true_cost(graph, solution.values)[2]) / predicted, rel=1e-6)
    if method == "lm":
        assert seen[0].damping == 0.1
        free = free_scalars(Problem(graph, values))
        raised = (H + 0.1 * np.diag(np.diag(H)))[np.ix_(free, free)]
        np.testing.assert_allclose(d[free], -np.linalg.solve(raised, g[free]), atol=1e-9)


class Arctan(Factor):
    """Gauss-Newton overshoots from where it is flat."""

    variables = (1,)
    rows = 1

    @staticmethod
    def residual(x):
        return np.arctan(x)


class Away(Factor):
    """Its Jacobian has the wrong sign: no step that the model likes lowers the cost."""

    variables = (1,)
    rows = 1

    @staticmethod
    def residual(x):
        return x

    @staticmethod
    def jacobians(x):
        return (-np.ones((len(x), 1, 1)),)


class Logarithm(Factor):
    """Not defined where the first full step leads."""

    variables = (1,)
    rows = 1

    @staticmethod
    def residual(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(x)


def one_number(kind, start):
    graph, values = FactorGraph(), Values()
    values.insert(0, [start])
    graph.add(kind(0, noise=Isotropic(1.0)))
    return graph, values


def test_gauss_newton_says_that_it_diverged_and_keeps_the_better_values():
    graph, values = one_number(Arctan, 3.0)
    solution = solve(graph, values, "gn", initial="given")
    assert solution.status == "diverged"
    assert solution.values.at(0) == 3.0
    assert solution.cost == solution.initial_cost
    for method in ("lm", "dogleg"):
        solution = solve(graph, values, method, initial="given")
        assert solution.status == "converged"
        assert abs(solution.values.at(0)[0]) < 1e-5


@pytest.mark.parametrize("method", ["lm", "dogleg"])
def test_search_that_cannot_go_down_has_stalled(method):
    graph, values = one_number(Away, 3.0)
    solution = solve(graph, values, method, initial="given")
    assert solution.status == "stalled"
    assert solution.values.at(0) == 3.0


def test_step_to_where_a_residual_is_not_defined_is_rejected():
    graph, values = one_number(Logarithm, 5.0)
    for method in ("lm", "dogleg"):
        solution = solve(graph, values, method, initial="given", settings=EXACT)
        assert not solution.steps[0].accepted
        assert solution.values.at(0)[0] == pytest.approx(1.0)
    assert solve(graph, values, "gn", initial="given").status == "diverged"
    graph, values = one_number(Logarithm, -1.0)
    with pytest.raises(GraphError, match=r"Logarithm.residual is not finite for factor 0 \(key 0\)"):
        solve(graph, values, initial="given")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("most", [0, 1, 2])
def test_iterations_are_counted_and_limited(method, most):
    graph, values = small_world(1, spread=0.1)
    solution = solve(graph, values, method, initial="given", settings=SolverSettings(max_iterations=most))
    assert solution.status == "max_iterations"
    assert solution.iterations == len(solution.steps) == most
    if most == 0:
        assert solution.cost == solution.initial_cost


def test_normal_equations_without_a_factor_name_their_variable():
    graph, values = FactorGraph(), Values()
    values.insert([4, 7], np.zeros((2, 2)))
    graph.add(Between(4, 7, [1.0, 0.0], Isotropic(1.0)))
    problem = Problem(graph, values)
    problem.analyze()
    found = gauss_newton(problem, SolverSettings(), problem.linearize(), lambda _: None)
    assert found.status == "indefinite"
    assert found.indefinite_key in (4, 7)


@pytest.mark.parametrize("method", METHODS)
def test_exact_measurements_leave_nothing(method, rng):
    world = sphere(6, 8, rng, sigmas=(0.01, 0.01))
    T = world.truth
    exact = type(T)(np.linalg.inv(T.matrix[world.i]) @ T.matrix[world.j])
    graph, values = FactorGraph(), Values()
    d = 0.02 * rng.normal(size=(len(T), 6))
    d[0] = 0.0
    values.insert(np.arange(len(T)), T.retract(d))
    graph.add(Between(world.i, world.j, exact, Isotropic(0.1)))
    graph.fix(0)
    solution = solve(graph, values, method, initial="given", settings=SolverSettings(absolute_decrease=1e-24))
    assert solution.status == "converged"
    assert solution.chi2 < 1e-18
    np.testing.assert_allclose(solution.values.block(type(T))[1].matrix, T.matrix, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kernel", WIDE)
def test_optimum_is_left_alone(method, kernel):
    graph, values = small_world(8, kernel=kernel)
    optimum = solve(graph, values, "lm", initial="given", settings=EXACT)
    again = solve(graph, optimum.values, method, initial="given")
    assert again.status == "converged"
    assert again.iterations <= 2
    assert optimum.cost * (1 - 1e-9) <= again.cost <= optimum.cost


@pytest.mark.parametrize("method", METHODS)
def test_units_do_not_matter(method):
    """The same problem in millimetres, metres and kilometres takes the same steps."""
    costs = []
    for unit in (1e3, 1.0, 1e-3):
        rng = np.random.default_rng(2)
        world = manhattan(60, rng)
        start = world.truth.retract(0.2 * rng.normal(size=(60, 3)) * (np.arange(60) > 0)[:, None])
        scaled = [SE2(T.matrix * [[1, 1, unit], [1, 1, unit], [1, 1, 1]]) for T in (start, world.T_i_j)]
        scale = np.diag([1.0, 1 / unit, 1 / unit])
        graph, values = FactorGraph(), Values()
        values.insert(np.arange(60), scaled[0])
        graph.add(Between(world.i, world.j, scaled[1], Information(scale @ world.information @ scale)))
        graph.fix(0)
        solution = solve(graph, values, method, initial="given")
        costs.append([step.cost for step in solution.steps])
    for other in costs[1:]:
        np.testing.assert_allclose(other, costs[0], rtol=1e-6)


@pytest.mark.parametrize("kernel", [*KERNELS, Cauchy(0.1), Huber(1e-2)])
def test_result_is_an_optimum_of_the_robust_cost(kernel):
    """No direction goes down: scipy finds nothing better nearby on the cost written out in NumPy."""
    graph, values = small_world(11, 8, kernel=kernel, false=2)
    solution = solve(graph, values, initial="given", settings=EXACT)
    record = next(iter(graph))
    T = solution.values.block(SE2)[1].matrix
    i, j = record.keys.T
    Z = np.linalg.inv(record.measured.elements(record.measurement))
    S = np.linalg.cholesky(record.noise.numbers).T

    def cost(d):
        moved = T @ se2.exp(np.concatenate([np.zeros(3), d]).reshape(-1, 3))
        r = se2.log(Z @ np.linalg.inv(moved[i]) @ moved[j]) @ S.T
        e = np.linalg.norm(r, axis=1)
        return float(np.sum(e**2 if kernel is None else 2.0 * kernel.cost(e)))

    zero = np.zeros(3 * len(T) - 3)
    assert cost(zero) == pytest.approx(solution.cost, rel=1e-9)
    if not isinstance(kernel, TruncatedLeastSquares):
        best = optimize.minimize(cost, zero, method="BFGS", options={"gtol": 1e-7})
        assert best.fun >= solution.cost * (1 - 1e-6)
        assert np.abs(best.x).max() < 1e-3


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), kernel=st.sampled_from([None, Huber(1.0), Cauchy(2.0)]))
def test_order_of_factors_and_names_of_keys_do_not_matter(seed, kernel):
    graph, values = small_world(seed, 20, kernel=kernel)
    record, poses = next(iter(graph)), values.block(SE2)[1]
    rng = np.random.default_rng(seed)
    name = rng.permutation(10**6)[:20] - 5 * 10**5
    graph_of_names, values_of_names = FactorGraph(), Values()
    for k in rng.permutation(20):
        values_of_names.insert(int(name[k]), poses[int(k)])
    measured = SE2(record.measured.elements(record.measurement))
    for k in rng.permutation(len(record)).tolist():
        i, j = name[record.keys[k]].tolist()
        graph_of_names.add(Between(i, j, measured[k], record.noise, kernel=kernel))
    graph_of_names.fix(name[[0]])
    one = solve(graph, values, initial="given", settings=EXACT)
    other = solve(graph_of_names, values_of_names, initial="given", settings=EXACT)
    assert other.cost == pytest.approx(one.cost, rel=1e-9)
    error = one.values.at(np.arange(20)).local(other.values.at(name))
    np.testing.assert_allclose(error, 0.0, atol=1e-5)


class OwnBetween(Factor):
    variables = (SE2, SE2)
    rows = 3

    @staticmethod
    def residual(T_world_i, T_world_j, T_i_j):
        return se2.log(np.linalg.inv(T_i_j) @ np.linalg.inv(T_world_i) @ T_world_j)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kernel", [None, GemanMcClure(3.0)])
def test_own_factors_give_the_same_solution(method, kernel):
    graph, values = small_world(4, kernel=kernel)
    record = next(iter(graph))
    own = FactorGraph()
    measured = record.measured.elements(record.measurement)
    own.add(OwnBetween(tuple(record.keys.T), data=(measured,), noise=record.noise, kernel=kernel))
    own.fix(0)
    one, other = (solve(g, values, method, initial="given", settings=EXACT) for g in (graph, own))
    assert other.cost == pytest.approx(one.cost, rel=1e-9)
    np.testing.assert_allclose(step_between(one.values, other.values), 0.0, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_observer_sees_every_step_as_it_is_reported(method):
    graph, values = small_world(6, spread=0.3)
    seen = []
    solution = solve(graph, values, method, initial="given", observer=seen.append)
    assert tuple(seen) == solution.steps
    assert [step.number for step in seen] == list(range(1, len(seen) + 1))
    assert solution.seconds["total"] == pytest.approx(sum(v for k, v in solution.seconds.items() if k != "total"))
    assert solution.rows == 3 * len(graph)
    assert solution.degrees_of_freedom == solution.rows - 3 * (len(values) - 1)


def test_error_of_an_observer_comes_through():
    graph, values = small_world(6)

    def stop(step):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(graph, values, observer=stop)


def test_given_values_are_not_changed():
    graph, values = small_world(6)
    before = values.packed()[0].tobytes()
    solve(graph, values)
    assert values.packed()[0].tobytes() == before


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_iterations", -1),
        ("relative_decrease", -1e-9),
        ("relative_decrease", np.nan),
        ("absolute_decrease", -1.0),
        ("initial_damping", -1.0),
        ("max_damping", -1.0),
        ("damping_floor", 0.0),
        ("ordering", "amt"),
    ],
)
def test_settings_have_ranges(name, value):
    with pytest.raises(ConfigError, match=name):
        SolverSettings(**{name: value})


def test_unknown_method_and_start_are_named():
    graph, values = small_world(6)
    with pytest.raises(ConfigError, match="no solver 'ln'"):
        solve(graph, values, "ln")
    with pytest.raises(ConfigError, match=r"no start 'cordal'.*chordal"):
        solve(graph, values, initial="cordal")


def test_residual_that_is_not_finite_is_named():
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], np.array([[0.0], [1e200]]))
    graph.add(Prior([0, 1], np.zeros((2, 1)), Isotropic(1.0)))
    with pytest.raises(GraphError, match=r"factor 1 \(key 1\)"):
        solve(graph, values)

"""The sparse normal equations against one dense matrix: steps, models, solves and covariances of any graph."""

import io
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import GraphError, UnderconstrainedError
from heliograph.graph import (
    Between,
    FactorGraph,
    GemanMcClure,
    Huber,
    Information,
    Isotropic,
    Marginals,
    Prior,
    Values,
    solve,
)
from heliograph.graph.problem.problem import Problem
from heliograph.graph.problem.settings import ORDERINGS
from heliograph.lie import SE3
from reference.normal_equations import assemble, damped, free_scalars, inverse_slowly, solve_slowly
from reference.random_graphs import FAMILIES, add_given, dof_of, random_graph, random_information, random_value

TESTS = Path(__file__).resolve().parents[3]


@st.composite
def problems(draw, most=25):
    """A problem of mixed families, analysed with any ordering and linearised."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    variables = draw(st.integers(1, most))
    families = draw(st.lists(st.sampled_from(FAMILIES), min_size=1, max_size=4, unique_by=str))
    graph, values = random_graph(
        rng,
        variables=variables,
        families=families,
        factors=draw(st.integers(0, 3 * variables)),
        kernels=(None, Huber(1.0), GemanMcClure(2.0)),
        held=draw(st.sampled_from([0.0, 0.2, 0.9])),
        components=draw(st.integers(1, 4)),
    )
    return graph, values, draw(st.sampled_from(sorted(ORDERINGS))), rng


def linearized(graph, values, ordering="auto", threads=1):
    problem = Problem(graph, values, threads=threads)
    problem.analyze(ordering)
    return problem, problem.linearize()


def complete_graph(count, family, rng, held=0, skip=0.0):
    """Every variable is joined with every other one: one dense front; `skip` is the share of factors left out."""
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(count), random_value(family, count, rng))
    i, j = np.triu_indices(count, 1)
    kept = rng.random(len(i)) >= skip
    i, j = i[kept], j[kept]
    dof = dof_of(family)
    omega = Information(random_information(dof, rng, (len(i),)))
    graph.add(Between(i, j, random_value(family, len(i), rng), omega))
    graph.add(Prior(np.arange(count), random_value(family, count, rng), Isotropic(2.0)))
    graph.fix(np.arange(held))
    return graph, values


def assert_solves(problem, tolerance=1e-9, damping=0.0, floor=1e-12):
    """Step, model, diagonal, product, solves and inverse are those of the dense matrix."""
    H, g, cost = assemble(problem)
    free = free_scalars(problem)
    native, n = problem.native, problem.size
    assert problem.factorize(damping, floor) is None
    predicted = problem.linear_step(damping, floor)
    raised = damped(H, damping, floor)
    step = -solve_slowly(raised, g, free)
    scale = np.abs(step).max(initial=1e-3)
    np.testing.assert_allclose(native.step(), step, atol=tolerance * scale, rtol=0)
    assert predicted == pytest.approx(-2 * g @ step - step @ H @ step, rel=1e-9, abs=1e-12 * cost)
    masked = np.where(free, g, 0.0)
    np.testing.assert_allclose(native.gradient(), masked, atol=1e-12 * np.abs(g).max(initial=1.0), rtol=0)
    np.testing.assert_allclose(native.diagonal(), np.where(free, np.diag(H), 0.0), rtol=1e-12, atol=1e-13)
    v = np.where(free, np.sin(np.arange(n)), 0.0)
    size = np.abs(H).max(initial=1.0)
    np.testing.assert_allclose(native.multiply(v), np.where(free, H @ v, 0.0), atol=1e-12 * size * n, rtol=0)
    right = np.random.default_rng(1).normal(size=(3, n))
    expected = np.array([solve_slowly(raised, np.where(free, row, 0.0), free) for row in right])
    scale = np.abs(expected).max(initial=1e-3)
    np.testing.assert_allclose(native.solve_for(right), expected, atol=tolerance * scale, rtol=0)


@settings(max_examples=120, deadline=None)
@given(case=problems(), damping=st.sampled_from([0.0, 1e-4, 3.0]), floor=st.sampled_from([1e-12, 0.5]))
def test_any_graph_is_solved_as_the_dense_matrix_is(case, damping, floor):
    graph, values, ordering, _ = case
    problem, cost = linearized(graph, values, ordering)
    assert cost.cost == pytest.approx(assemble(problem)[2], rel=1e-12)
    assert_solves(problem, damping=damping, floor=floor)


@settings(max_examples=80, deadline=None)
@given(case=problems())
def test_covariances_are_the_dense_inverse(case):
    graph, values, _, rng = case
    marginals = Marginals(graph, values)
    problem, _ = linearized(graph, values)
    inverse = inverse_slowly(assemble(problem)[0], free_scalars(problem))
    scale = np.abs(inverse).max(initial=1e-3)
    keys = rng.permutation(values.keys())
    asked = keys[: rng.integers(1, len(keys) + 1)]
    starts, dofs = problem.tangents(values.dense(asked))
    places = [np.arange(s, s + d) for s, d in zip(starts, dofs, strict=True)]
    for key, at in zip(asked.tolist(), places, strict=True):
        np.testing.assert_allclose(marginals.covariance(key), inverse[np.ix_(at, at)], atol=1e-9 * scale, rtol=0)
    alike = asked[dofs == dofs[0]]
    blocks = [inverse[np.ix_(at, at)] for at, d in zip(places, dofs, strict=True) if d == dofs[0]]
    np.testing.assert_allclose(marginals.covariance(alike), np.stack(blocks), atol=1e-9 * scale, rtol=0)
    joined = np.concatenate(places)
    np.testing.assert_allclose(marginals.joint(asked), inverse[np.ix_(joined, joined)], atol=1e-9 * scale, rtol=0)


# Scalars of one dense front on both sides of every size at which the products change their course: granules of 4,
# packing from 48 deep and 96 tall, panels of 96, packed depths of 192, tall panels of 144 rows and 480 columns.
EDGES = (
    1,
    2,
    3,
    4,
    5,
    7,
    8,
    9,
    11,
    12,
    13,
    47,
    48,
    49,
    95,
    96,
    97,
    98,
    99,
    143,
    144,
    145,
    191,
    192,
    193,
    287,
    288,
    289,
)
LARGE = (383, 385, 479, 480, 481, 577, 675)


def dense_front(scalars, rng):
    """A front of so many pivots: vectors of 1 to 9 scalars, all joined with one another."""
    graph, values = FactorGraph(), Values()
    sizes = []
    while sum(sizes) < scalars:
        sizes.append(min(int(rng.integers(1, 10)), scalars - sum(sizes)))
    for key, size in enumerate(sizes):
        values.insert(np.array([key]), rng.normal(size=(1, size)))
        graph.add(Prior(np.array([key]), rng.normal(size=(1, size)), Isotropic(0.5)))
    for a in range(len(sizes)):
        for b in range(a):
            add_given(graph, (a, b), (sizes[a], sizes[b]), rng)
    return graph, values


@pytest.mark.parametrize("scalars", EDGES)
def test_front_is_right_at_every_edge_of_its_kernels(scalars, rng):
    if scalars <= 100:
        graph, values = dense_front(scalars, rng)
    else:
        graph, values = complete_graph(scalars, 1, rng)
    problem, _ = linearized(graph, values)
    assert problem.native.plan()["fronts"] == 1
    assert_solves(problem)


@pytest.mark.parametrize("scalars", LARGE)
def test_large_front_is_right_at_every_edge_of_its_kernels(scalars, rng):
    family = 9 if scalars % 9 == 0 else 5 if scalars % 5 == 0 else 1
    graph, values = complete_graph(scalars // dof_of(family), family, rng, skip=0.9 if family == 1 else 0.0)
    problem, _ = linearized(graph, values)
    assert_solves(problem)


@pytest.mark.parametrize(
    ("left", "shared", "right"), [(49, 97, 51), (95, 145, 3), (193, 96, 48), (50, 481, 50), (97, 193, 97)]
)
def test_large_remainders_reach_their_parent(left, shared, right, rng):
    """Two cliques that share variables: each is a front, and hands a large remainder on."""
    graph, values = FactorGraph(), Values()
    n = left + shared + right
    values.insert(np.arange(n), rng.normal(size=(n, 1)))
    graph.add(Prior(np.arange(n), np.zeros((n, 1)), Isotropic(1.0)))
    for part in (np.arange(left + shared), np.arange(left, n)):
        i, j = (part[k] for k in np.triu_indices(len(part), 1))
        graph.add(Between(i, j, rng.normal(size=(len(i), 1)), Isotropic(rng.uniform(1, 9, len(i)))))
    for ordering in ORDERINGS:
        problem, _ = linearized(graph, values, ordering)
        assert_solves(problem)


@pytest.mark.parametrize("count", [60, 100])
def test_complete_graph_of_poses_is_solved(count, rng):
    graph, values = complete_graph(count, SE3, rng, held=1)
    problem, _ = linearized(graph, values)
    assert_solves(problem)
    marginals = Marginals(graph, values)
    inverse = inverse_slowly(assemble(problem)[0], free_scalars(problem))
    blocks = np.stack([inverse[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(count)])
    np.testing.assert_allclose(marginals.covariance(np.arange(count)), blocks, atol=1e-10)
    np.testing.assert_allclose(marginals.joint([3, 0, count - 1])[:6, 12:], inverse[18:24, -6:], atol=1e-10)


def sparse_world(rng, count=1500):
    """A chain of poses with loops, and points seen from them."""
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(count), random_value(SE3, count, rng))
    values.insert(np.arange(count, count + 100), rng.normal(size=(100, 5)))
    i = np.concatenate([np.arange(count - 1), rng.integers(0, count - 50, count)])
    j = np.concatenate([np.arange(1, count), i[count - 1 :] + rng.integers(2, 50, count)])
    omega = Information(random_information(6, rng, (len(i),)))
    graph.add(Between(i, j, random_value(SE3, len(i), rng), omega))
    graph.add(Prior(np.arange(count, count + 100), rng.normal(size=(100, 5)), Isotropic(1.0)))
    for k in range(100):
        add_given(graph, (int(rng.integers(count)), count + k), (SE3, 5), rng)
    graph.fix([0])
    return graph, values


@pytest.mark.parametrize("ordering", sorted(ORDERINGS))
def test_any_number_of_threads_gives_the_same_bits(ordering, rng):
    graph, values = sparse_world(rng)
    found = []
    for threads in (1, 2, 4, 9):
        problem, cost = linearized(graph, values, ordering, threads)
        assert problem.factorize(1e-3, 1e-12) is None
        predicted = problem.linear_step(1e-3, 1e-12)
        found.append((cost, predicted, problem.native.step().tobytes(), problem.native.diagonal().tobytes()))
    assert found[1:] == found[:1] * 3


def test_more_threads_than_work_are_no_harm(rng):
    for count in (1, 2, 3):
        graph, values = complete_graph(count, 2, rng)
        results = [solve(graph, values, initial="given", threads=threads).values.at(0).tobytes() for threads in (1, 32)]
        assert results[0] == results[1]


SCRIPT = """
import sys
import numpy as np
from unit.graph.problem.test_multifrontal import complete_graph, linearized, sparse_world
rng = np.random.default_rng(3)
for world in (sparse_world(rng, 300), complete_graph(150, 2, rng), complete_graph(49, 1, rng)):
    problem, cost = linearized(*world)
    assert problem.factorize(1e-3, 1e-12) is None
    predicted = problem.linear_step(1e-3, 1e-12)
    np.save(sys.stdout.buffer, np.concatenate([[*cost, predicted], problem.native.step()]))
"""


def test_instruction_sets_agree():
    streams = []
    best = {name: value for name, value in os.environ.items() if name != "HELIOGRAPH_ISA"}
    for isa in ({"HELIOGRAPH_ISA": "baseline"}, {}):
        environment = {**best, **isa, "PYTHONPATH": str(TESTS)}
        done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, check=True)
        streams.append(io.BytesIO(done.stdout))
    for _ in range(3):
        one, other = (np.load(stream) for stream in streams)
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10 * np.abs(other[3:]).max())


def broken_world(rng, broken):
    """A chain of vectors in which the given ones are pulled at by nothing in one direction."""
    graph, values = FactorGraph(), Values()
    count = 400
    values.insert(np.arange(1000, 1000 + count), rng.normal(size=(count, 3)))
    sigmas = np.full(count, 0.5)
    good = np.setdiff1d(np.arange(count), broken)
    graph.add(Prior(1000 + good, np.zeros((len(good), 3)), Isotropic(sigmas[good])))
    chained = good[:-1][np.diff(good) == 1]
    graph.add(Between(1000 + chained, 1001 + chained, np.zeros((len(chained), 3)), Isotropic(1.0)))
    return graph, values


@pytest.mark.parametrize("ordering", sorted(ORDERINGS))
@pytest.mark.parametrize("broken", [[0], [399], [17, 201, 350]])
def test_first_pivot_that_fails_names_its_variable_at_any_number_of_threads(ordering, broken, rng):
    graph, values = broken_world(rng, np.array(broken))
    named = set()
    for threads in (1, 2, 3, 8):
        problem, _ = linearized(graph, values, ordering, threads)
        named.add(problem.factorize(0.0, 0.0))
        assert problem.factorize(1e-6, 1e-6) is None
    assert len(named) == 1
    assert named.pop() - 1000 in broken


@pytest.mark.parametrize("threads", [1, 4])
def test_not_a_number_fails_at_a_variable_it_touches(threads, rng):
    graph, values = sparse_world(rng, 400)
    problem, _ = linearized(graph, values, threads=threads)
    group = next(k for k, g in enumerate(problem.groups) if g.custom is None and len(g.variables) > 300)
    weights = np.ones(len(problem.groups[group].variables))
    weights[200] = np.nan
    problem.native.set_weights(group, weights)
    problem.linearize()
    assert problem.factorize(0.0, 0.0) is not None
    problem.native.set_weights(group, np.zeros(0))
    problem.linearize()
    assert problem.factorize(0.0, 0.0) is None


@settings(max_examples=60, deadline=None)
@given(case=problems(most=40))
def test_factor_holds_at_least_the_fill_of_its_order_and_no_more_than_the_dense_one(case):
    graph, values, ordering, _ = case
    problem, _ = linearized(graph, values, ordering)
    plan = problem.native.plan()
    n = problem.free_scalars
    dofs = problem.tangents(np.setdiff1d(np.arange(len(values)), problem.held))[1]
    assert plan["scalars"] == n
    assert plan["largest_rows"] < max(n, 1)
    assert plan["fronts"] <= len(dofs)
    assert plan["factor_doubles"] >= (dofs * (dofs + 1) // 2).sum()
    assert plan["factor_doubles"] <= n * (n + 11)  # one row more for the gradient, and padding twice


def test_held_variables_keep_their_bits_and_have_no_covariance(rng):
    graph, values = random_graph(rng, variables=40, families=FAMILIES, factors=80, held=0.4)
    solution = solve(graph, values, initial="given")
    marginals = Marginals(graph, solution.values)
    for key in graph.fixed.tolist():
        before, after = values.at(key), solution.values.at(key)
        if isinstance(before, np.ndarray):
            assert before.tobytes() == after.tobytes()
        else:
            name = "vector" if hasattr(before, "vector") else "matrix"
            assert getattr(before, name).tobytes() == getattr(after, name).tobytes()
        assert not marginals.covariance(key).any()
    assert not marginals.joint(graph.fixed[:3]).any()


def test_graph_of_held_variables_alone_has_covariances_and_nothing_to_solve(rng):
    graph, values = complete_graph(3, SE3, rng, held=3)
    assert solve(graph, values).start.startswith("nothing to estimate")
    np.testing.assert_array_equal(Marginals(graph, values).covariance([0, 2]), np.zeros((2, 6, 6)))


def test_no_keys_have_no_covariance(rng):
    graph, values = complete_graph(3, SE3, rng)
    assert Marginals(graph, values).covariance([]).shape[0] == 0
    assert Marginals(graph, values).joint([]).shape == (0, 0)


def test_covariance_wants_known_keys_of_one_size(rng):
    graph, values = random_graph(rng, variables=20, families=(SE3, 2), factors=20)
    marginals = Marginals(graph, values)
    with pytest.raises(GraphError, match="key 100000: not among"):
        marginals.covariance(100000)
    with pytest.raises(GraphError, match="2 and of 6 degrees of freedom"):
        marginals.covariance(values.keys())


def test_variable_without_factors_has_no_covariance(rng):
    graph, values = complete_graph(5, 2, rng)
    values.insert(77, [1.0, 2.0])
    with pytest.raises(UnderconstrainedError, match="77"):
        Marginals(graph, values)


def test_covariances_asked_from_several_threads_are_the_same(rng):
    graph, values = random_graph(rng, variables=100, families=FAMILIES, factors=300, held=0.02)
    solution = solve(graph, values, initial="given")
    keys = [key for key in values.keys().tolist() if key not in graph.fixed.tolist()]
    want = [Marginals(graph, solution.values).covariance(key) for key in keys[:40]]
    marginals = Marginals(graph, solution.values)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(marginals.covariance, keys[:40] * 3))
    for k, P in enumerate(found):
        np.testing.assert_array_equal(P, want[k % 40])

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import GraphError
from heliograph.graph.problem.ordering import Pattern, minimum_degree, nested_dissection
from reference.elimination import eliminate_slowly, minimum_degree_slowly

ORDERS = [minimum_degree, nested_dissection]


@st.composite
def graphs(draw, most=40):
    count = draw(st.integers(0, most))
    node = st.integers(0, max(count - 1, 0))
    edges = draw(st.lists(st.tuples(node, node), max_size=4 * count)) if count else []
    weight = draw(st.lists(st.sampled_from([1, 2, 3, 6]), min_size=count, max_size=count))
    return edges, weight


def grid(*shape):
    number = np.arange(np.prod(shape)).reshape(shape)
    pairs = [
        np.stack((np.take(number, range(n - 1), a).ravel(), np.take(number, range(1, n), a).ravel()), 1)
        for a, n in enumerate(shape)
    ]
    return Pattern.from_edges(np.concatenate(pairs), np.full(number.size, 3))


def random_walk(count, loops, rng):
    """Odometry chain with loop closures between random pairs."""
    chain = np.stack((np.arange(count - 1), np.arange(1, count)), 1)
    return Pattern.from_edges(np.concatenate((chain, rng.integers(0, count, (loops, 2)))), np.full(count, 6))


def assert_permutation(order, count):
    assert order.dtype == np.int32
    np.testing.assert_array_equal(np.sort(order), np.arange(count))


@pytest.mark.parametrize("order", ORDERS)
@given(graph=graphs())
def test_order_names_every_node_once(order, graph):
    edges, weight = graph
    assert_permutation(order(Pattern.from_edges(edges, weight)), len(weight))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("edges", "count"),
    [
        ([], 0),
        ([], 1),
        ([], 3000),
        ([(i, j) for i in range(200) for j in range(i)], 200),
        ([(0, i) for i in range(1, 3000)], 3000),
        ([(i, j) for i in range(3) for j in range(3, 3000)], 3000),
        ([(i, i + 1) for i in range(2999)], 3000),
        ([(i, (i + 1) % 3000) for i in range(3000)], 3000),
        ([(7 * c + i, 7 * c + j) for c in range(400) for i in range(7) for j in range(i)], 2800),
    ],
    ids=["empty", "single", "isolated", "complete", "star", "three hubs", "chain", "ring", "cliques"],
)
def test_order_copes_with_extreme_graphs(order, edges, count):
    pattern = Pattern.from_edges(edges, np.full(count, 6))

    found = order(pattern)

    assert_permutation(found, count)
    # What the edges need by themselves, and as much again for the end of a ring or the rows of a hub.
    assert pattern.fill(found).nonzeros <= 36 * (2 * len(edges) + 2 * count)


@given(graph=graphs(), data=st.data())
def test_fill_equals_elimination_by_sets(graph, data):
    edges, weight = graph
    order = data.draw(st.permutations(range(len(weight))))

    fill = Pattern.from_edges(edges, weight).fill(np.array(order, np.int32))

    nonzeros, flops, parent, heights = eliminate_slowly(edges, weight, order)
    assert fill.nonzeros == nonzeros
    assert fill.flops == pytest.approx(flops, rel=1e-12)
    np.testing.assert_array_equal(fill.parent, parent)
    np.testing.assert_array_equal(fill.column_counts, heights)


def test_minimum_degree_fills_about_as_little_as_exact_degrees():
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(60):
        count = int(rng.integers(20, 90))
        edges = rng.integers(0, count, (int(count * rng.uniform(1.0, 2.5)), 2)).tolist()
        weight = rng.choice([1, 3, 6], count)
        pattern = Pattern.from_edges(edges, weight)
        exact = pattern.fill(minimum_degree_slowly(edges, weight))
        ratios.append(pattern.fill(minimum_degree(pattern)).nonzeros / exact.nonzeros)
    assert np.mean(ratios) < 1.03
    assert np.max(ratios) < 1.15


@settings(max_examples=200)
@given(graph=graphs(), data=st.data())
def test_minimum_degree_eliminates_lower_groups_first(graph, data):
    edges, weight = graph
    group = data.draw(st.lists(st.integers(-2, 3), min_size=len(weight), max_size=len(weight)))

    order = minimum_degree(Pattern.from_edges(edges, weight), group)

    assert_permutation(order, len(weight))
    assert (np.diff(np.array(group, int)[order]) >= 0).all()


def test_minimum_degree_keeps_the_newest_poses_last_at_little_cost(rng):
    pattern = random_walk(2000, 200, rng)
    group = np.zeros(2000, int)
    group[-20:] = 1

    order = minimum_degree(pattern, group)

    assert set(order[-20:].tolist()) == set(range(1980, 2000))
    assert pattern.fill(order).nonzeros < 1.3 * pattern.fill(minimum_degree(pattern)).nonzeros


@pytest.mark.parametrize("shape", [(100, 100), (20, 20, 20)])
def test_nested_dissection_beats_minimum_degree_on_large_grids(shape):
    pattern = grid(*shape)

    assert pattern.fill(nested_dissection(pattern)).flops < 0.85 * pattern.fill(minimum_degree(pattern)).flops


def test_nested_dissection_of_a_chain_with_few_loops_fills_as_minimum_degree(rng):
    pattern = random_walk(20000, 40, rng)

    dissected, degree = (pattern.fill(order(pattern)).nonzeros for order in (nested_dissection, minimum_degree))

    assert dissected < 1.05 * degree


@pytest.mark.parametrize("order", ORDERS)
def test_order_is_the_same_each_time(order, rng):
    pattern = random_walk(5000, 2500, rng)

    np.testing.assert_array_equal(order(pattern), order(pattern))


@pytest.mark.parametrize("order", ORDERS)
def test_order_does_not_depend_on_the_unit_of_weights(order):
    pattern = grid(30, 31)
    scaled = Pattern(offset=pattern.offset, neighbour=pattern.neighbour, weight=pattern.weight * 2)

    np.testing.assert_array_equal(order(pattern), order(scaled))


def test_pattern_refuses_an_edge_to_an_unknown_node():
    with pytest.raises(GraphError, match=r"edge \[1, 5\] leaves the 3 nodes"):
        Pattern.from_edges([(0, 1), (1, 5)], [1, 1, 1])


@pytest.mark.parametrize("order", ORDERS)
def test_order_refuses_a_weight_of_zero(order):
    with pytest.raises(GraphError, match="positive weights"):
        order(Pattern.from_edges([(0, 1)], [1, 0]))


def test_minimum_degree_refuses_groups_of_another_length():
    with pytest.raises(GraphError, match="one group a node"):
        minimum_degree(Pattern.from_edges([(0, 1)], [1, 1]), [0])


@pytest.mark.parametrize("order", [[0, 0], [0], [0, 2], [-1, 0]])
def test_fill_refuses_what_is_not_a_permutation(order):
    with pytest.raises(GraphError, match="every node once"):
        Pattern.from_edges([(0, 1)], [1, 1]).fill(order)


@pytest.mark.parametrize(
    ("offset", "neighbour"),
    [([0, 1, 1], [5]), ([0, 1, 2], [0, 0]), ([0, 2, 1], [1]), ([0, 2, 2], [1, 1]), ([1, 1, 1], []), ([0, 1, 2], [1])],
)
def test_orders_refuse_rows_that_are_no_graph(offset, neighbour):
    rows = np.array(offset, np.int64), np.array(neighbour, np.int32)
    with pytest.raises(GraphError):
        minimum_degree(Pattern(offset=rows[0], neighbour=rows[1], weight=np.ones(2, np.int32)))

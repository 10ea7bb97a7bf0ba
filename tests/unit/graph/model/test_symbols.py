"""Keys with names: what they are, and that messages say them."""

import numpy as np
import pytest

from diagnosed import refusal
from heliograph.errors import GraphError
from heliograph.graph import (
    Between,
    FactorGraph,
    Huber,
    Isotropic,
    Landmark,
    Marginals,
    Prior,
    Symbol,
    Values,
    key_name,
    solve,
)
from heliograph.lie import SE2, SE3, ExtendedPose

X, L = Symbol("X"), Symbol("L")


def test_symbols_are_integers_with_the_letter_on_top():
    assert X(3) == (ord("X") << 56) + 3
    assert Symbol("x")(1) == 8646911284551352321
    keys = X(np.arange(3))
    assert keys.dtype == np.int64 and keys.tolist() == [X(0), X(1), X(2)]
    assert X(range(2)).tolist() == [X(0), X(1)]
    assert X(np.int64(5)) == X(5)
    assert repr(X) == "Symbol('X')"


def test_names_are_of_symbols_alone():
    assert [key_name(k) for k in (X(3), Symbol("x")(0), 7, -5, 1_700_000_000_000_000_000)] == [
        "X3",
        "x0",
        "7",
        "-5",
        "1700000000000000000",
    ]
    assert key_name(X(2**56 - 1)) == f"X{2**56 - 1}"


@pytest.mark.parametrize("letter", ["", "XY", "3", "ä", 7])
def test_symbol_is_one_letter(letter):
    with pytest.raises(GraphError, match="one ASCII letter"):
        Symbol(letter)


@pytest.mark.parametrize("number", [-1, 2**56, 1.5, [0, -1], [0.5]])
def test_symbol_takes_whole_numbers(number):
    with pytest.raises(GraphError, match=r"Symbol\('X'\) takes whole numbers"):
        X(number)


def test_messages_say_names():
    values, graph = Values(), FactorGraph()
    values.insert(X(np.arange(4)), SE2.identity((4,)))
    with pytest.raises(GraphError, match="key X3 is used twice"):
        values.insert(X(3), SE2.identity())
    with pytest.raises(GraphError, match="no value for key L5"):
        values.at(L(5))
    with pytest.raises(GraphError, match=r"key L1: .* not finite"):
        values.insert(L(1), [np.nan, 0.0])
    graph.add(Between(X([0, 1, 2]), X([1, 2, 3]), SE2.identity(), Isotropic(0.1)))
    assert graph.name(1) == "factor 1 (keys X1, X2)"
    found = refusal(graph, values)
    assert "poses X0-X3 are free" in found.message and "graph.fix(X0)" in found.message
    graph.fix(X(0))
    with pytest.raises(GraphError, match="key L9"):
        Marginals(graph, values).covariance(L(9))


def test_graph_and_values_can_be_printed():
    values, graph = Values(), FactorGraph()
    values.insert(X([0, 1]), SE2.exp([[0.5, 0.0, 0.0], [0.0, 1.0, 2.0]]))
    values.insert(L(np.arange(12)), np.arange(24.0).reshape(12, 2))
    graph.add(Prior(X(0), SE2.identity(), Isotropic(0.1)))
    graph.add(Between(X(0), X(1), SE2.identity(), Isotropic(0.1)))
    graph.add(Landmark(X([0, 1]), L(3), [[1.0, 2.0]] * 2, Isotropic(0.2)))
    graph.fix(L(3))
    assert repr(graph) == "FactorGraph(1 Prior, 1 Between, 2 Landmark, 1 held)"
    assert repr(FactorGraph()) == "FactorGraph()"
    lines = str(graph).splitlines()
    assert lines[1].startswith("  factor 0: Prior(1 x key X0")
    assert lines[3].startswith("  factors 2-3: Landmark(2 x keys X0, L3")
    assert lines[-1] == "  held: key L3"
    told = str(values).splitlines()
    assert told[0] == "Values(2 SE2, 12 vectors of dimension 2)"
    assert told[1] == "  X0: rotation [0.5], position [0., 0.]"
    assert told[3] == "  L0: [0., 1.]" and told[-1] == "  ... (12 vectors of dimension 2 in all)"
    other = Values()
    other.insert(0, SE3.exp([0.0, 0.0, 0.25, 1.0, 0.0, 0.0]))
    other.insert(1, ExtendedPose.identity())
    assert "rotation [0.  , 0.  , 0.25]" in str(other) and "velocity" in str(other)


def test_errors_are_half_the_cost_factor_by_factor():
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], [[0.0], [10.0]])
    graph.add(Prior(0, [1.0], Isotropic(0.5)))
    graph.add(Between(0, 1, [4.0], Isotropic(1.0), kernel=Huber(1.0)))
    graph.add(Prior([1, 0], [[10.0], [3.0]], Isotropic(1.0)))
    np.testing.assert_allclose(graph.errors(values), [2.0, 1.0 * (6.0 - 0.5), 0.0, 4.5])
    assert graph.error(values) == pytest.approx(12.0)
    found = solve(graph, values)
    assert graph.error(found.values) == pytest.approx(0.5 * found.cost)
    with pytest.raises(GraphError, match="no value for key 1"):
        graph.errors(_without_one())


def _without_one():
    values = Values()
    values.insert(0, [0.0])
    return values

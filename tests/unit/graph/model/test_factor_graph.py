"""The graph: factors are numbered, wrong ones are refused by number and keys, and nothing is half added."""

import numpy as np
import pytest

from heliograph.errors import DataError, GraphError, UnderconstrainedError
from heliograph.graph import Between, FactorGraph, Information, Isotropic, Position, Prior, Range
from heliograph.lie import SE2

NOISE = Isotropic(0.1)


@pytest.fixture
def graph():
    g = FactorGraph()
    g.add(Prior(0, SE2.identity(), NOISE))
    g.add(Between([0, 1, 2], [1, 2, 3], SE2.identity(), NOISE))
    return g


def test_factors_are_numbered_in_order(graph):
    assert graph.add(Position([3, 0], [1.0, 2.0], NOISE)) == range(4, 6)
    assert len(graph) == 6 and [record.kind for record in graph] == ["Prior", "Between", "Position"]
    record, row = graph.factor(3)
    assert record.kind == "Between" and row == 2 and graph.name(3) == "factor 3 (keys 2, 3)"
    assert graph.name(5) == "factor 5 (key 0)"
    assert [(a.first, len(a.record)) for a in graph.groups()] == [(0, 1), (1, 3), (4, 2)]
    for number in (-1, 6):
        with pytest.raises(GraphError, match=f"no factor {number}; the graph has 6"):
            graph.factor(number)


def test_fixed_keys_are_gathered(graph):
    assert graph.fixed.tolist() == []
    graph.fix(3)
    graph.fix([2, 3, 0])
    assert graph.fixed.tolist() == [0, 2, 3]


def test_a_copy_grows_by_itself(graph):
    other = graph.copy()
    other.add(Prior(9, SE2.identity(), NOISE))
    other.fix(1)
    assert (len(graph), len(other), graph.fixed.tolist()) == (4, 5, [])


def test_an_empty_record_adds_nothing(graph):
    assert graph.add(Between([], [], SE2.identity(), NOISE)) == range(4, 4) and len(graph) == 4


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (
            lambda: Between([5, 6], [6, 6], SE2.identity(), NOISE),
            r"factor 5 \(keys 6, 6\): Between joins a variable",
        ),
        (lambda: Range([5, 6], 7, [1.0, -2.0], NOISE), r"factor 5 \(keys 6, 7\): .*Range is impossible: \[-2"),
        (lambda: Position([5, 6], [[0.0, 0.0], [np.nan, 0.0]], NOISE), r"factor 5 \(key 6\): .*not finite: \[nan"),
        (
            lambda: Between([5, 6], [6, 7], SE2.identity(), Information([np.eye(3), np.diag([1.0, 1.0, -6e6])])),
            r"factor 5 \(keys 6, 7\): its information matrix is not positive semi-definite: .* -6e\+06",
        ),
        (lambda: Between(5, 6, SE2.identity(), Isotropic(0.0)), r"factor 4 \(keys 5, 6\): its standard deviation is 0"),
        (lambda: SE2.identity(), r"a SE2 is no factor"),
    ],
)
def test_wrong_factors_are_refused_by_number_and_keys(graph, record, message):
    with pytest.raises(GraphError, match=message):
        graph.add(record())
    assert len(graph) == 4 and len(graph.groups()) == 2


def test_errors_of_graphs_are_errors_of_data():
    assert issubclass(GraphError, DataError) and issubclass(UnderconstrainedError, GraphError)
    assert UnderconstrainedError("free", diagnosis=3).diagnosis == 3

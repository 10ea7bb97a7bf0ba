"""Values: keys are unique, families are stacked, wrong numbers are named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import GraphError
from heliograph.graph import Values
from heliograph.graph.model.families import vectors
from heliograph.lie import S2, SE2, SE3


@pytest.fixture
def values(rng):
    v = Values()
    v.insert([5, 3, 9], SE2.exp(rng.normal(size=(3, 3))))
    v.insert(100, [1.0, 2.0])
    v.insert([101, 102], [[3.0, 4.0], [5.0, 6.0]])
    v.insert(4, SE2.identity())
    return v


def test_values_return_what_was_inserted(values, rng):
    assert len(values) == 7 and 5 in values and np.int64(102) in values
    assert 6 not in values and "5" not in values and True not in values
    np.testing.assert_array_equal(values.at([102, 100]), [[5.0, 6.0], [1.0, 2.0]])
    assert values.at(100).shape == (2,) and values.at(4).matrix.shape == (3, 3)
    keys, poses = values.block(SE2)
    np.testing.assert_array_equal(keys, [5, 3, 9, 4])
    assert isinstance(poses, SE2) and len(poses) == 4
    np.testing.assert_array_equal(poses.matrix[3], np.eye(3))
    assert values.block(SE3)[1].matrix.shape == (0, 4, 4)
    assert [family.name for family in values.families()] == ["SE2", "vectors of dimension 2"]


def test_dense_order_is_family_by_family(values):
    np.testing.assert_array_equal(values.keys(), [5, 3, 9, 4, 100, 101, 102])
    np.testing.assert_array_equal(values.dense(values.keys()), np.arange(7))
    np.testing.assert_array_equal(values.dense([[4, 7], [101, 5]]), [[3, -1], [5, 0]])


def test_update_changes_only_what_it_names(values):
    before = values.copy()
    values.update([3, 9], SE2.identity((2,)))
    values.update(101, [7.0, 8.0])
    np.testing.assert_array_equal(values.at([9, 3]).matrix, SE2.identity((2,)).matrix)
    np.testing.assert_array_equal(values.at(101), [7.0, 8.0])
    np.testing.assert_array_equal(values.at(5).matrix, before.at(5).matrix)
    np.testing.assert_array_equal(before.at(101), [3.0, 4.0])


def test_a_copy_grows_by_itself(values):
    other = values.copy()
    other.insert(55, [0.0, 0.0])
    assert 55 not in values and len(values) == 7 and len(other) == 8
    values.insert(55, SE2.identity())
    assert other.at(55).shape == (2,)


def test_values_do_not_share_memory_with_what_was_inserted():
    source = np.ones((2, 3))
    v = Values()
    v.insert([1, 2], source)
    source[:] = 5.0
    v.at([1, 2])[:] = 6.0
    v.block(3)[1][:] = 7.0
    np.testing.assert_array_equal(v.at([1, 2]), np.ones((2, 3)))


def test_with_packed_replaces_all_numbers(values):
    doubled = values.with_packed([values.packed()[0], 2.0 * values.packed()[1]])
    np.testing.assert_array_equal(doubled.at(102), [10.0, 12.0])
    np.testing.assert_array_equal(values.at(102), [5.0, 6.0])
    assert doubled.families() == values.families()


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda v: v.insert(5, SE2.identity()), r"key 5 is used twice"),
        (lambda v: v.insert(5, [0.0]), r"key 5 is used twice"),
        (lambda v: v.insert([7, 8, 7], np.zeros((3, 2))), r"key 7 is used twice"),
        (lambda v: v.insert(np.r_[200:300, 250], np.zeros((101, 2))), r"key 250 is used twice"),
        (lambda v: v.insert(np.r_[200:300, 102], np.zeros((101, 2))), r"key 102 is used twice"),
        (lambda v: v.insert([7, 8], np.zeros((3, 2))), r"keys of shape \(2,\) and 3 values"),
        (lambda v: v.insert(7, np.zeros((1, 2))), r"keys of shape \(\) and 1 values"),
        (lambda v: v.insert([7], [1.0, 2.0]), r"1 value "),
        (lambda v: v.insert([7, 8], [[1.0, 2.0], [np.nan, 0.0]]), r"key 8: .*nan.*not finite"),
        (lambda v: v.insert(7, SE2(2.0 * np.eye(3))), r"key 7: .* no value of SE2"),
        (lambda v: v.insert(7.0, [1.0]), r"keys are integers"),
        (lambda v: v.insert(np.uint64(2**63), [1.0]), r"does not fit"),
        (lambda v: v.at(77), r"no value for key 77"),
        (lambda v: v.at([5, 77, 78]), r"no value for keys 77, 78"),
        (lambda v: v.at([5, 100]), r"several families \(SE2, vectors of dimension 2\)"),
        (lambda v: v.at([]), r"no keys"),
        (lambda v: v.update(77, [0.0, 0.0]), r"no value for key 77"),
        (lambda v: v.update(5, [0.0, 0.0]), r"key 5: the variables are SE2"),
        (lambda v: v.update(100, [np.inf, 0.0]), r"not finite"),
    ],
)
def test_mistakes_are_named_and_change_nothing(values, act, message):
    before = values.copy()
    with pytest.raises(GraphError, match=message):
        act(values)
    np.testing.assert_array_equal(values.keys(), before.keys())
    for mine, theirs in zip(values.packed(), before.packed(), strict=True):
        np.testing.assert_array_equal(mine, theirs)


KEYS = st.integers(-(2**63), 2**63 - 1) | st.integers(-20, 20)


@given(st.lists(st.tuples(st.booleans(), st.lists(KEYS, max_size=100)), max_size=8), st.lists(KEYS, max_size=90))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_index_is_a_dictionary(batches, queries):
    """Insertions large and small, singles in between, keys anywhere in 64 bits: the same as a dict."""
    v, twin = Values(), {}
    for planar, keys in batches:
        width = 1 if planar else 2
        numbers = np.full((len(keys), width), float(len(twin)))
        if len(set(keys)) < len(keys) or any(key in twin for key in keys):
            with pytest.raises(GraphError, match="twice"):
                v.insert(keys, numbers)
        elif keys:
            v.insert(keys, numbers)
            twin.update(dict.fromkeys(keys, tuple(numbers[0])))
    assert len(v) == len(twin) and set(v.keys().tolist()) == set(twin)
    np.testing.assert_array_equal(v.dense(queries) >= 0, [key in twin for key in queries])
    for key, number in list(twin.items())[:20]:
        assert tuple(v.at(key)) == number


def test_single_and_bulk_insertions_give_the_same(rng):
    keys, numbers = rng.permutation(1000), rng.normal(size=(1000, 2))
    bulk, single = Values(), Values()
    bulk.insert(keys, numbers)
    for key, row in zip(keys.tolist(), numbers, strict=True):
        single.insert(key, row)
    np.testing.assert_array_equal(bulk.keys(), single.keys())
    np.testing.assert_array_equal(bulk.at(np.arange(1000)), single.at(np.arange(1000)))


def test_scalars_and_directions_are_values():
    v = Values()
    v.insert(1, 2.5)
    v.insert([2, 3], S2([[0.0, 0.0, -2.0], [1.0, 0.0, 0.0]]))
    assert v.at(1).tolist() == [2.5] and v.families()[0] == vectors(1)
    np.testing.assert_array_equal(v.at(2).vector, [0.0, 0.0, -1.0])

"""Records of built-in factors: shapes, packing, and what they refuse."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    Bearing,
    Between,
    Huber,
    Isotropic,
    Landmark,
    LinearMotion,
    Position,
    Prior,
    Range,
)
from heliograph.graph.model.families import FAMILIES, family_named, vectors
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose

NOISE = Isotropic(0.1)
I3 = np.eye(3)


@pytest.mark.parametrize(
    ("record", "code", "shape", "rows", "arity"),
    [
        (lambda: Prior(1, SE3.identity(), NOISE), 1, (1, 12), 6, 1),
        (lambda: Prior([1, 2], SE2.identity((2,)), NOISE), 1, (2, 4), 3, 1),
        (lambda: Prior([1, 2], S2([0.0, 0.0, 1.0]), NOISE), 1, (2, 3), 2, 1),
        (lambda: Prior(1, 2.0, NOISE), 1, (1, 1), 1, 1),
        (lambda: Between(1, 2, SO3.identity(), NOISE), 2, (1, 9), 3, 2),
        (lambda: Between([1, 2], [2, 3], ExtendedPose.identity((2,)), NOISE), 2, (2, 15), 9, 2),
        (lambda: Between(0, [2, 3], [1.0, 2.0], NOISE), 2, (2, 2), 2, 2),
        (lambda: Range(1, 2, 3.0, NOISE), 3, (1, 1), 1, 2),
        (lambda: Range([1, 2], 5, [3.0, 4.0], NOISE), 3, (2, 1), 1, 2),
        (lambda: Bearing(1, 2, SO2.exp([0.3]), NOISE), 4, (1, 2), 1, 2),
        (lambda: Bearing([1, 2], 2, S2(I3[:2]), NOISE), 4, (2, 3), 2, 2),
        (lambda: Landmark([1, 2], [8, 9], np.ones((2, 3)), NOISE), 5, (2, 3), 3, 2),
        (lambda: Landmark(1, 8, [1.0, 2.0], NOISE), 5, (1, 2), 2, 2),
        (lambda: Position(1, [1.0, 2.0, 3.0], NOISE), 6, (1, 3), 3, 1),
        (lambda: LinearMotion(1, 2, np.ones((2, 3)), [1.0, 2.0], NOISE), 7, (1, 8), 2, 2),
        (lambda: LinearMotion([1, 2], [2, 3], np.eye(2), np.ones((2, 2)), NOISE), 7, (2, 6), 2, 2),
    ],
)
def test_record_shapes(record, code, shape, rows, arity):
    r = record()
    assert (r.type, r.measurement.shape, r.rows, r.arity, len(r)) == (code, shape, rows, arity, shape[0])
    assert r.measurement.flags.c_contiguous and not r.measurement.flags.writeable
    assert r.keys.dtype == np.int64 and r.keys.shape == (shape[0], arity) and not r.flaws().any()
    assert r.kind in repr(r) and r.kernel is None


def test_measurements_are_packed_as_the_native_side_reads_them(rng):
    T = SE3.exp(rng.normal(size=(2, 6)))
    record = Between([0, 1], [1, 2], T, NOISE, kernel=Huber(1.3))
    np.testing.assert_array_equal(record.measurement, family_named(SE3).pack(T))
    assert record.kernel == Huber(1.3)
    F = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(LinearMotion(0, 1, F, [7.0, 8.0], NOISE).measurement, [[0, 1, 2, 3, 4, 5, 7, 8]])
    np.testing.assert_array_equal(Bearing(0, 1, SO2.identity(), NOISE).measurement, [[1.0, 0.0]])


def test_a_record_does_not_change_and_does_not_share(rng):
    keys, points = np.array([1, 2]), np.ones((2, 3))
    record = Position(keys, points, NOISE)
    keys[:], points[:] = 9, 9.0
    np.testing.assert_array_equal(record.keys, [[1], [2]])
    assert (record.measurement == 1.0).all()
    with pytest.raises(AttributeError, match="cannot be changed"):
        record.kernel = Huber(1.0)
    with pytest.raises(ValueError, match="read-only"):
        record.keys[0, 0] = 5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Between([1, 2], [2, 3, 4], SE2.identity(), NOISE), r"different numbers of keys a variable"),
        (lambda: Between(1, 2, SE2.identity((2,)), NOISE), r"Between: 2 measurements for 1 factors"),
        (lambda: Between([1, 2, 3], [2, 3, 4], SE2.identity((2,)), NOISE), r"2 measurements for 3 factors"),
        (lambda: Between(1.5, 2, SE2.identity(), NOISE), r"keys are integers, got float64"),
        (lambda: Between([[1]], [[2]], SE2.identity(), NOISE), r"one int or \(N,\) ints a variable"),
        (lambda: Between(1, 2, S2([1.0, 0.0, 0.0]), NOISE), r"directions have no difference"),
        (lambda: Between(1, 2, SE2.identity(), 0.1), r"its noise is a float"),
        (lambda: Between(1, 2, SE2.identity(), NOISE, kernel=1.3), r"its kernel is a float"),
        (lambda: Prior(1, "pose", NOISE), r"a str is no value"),
        (lambda: Range(1, 2, [[3.0]], NOISE), r"distances are one number or \(N,\)"),
        (lambda: Bearing(1, 2, 0.3, NOISE), r"a direction is an SO2 .* not a float"),
        (lambda: Landmark(1, 2, [1.0], NOISE), r"2 or 3 coordinates, got 1"),
        (lambda: Landmark(1, 2, SE2.identity(), NOISE), r"points are an array"),
        (lambda: LinearMotion(1, 2, np.eye(2), [1.0], NOISE), r"got shapes \(2, 2\) and \(1,\)"),
        (lambda: LinearMotion([1, 2], [2, 3], np.ones((3, 2, 2)), [1.0, 1.0], NOISE), r"for 2 factors"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(GraphError, match=message):
        make()


def test_flaws_point_at_the_row():
    assert Range([1, 2, 3], 9, [1.0, -1.0, np.nan], NOISE).flaws().tolist() == [False, True, True]
    assert Position([1, 2], [[1.0, np.inf], [1.0, 2.0]], NOISE).flaws().tolist() == [True, False]
    T = np.stack([np.eye(4), 2.0 * np.eye(4)])
    assert Between([1, 2], [2, 3], SE3(T), NOISE).flaws().tolist() == [False, True]


@pytest.mark.parametrize(
    ("record", "fine", "wrong"),
    [
        (lambda: Prior(1, SE3.identity(), NOISE), [(SE3,)], [(SE2,), (6,)]),
        (lambda: Between(1, 2, SE2.identity(), NOISE), [(SE2, SE2)], [(SE2, 3), (SE3, SE3)]),
        (
            lambda: Range(1, 2, 1.0, NOISE),
            [(SE2, 2), (SE3, ExtendedPose), (3, SE3)],
            [(SE2, 3), (SO3, 3), (4, 4)],
        ),
        (lambda: Bearing(1, 2, SO2.identity(), NOISE), [(SE2, 2), (SE2, SE2)], [(SE3, 3), (2, 2), (SE2, 3)]),
        (lambda: Bearing(1, 2, S2([1.0, 0, 0]), NOISE), [(SE3, 3), (SE3, SE3)], [(SE2, 2), (SE3, 2)]),
        (lambda: Landmark(1, 2, [1.0, 2.0], NOISE), [(SE2, 2), (SE2, SE2)], [(SE3, 3), (2, 2)]),
        (lambda: Position(1, [1.0, 2.0, 3.0], NOISE), [(SE3,), (3,), (ExtendedPose,)], [(SE2,), (2,), (SO3,)]),
        (lambda: LinearMotion(1, 2, np.ones((2, 3)), [0.0, 0.0], NOISE), [(3, 2)], [(2, 3), (3, 3)]),
    ],
)
def test_families_that_fit(record, fine, wrong):
    r = record()
    for names in fine:
        assert r.mismatch(tuple(family_named(name) for name in names)) is None
    for names in wrong:
        families = tuple(family_named(name) for name in names)
        fault = r.mismatch(families)
        assert fault is not None and fault.startswith(r.kind) and families[-1].name in fault


def test_placed_families_have_a_position():
    assert {f.name for f in FAMILIES.values() if f.space} == {"SE2", "SE3", "ExtendedPose"}
    assert [vectors(d).space for d in (1, 2, 3, 4)] == [0, 2, 3, 0]

"""A user's own factor: what the class must have, what it is handed, and its derivatives."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import Factor, FactorGraph, Huber, Isotropic
from heliograph.graph.model import differences
from heliograph.lie import S2, SE2, SE3, SO3, ExtendedPose, s2, se2, se3, se23, so2, so3

NOISE = Isotropic(0.1)


class Between2(Factor):
    variables = (SE2, SE2)
    rows = 3

    @staticmethod
    def residual(T_world_i, T_world_j, T_i_j):
        T_found = se2.compose(se2.inverse(T_world_i), T_world_j)
        return se2.log(se2.compose(se2.inverse(T_i_j), T_found))


class Between2Exact(Between2):
    @staticmethod
    def jacobians(T_world_i, T_world_j, T_i_j):
        T_j_i = se2.compose(se2.inverse(T_world_j), T_world_i)
        by_j = se2.right_jacobian_inverse(Between2.residual(T_world_i, T_world_j, T_i_j))
        return -by_j @ se2.adjoint(T_j_i), by_j


class Distance(Factor):
    variables = (3, ExtendedPose)
    rows = 1

    @staticmethod
    def residual(p_world, X, distance):
        return np.linalg.norm(p_world - X[:, :3, 3], axis=-1, keepdims=True) - distance[:, None]


def between_arrays(rng, count=4):
    return [se2.exp(rng.normal(size=(count, 3))) for _ in range(3)]


def test_differences_agree_with_exact_jacobians(rng):
    X, Y, Z = between_arrays(rng, 50)
    residual, jacobians = Between2.evaluate((X, Y), (Z,))
    exact, exact_jacobians = Between2Exact.evaluate((X, Y), (Z,))
    assert Between2Exact.has_jacobians and not Between2.has_jacobians
    np.testing.assert_allclose(residual, exact, atol=1e-14)
    for found, expected in zip(jacobians, exact_jacobians, strict=True):
        assert found.shape == (50, 3, 3) and found.flags.c_contiguous
        np.testing.assert_allclose(found, expected, atol=2e-9)


def _counting(limit):
    calls = []

    class Counted(Between2):
        @staticmethod
        def residual(*arrays):
            calls.append(len(arrays[0]))
            return Between2.residual(*arrays)

    return Counted, calls


def test_all_perturbations_are_one_call(rng):
    counted, calls = _counting(None)
    X, Y, Z = between_arrays(rng, 20)
    counted.evaluate((X, Y), (Z,))
    assert calls == [20 * 13]


def test_many_instances_are_split_and_named(rng, monkeypatch):
    monkeypatch.setattr(differences, "MAX_ROWS", 13 * 6)
    counted, calls = _counting(None)
    X, Y, Z = between_arrays(rng, 20)
    residual, jacobians = counted.evaluate((X, Y), (Z,))
    assert calls == [78, 78, 78, 26]
    monkeypatch.undo()
    whole, whole_jacobians = Between2.evaluate((X, Y), (Z,))
    np.testing.assert_array_equal(residual, whole)
    np.testing.assert_array_equal(jacobians, whole_jacobians)
    monkeypatch.setattr(differences, "MAX_ROWS", 13 * 6)
    Z[15] = np.nan
    with pytest.raises(GraphError, match=r"Counted.residual is not finite for factor 115"):
        counted.evaluate((X, Y), (Z,), name=lambda row: f"factor {100 + row}")


def _family_factor(name, rows, local):
    def residual(x, z):
        return local(z, x)

    return type("Own", (Factor,), {"variables": (name,), "rows": rows, "residual": staticmethod(residual)})


@pytest.mark.parametrize(
    ("name", "draw", "local", "slope"),
    [
        (2, lambda rng: rng.normal(size=(5, 2)), lambda z, x: x - z, lambda _: np.tile(np.eye(2), (5, 1, 1))),
        (SO3, lambda rng: so3.exp(rng.normal(size=(5, 3))), so3.local, so3.right_jacobian_inverse),
        (SE2, lambda rng: se2.exp(rng.normal(size=(5, 3))), se2.local, se2.right_jacobian_inverse),
        (SE3, lambda rng: se3.exp(rng.normal(size=(5, 6))), se3.local, se3.right_jacobian_inverse),
        (ExtendedPose, lambda rng: se23.exp(rng.normal(size=(5, 9))), se23.local, se23.right_jacobian_inverse),
    ],
)
def test_differences_follow_the_retraction_of_every_family(rng, name, draw, local, slope):
    x, z = draw(rng), draw(rng)
    factor = _family_factor(name, slope(local(z, x)).shape[-1], local)
    residual, (J,) = factor.evaluate((x,), (z,))
    np.testing.assert_allclose(residual, local(z, x), atol=1e-14)
    np.testing.assert_allclose(J, slope(residual), atol=1e-8)


def test_differences_on_the_circle_and_the_sphere(rng):
    from heliograph.lie import SO2

    angle = _family_factor(SO2, 1, so2.local)
    _, (J,) = angle.evaluate((so2.exp([[0.3], [2.0]]),), (so2.exp([[0.1], [0.2]]),))
    np.testing.assert_allclose(J, np.ones((2, 1, 1)), atol=1e-9)
    directions = S2(rng.normal(size=(6, 3))).vector
    itself = _family_factor(S2, 3, lambda z, x: x - z)
    _, (J,) = itself.evaluate((directions,), (0.0 * directions,))
    np.testing.assert_allclose(J, s2.basis(directions), atol=1e-9)


def test_differences_stay_accurate_far_from_the_origin(rng):
    """Positions of a million metres leave few digits for a small step; the step grows with them."""
    p, X = 1e6 + rng.normal(size=(3, 3)), se23.exp(rng.normal(size=(3, 9)))
    X[:, :3, 3] = p + 10.0 * rng.normal(size=(3, 3))
    _, (by_point, by_pose) = Distance.evaluate((p, X), (np.zeros(3),))
    direction = (p - X[:, :3, 3]) / np.linalg.norm(p - X[:, :3, 3], axis=1, keepdims=True)
    np.testing.assert_allclose(by_point[:, 0], direction, atol=2e-6)
    np.testing.assert_allclose(by_pose[:, 0, 3:6], -np.einsum("ni,nij->nj", direction, X[:, :3, :3]), atol=2e-6)
    assert not by_pose[:, 0, 6:].any()


def test_data_gets_the_instances_in_front(rng):
    one = Between2((3, 4), data=(SE2.identity(),), noise=NOISE)
    assert len(one) == 1 and one.data[0].shape == (1, 3, 3) and one.keys.tolist() == [[3, 4]]
    many = Between2(([1, 2], [2, 3]), data=(SE2.identity(),), noise=NOISE, kernel=Huber(1.0))
    assert many.data[0].shape == (2, 3, 3) and many.kernel == Huber(1.0) and many.rows == 3
    assert Distance((1, 2), data=(3.0,), noise=NOISE).data[0].shape == (1,)
    assert Distance(([1, 2], 3), data=([3.0, 4.0],), noise=NOISE).data[0].shape == (2,)
    assert FactorGraph().add(many) == range(2)


def test_keys_are_given_one_a_variable_as_for_the_built_in_factors():
    apart, together = Distance(1, 2, data=(3.0,), noise=NOISE), Distance((1, 2), data=(3.0,), noise=NOISE)
    np.testing.assert_array_equal(apart.keys, together.keys)
    many = Distance([1, 2], 3, data=([3.0, 4.0],), noise=NOISE)
    np.testing.assert_array_equal(many.keys, [[1, 3], [2, 3]])
    with pytest.raises(GraphError, match=r"joins 2 variables, got keys for 1; give .* Distance\(i, j, data="):
        Distance([1, 2], data=(3.0,), noise=NOISE)
    with pytest.raises(GraphError, match="joins 2 variables, got keys for 3"):
        Distance(1, 2, 3, data=(3.0,), noise=NOISE)


def test_data_that_are_not_finite_are_named():
    with pytest.raises(GraphError, match=r"factor 0 \(keys 1, 2\): data of Distance are not finite"):
        FactorGraph().add(Distance((1, 2), data=(np.nan,), noise=NOISE))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Between2((3, 4, 5), data=(SE2.identity(),), noise=NOISE),
            r"joins 2 variables, got keys for 3",
        ),
        (lambda: Between2((3, 4), noise=NOISE), r"Between2.residual does not take 2 variables and 0 data"),
        (lambda: Between2((3, 4), data=SE2.identity(), noise=NOISE), r"data is a tuple"),
        (lambda: Between2((3, 4), data=("x",), noise=NOISE), r"datum 0 is no array of numbers"),
        (lambda: Between2(([1, 2], 4), data=(SE2.identity((3,)),), noise=NOISE), r"datum 0 is a batch of 3 for 2"),
        (lambda: Distance(([1, 2], 4), data=([1.0, 2.0, 3.0],), noise=NOISE), r"the first axis counts the 2 instances"),
        (lambda: Between2(([1, 2], [4, 5, 6]), data=(SE2.identity(),), noise=NOISE), r"different numbers of keys"),
        (lambda: Factor((1,), noise=NOISE), r"Factor is a base class"),
    ],
)
def test_wrong_instances_are_refused(make, message):
    with pytest.raises(GraphError, match=message):
        make()


def _residual(x):
    return x


GOOD = {"variables": (2,), "rows": 2, "residual": staticmethod(_residual)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"variables": None}, r"class Wrong needs `variables`"),
        ({"variables": ()}, r"class Wrong needs `variables`"),
        ({"variables": (2,) * 9}, r"class Wrong needs `variables`"),
        ({"variables": ("SE3",)}, r"class Wrong: 'SE3' is no family"),
        ({"rows": 0}, r"class Wrong needs `rows`"),
        ({"rows": 2.0}, r"class Wrong needs `rows`"),
        ({"rows": ...}, r"class Wrong needs `rows`"),
        ({"residual": ...}, r"class Wrong needs `residual`"),
        ({"residual": _residual}, r"`residual` as a @staticmethod"),
        ({"jacobians": _residual}, r"`jacobians` as a @staticmethod"),
    ],
)
def test_wrong_classes_are_refused(change, message):
    body = {k: v for k, v in {**GOOD, **change}.items() if v is not ...}
    with pytest.raises(GraphError, match=message):
        type("Wrong", (Factor,), body)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"residual": lambda x: x[:, :1]},
            r"residual must return shape \(25, 2\) for 25 instances, got \(25, 1\)",
        ),
        ({"residual": lambda x: x[0]}, r"got \(2,\)"),
        ({"residual": lambda x: np.log(np.where(x > 5, -1.0, 1.0))}, r"Wrong.residual is not finite for instance 3"),
        (
            {"jacobians": lambda _: np.zeros((5, 2, 2))},
            r"Wrong.jacobians returns one array a variable, 1, got a ndarray",
        ),
        ({"jacobians": lambda _: (1, 2)}, r"one array a variable, 1, got 2 of them"),
        ({"jacobians": lambda _: [np.zeros((5, 2))]}, r"Wrong.jacobians, variable 0 must return shape \(5, 2, 2\)"),
        (
            {"jacobians": lambda _: [np.full((5, 2, 2), np.nan)]},
            r"Wrong.jacobians, variable 0 is not finite for instance 0",
        ),
    ],
)
def test_wrong_results_are_named(change, message):
    wrong = type("Wrong", (Factor,), {**GOOD, **{k: staticmethod(v) for k, v in change.items()}})
    x = np.ones((5, 2))
    x[3, 1] = 9.0
    with np.errstate(invalid="ignore"), pytest.raises(GraphError, match=message):
        wrong.evaluate((x,), ())


def test_no_instances_are_no_work():
    residual, jacobians = Between2Exact.evaluate((np.zeros((0, 3, 3)),) * 2, (np.zeros((0, 3, 3)),))
    assert residual.shape == (0, 3) and jacobians[1].shape == (0, 3, 3)

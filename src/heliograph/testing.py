"""Laws that parts of Heliograph obey, for the tests of the library and of whoever plugs something in.

Each raises `AssertionError` with the case that breaks the law. Nothing here needs a test framework.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import GraphError
from heliograph.graph.model.factor import Factor
from heliograph.graph.model.families import Family
from heliograph.lie import so3
from heliograph.lie.groups import MatrixGroup
from heliograph.maps import LocalMap

__all__ = [
    "MAGNITUDES",
    "RobustKernel",
    "assert_factor",
    "assert_jacobian",
    "assert_lie_group",
    "assert_local_map",
    "assert_robust_kernel",
    "numeric_jacobian",
]

Array = NDArray[np.float64]
MAGNITUDES = (
    0.0,
    1e-12,
    1e-9,
    1e-6,
    1e-3,
    0.1,
    0.7,
    1.5,
    2.0,
    2.5,
    3.0,
    np.pi - 1e-3,
    np.pi - 1e-6,
    np.pi - 1e-9,
    np.pi,
)


class RobustKernel(Protocol):
    """A robust cost of a whitened residual."""

    def cost(self, residual: Array) -> Array:
        """Return rho(r), elementwise; ``r^2 / 2`` for small residuals."""
        ...

    def weight(self, residual: Array) -> Array:
        """Return ``rho'(r) / r``, elementwise; 1 at zero."""
        ...


def numeric_jacobian(f: Callable[[Array], Array], x: Array, *, step: float = 1e-3) -> Array:
    """Return the derivative of ``f`` at ``x`` by a five-point stencil, (..., m, n) for ``f: (n,) -> (..., m)``.

    Parameters
    ----------
    f : callable
        Of a vector.
    x : (n,) float64
        Where.
    step : float
        Its truncation error is ``step^4 / 30`` times the fifth derivative, its rounding error about ``1e-16 / step``.
    """
    x = np.asarray(x, dtype=np.float64)
    columns = []
    for direction in np.eye(len(x)):
        d = step * direction
        near, far = f(x + d) - f(x - d), f(x + 2.0 * d) - f(x - 2.0 * d)
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.stack(columns, axis=-1)


def assert_jacobian(
    f: Callable[[Array], Array], x: Array, J: Array, *, step: float = 1e-3, rtol: float = 1e-7, atol: float = 1e-9
) -> None:
    """Assert that ``J`` (..., m, n) is the derivative of ``f`` at ``x`` (n,).

    For arguments on a manifold pass ``lambda d: f(X.retract(d))`` and ``x = 0``; for values on one, their `local` from
    the value at ``x``. Use points where the residual is large: a Jacobian that holds only near zero is wrong.
    """
    expected = numeric_jacobian(f, x, step=step)
    np.testing.assert_allclose(J, expected, rtol=rtol, atol=atol, err_msg=f"the Jacobian at x = {np.asarray(x)}")


def assert_lie_group(
    group: type[MatrixGroup],
    rng: np.random.Generator,
    *,
    magnitudes: Sequence[float] = MAGNITUDES,
    tolerance: float = 1e-12,
) -> None:
    """Assert the group axioms, the exponential map, the adjoint, the right Jacobians, the retraction and batching.

    Parameters
    ----------
    group : type
        A class with the interface of `heliograph.lie.SE3`.
    rng : numpy.random.Generator
        Draws the elements.
    magnitudes : sequence of float
        Rotation angles, each at most pi, to sweep the tangent vectors over [rad].
    tolerance : float
        For identities that hold but for rounding; numeric derivatives get what their stencil can give.
    """
    for magnitude in magnitudes:
        x = _tangent(group, rng, magnitude)
        X, Y, Z = group.exp(x), _random(group, rng), _random(group, rng)
        case = f"{group.__name__} at rotation angle {magnitude:.12g}"
        _assert_axioms(group, X, Y, Z, case, tolerance)
        _assert_exponential(group, x, magnitude, case, tolerance)
        _assert_adjoint(X, Y, x, case, tolerance)
        _assert_right_jacobian(group, x, case, tolerance)
        _assert_retraction(X, Y, x, magnitude, case, tolerance)
    _assert_batching(group, np.stack([_tangent(group, rng, magnitude) for magnitude in magnitudes]), tolerance)


def assert_robust_kernel(kernel: RobustKernel, *, largest: float = 1e3, tolerance: float = 1e-6) -> None:
    """Assert that a kernel is least squares near zero, never steeper, symmetric, and that its weight is its slope.

    Parameters
    ----------
    kernel : RobustKernel
        Its scale should be within a few orders of magnitude of 1.
    largest : float
        Largest residual tried.
    tolerance : float
        Relative.
    """
    r = np.concatenate([[0.0], np.logspace(-6, np.log10(largest), 400)])
    cost, weight = np.asarray(kernel.cost(r)), np.asarray(kernel.weight(r))
    assert cost.shape == weight.shape == r.shape, "cost and weight must work element by element"
    assert cost[0] == 0.0, f"the cost at zero is {cost[0]}, not 0"
    np.testing.assert_allclose(weight[0], 1.0, rtol=tolerance, err_msg="the weight at zero")
    np.testing.assert_allclose(cost[1:4], 0.5 * r[1:4] ** 2, rtol=1e-3, err_msg="the cost of small residuals")
    assert np.all(cost <= 0.5 * r * r * (1.0 + tolerance) + 1e-300), "the cost exceeds least squares"
    assert np.all(np.diff(cost) >= -tolerance * cost[1:]), "the cost falls with the residual"
    assert np.all((weight >= 0.0) & (weight <= 1.0 + tolerance)), "a weight lies outside [0, 1]"
    assert np.all(np.diff(weight) <= tolerance), "the weight grows with the residual"
    np.testing.assert_array_equal(kernel.cost(-r), cost, err_msg="the cost of a negative residual")
    np.testing.assert_array_equal(kernel.weight(-r), weight, err_msg="the weight of a negative residual")
    step = 1e-4 * r[1:]
    near = np.asarray(kernel.cost(r[1:] + step)) - np.asarray(kernel.cost(r[1:] - step))
    far = np.asarray(kernel.cost(r[1:] + 2 * step)) - np.asarray(kernel.cost(r[1:] - 2 * step))
    slope = (8.0 * near - far) / (12.0 * step)
    # The rounding of the difference scales with the cost itself, which saturates where the slope dies out.
    slack = tolerance * weight[1:] * r[1:] + 1e-11 * cost[1:] / step
    assert np.all(np.abs(slope - weight[1:] * r[1:]) <= slack), "the weight is not the cost's slope over the residual"


def assert_factor(
    factor: type[Factor],
    rng: np.random.Generator,
    data: Callable[[np.random.Generator, int], Sequence[Array]] | None = None,
    *,
    unchanged_by: Callable[[np.random.Generator, Sequence[Array]], Sequence[Array]] | None = None,
    tolerance: float = 1e-6,
) -> None:
    """Assert the shapes of a user's factor, that instances do not mix, and its Jacobians at large errors.

    Where a variable may be of several families, for each of them.

    Parameters
    ----------
    factor : type
        Derived from `heliograph.graph.Factor`.
    rng : numpy.random.Generator
        Draws the variables: rotations of up to 3 rad, positions and vectors of metres.
    data : callable, optional
        Of a generator and N, draws the data, each (N, ...).
    unchanged_by : callable, optional
        Of a generator and the variables' arrays, moves them to where the residual must be the same: an invariance that
        the factor claims, such as moving the whole world.
    tolerance : float
        Of Jacobians, relative to their largest number or to 1; identities must hold to a thousandth of it.
    """
    for families in itertools.product(*factor.families):
        _assert_factor_of(factor, families, rng, data, unchanged_by, tolerance)


def _assert_factor_of(
    factor: type[Factor],
    families: Sequence[Family],
    rng: np.random.Generator,
    data: Callable[[np.random.Generator, int], Sequence[Array]] | None,
    unchanged_by: Callable[[np.random.Generator, Sequence[Array]], Sequence[Array]] | None,
    tolerance: float,
) -> None:
    """Assert the law of factors for variables of these families."""
    count, name = 9, factor.__name__
    arrays = [_elements(family, rng, count) for family in families]
    items = [np.asarray(item, dtype=np.float64) for item in (data(rng, count) if data is not None else ())]
    residual, jacobians = _evaluated(factor, families, arrays, items)
    scale = max(1.0, float(np.abs(residual).max()))
    for row in range(count):
        one = slice(row, row + 1)
        alone, alone_jacobians = _evaluated(factor, families, [a[one] for a in arrays], [item[one] for item in items])
        law = f"{name}: instance {row} alone is not what it is in the batch,"
        bound = 1e-3 * tolerance * scale
        np.testing.assert_allclose(alone, residual[one], rtol=0, atol=bound, err_msg=f"{law} residual")
        for k, (found, expected) in enumerate(zip(alone_jacobians, jacobians, strict=True)):
            bound = 1e-3 * tolerance * max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(found, expected[one], rtol=0, atol=bound, err_msg=f"{law} Jacobian {k}")
        for k, (family, J) in enumerate(zip(families, jacobians, strict=True)):
            moved = _residual_of_step(factor, family, arrays, items, row, k)
            slope = numeric_jacobian(moved, np.zeros(family.dof))
            bound = tolerance * max(1.0, float(np.abs(slope).max()))
            case = f"{name}: the Jacobian of instance {row} by variable {k} ({family.name})"
            np.testing.assert_allclose(J[row], slope, rtol=0, atol=bound, err_msg=case)
    if unchanged_by is not None:
        elsewhere, _ = _evaluated(factor, families, unchanged_by(rng, arrays), items)
        law = f"{name}: the residual changes with what it should not depend on"
        np.testing.assert_allclose(elsewhere, residual, rtol=0, atol=tolerance * scale, err_msg=law)


def assert_local_map(make_map: Callable[[], LocalMap], rng: np.random.Generator) -> None:
    """Assert that a local map finds the walls it was shown, keeps to gate and bound, and forgets when it is cleared.

    Empty and NaN clouds must leave it as it is.

    Parameters
    ----------
    make_map : callable
        Returns a new, empty map. Three walls of 4 m by 4 m with 300 points a square metre must be enough for it.
    rng : numpy.random.Generator
        Draws walls, poses and queries.
    """
    walls = _Walls(rng)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3.exp(rng.normal(size=3)), rng.uniform(-5.0, 5.0, 3)
    cloud_odom = walls.points(rng, 4800, 0.0)
    cloud_body = ((cloud_odom - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
    local_map, twin = make_map(), make_map()
    _assert_nothing_found(local_map, cloud_odom, "an empty map")
    for some in (local_map, twin):
        share = some.insert(cloud_body, T)
        assert share == 1.0, f"the first scan is new by {share:.0%}, not all of it"
    size = len(local_map)
    assert size > 0, "a map with points has length 0"
    local_map.insert(cloud_body[:0], T)
    local_map.insert(np.full((7, 3), np.nan, dtype=np.float32), T)
    assert len(local_map) == size, "an empty cloud or one of NaN changed the map"
    for offset, gate in ((0.03, 0.2), (-0.1, 0.15), (0.1, 0.05)):
        _assert_walls_found(local_map, twin, walls, rng, offset, gate)
    share = local_map.insert(cloud_body, T)
    assert share == 0.0, f"the same scan again is new by {share:.0%}"
    before = local_map.planes_at(cloud_odom, gate=0.1)
    local_map.prune(walls.centre)
    after = local_map.planes_at(cloud_odom, gate=0.1)
    np.testing.assert_array_equal(after.source, before.source, err_msg="pruning around the walls forgot some")
    local_map.prune(walls.centre + 1e5)
    _assert_nothing_found(local_map, cloud_odom, "a map pruned 100 km away")
    _assert_fills_again(local_map, cloud_body, T, cloud_odom, before.source, "a map pruned to nothing")
    local_map.clear()
    _assert_nothing_found(local_map, cloud_odom, "a cleared map")
    _assert_fills_again(local_map, cloud_body, T, cloud_odom, before.source, "a cleared map")


def _assert_fills_again(
    local_map: LocalMap, cloud_body: NDArray[np.float32], T: Array, queries: Array, source: NDArray[np.uint8], case: str
) -> None:
    share = local_map.insert(cloud_body, T)
    assert share == 1.0, f"{case} takes the first scan for new by {share:.0%}, not all of it"
    local_map.insert(cloud_body, T)
    found = local_map.planes_at(queries, gate=0.1)
    np.testing.assert_array_equal(found.source, source, err_msg=f"{case} does not fill again")


class _Walls:
    """Three walls that meet nowhere near their middles, in odom: their normals, and the place between them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.normals = so3.exp(rng.normal(size=3)).T
        self.centre = rng.uniform(-20.0, 20.0, 3)

    def points(self, rng: np.random.Generator, count: int, offset: float) -> Array:
        """Return ``count`` points in turn of each wall, moved along its normal by ``offset``, (3 count, 3)."""
        out = np.empty((count, 3, 3))
        for i, n in enumerate(self.normals):
            u, v = self.normals[(i + 1) % 3], self.normals[(i + 2) % 3]
            a, b = rng.uniform(-2.0, 2.0, (2, count, 1))
            out[:, i] = self.centre + (6.0 + offset) * n + a * u + b * v
        return out.reshape(-1, 3)


def _assert_nothing_found(local_map: LocalMap, queries: Array, case: str) -> None:
    for some in (queries, queries[:0]):
        found = local_map.planes_at(some, gate=1.0)
        shapes = [found.normal.shape, found.point.shape, found.variance.shape, found.source.shape]
        assert shapes == [(len(some), 3), (len(some), 3), (len(some),), (len(some),)], f"{case}: shapes are {shapes}"
        assert not np.any(found.source), f"{case} finds planes"
    assert len(local_map) == 0, f"{case} has length {len(local_map)}, not 0"


def _assert_walls_found(
    local_map: LocalMap, twin: LocalMap, walls: _Walls, rng: np.random.Generator, offset: float, gate: float
) -> None:
    queries = walls.points(rng, 150, offset)
    normals = np.tile(walls.normals, (150, 1))
    found, again = local_map.planes_at(queries, gate=gate), twin.planes_at(queries, gate=gate)
    for name in ("normal", "point", "variance", "source"):
        a, b = getattr(found, name), getattr(again, name)
        some = found.source > 0
        np.testing.assert_array_equal(a[some], b[some], err_msg=f"two maps with the same points differ in {name}")
    case = f"queries {offset:g} m off the walls with a gate of {gate:g} m"
    share = float(np.mean(found.source > 0))
    if abs(offset) > 1.5 * gate:
        assert share < 0.05, f"{case}: {share:.0%} passed"
        return
    assert share > 0.8, f"{case}: only {share:.0%} found a plane"
    n, d = found.normal[some].astype(np.float64), queries[some] - found.point[some]
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-5, err_msg=f"{case}: normals are not unit")
    np.testing.assert_allclose(np.abs(np.sum(n * normals[some], axis=1)), 1.0, atol=1e-2, err_msg=f"{case}: normals")
    r = np.abs(np.sum(n * d, axis=1))
    assert r.max() <= gate * (1.0 + 1e-5), f"{case}: a residual of {r.max():g} m passed"
    np.testing.assert_allclose(r, abs(offset), atol=5e-3, err_msg=f"{case}: residuals")
    variance = found.variance[some]
    assert np.isfinite(variance).all() and (variance > 0.0).all(), f"{case}: variances must be positive"


def _elements(family: Family, rng: np.random.Generator, count: int) -> Array:
    """Return random values of a family, (N, *shape)."""
    if family.lie is None:
        return 3.0 * rng.normal(size=(count, family.dof))
    if not issubclass(family.lie, MatrixGroup):
        return np.asarray(family.lie(rng.normal(size=(count, 3))).vector)
    group = family.lie
    return np.stack([group.exp(3.0 * _tangent(group, rng, rng.uniform(0.1, 1.0))).matrix for _ in range(count)])


def _evaluated(
    factor: type[Factor], families: Sequence[Family], arrays: Sequence[Array], data: Sequence[Array]
) -> tuple[Array, list[Array]]:
    try:
        return factor.evaluate(arrays, data, families=families)
    except GraphError as error:
        raise AssertionError(str(error)) from error


def _residual_of_step(
    factor: type[Factor], family: Family, arrays: Sequence[Array], data: Sequence[Array], row: int, variable: int
) -> Callable[[Array], Array]:
    """Return the residual (rows,) of one instance as a function of a step (dof,) of one variable."""
    one = slice(row, row + 1)

    def residual(step: Array) -> Array:
        moved = [array[one] for array in arrays]
        moved[variable] = family.retract(moved[variable], step[None])
        return np.asarray(factor.residuals(moved, [item[one] for item in data])[0])

    return residual


def _tangent(group: type[MatrixGroup], rng: np.random.Generator, angle: float) -> Array:
    """Return a random tangent vector with a rotation by the angle and, in a rigid group, a translation of metres."""
    x, part = rng.normal(size=group.dof), _rotations(group)
    x[part] *= angle / np.linalg.norm(x[part])
    return x


def _rotations(group: type[MatrixGroup]) -> slice:
    """Return the part of a tangent vector that is rotation."""
    return slice(0, group.turns)


def _random(group: type[MatrixGroup], rng: np.random.Generator) -> MatrixGroup:
    return group.exp(_tangent(group, rng, rng.uniform(0.1, 3.0)))


def _close(actual: Array, expected: Array, case: str, law: str, tolerance: float) -> None:
    # Rotations are of order one and translations of order ten: one absolute bound serves both.
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=20.0 * tolerance, err_msg=f"{law}, {case}")


def _assert_axioms(
    group: type[MatrixGroup], X: MatrixGroup, Y: MatrixGroup, Z: MatrixGroup, case: str, tolerance: float
) -> None:
    E = group.identity()
    for law, left, right in (
        ("X I = X", X @ E, X),
        ("I X = X", E @ X, X),
        ("X X^-1 = I", X @ X.inverse(), E),
        ("X^-1 X = I", X.inverse() @ X, E),
        ("(X Y) Z = X (Y Z)", (X @ Y) @ Z, X @ (Y @ Z)),
        ("(X Y)^-1 = Y^-1 X^-1", (X @ Y).inverse(), Y.inverse() @ X.inverse()),
    ):
        _close(left.matrix, right.matrix, case, law, tolerance)
    if group.space:
        point = np.arange(1.0, 1.0 + group.space)
        _close((X @ Y) @ point, X @ (Y @ point), case, "(X Y) p = X (Y p)", tolerance)


def _assert_exponential(group: type[MatrixGroup], x: Array, angle: float, case: str, tolerance: float) -> None:
    X = group.exp(x)
    _close(group.exp(X.log()).matrix, X.matrix, case, "exp(log(X)) = X", tolerance)
    _close((X @ group.exp(-x)).matrix, group.identity().matrix, case, "exp(x) exp(-x) = I", tolerance)
    _close((group.exp(0.25 * x) @ group.exp(0.75 * x)).matrix, X.matrix, case, "exp(x/4) exp(3x/4) = exp(x)", tolerance)
    if angle < np.pi - 1e-10:  # at pi the axis has two signs
        # Relative where the rotation is tiny: a logarithm that returns zero there is wrong.
        part, found = _rotations(group), X.log()
        _close(found, x, case, "log(exp(x)) = x", tolerance)
        scale = max(angle, 1e-300)
        _close(found[part] / scale, x[part] / scale, case, "log(exp(x)) / |x|", tolerance)


def _assert_adjoint(X: MatrixGroup, Y: MatrixGroup, x: Array, case: str, tolerance: float) -> None:
    group = type(X)
    moved = group.exp(Y.adjoint() @ x)
    _close((Y @ group.exp(x)).matrix, (moved @ Y).matrix, case, "Y exp(x) = exp(Ad x) Y", tolerance)
    _close((X @ Y).adjoint(), X.adjoint() @ Y.adjoint(), case, "Ad(X Y) = Ad(X) Ad(Y)", tolerance)
    _close(group.exp(x).adjoint() @ x, x, case, "Ad(exp(x)) x = x", tolerance)


def _assert_right_jacobian(group: type[MatrixGroup], x: Array, case: str, tolerance: float) -> None:
    X, Jr = group.exp(x), group.right_jacobian(x)
    expected = numeric_jacobian(lambda y: X.local(group.exp(y)), x)
    _close(Jr, expected, case, "right Jacobian = derivative", max(tolerance, 1e-12))
    inverse = group.right_jacobian_inverse(x)
    _close(Jr @ inverse, np.eye(group.dof), case, "Jr Jr^-1 = I", tolerance)
    _close(X.adjoint() @ Jr, group.right_jacobian(-x), case, "Ad(exp(x)) Jr(x) = Jr(-x)", tolerance)


def _assert_retraction(X: MatrixGroup, Y: MatrixGroup, x: Array, angle: float, case: str, tolerance: float) -> None:
    _close(Y.retract(x).matrix, (Y @ type(X).exp(x)).matrix, case, "retract(Y, x) = Y exp(x)", tolerance)
    _close(X.retract(X.local(Y)).matrix, Y.matrix, case, "retract(X, local(X, Y)) = Y", tolerance)
    if angle < np.pi - 1e-5:  # nearer to pi rounding of the product decides the sign of the axis or its digits
        _close(Y.local(Y.retract(x)), x, case, "local(Y, retract(Y, x)) = x", tolerance)


def _assert_batching(group: type[MatrixGroup], x: Array, tolerance: float) -> None:
    """Assert that a batch gives what its elements give one at a time, in one axis and in two."""
    case = f"{group.__name__}, batch against loop"
    batch, Y = group.exp(x), group.exp(x[::-1])
    singles = [group.exp(row) for row in x]
    _close(batch.matrix, np.stack([X.matrix for X in singles]), case, "exp", tolerance)
    _close(batch.log(), np.stack([X.log() for X in singles]), case, "log", tolerance)
    _close(batch.adjoint(), np.stack([X.adjoint() for X in singles]), case, "adjoint", tolerance)
    _close(batch.inverse().matrix, np.stack([X.inverse().matrix for X in singles]), case, "inverse", tolerance)
    products = np.stack([X.matrix @ other for X, other in zip(singles, Y.matrix, strict=True)])
    _close((batch @ Y).matrix, products, case, "@", tolerance)
    for name in ("right_jacobian", "right_jacobian_inverse"):
        f = getattr(group, name)
        _close(f(x), np.stack([f(row) for row in x]), case, name, tolerance)
    grid = group.exp(np.stack([x, 0.5 * x]))
    _close(grid.matrix[1], group.exp(0.5 * x).matrix, case, "two batch axes", tolerance)
    if group.exp(x[:0]).matrix.shape != (0, group.size, group.size):
        raise AssertionError(f"{group.__name__}: an empty batch must stay empty")

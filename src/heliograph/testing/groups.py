"""The law of Lie groups."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heliograph.arrays import Array
from heliograph.lie.groups import MatrixGroup
from heliograph.testing.jacobians import numeric_jacobian, random_tangent, rotations

__all__ = ["MAGNITUDES", "assert_lie_group"]

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
        x = random_tangent(group, rng, magnitude)
        X, Y, Z = group.exp(x), _random(group, rng), _random(group, rng)
        case = f"{group.__name__} at rotation angle {magnitude:.12g}"
        _assert_axioms(group, X, Y, Z, case, tolerance)
        _assert_exponential(group, x, magnitude, case, tolerance)
        _assert_adjoint(X, Y, x, case, tolerance)
        _assert_right_jacobian(group, x, case, tolerance)
        _assert_retraction(X, Y, x, magnitude, case, tolerance)
    _assert_batching(group, np.stack([random_tangent(group, rng, magnitude) for magnitude in magnitudes]), tolerance)


def _random(group: type[MatrixGroup], rng: np.random.Generator) -> MatrixGroup:
    return group.exp(random_tangent(group, rng, rng.uniform(0.1, 3.0)))


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
        part, found = rotations(group), X.log()
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

"""Bundle adjustment over planes: poses of keyframes moved so that walls become thin, or left as they were.

Points that several keyframes saw in one cube are to lie on one plane. The cost of a cube is the least eigenvalue of
their covariance times their number: the squared distances to the best plane, which needs no variables of its own
(Z. Liu, F. Zhang, "BALM", RA-L 2021). What the graph says of the way from keyframe to keyframe holds what no plane
tells. Half of the points take no part: they judge the result. Equation (6) of docs/theory/slam.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points, freeze
from heliograph.lie import se3, so3

__all__ = ["PlaneBundle", "PlaneRefinement", "StepsBetween", "refine_planes"]

_CUBE = 1.0  # edge of the cubes in which points are to lie on one plane [m]
_FEWEST = 24  # points of a cube
_FLAT, _THICK = 0.06, 0.10  # a plane's least eigenvalue over the next one, and its thickness, at most [m]
_SIGMA = 0.06  # of a point's distance to its plane, neighbours' common errors counted (0.03 m, four as one) [m]
_ROUNDS, _STEPS, _SOLVE = 6, 3, 80  # new cubes, steps with the same ones, iterations of a linear solution
_CONVERGED = 1e-4  # a round that moves nothing by more ends the search [m]
_BETTER = 0.99  # the judging half must become thinner by a percent
_SIDES = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class StepsBetween:
    """Pairs of keyframes whose relative poses are known, and how well.

    Parameters
    ----------
    first, second : (N,) int64
        Keyframes.
    covariance : (N, 6, 6) float64
        Covariance of right perturbations of ``inverse(T_first) @ T_second`` [rad^2, m^2].
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    covariance: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneRefinement:
    """What an adjustment over planes came to.

    Parameters
    ----------
    T_map_imu : (K, 4, 4) float64
        The adjusted poses, or those given where they are not better.
    refined : bool
        Whether they were taken.
    reason : str
        Why, in words.
    planes : int
        Cubes with a plane that several keyframes saw.
    thickness_before, thickness_after : float
        RMS distance of the points that took no part to their planes, median over cubes [m].
    moved : float
        How far a keyframe was moved at most [m].
    """

    T_map_imu: Array
    refined: bool
    reason: str
    planes: int
    thickness_before: float
    thickness_after: float
    moved: float

    def __post_init__(self) -> None:
        freeze(self)


class PlaneBundle:
    """Planes that keyframes share, as sums over their points: the cost of poses, and its derivatives.

    Parameters
    ----------
    keyframe, plane : (E,) int64
        Which keyframe saw which plane.
    count : (E,) float64
        Points that it saw of it.
    first : (E, 3) float64
        Sums of these points in the keyframe's body frame [m].
    second : (E, 3, 3) float64
        Sums of their outer products [m^2].
    """

    def __init__(
        self, keyframe: NDArray[np.int64], plane: NDArray[np.int64], count: Array, first: Array, second: Array
    ) -> None:
        self.keyframe, self.plane = keyframe, plane
        self.count, self.first, self.second = count, first, second
        self.planes = int(plane.max(initial=-1)) + 1

    def spread(self, T_map_imu: Array) -> tuple[Array, Array, Array, Array]:
        """Return numbers of points (P,), centres (P, 3), eigenvalues (P, 3) and vectors (P, 3, 3) of the planes."""
        R, p = T_map_imu[self.keyframe, :3, :3], T_map_imu[self.keyframe, :3, 3]
        turned = np.einsum("eij,ej->ei", R, self.first)
        sums = turned + self.count[:, None] * p
        cross = np.einsum("ei,ej->eij", turned, p)
        outer = R @ self.second @ np.swapaxes(R, 1, 2) + cross + np.swapaxes(cross, 1, 2)
        outer += self.count[:, None, None] * np.einsum("ei,ej->eij", p, p)
        n, s, S = (_summed(self.plane, part, self.planes) for part in (self.count, sums, outer))
        n = np.maximum(n, 1.0)
        centre = s / n[:, None]
        values, vectors = np.linalg.eigh(S / n[:, None, None] - np.einsum("pi,pj->pij", centre, centre))
        return n, centre, np.maximum(values, 0.0), vectors

    def cost(self, T_map_imu: Array) -> float:
        """Return the sum of squared distances of all points to their planes [m^2]."""
        n, _, values, _ = self.spread(T_map_imu)
        return float(n @ values[:, 0])

    def linearised(self, T_map_imu: Array) -> tuple[Array, Array, Array, Array]:
        """Return gradient and Gauss-Newton Hessian of half the cost, right perturbations of the poses.

        Returns
        -------
        gradient : (K, 6) float64
        own : (K, 6, 6) float64
            The Hessian's blocks on the diagonal with all planes held.
        shared : (E, 6, 3) float64
            Between a keyframe and a plane: two tilts and the distance.
        planes : (P, 3, 3) float64
            Matrices of the planes.
        """
        _, centre, _, vectors = self.spread(T_map_imu)
        R, p = T_map_imu[self.keyframe, :3, :3], T_map_imu[self.keyframe, :3, 3]
        axes = np.swapaxes(R, 1, 2) @ vectors[self.plane]  # normal, then the plane's own axes, in the body frame
        m = axes[..., 0]
        c = np.einsum("eji,ej->ei", R, centre[self.plane] - p)  # the plane's centre seen by the body
        n, s, S = self.count[:, None, None], self.first, self.second
        hat = so3.hat(m)
        # A point q moves along the normal by a . xi with a = (q x m, m); the plane tilts and shifts under it.
        own = np.empty((len(m), 6, 6))
        turned = -np.einsum("eij,ej->ei", hat, s)  # sum of q x m
        own[:, :3, :3] = hat @ S @ np.swapaxes(hat, 1, 2)
        own[:, :3, 3:] = np.einsum("ei,ej->eij", turned, m)
        own[:, 3:, :3] = np.swapaxes(own[:, :3, 3:], 1, 2)
        own[:, 3:, 3:] = n * np.einsum("ei,ej->eij", m, m)
        about = S - np.einsum("ei,ej->eij", s, c)  # sum of q (q - c)'
        off = s - self.count[:, None] * c  # sum of q - c
        r = np.concatenate([-np.einsum("eij,ejk,ek->ei", hat, about, m),
                            np.einsum("ei,ei->e", m, off)[:, None] * m], axis=1)  # fmt: skip
        shared = np.empty((len(m), 6, 3))
        shared[:, :3, :2] = -hat @ about @ axes[..., 1:]
        shared[:, 3:, :2] = np.einsum("ei,ej->eij", m, np.einsum("eij,ei->ej", axes[..., 1:], off))
        shared[:, :3, 2], shared[:, 3:, 2] = -turned, -self.count[:, None] * m
        spread = S - np.einsum("ei,ej->eij", s, c) - np.einsum("ei,ej->eij", c, s) + n * np.einsum("ei,ej->eij", c, c)
        plane = np.zeros((len(m), 3, 3))
        plane[:, :2, :2] = np.swapaxes(axes[..., 1:], 1, 2) @ spread @ axes[..., 1:]
        plane[:, 2, 2] = self.count
        plane[:, :2, 2] = plane[:, 2, :2] = -np.einsum("eij,ei->ej", axes[..., 1:], off)
        K = len(T_map_imu)
        gradient, blocks = (_summed(self.keyframe, part, K) for part in (r, own))
        return gradient, blocks, shared, _summed(self.plane, plane, self.planes)


def refine_planes(clouds: Sequence[Points], T_map_imu: Array, steps: StepsBetween) -> PlaneRefinement:
    """Adjust the poses of keyframes so that what several of them saw lies on planes.

    Parameters
    ----------
    clouds : sequence of (N, 3) float32
        In the body frames of the keyframes [m].
    T_map_imu : (K, 4, 4) float64
        Their poses; the first one stays.
    steps : StepsBetween
        What is known of their relative poses besides: at the given poses nothing of it is contradicted.
    """
    T = np.array(T_map_imu)
    judges = [cloud[1::2] for cloud in clouds]
    parts = [cloud[::2] for cloud in clouds]
    before, bundle = T.copy(), None
    for _ in range(_ROUNDS):
        bundle = _bundle(parts, T)
        if bundle.planes == 0:
            return _kept(before, "no plane is seen by several keyframes", 0)
        moved = 0.0
        for _ in range(_STEPS):
            T, step = _step(bundle, T, before, steps)
            moved = max(moved, step)
        if moved < _CONVERGED:
            break
    there = bundle.planes if bundle is not None else 0
    return _judged(judges, before, T, there)


def _judged(judges: Sequence[Points], before: Array, after: Array, planes: int) -> PlaneRefinement:
    """Take the adjusted poses only where points that took no part lie on thinner planes, and on as many."""
    spread = [_bundle(judges, T).spread(T) for T in (before, after)]
    counts = [len(n) for n, *_ in spread]
    thick = [float(np.sqrt(np.median(values[:, 0]))) if len(values) else 0.0 for _, _, values, _ in spread]
    mean = [float(np.average(np.sqrt(values[:, 0]), weights=n)) if len(n) else 0.0 for n, _, values, _ in spread]
    moved = float(np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1).max(initial=0.0))
    worse = [
        text
        for text, holds in (
            ("walls would not be thinner", thick[1] <= _BETTER * thick[0] and mean[1] <= _BETTER * mean[0]),
            ("fewer planes would be whole", counts[1] >= _BETTER * counts[0]),
        )
        if not holds
    ]
    return PlaneRefinement(
        T_map_imu=before if worse else after,
        refined=not worse,
        reason="; ".join(worse) or "walls are thinner",
        planes=planes,
        thickness_before=thick[0],
        thickness_after=thick[1],
        moved=moved,
    )


def _kept(T: Array, reason: str, planes: int) -> PlaneRefinement:
    return PlaneRefinement(
        T_map_imu=T, refined=False, reason=reason, planes=planes, thickness_before=0.0, thickness_after=0.0, moved=0.0
    )


def _step(bundle: PlaneBundle, T: Array, given: Array, steps: StepsBetween) -> tuple[Array, float]:
    """Take a step that lowers the cost; return the poses and how far it went [m]."""
    weight = 1.0 / _SIGMA**2
    gradient, own, shared, planes = bundle.linearised(T)
    information: Array = np.asarray(np.linalg.inv(steps.covariance), dtype=np.float64)
    i, j = steps.first, steps.second
    Z = np.asarray(se3.inverse(given[i]) @ given[j], dtype=np.float64)
    e = se3.local(Z, se3.inverse(T[i]) @ T[j])
    carry = -se3.adjoint(se3.inverse(T[j]) @ T[i])
    K = len(T)
    b = weight * gradient
    b += _summed(j, np.einsum("nij,nj->ni", information, e), K)
    b += _summed(i, np.einsum("nji,njk,nk->ni", carry, information, e), K)
    diagonal = weight * own + _summed(j, information, K) + _summed(i, np.swapaxes(carry, 1, 2) @ information @ carry, K)
    inverse = np.linalg.inv(planes + 1e-9 * np.eye(3))

    def product(x: Array) -> Array:
        y = np.einsum("kij,kj->ki", weight * own, x)
        through = _summed(bundle.plane, np.einsum("eij,ei->ej", shared, x[bundle.keyframe]), bundle.planes)
        through = np.einsum("pij,pj->pi", inverse, through)
        y -= weight * _summed(bundle.keyframe, np.einsum("eij,ej->ei", shared, through[bundle.plane]), K)
        d = np.einsum("nij,nj->ni", information, x[j] + np.einsum("nij,nj->ni", carry, x[i]))
        return np.asarray(y + _summed(j, d, K) + _summed(i, np.einsum("nji,nj->ni", carry, d), K))

    x = _solved(product, np.asarray(np.linalg.inv(diagonal + 1e-9 * np.eye(6)), dtype=np.float64), -b)
    cost = _total(bundle, T, Z, information, steps, weight)
    for scale in (1.0, 0.5, 0.25, 0.1):
        moved = np.asarray(T @ se3.exp(scale * x), dtype=np.float64)
        if _total(bundle, moved, Z, information, steps, weight) < cost:
            return moved, scale * float(np.linalg.norm(x[:, 3:], axis=1).max())
    return T, 0.0


def _total(bundle: PlaneBundle, T: Array, Z: Array, information: Array, steps: StepsBetween, weight: float) -> float:
    e = se3.local(Z, se3.inverse(T[steps.first]) @ T[steps.second])
    return weight * bundle.cost(T) + float(np.einsum("ni,nij,nj->", e, information, e))


def _solved(product: Callable[[Array], Array], preconditioner: Array, b: Array) -> Array:
    """Solve by conjugate gradients; the first pose stays."""
    free = np.ones((len(b), 1))
    free[0] = 0.0
    x, r = np.zeros_like(b), b * free
    z = np.einsum("kij,kj->ki", preconditioner, r) * free
    p, rz = z, float(np.vdot(r, z))
    start = rz
    for _ in range(_SOLVE):
        if rz <= 1e-10 * start or rz == 0.0:
            break
        Ap = product(p) * free
        alpha = rz / float(np.vdot(p, Ap))
        x, r = x + alpha * p, r - alpha * Ap
        z = np.einsum("kij,kj->ki", preconditioner, r) * free
        rz, before = float(np.vdot(r, z)), rz
        p = z + rz / before * p
    return x


def _bundle(clouds: Sequence[Points], T_map_imu: Array) -> PlaneBundle:
    """Find the cubes that hold a plane which several keyframes saw, each side of a wall for itself."""
    keyframe = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    points = np.concatenate([np.asarray(cloud, dtype=np.float64) for cloud in clouds])
    good = np.isfinite(points).all(axis=1)
    keyframe, points = keyframe[good], points[good]
    world = np.einsum("nij,nj->ni", T_map_imu[keyframe, :3, :3], points) + T_map_imu[keyframe, :3, 3]
    cells = np.floor(world / _CUBE).astype(np.int64)
    cells -= cells.min(axis=0)
    width = cells.max(axis=0) + 1
    cube = np.unique((cells[:, 0] * width[1] + cells[:, 1]) * width[2] + cells[:, 2], return_inverse=True)[1].ravel()
    whole = _gathered(keyframe, cube, points)
    _, centre, _, vectors = whole.spread(T_map_imu)
    # The side that a body is on: the far side of a thin wall is another plane.
    normal = vectors[cube, :, 0]
    side = np.einsum("ni,ni->n", normal, T_map_imu[keyframe, :3, 3] - centre[cube]) > 0.0
    halves = _gathered(keyframe, _SIDES * cube + side, points)
    n, _, values, _ = halves.spread(T_map_imu)
    seen = np.bincount(halves.plane, minlength=halves.planes)
    flat = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 0] < _THICK**2)
    kept = (flat & (seen > 1) & (n >= _FEWEST))[halves.plane]
    number = np.unique(halves.plane[kept], return_inverse=True)[1].ravel()
    return PlaneBundle(
        halves.keyframe[kept], number.astype(np.int64), halves.count[kept], halves.first[kept], halves.second[kept]
    )


def _gathered(keyframe: NDArray[np.int64], plane: NDArray[np.int64], points: Array) -> PlaneBundle:
    width = int(keyframe.max(initial=0)) + 1
    pairs, at = np.unique(plane * width + keyframe, return_inverse=True)
    at, E = at.ravel(), len(pairs)
    count = np.bincount(at, minlength=E).astype(np.float64)
    first = _summed(at, points, E)
    second = _summed(at, np.einsum("ni,nj->nij", points, points), E)
    return PlaneBundle(pairs % width, pairs // width, count, first, second)


def _summed(index: NDArray[np.int64], rows: Array, count: int) -> Array:
    """Return the sums of rows with one index, (count, ...)."""
    flat = rows.reshape(len(rows), int(np.prod(rows.shape[1:])))
    out = np.stack([np.bincount(index, flat[:, k], minlength=count) for k in range(flat.shape[1])], axis=1)
    return np.asarray(out.reshape(count, *rows.shape[1:]), dtype=np.float64)

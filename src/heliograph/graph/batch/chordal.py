"""Chordal start of pose graphs: rotations by linear relaxation, then positions given the rotations.

Both steps are linear least squares, so they need no start and have no local minima.

References
----------
.. [1] D. Martinec, T. Pajdla, "Robust rotation and translation estimation in multiview reconstruction", CVPR 2007.
.. [2] L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM: a survey on rotation
   estimation and its use in pose graph optimization", ICRA 2015.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, Indices, Mask, freeze
from heliograph.graph.model.families import FAMILIES, Family, vectors
from heliograph.graph.model.noise import FULL, Whitening
from heliograph.graph.model.values import Values
from heliograph.graph.problem.linear import Anchors, Differences, connected, solve_linear
from heliograph.graph.problem.resolve import ResolvedGroup
from heliograph.lie import SE2, SE3, SO2, SO3

__all__ = ["chordal_values", "nearest_rotations", "whitened_information"]


_PRIOR, _BETWEEN, _LANDMARK, _POSITION = 1, 2, 5, 6  # codes of factors
_DIMENSION = {FAMILIES[SO2]: 2, FAMILIES[SE2]: 2, FAMILIES[SO3]: 3, FAMILIES[SE3]: 3}
_MOTIONS = (FAMILIES[SE2], FAMILIES[SE3])
_FLAT = 1e-2  # of the volume that the size allows: below it polar factors are left to singular values
_NEWTON = 12
_ROUND = 1e-12  # relative difference of information along different axes that is none
_CONSTRAINT = 1e8  # information of a hard constraint relative to its unit scale


@dataclass(frozen=True, slots=True, kw_only=True)
class _Measured:
    """Measurements of one kind: dense variables (N, arity), values as arrays (N, ...), S (N, rows, rows)."""

    variables: Indices
    value: Array
    root: Array

    def __post_init__(self) -> None:
        freeze(self)

    def part(self, mask: Mask) -> _Measured:
        if mask.all():
            return self
        return _Measured(variables=self.variables[mask], value=self.value[mask], root=self.root[mask])

    def turning(self, rows: int) -> Array:
        """Return the mean information of the first `rows` rows, the rotation's, (N,)."""
        return np.asarray(np.einsum("nab,nab->n", self.root[:, :, :rows], self.root[:, :, :rows]) / rows)

    def placing(self, d: int, frame: Array | None = None) -> Array:
        """Return the information of the last d rows, the position's, seen from turned frames: (N,) if all are round."""
        S = self.root[:, :, -d:]
        omega = np.einsum("nab,nac->nbc", S, S)
        size = np.einsum("nii->n", omega) / d
        if (np.abs(omega - size[:, None, None] * np.eye(d)).max(axis=(1, 2)) <= _ROUND * size).all():
            return np.asarray(size)
        if frame is None:
            return np.asarray(omega)
        turned = frame @ omega @ np.swapaxes(frame, 1, 2)
        return np.asarray(0.5 * (turned + np.swapaxes(turned, 1, 2)))


def chordal_values(
    groups: Sequence[ResolvedGroup], values: Values, held: Indices, *, order: Indices | None = None, threads: int = 1
) -> Values | None:
    """Return values with poses from the chordal start, or None where the graph has no rotations to average.

    Poses (SE2, SE3) and rotations (SO2, SO3) that are joined by between factors get a new value, and points that poses
    see by landmark factors follow. Held variables stay, priors and positions draw with their weight, and a component
    without either keeps its first variable where it is given. All else stays as given.

    Parameters
    ----------
    groups : sequence of ResolvedGroup
        The factors.
    values : Values
        As given.
    held : (M,) int64
        Dense indices of held variables.
    order : (K,) int64, optional
        In which variables were found to be eliminated best: the linear problems have the same structure.
    threads : int
        For the native parts.
    """
    families = values.families()
    firsts = np.concatenate([[0], np.cumsum(values.counts())]).astype(np.int64)
    packed = [block.copy() for block in values.packed()]
    is_held = np.zeros(int(firsts[-1]), dtype=bool)
    is_held[held] = True
    found = False
    for number, family in enumerate(families):
        if family not in _DIMENSION:
            continue
        elements = family.elements(packed[number])
        turned = _rotations(groups, family, elements, int(firsts[number]), is_held, order=order, threads=threads)
        if turned is None:
            continue
        found = True
        d = _DIMENSION[family]
        if family not in _MOTIONS:
            packed[number] = family.pack_elements(turned.R)
            continue
        points = families.index(vectors(d)) if vectors(d) in families else None
        scene = _Scene(
            groups=groups,
            family=family,
            pose_first=int(firsts[number]),
            point_first=-1 if points is None else int(firsts[points]),
            is_held=is_held,
            order=order,
            threads=threads,
        )
        given = np.zeros((0, d)) if points is None else packed[points]
        placed = _place(scene, turned, elements, given)
        if placed is None:
            return None
        packed[number] = family.pack_elements(placed[0])
        if points is not None:
            packed[points] = placed[1]
    return values.with_packed(packed) if found else None


def nearest_rotations(M: Array) -> Array:
    """Return the rotations (N, d, d) nearest to matrices (N, d, d) in the Frobenius norm, determinant +1."""
    if M.shape[-1] == 2:
        angle = np.arctan2(M[:, 1, 0] - M[:, 0, 1], M[:, 0, 0] + M[:, 1, 1])
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
    R, settled = _polar(M)
    if not settled.all():
        U, _, Vt = np.linalg.svd(M[~settled])
        U[:, :, -1] *= np.linalg.det(U @ Vt)[:, None]
        R[~settled] = U @ Vt
    return R


def _polar(M: Array) -> tuple[Array, Mask]:
    """Return the orthogonal polar factors (N, 3, 3), and which of them Newton's iteration has found.

    It halves R plus its inverse transpose, scaled to volume one before (N. Higham, "Computing the polar
    decomposition", SIAM J. Sci. Stat. Comput. 7, 1986): for a batch many times faster than singular values. Reflections
    and what is nearly flat are left to those.
    """
    R = np.array(M)
    scale = np.einsum("nij,nij->n", M, M) / 3.0
    determinant = np.einsum("ni,ni->n", np.cross(R[:, 0], R[:, 1]), R[:, 2])
    good = determinant > _FLAT * scale**1.5
    R[~good] = np.eye(3)
    R[good] /= np.cbrt(determinant[good])[:, None, None]
    for _ in range(_NEWTON):
        cofactor = np.cross(R[:, [1, 2, 0]], R[:, [2, 0, 1]])
        volume = np.einsum("ni,ni->n", R[:, 0], cofactor[:, 0])
        change = 0.5 * (cofactor / volume[:, None, None] - R)
        R += change
        if not len(R) or np.abs(change).max() < 1e-15:
            break
    return R, np.asarray(good & (np.abs(change).max(axis=(1, 2)) < 1e-12))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Turned:
    """Rotations (N, d, d) of a family, and which variables may still be turned together.

    Parameters
    ----------
    free : (N,) int64
        Component of variables that nothing absolute orients; -1 for the rest.
    moved : (N,) bool
        Variables that have a relative rotation.
    """

    R: Array
    free: Indices
    moved: Mask

    def __post_init__(self) -> None:
        freeze(self)


def _rotations(
    groups: Sequence[ResolvedGroup],
    family: Family,
    elements: Array,
    first: int,
    is_held: Mask,
    *,
    order: Indices | None,
    threads: int,
) -> _Turned | None:
    """Return rotations from the linear relaxation ([2]_ section III-B; docs/theory/graph.md, eqs. 17-18).

    The rows of R_j = R_i R_ij are linear in R_i and R_j: a row x of R obeys ``x_j = R_ij' x_i``, the same for all d.
    The constraint that R is a rotation is dropped, and restored by the nearest rotation.
    """
    d = _DIMENSION[family]
    n, rows = len(elements), 1 if d == 2 else 3
    edges = _measured(groups, _BETWEEN, (family, family))
    weight = edges.turning(rows)
    edges, weight = edges.part(weight > 0.0), weight[weight > 0.0]
    if not len(weight):
        return None
    i, j = (edges.variables - first).T
    moved = np.zeros(n, dtype=bool)
    moved[i] = moved[j] = True
    priors = _measured(groups, _PRIOR, (family,))
    strength = priors.turning(rows)
    useful = (strength > 0.0) & moved[priors.variables[:, 0] - first]
    priors, strength = priors.part(useful), strength[useful]
    label = connected(n, i, j)
    fixed = is_held[first : first + n] & moved
    oriented = np.isin(label, label[np.concatenate([np.flatnonzero(fixed), priors.variables[:, 0] - first])])
    # A component that nothing orients keeps the rotation of its first variable.
    fixed |= moved & ~oriented & (label == np.arange(n))
    used = np.flatnonzero(moved)
    place = np.cumsum(moved) - 1
    rotation = np.swapaxes(edges.value[:, :d, :d], 1, 2)
    x = solve_linear(
        len(used),
        Differences(i=place[i], j=place[j], F=rotation, u=None, columns=d, weight=weight),
        Anchors(
            at=place[priors.variables[:, 0] - first],
            value=np.swapaxes(priors.value[:, :d, :d], 1, 2),
            weight=strength,
        ),
        _held_at(place[fixed], np.swapaxes(elements[fixed, :d, :d], 1, 2)),
        order=_renumbered(order, [(first, np.where(moved, place, -1))]),
        threads=threads,
    )
    if x is None:
        return None
    R = elements[:, :d, :d].copy()
    R[used] = nearest_rotations(np.swapaxes(x, 1, 2))
    R[fixed] = elements[fixed, :d, :d]
    return _Turned(R=R, free=np.where(moved & ~oriented, label, -1), moved=moved)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    """What the placing of poses and points reads."""

    groups: Sequence[ResolvedGroup]
    family: Family
    pose_first: int
    point_first: int
    is_held: Mask
    order: Indices | None
    threads: int

    def __post_init__(self) -> None:
        freeze(self)


def _renumbered(order: Indices | None, parts: Sequence[tuple[int, Indices]]) -> Indices | None:
    """Return an order of variables as one of unknowns; a part is its first variable and their unknowns, -1: none."""
    if order is None:
        return None
    unknown = np.full(int(order.max(initial=-1)) + 1, -1, dtype=np.int64)
    for first, numbers in parts:
        there = numbers[: max(len(unknown) - first, 0)]
        unknown[first : first + len(there)] = there
    found = unknown[order]
    return found[found >= 0]


def _place(scene: _Scene, turned: _Turned, elements: Array, points: Array) -> tuple[Array, Array] | None:
    """Return poses (N, d+1, d+1) and points (P, d) that fit the rotations; None where they are not determined."""
    positions = _measured(scene.groups, _POSITION, (scene.family,))
    at = positions.variables[:, 0] - scene.pose_first
    doubtful = (turned.free[at] >= 0) & turned.moved[at]
    R = turned.R
    looks, known = _known_sightings(scene, turned, points)
    if doubtful.any() or len(looks.variables):
        # Nothing orients these components but positions and held points: place them by themselves, then turn them.
        alone = _translations(scene, R, elements, points, positions.part(~doubtful), hold_points=False)
        if alone is None:
            return None
        look = looks.variables[:, 0] - scene.pose_first
        here = np.concatenate([alone[0][at[doubtful]], alone[0][look] + (R[look] @ looks.value[:, :, None])[..., 0]])
        there = np.concatenate([positions.value[doubtful], known])
        R = _oriented(turned, np.concatenate([at[doubtful], look]), here, there)
    found = _translations(scene, R, elements, points, positions)
    if found is None:
        return None
    d = R.shape[-1]
    poses = elements.copy()
    poses[:, :d, :d] = R
    poses[:, :d, d] = found[0]
    return poses, found[1]


def _known_sightings(scene: _Scene, turned: _Turned, points: Array) -> tuple[_Measured, Array]:
    """Return the sightings of held points from poses that nothing orients, and p_world (S, d) of the points."""
    d = turned.R.shape[-1]
    seen = _measured(scene.groups, _LANDMARK, (scene.family, vectors(d)))
    free = turned.free[seen.variables[:, 0] - scene.pose_first] >= 0
    seen = seen.part(free & scene.is_held[seen.variables[:, 1]])
    return seen, points[seen.variables[:, 1] - scene.point_first]


def _oriented(turned: _Turned, at: Indices, here: Array, there: Array) -> Array:
    """Return the rotations with each free component turned so that its places fit best (Kabsch 1976).

    Parameters
    ----------
    turned : _Turned
        Rotations.
    at : (K,) int64
        Whose component each place belongs to.
    here, there : (K, d) float64
        Where it is if the component is placed by itself, and in the world.
    """
    R: Array = turned.R.copy()
    for component in np.unique(turned.free[at]):
        mine = turned.free[at] == component
        a, b = here[mine], there[mine]
        spread = (b - b.mean(axis=0)).T @ (a - a.mean(axis=0))
        singular = np.linalg.svd(spread, compute_uv=False)
        if mine.sum() > 1 and singular[0] > 0.0 and (len(singular) == 2 or singular[1] > 1e-6 * singular[0]):
            members = turned.free == component
            R[members] = nearest_rotations(spread[None]) @ R[members]
    return R


def _translations(
    scene: _Scene, R: Array, elements: Array, points: Array, positions: _Measured, *, hold_points: bool = True
) -> tuple[Array, Array] | None:
    """Return positions of poses and points given the rotations (docs/theory/graph.md, eq. 19)."""
    d, n = R.shape[-1], len(R)
    given = np.concatenate([elements[:, :d, d], points])
    i, j, u, weight = _relative(scene, R)
    if not len(i):
        return elements[:, :d, d], points
    known = np.zeros(len(given), dtype=bool)
    known[i] = known[j] = True
    at, value, strength = _absolute(scene, positions, known, n)
    held = np.concatenate([_held_slice(scene, scene.pose_first, n), _held_slice(scene, scene.point_first, len(points))])
    held &= known
    held[n:] &= hold_points
    label = connected(len(given), i, j)
    placed = np.isin(label, label[np.concatenate([np.flatnonzero(held), at])])
    held |= known & ~placed & (label == np.arange(len(given)))
    place = np.where(known, np.cumsum(known) - 1, -1)
    parts = [(scene.pose_first, place[:n])]
    if len(points):
        parts.append((scene.point_first, place[n:]))
    x = solve_linear(
        int(known.sum()),
        Differences(
            i=place[i], j=place[j], F=np.tile(np.eye(d), (len(i), 1, 1)), u=u[:, :, None], columns=1, weight=weight
        ),
        Anchors(at=place[at], value=value[:, :, None], weight=strength),
        _held_at(place[held], given[held][:, :, None]),
        order=_renumbered(scene.order, parts),
        threads=scene.threads,
    )
    if x is None:
        return None
    given[known] = x[:, :, 0]
    return given[:n], given[n:]


def _relative(scene: _Scene, R: Array) -> tuple[Indices, Indices, Array, Array]:
    """Return i, j, offset (E, d) and information (E, d, d) of measured differences of positions, in the world.

    Poses count from 0, points after them.
    """
    d, n = R.shape[-1], len(R)
    edges = _measured(scene.groups, _BETWEEN, (scene.family, scene.family))
    i, j = (edges.variables - scene.pose_first).T
    seen = _measured(scene.groups, _LANDMARK, (scene.family, vectors(d)))
    look, point = seen.variables[:, 0] - scene.pose_first, seen.variables[:, 1] - scene.point_first + n
    frame = R[i] @ edges.value[:, :d, :d]  # in which the residual of a between factor counts
    u = np.concatenate([(R[i] @ edges.value[:, :d, d:])[..., 0], (R[look] @ seen.value[:, :, None])[..., 0]])
    weight = _joined([edges.placing(d, frame), seen.placing(d, R[look])], d)
    i, j = np.concatenate([i, look]), np.concatenate([j, point])
    useful = _size(weight) > 0.0
    return (i, j, u, weight) if useful.all() else (i[useful], j[useful], u[useful], weight[useful])


def _size(weight: Array) -> Array:
    return weight if weight.ndim == 1 else np.einsum("nii->n", weight)


def _joined(weights: list[Array], d: int) -> Array:
    """Return information as (N,) if all parts are round, else (N, d, d)."""
    if all(weight.ndim == 1 for weight in weights):
        return np.concatenate(weights)
    return np.concatenate([w[:, None, None] * np.eye(d) if w.ndim == 1 else w for w in weights])


def _absolute(scene: _Scene, positions: _Measured, known: Mask, n: int) -> tuple[Indices, Array, Array]:
    """Return where (A,), what (A, d) and information (A, d, d) of measured positions, in the world."""
    d = _DIMENSION[scene.family]
    priors = _measured(scene.groups, _PRIOR, (scene.family,))
    sources = [
        (priors.variables[:, 0] - scene.pose_first, priors.value[:, :d, d], priors.placing(d, priors.value[:, :d, :d])),
        (positions.variables[:, 0] - scene.pose_first, positions.value, positions.placing(d)),
    ]
    for code in (_PRIOR, _POSITION):
        own = _measured(scene.groups, code, (vectors(d),))
        sources.append((own.variables[:, 0] - scene.point_first + n, own.value, own.placing(d)))
    at = np.concatenate([source[0] for source in sources])
    value = np.concatenate([source[1] for source in sources])
    weight = _joined([source[2] for source in sources], d)
    useful = known[at] & (_size(weight) > 0.0)
    return at[useful], value[useful], weight[useful]


def _held_slice(scene: _Scene, first: int, count: int) -> Mask:
    return scene.is_held[first : first + count].copy() if count else np.zeros(0, dtype=bool)


def _held_at(at: Indices, value: Array) -> Anchors:
    return Anchors(at=at, value=value, weight=np.ones(len(at)))


def _measured(groups: Sequence[ResolvedGroup], code: int, families: tuple[Family, ...]) -> _Measured:
    """Return all measurements of a type of factor on variables of these families, in the order of the groups."""
    measured = families[-1] if code in (_PRIOR, _BETWEEN) else vectors(_DIMENSION.get(families[0], families[0].dof))
    mine = [  # those that measure all of it
        group for group in groups if (group.code, group.families, group.rows) == (code, families, measured.dof)
    ]
    if not mine:
        return _Measured(
            variables=np.zeros((0, len(families)), dtype=np.int64),
            value=np.zeros((0, *measured.shape)),
            root=np.zeros((0, measured.dof, measured.dof)),
        )
    return _Measured(
        variables=np.concatenate([group.variables for group in mine]).astype(np.int64),
        value=np.concatenate([measured.elements(group.measurement) for group in mine]),
        root=np.concatenate([_roots(group.noise, group.rows, len(group.variables)) for group in mine]),
    )


def _roots(noise: Whitening, rows: int, count: int) -> Array:
    """Return the S of every factor as matrices, (count, rows, rows)."""
    S = noise.sqrt_information
    S = S.reshape(-1, rows, rows) if noise.form == FULL else S[:, :, None] * np.eye(rows)
    if noise.constrained:
        S = np.sqrt(_CONSTRAINT) * S
    return np.broadcast_to(S, (count, rows, rows))


def whitened_information(noise: Whitening, rows: int, count: int) -> Array:
    """Return ``S' S`` of every factor, (count, rows, rows)."""
    S = _roots(noise, rows, count)
    return np.asarray(np.swapaxes(S, 1, 2) @ S)

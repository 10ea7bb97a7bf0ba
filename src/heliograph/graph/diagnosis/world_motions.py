"""Motions of the world: how turning and shifting it moves every variable, and such motions in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.arrays import Array, freeze
from heliograph.graph.model.families import Family
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose
from heliograph.lie import s2 as s2_ops

__all__ = ["WorldMotions", "describe_motions", "space_of", "world_motions"]


_ALIGNED = 1e-6  # of a unit vector: as near to an axis, it is called by the axis' name
_FLAT = 1e-6  # relative singular value below which a motion has no rotation, or no translation
_AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldMotions:
    """Small motions of the world as tangent vectors of some variables.

    Parameters
    ----------
    columns : (T, g) float64
        One motion a column: the rotations about the centre, as many as the space has, then the translations, then
        what `extra` counts, then the growth about the centre. Rotations are per radian, translations per metre.
    space : int
        2 or 3; 0: there is no space, the columns shift the components of vectors.
    turns : int
        Number of rotations.
    centre : (space,) float64
        Mean position, in the world.
    extent : float
        Largest distance of a position from the centre; 1 for a single one [m].
    extra : int
        Shifts of velocities (extended poses), before the growth.
    """

    columns: Array
    space: int
    turns: int
    centre: Array
    extent: float
    extra: int = 0

    def __post_init__(self) -> None:
        freeze(self)


def space_of(families: Sequence[Family]) -> int:
    """Return the dimension of the space that variables of these families live in, 0 for plain numbers."""
    spaces = {3 if family.lie in (SO3, S2) else 2 if family.lie is SO2 else family.space for family in families}
    return max(spaces, default=0)


def world_motions(families: Sequence[Family], elements: Sequence[Array]) -> WorldMotions:
    """Return the motions of the world on variables, stacked family by family.

    Parameters
    ----------
    families : sequence of Family
        Each with the variables below.
    elements : sequence of (N, *shape) float64
        Their values.
    """
    space = space_of(families)
    if space == 0:
        widest = max((family.dof for family in families), default=0)
        columns = [
            np.tile(np.eye(family.dof, widest), (len(e), 1)) for family, e in zip(families, elements, strict=True)
        ]
        return WorldMotions(columns=_stack(columns, widest), space=0, turns=0, centre=np.zeros(0), extent=1.0)
    turns = 1 if space == 2 else 3
    positions = [p for f, e in zip(families, elements, strict=True) if (p := _position(f, e)) is not None]
    everything = np.concatenate([p[:, :space] for p in positions if p.shape[1] == space] or [np.zeros((1, space))])
    centre = everything.mean(axis=0)
    extent = float(np.linalg.norm(everything - centre, axis=1).max())
    extra = 3 if any(family.lie is ExtendedPose for family in families) else 0
    columns = []
    for family, e in zip(families, elements, strict=True):
        block = _of_family(family, e, centre, space, turns)
        growth = _growth(family, e, centre)
        columns.append(np.column_stack([np.pad(block, ((0, 0), (0, turns + space + extra - block.shape[1]))), growth]))
    return WorldMotions(
        columns=_stack(columns, turns + space + extra + 1),
        space=space,
        turns=turns,
        centre=centre,
        extent=extent if extent > 0.0 else 1.0,
        extra=extra,
    )


def _stack(columns: list[Array], width: int) -> Array:
    return np.concatenate(columns) if columns else np.zeros((0, width))


def _position(family: Family, e: Array) -> Array | None:
    if family.lie is None:
        return e if family.space else None
    if family.lie in (SE2, SE3, ExtendedPose):
        return e[:, : family.space, family.space]
    return None


def _of_family(family: Family, e: Array, centre: Array, space: int, turns: int) -> Array:
    """Return the motions (N dof, turns + space [+ 3]) of variables of one family."""
    count, width = len(e), turns + space
    out = np.zeros((count, family.dof, width + (3 if family.lie is ExtendedPose else 0)))
    if (family.space or space) != space or (space == 3 and family.lie is SO2):
        return out.reshape(count * family.dof, -1)  # of another space: nothing is known of how it moves
    position = _position(family, e)
    velocity_of = None if position is None else _turned(position - centre, space)
    if family.lie is None:
        if velocity_of is not None:
            out[:, :, :turns], out[:, :, turns:width] = velocity_of, np.eye(space)
    elif family.lie is S2:
        frame = s2_ops.basis(e)
        out[:, :, :turns] = np.swapaxes(frame, 1, 2) @ _turned(e, space)
    else:
        back = np.swapaxes(e[:, :space, :space], 1, 2)
        out[:, :turns, :turns] = 1.0 if turns == 1 else back
        if velocity_of is not None:
            out[:, turns : turns + space, :turns] = back @ velocity_of
            out[:, turns : turns + space, turns:width] = back
        if family.lie is ExtendedPose:
            out[:, 6:, :3] = back @ _turned(e[:, :3, 4], space)
            out[:, 6:, 6:] = back
    return out.reshape(count * family.dof, -1)


def _growth(family: Family, e: Array, centre: Array) -> Array:
    """Return how variables (N) move when all distances grow alike, (N dof,)."""
    out = np.zeros((len(e), family.dof))
    position = _position(family, e)
    if position is None or position.shape[1] != len(centre):
        return out.reshape(-1)
    if family.lie is None:
        out[:] = position - centre
    else:
        space = family.space
        turns = 1 if space == 2 else 3
        back = np.swapaxes(e[:, :space, :space], 1, 2)
        out[:, turns : turns + space] = np.einsum("nij,nj->ni", back, position - centre)
        if family.lie is ExtendedPose:
            out[:, 6:] = np.einsum("nij,nj->ni", back, e[:, :3, 4])
    return out.reshape(-1)


def _turned(p: Array, space: int) -> Array:
    """Return how points (N, space) move when the world turns, (N, space, turns)."""
    if space == 2:
        return np.stack([-p[:, 1], p[:, 0]], axis=1)[:, :, None]
    out = np.zeros((len(p), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = p[:, 2], -p[:, 1], p[:, 0]
    return out - np.swapaxes(out, 1, 2)


def describe_motions(motions: WorldMotions, twists: Array) -> tuple[str, str]:
    """Return motions in words, such as ``translate along z``, and their kind.

    Parameters
    ----------
    motions : WorldMotions
        What the coefficients mean.
    twists : (g, k) float64
        k independent combinations of its columns, without growth.

    Returns
    -------
    words : str
        After "free to".
    kind : str
        ``translation``, ``rotation``, ``rigid`` (both) or ``other``.
    """
    if motions.space == 0:
        return f"shift {_axis_words(twists, 'component ', 'components ')}", "translation"
    turns, space = motions.turns, motions.space
    spin, shift = twists[:turns] * motions.extent, twists[turns : turns + space]
    rate = twists[turns + space : turns + space + motions.extra]
    size = float(np.abs(np.concatenate([spin, shift, rate])).max())
    _, strengths, mixes = np.linalg.svd(spin)
    rank = int((strengths > _FLAT * size).sum())
    turning, sliding = mixes[:rank].T, mixes[rank:].T
    translations, beside = _span(shift @ sliding), rate @ sliding
    words = []
    if translations.shape[1]:
        words.append("translate " + _directions(translations, space))
    if beside.size and np.abs(beside).max() > _FLAT * size:
        words.append("change its velocity " + _directions(_span(beside), 3))
    if rank:
        words.append(_rotation_words(spin @ turning / motions.extent, shift @ turning, translations, motions))
    if rank == turns and translations.shape[1] == space:
        words = ["move as a whole (" + " and ".join(words) + ")"]
    kind = "rigid" if rank and translations.shape[1] else "rotation" if rank else "translation"
    return " and ".join(words), kind


def _span(vectors: Array) -> Array:
    """Return an orthonormal basis of the columns' span."""
    if not vectors.size:
        return np.zeros((len(vectors), 0))
    left, strengths, _ = np.linalg.svd(vectors, full_matrices=False)
    return left[:, strengths > _FLAT * max(float(strengths[0]), np.finfo(float).tiny)]


def _rotation_words(spin: Array, shift: Array, translations: Array, motions: WorldMotions) -> str:
    """Say which turns (turns, r) with the translations (space, r) these are."""
    space = motions.space
    turn = _turned(np.eye(space), space)  # d velocity / d spin at each unit vector
    # velocity = spin x (p - q) vanishes at q: shift = -spin x (q - centre), but for translations that are free anyway
    kept = np.eye(space) - translations @ translations.T
    rows = np.concatenate([kept @ -np.einsum("kit,t->ik", turn, w) for w in spin.T])
    wanted = np.concatenate([kept @ v for v in shift.T])
    through, *_ = np.linalg.lstsq(rows, wanted, rcond=1e-9)
    left = np.abs(rows @ through - wanted).max(initial=0.0)
    point = "(" + ", ".join(f"{x:.6g}" for x in _cleaned(motions.centre + through, motions.extent)) + ")"
    screw = "" if left <= 1e-6 * motions.extent * float(np.abs(spin).max()) else ", and along the axis as they turn"
    if space == 2:
        return f"rotate about {point}"
    if spin.shape[1] == 3:
        return f"rotate about every axis through {point}{screw}"
    return f"rotate about {_axis_words(_span(spin), '', '')} through {point}{screw}"


def _cleaned(point: Array, extent: float) -> Array:
    return np.where(np.abs(point) < 1e-9 * max(extent, float(np.abs(point).max())), 0.0, point)


def _directions(basis: Array, space: int) -> str:
    if basis.shape[1] == space:
        return "in every direction"
    return "along " + _axis_words(basis, "", "")


def _axis_words(vectors: Array, one: str, many: str) -> str:
    """Name the span of the columns: by axes where it is made of axes, else by numbers."""
    basis = _span(vectors)
    dimension = len(basis)
    names = _AXES[:dimension] if one == "" and dimension <= 3 else [str(k) for k in range(dimension)]
    share = np.einsum("ij,ij->i", basis, basis)  # 1 where the axis lies in the span, 0 where it is normal to it
    if np.minimum(share, 1.0 - share).max() <= _ALIGNED:
        chosen = [names[k] for k in np.flatnonzero(share > 0.5)]
        return (one if len(chosen) == 1 else many) + _listed(chosen)
    shown = []
    for v in basis.T:
        upward = v if v[np.argmax(np.abs(v))] > 0.0 else -v
        shown.append("(" + ", ".join(f"{0.0 if abs(x) < _ALIGNED else x:.3g}" for x in upward) + ")")
    return _listed(shown)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]

"""What a graph leaves free, in words: which variables, how they can move, and what would hold them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Keys, freeze
from heliograph.graph.diagnosis.world_motions import WorldMotions, describe_motions, world_motions
from heliograph.graph.model.families import Family
from heliograph.graph.model.symbols import key_name
from heliograph.lie import S2, SO2, SO3

__all__ = ["FreeMotion", "describe_free", "key_ranges", "named_keys", "remedy_for"]


_MAX_RUNS = 6  # stretches of keys in a message
_MOVES = 1e-6  # of the largest: a variable that moves less rests
_RIGID = 1e-5  # sine of the angle between a motion and the rigid ones
_TOGETHER = 0.5  # share of variables that two motions have in common to be told as one


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeMotion:
    """Variables that a graph leaves free to move together.

    Parameters
    ----------
    keys : (N,) int64
        Ascending.
    variables : str
        What they are, with their keys in ranges: ``poses 120-340``.
    kind : str
        ``translation``, ``rotation``, ``rigid`` (both), ``scale``, ``other`` or ``no factor``.
    directions : int
        Number of independent motions; for `each`, of one variable.
    words : str
        How, in the axes of the world: ``translate along z``.
    component : int
        Component of the graph, from 0.
    remedy : str
        What would hold them.
    each : bool
        The variables are free one by one, not together.
    """

    keys: Keys
    variables: str
    kind: str
    directions: int
    words: str
    component: int
    remedy: str
    each: bool = False

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def text(self) -> str:
        """A sentence without its end."""
        one = len(self.keys) == 1
        if self.kind == "no factor":
            return f"{self.variables} {'has' if one else 'have'} no factor"
        each = "each " if self.each and not one else ""
        return f"{self.variables} {'is' if one else 'are'} {each}free to {self.words}"

    @property
    def scalars(self) -> int:
        """Degrees of freedom that are undetermined."""
        return self.directions * (len(self.keys) if self.each else 1)


def key_ranges(keys: Keys) -> str:
    """Return keys with runs as ranges: ``3, 7, 120-340``; cut off after some."""
    ordered = np.unique(keys)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(ordered) != 1])) if len(ordered) else ordered
    ends = np.concatenate([starts[1:], [len(ordered)]]) - 1
    runs: list[str] = []
    for a, b in zip(ordered[starts[:_MAX_RUNS]].tolist(), ordered[ends[:_MAX_RUNS]].tolist(), strict=True):
        first, last = key_name(a), key_name(b)
        runs.append(first if a == b else f"{first}, {last}" if b == a + 1 else f"{first}-{last}")
    more = f" ... ({len(ordered)} in all)" if len(starts) > _MAX_RUNS else ""
    return ", ".join(runs) + more


def _noun(family: Family) -> str:
    if family.lie is None:
        return "point" if family.space else "vector"
    return "rotation" if family.lie in (SO2, SO3) else "direction" if family.lie is S2 else "pose"


def named_keys(keys: Sequence[Keys], families: Sequence[Family]) -> str:
    """Return ``poses 0-199 and point 1000`` for the keys of each family."""
    by_noun: dict[str, list[Keys]] = {}
    for some, family in zip(keys, families, strict=True):
        if len(some):
            by_noun.setdefault(_noun(family), []).append(some)
    parts = []
    for noun, batches in by_noun.items():
        together = np.concatenate(batches)
        parts.append(f"{noun}{'' if len(together) == 1 else 's'} {key_ranges(together)}")
    return " and ".join(parts)


def remedy_for(kind: str, key: int, *, alone: bool) -> str:
    """Return what would hold variables that move in this way."""
    if kind == "no factor":
        return "give a factor, hold at the value given (graph.fix), or leave out of the values"
    if alone:
        return "add a factor that sees this direction, or hold it (graph.fix)"
    if kind == "rigid":
        return f"hold one of them, such as graph.fix({key_name(key)}), or give one a Prior"
    if kind == "scale":
        return "add a factor that sees a distance, such as a Range, or hold two of them (graph.fix)"
    if kind == "other":
        return "add a factor that sees it, or hold one of them (graph.fix)"
    if kind == "translation":
        return f"add a Position or a Prior, or hold one of them (graph.fix({key_name(key)}))"
    return f"add a factor that sees this turn, such as a Prior, or hold one of them (graph.fix({key_name(key)}))"


def describe_free(
    basis: Array, keys: Sequence[Keys], families: Sequence[Family], elements: Sequence[Array], component: int
) -> list[FreeMotion]:
    """Tell independent motions apart by who moves, and say how.

    Parameters
    ----------
    basis : (T, n) float64
        Independent motions of the variables, family by family.
    keys : sequence of (N,) int64
        Keys of each family's variables.
    families : sequence of Family
        As many.
    elements : sequence of (N, *shape) float64
        Values.
    component : int
        Where all of this is.
    """
    sizes = np.concatenate([np.full(len(k), f.dof) for k, f in zip(keys, families, strict=True)])
    owner = np.repeat(np.arange(len(sizes)), sizes)
    moves: list[tuple[NDArray[np.bool_], list[Array]]] = []
    for vector in _sparse(basis).T:
        amount = np.zeros(len(sizes))
        np.maximum.at(amount, owner, np.abs(vector))
        support = amount > _MOVES * amount.max()
        for k, (other, vectors) in enumerate(moves):
            if (support & other).sum() > _TOGETHER * max(support.sum(), other.sum()):
                moves[k] = (support | other, [*vectors, vector])
                break
        else:
            moves.append((support, [vector]))
    bounds = np.cumsum([0, *map(len, keys)])
    told = []
    for support, vectors in moves:
        chosen = [support[a:b] for a, b in itertools.pairwise(bounds)]
        mine = [(k[c], f, e[c]) for k, f, e, c in zip(keys, families, elements, chosen, strict=True) if c.any()]
        told.extend(_tell(np.stack(vectors, axis=1)[support[owner]], mine, component))
    return told


def _sparse(basis: Array) -> Array:
    """Return a basis of the same space in which each motion has a place where it alone moves."""
    rows = basis.T.copy()
    for k in range(len(rows)):
        i, j = np.unravel_index(int(np.argmax(np.abs(rows[k:]))), rows[k:].shape)
        rows[[k, k + int(i)]] = rows[[k + int(i), k]]
        rows[k] /= rows[k, j]
        others = np.arange(len(rows)) != k
        rows[others] -= rows[others, j][:, None] * rows[k]
    return np.asarray(np.where(np.abs(rows) < 1e-9 * np.abs(rows).max(axis=1, keepdims=True), 0.0, rows).T)


def _tell(basis: Array, mine: list[tuple[Keys, Family, Array]], component: int) -> list[FreeMotion]:
    keys, families = [part[0] for part in mine], [part[1] for part in mine]
    motions = world_motions(families, [part[2] for part in mine])
    every = np.sort(np.concatenate(keys))
    weights = _weights(families, keys, motions.extent)[:, None]
    mine_q = np.linalg.qr(basis * weights)[0]
    left, strengths, _ = np.linalg.svd(motions.columns * weights, full_matrices=False)
    world_q = left[:, strengths > 1e-9 * strengths.max(initial=0.0)] if strengths.size else left[:, :0]
    rigid, sines = _common(mine_q, world_q)
    parts: list[tuple[int, str, str]] = []
    if rigid.shape[1]:
        scaled = motions.columns * weights
        size = np.linalg.norm(scaled, axis=0)
        size = np.where(size > 1e-9 * size.max(), size, np.inf)
        twists = np.linalg.lstsq(scaled / size, rigid, rcond=1e-9)[0] / size[:, None]
        rest, scales = _without_scale(motions, twists)
        if rest.shape[1]:
            parts.append((rest.shape[1], *describe_motions(motions, rest)))
        if scales:
            parts.append((1, "grow and shrink as a whole", "scale"))
    others = int((sines > _RIGID).sum())
    if others:
        ways = "in 1 way" if others == 1 else f"in {others} independent ways"
        parts.append((others, f"move {ways} that {'is' if others == 1 else 'are'} no motion of the whole", "other"))
    variables = named_keys(keys, families)
    return [
        FreeMotion(
            keys=every,
            variables=variables,
            kind=kind,
            directions=count,
            words=words,
            component=component,
            remedy=remedy_for(kind, int(every[0]), alone=len(every) == 1),
        )
        for count, words, kind in parts
    ]


def _without_scale(motions: WorldMotions, twists: Array) -> tuple[Array, bool]:
    """Return the combinations of twists (g, k) that do not scale, and whether there is one that does."""
    if motions.space == 0:
        return twists, False
    share = twists[-1] * motions.extent
    if np.abs(share).max() <= _MOVES * np.abs(twists).max():
        return twists, False
    return np.asarray(twists @ np.linalg.svd(share[None])[2][1:].T), True


def _weights(families: Sequence[Family], keys: Sequence[Keys], extent: float) -> Array:
    """Return what makes tangents (T,) comparable: radians as they are, metres relative to the extent."""
    parts = []
    for family, some in zip(families, keys, strict=True):
        turns = 0 if family.lie is None else 1 if family.dof in (1, 3) and family.lie is not SO3 else 3
        one = np.full(family.dof, 1.0 / extent)
        one[: family.dof if family.lie is S2 else turns] = 1.0
        parts.append(np.tile(one, len(some)))
    return np.concatenate(parts)


def _common(mine: Array, world: Array) -> tuple[Array, Array]:
    """Return an orthonormal basis of what two spaces share, and the sines (n,) of the first's angles to the second."""
    _, _, mixes = np.linalg.svd(world.T @ mine)
    turned = mine @ mixes.T
    sines = np.linalg.norm(turned - world @ (world.T @ turned), axis=0)
    return turned[:, sines <= _RIGID], sines

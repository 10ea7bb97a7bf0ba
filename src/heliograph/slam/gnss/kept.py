"""Fixes and wheels of a run that has ended: the factors that its graph kept of them."""

from __future__ import annotations

import numpy as np

from heliograph.factors import AnchoredPosition, ScaledMotion
from heliograph.graph import FactorGraph, Symbol, Values

__all__ = ["KeptFixes", "kept_fixes"]

E, L, K = Symbol("E"), Symbol("L"), Symbol("K")


class KeptFixes:
    """Factors of fixes and wheels with the variables that they bring.

    Parameters
    ----------
    graph : FactorGraph
    values : Values
    """

    def __init__(self, graph: FactorGraph, values: Values) -> None:
        self.graph, self.values = graph, values


def kept_fixes(graph: FactorGraph, values: Values) -> KeptFixes | None:
    """Return what a run's graph holds of fixes and wheels; None where they do not hold its map."""
    frame = [int(key) for key in (E(0), L(0), K(0)) if int(key) in values]
    if not frame:
        return None
    kept, own = FactorGraph(), Values()
    for key in frame:
        own.insert(key, values.at(key))
    for group in graph.groups():
        if isinstance(group.record, AnchoredPosition | ScaledMotion) or np.isin(group.record.keys, frame).all():
            kept.adopt(group)
    return KeptFixes(kept, own)

"""Variables that came before their first factor: they wait outside the tree until one brings them in."""

from __future__ import annotations

from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.values import Values

__all__ = ["EarlyVariables"]


class EarlyVariables:
    """Values of variables that no factor touches yet. What an update changes counts from `commit` on.

    Attributes
    ----------
    values : Values
        By key, as they were given.
    """

    __slots__ = ("_next", "values")

    def __init__(self) -> None:
        self.values = Values()
        self._next: Values | None = None  # after the update that is under way

    def enter(self, graph: FactorGraph, values: Values, keys: list[int], named_by: list[list[int]]) -> Values:
        """Return which variables an update brings into the tree: those that its factors, or what it holds, name.

        Parameters
        ----------
        graph : FactorGraph
            New factors.
        values : Values
            New variables; those that nothing names wait here.
        keys : list of int
            Keys of the new variables.
        named_by : list of list of int
            Keys that each record of the graph names.
        """
        self._next = None
        waiting_already = len(self.values) > 0
        if not keys and not waiting_already:
            return values
        named = set().union(*named_by)
        if not waiting_already and named.issuperset(keys):  # nearly always
            return values
        named.update(graph.fixed.tolist())
        if not waiting_already and named.issuperset(keys):
            return values
        entering, waiting = Values(), Values()
        for source in (self.values, values):
            for family in source.families():
                mine, _ = source.block(family)
                for key in mine.tolist():
                    (entering if key in named else waiting).insert(key, source.at(key))
        self._next = waiting
        return entering

    def commit(self) -> None:
        """Take what the update has changed for good."""
        if self._next is not None:
            self.values, self._next = self._next, None

    def roll_back(self) -> None:
        """Undo what the update has changed."""
        self._next = None

    def drop(self, keys: list[int]) -> None:
        """Forget variables."""
        kept = Values()
        for family in self.values.families():
            for key in self.values.block(family)[0].tolist():
                if key not in keys:
                    kept.insert(key, self.values.at(key))
        self.values = kept

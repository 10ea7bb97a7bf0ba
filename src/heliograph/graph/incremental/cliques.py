"""Views of a Bayes tree: its cliques as records, as Graphviz text, and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from heliograph.errors import GraphError, MissingDependencyError
from heliograph.graph.incremental.tree_state import TreeState

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CliqueRecord", "clique_records", "plot_cliques", "tree_to_dot"]

_MAX_CLIQUES = 500
_TOUCHED, _RESTING = "#e0a15e", "#1f4e79"


@dataclass(frozen=True, slots=True, kw_only=True)
class CliqueRecord:
    """P(pivots | rows): one clique of a Bayes tree.

    Parameters
    ----------
    number : int
        By which `parent` names it; good until the next update.
    parent : int or None
        None for a root.
    pivots : tuple of int
        Keys of the variables that it determines.
    rows : tuple of int
        Keys of those that they depend on; all are in its parent.
    touched : bool
        The last update made it.
    """

    number: int
    parent: int | None
    pivots: tuple[int, ...]
    rows: tuple[int, ...]
    touched: bool


def clique_records(state: TreeState) -> tuple[CliqueRecord, ...]:
    """Return the cliques of a state, parents before their children."""
    table = state.native.clique_table()
    keys = state.key_of(table.variables).tolist()
    touched = set(table.made.tolist())
    starts = np.concatenate([[0], np.cumsum(table.sizes)]).tolist()
    records = {
        number: CliqueRecord(
            number=number,
            parent=None if above < 0 else above,
            pivots=tuple(keys[start : start + count]),
            rows=tuple(keys[start + count : end]),
            touched=number in touched,
        )
        for number, above, count, start, end in zip(
            table.number.tolist(), table.parent.tolist(), table.pivots.tolist(), starts[:-1], starts[1:], strict=True
        )
    }
    children: dict[int | None, list[int]] = {}
    for record in records.values():
        children.setdefault(record.parent, []).append(record.number)
    ordered, open_ = [], list(reversed(children.get(None, [])))
    while open_:
        number = open_.pop()
        ordered.append(records[number])
        open_ += reversed(children.get(number, []))
    return tuple(ordered)


def tree_to_dot(cliques: Sequence[CliqueRecord], *, names: Mapping[int, str] | None = None) -> str:
    """Return a Bayes tree in the language of Graphviz: cliques as "pivots : rows", the last update's coloured.

    Parameters
    ----------
    cliques : sequence of CliqueRecord
        As `ISAM2.cliques` returns them.
    names : mapping of int to str, optional
        Labels of variables; their keys where it has none.

    Raises
    ------
    GraphError
        More than 500 cliques: nobody could read the picture.
    """
    if len(cliques) > _MAX_CLIQUES:
        raise GraphError(
            f"a tree of {len(cliques)} cliques cannot be read as a drawing (at most {_MAX_CLIQUES}); "
            "give a part of them, or plot them with plot_cliques"
        )
    names = names or {}
    shown = {clique.number for clique in cliques}
    lines = ["digraph bayes_tree {", "  node [shape=box, style=rounded];"]
    for clique in cliques:
        label = " ".join(str(names.get(key, key)) for key in clique.pivots)
        if clique.rows:
            label += " : " + " ".join(str(names.get(key, key)) for key in clique.rows)
        label = label.replace("\\", "\\\\").replace('"', '\\"')
        color = f', style="rounded,filled", fillcolor="{_TOUCHED}"' if clique.touched else ""
        lines.append(f'  "c{clique.number}" [label="{label}"{color}];')
        if clique.parent in shown:
            lines.append(f'  "c{clique.parent}" -> "c{clique.number}";')
    return "\n".join([*lines, "}"]) + "\n"


def plot_cliques(cliques: Sequence[CliqueRecord], *, title: str = "") -> Figure:
    """Return a plot of a Bayes tree in layers: roots on top, areas by variables, what the last update made in orange.

    Parameters
    ----------
    cliques : sequence of CliqueRecord
        As `ISAM2.cliques` returns them: parents before their children.
    title : str
        Above the picture.

    Returns
    -------
    matplotlib Figure
        Save it with ``savefig``; it belongs to no window.

    Raises
    ------
    MissingDependencyError
        matplotlib is not installed.
    GraphError
        There are no cliques.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError("a plot needs matplotlib; install it with `pip install matplotlib`") from None
    if not cliques:
        raise GraphError("there are no cliques, so there is nothing to plot; update the smoother first")
    place = _layers(cliques)
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    lines = [(place[c.number], place[c.parent], (np.nan, np.nan)) for c in cliques if c.parent in place]
    if lines:
        axes.plot(*np.array(lines).reshape(-1, 2).T, color="#b0b0b0", linewidth=0.5, zorder=1)
    for touched, color in ((False, _RESTING), (True, _TOUCHED)):
        part = [c for c in cliques if c.touched is touched]
        if part:
            areas = [4.0 * (len(c.pivots) + len(c.rows)) for c in part]
            x, y = np.array([place[c.number] for c in part]).T
            axes.scatter(x, y, s=areas, c=color, linewidths=0, zorder=2)
    axes.invert_yaxis()
    axes.set_ylabel("depth [cliques]")
    axes.set_xticks([])
    axes.set_title(title)
    return figure


def _layers(cliques: Sequence[CliqueRecord]) -> dict[int | None, tuple[float, float]]:
    """Return places (x, depth): leaves side by side, a parent above the middle of its children."""
    depth: dict[int, int] = {}
    spans: dict[int, list[float]] = {}
    for clique in cliques:
        depth[clique.number] = 0 if clique.parent not in depth else depth[clique.parent] + 1
    leaves = 0.0
    place: dict[int | None, tuple[float, float]] = {}
    for clique in reversed(cliques):  # children first
        span = spans.get(clique.number)
        if span is None:
            leaves -= 1.0
            span = [leaves]
        x = 0.5 * (min(span) + max(span))
        place[clique.number] = (x, float(depth[clique.number]))
        if clique.parent is not None:
            spans.setdefault(clique.parent, []).append(x)
    return place

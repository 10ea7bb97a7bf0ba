"""Pictures: a small factor graph as Graphviz text, a pose graph before and after as a plot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array
from heliograph.errors import GraphError, MissingDependencyError
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.values import Values
from heliograph.lie import SE2, SE3

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure

__all__ = ["plot_poses", "to_dot"]


_MAX_VARIABLES = 500
_ODOMETRY, _LOOP, _POINT = "#1f4e79", "#e0a15e", "#4d4d4d"


def to_dot(graph: FactorGraph, *, names: Mapping[int, str] | None = None) -> str:
    """Return a small factor graph in the language of Graphviz: variables as circles, factors as dots between them.

    Parameters
    ----------
    graph : FactorGraph
        What to draw; held variables have a double circle.
    names : mapping of int to str, optional
        Labels of variables; their keys where it has none.

    Raises
    ------
    GraphError
        More than 500 variables: nobody could read the picture.
    """
    records = list(graph)
    keys = np.unique(np.concatenate([record.keys.ravel() for record in records])) if records else np.empty(0, np.int64)
    if len(keys) > _MAX_VARIABLES:
        raise GraphError(
            f"a graph of {len(keys)} variables cannot be read as a picture of circles (at most {_MAX_VARIABLES}); "
            "draw a part of it, or plot its poses with plot_poses"
        )
    held = set(graph.fixed.tolist())
    names = names or {}
    lines = ["graph factors {", "  layout=neato; overlap=false; splines=true;"]
    for key in keys.tolist():
        shape = "doublecircle" if key in held else "circle"
        label = str(names.get(key, key)).replace("\\", "\\\\").replace('"', '\\"')
        lines.append(f'  "v{key}" [label="{label}", shape={shape}];')
    number = 0
    for record in records:
        for row in record.keys.tolist():
            lines.append(f'  "f{number}" [label="", xlabel="{record.kind} {number}", shape=point, width=0.1];')
            lines += [f'  "v{key}" -- "f{number}";' for key in row]
            number += 1
    return "\n".join([*lines, "}"]) + "\n"


def plot_poses(graph: FactorGraph, values: Values, *, before: Values | None = None, title: str = "") -> Figure:
    """Return a plot of the poses in the plane or in space: odometry dark, loops lighter.

    Parameters
    ----------
    graph : FactorGraph
        Factors of two variables are drawn as lines; those between keys that follow each other count as odometry.
    values : Values
        Where the variables are.
    before : Values, optional
        Drawn beside it, with the same factors: the start.
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
        There are no poses among the values.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError("a plot needs matplotlib; install it with `pip install matplotlib`") from None
    family = SE2 if len(values.block(SE2)[0]) else SE3
    if not len(values.block(family)[0]):
        raise GraphError("there are no poses (SE2 or SE3) among the values, so there is nothing to plot")
    figure = Figure(figsize=(6.0 if before is None else 11.0, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    panels = [("before", before), ("after", values)] if before is not None else [("", values)]
    for column, (label, shown) in enumerate(panels):
        projection = None if family is SE2 else "3d"
        axes = figure.add_subplot(1, len(panels), column + 1, projection=projection)
        _panel(axes, graph, shown, family)
        axes.set_title(label)
    if title:
        figure.suptitle(title)
    return figure


def _panel(axes: Any, graph: FactorGraph, values: Values, family: type[SE2] | type[SE3]) -> None:  # noqa: ANN401
    keys, poses = values.block(family)
    points, places = values.block(family.space)
    names = np.concatenate([keys, points])
    order = np.argsort(names)
    positions = np.concatenate([poses.translation, places])[order]
    pairs = _pairs(graph, names[order])
    follows = np.abs(names[order][pairs[:, 1]] - names[order][pairs[:, 0]]) == 1
    for kind, color, width in ((~follows, _LOOP, 0.4), (follows, _ODOMETRY, 0.9)):
        axes.plot(*_segments(positions, pairs[kind]), color=color, linewidth=width, solid_capstyle="round")
    if len(places):
        axes.plot(*places.T, linestyle="none", marker="+", markersize=4, color=_POINT)
    if family is SE2:
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
    axes.set_aspect("equal")


def _pairs(graph: FactorGraph, names: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places in `names` of what factors of two variables join, (M, 2); others are left out."""
    parts = [record.keys for record in graph if record.keys.shape[1] == 2]
    if not parts:
        return np.empty((0, 2), dtype=np.int64)
    keys = np.concatenate(parts)
    at = np.minimum(np.searchsorted(names, keys), len(names) - 1)
    return np.asarray(at[(names[at] == keys).all(axis=1)])


def _segments(positions: Array, pairs: NDArray[np.int64]) -> Array:
    """Return lines between pairs as one line with gaps, (d, 3 M): a thousand times faster to draw than M lines."""
    lines = np.full((len(pairs), 3, positions.shape[1]), np.nan)
    lines[:, :2] = positions[pairs]
    return np.asarray(lines.reshape(-1, positions.shape[1]).T)

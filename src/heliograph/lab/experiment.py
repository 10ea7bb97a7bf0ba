"""What an experiment is: its words, its controls, and what it shows after each step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from heliograph.arrays import freeze
from heliograph.errors import ConfigError, closest

__all__ = [
    "Action",
    "Chart",
    "ChartTrace",
    "Control",
    "Experiment",
    "ExperimentRun",
    "ExperimentView",
    "Reading",
    "Settings",
    "WorkedNumber",
]

Settings: TypeAlias = Mapping[str, Any]
"""Name of a control -> its value: a number, a word of a choice, or whether it is on."""

MAX_POINTS = 4000  # of a trace: what a browser draws without a pause


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Something to set: a slider, a choice or a switch.

    Parameters
    ----------
    name, label : str
        Key in the settings, and the words beside it.
    default : float, str or bool
        A number makes a slider, a word a choice, a truth value a switch.
    low, high, step : float
        Ends and grid of a slider.
    unit : str
        Unit of a slider's number.
    choices : tuple of str
        Words to choose from.
    live : bool
        A change shows at once; otherwise the experiment begins again.
    """

    name: str
    label: str
    default: float | str | bool
    low: float = 0.0
    high: float = 1.0
    step: float = 0.1
    unit: str = ""
    choices: tuple[str, ...] = ()
    live: bool = False

    def value(self, given: object) -> float | str | bool:
        """Return a value as this control takes it, or raise `ConfigError`."""
        if isinstance(self.default, bool):
            if not isinstance(given, bool):
                raise ConfigError(f"{self.name} = {given!r} is neither true nor false")
            return given
        if isinstance(self.default, str):
            if given not in self.choices:
                word = str(given)
                raise ConfigError(
                    f"{self.name} = '{word}' is not one of {', '.join(self.choices)}{closest(word, self.choices)}"
                )
            return str(given)
        if isinstance(given, bool) or not isinstance(given, (int, float)) or not self.low <= given <= self.high:
            raise ConfigError(f"{self.name} = {given!r} is not a number from {self.low:g} to {self.high:g}")
        return float(given)


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """A button: its key in a step, its words, and what it does, for those who cannot see."""

    name: str
    label: str
    hint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkedNumber:
    """A number that the lesson works out by hand, and where the page shows it.

    Parameters
    ----------
    text : str
        The sum in words.
    value : float
        Its result as the engine gives it.
    digits : int
        Decimals that the lesson quotes.
    """

    text: str
    value: float
    digits: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A number of the current step.

    Parameters
    ----------
    name, label : str
        Key, and the words beside it.
    value : float or str
        As the engine gave it.
    digits : int
        Decimals to show.
    unit : str
    """

    name: str
    label: str
    value: float | str
    digits: int = 3
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartTrace:
    """Something drawn in a chart.

    Parameters
    ----------
    name : str
        In the legend; empty keeps it out of there.
    kind : str
        ``"points"``, ``"line"``, ``"segments"`` (parted by NaN), ``"bars"`` or ``"cloud"`` (three coordinates).
    x, y, z : array_like
        Coordinates; those of bars are words.
    color : int
        Number of a colour of the page, 1 to 6; 0 is the muted one.
    dashed : bool
        A broken line.
    values : array_like, optional
        Colours of points by a number each, such as the height.
    frames : tuple of (array_like, array_like)
        What comes before ``x`` and ``y``, shown one after another to those who like things to move.
    """

    name: str
    kind: str
    x: ArrayLike
    y: ArrayLike
    z: ArrayLike | None = None
    color: int = 1
    dashed: bool = False
    values: ArrayLike | None = None
    frames: tuple[tuple[ArrayLike, ArrayLike], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """A picture: what is drawn, and its axes.

    Parameters
    ----------
    name, title : str
        Key, and what stands above.
    x, y : str
        Labels of the axes, with units.
    traces : tuple of ChartTrace
    equal : bool
        One metre is as long on both axes.
    log : bool
        Logarithmic ordinate.
    x_range, y_range : (float, float), optional
        Fixed ends of an axis, so that a growing picture does not jump.
    lines : tuple of (float, str)
        Heights to mark, and their words.
    """

    name: str
    title: str
    x: str
    y: str
    traces: tuple[ChartTrace, ...]
    equal: bool = False
    log: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    lines: tuple[tuple[float, str], ...] = ()

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentView:
    """All that is shown after a step.

    Parameters
    ----------
    message : str
        What just happened, in a sentence; read out to those who cannot see.
    readings : tuple of Reading
    charts : tuple of Chart
    done : bool
        No further step would change anything.
    """

    message: str
    readings: tuple[Reading, ...] = ()
    charts: tuple[Chart, ...] = ()
    done: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the view as plain numbers and lists, for JSON: numbers as they are, coordinates to a tenth of a mm."""
        return {
            "message": self.message,
            "done": self.done,
            "readings": [asdict(reading) | {"value": _plain(reading.value)} for reading in self.readings],
            "charts": [_chart(chart) for chart in self.charts],
        }


class ExperimentRun(ABC):
    """An experiment that was begun with some settings."""

    @abstractmethod
    def step(self, action: str, settings: Settings) -> None:
        """Go on by one step; ``settings`` are all controls as they are now, of which the live ones count."""

    @abstractmethod
    def view(self, settings: Settings) -> ExperimentView:
        """Return what there is to see."""

    def release(self) -> None:  # noqa: B027 - few hold anything
        """Let go of what it holds beside memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """An idea of the lesson to play with, on the engine itself.

    Parameters
    ----------
    name, title : str
        Key in addresses, and heading.
    chapter : str
        Chapter of the lesson and its title.
    question : str
        What to do and what to look for, in two or three sentences.
    controls : tuple of Control
    actions : tuple of Action
        Buttons beside "begin again"; the first is also what "auto" repeats.
    begin : callable
        Settings -> an `ExperimentRun`.
    command : str
        The command line that does the same with a recording.
    code : str
        At most ten lines of Python that do the same.
    worked : callable
        Returns the lesson's worked numbers as the engine gives them.
    """

    name: str
    title: str
    chapter: str
    question: str
    begin: Callable[[Settings], ExperimentRun]
    command: str
    code: str
    controls: tuple[Control, ...] = ()
    actions: tuple[Action, ...] = (Action(name="step", label="Step", hint="go on by one step"),)
    worked: Callable[[], tuple[WorkedNumber, ...]] = field(default=tuple)

    def settings(self, given: Settings | None = None) -> dict[str, Any]:
        """Return all controls' values: those given, checked, and the defaults of the rest."""
        given = given or {}
        known = {control.name: control for control in self.controls}
        for name in given:
            if name not in known:
                raise ConfigError(f"experiment '{self.name}' has no control '{name}'{closest(str(name), list(known))}")
        return {name: control.value(given.get(name, control.default)) for name, control in known.items()}

    def action(self, name: str) -> str:
        """Return the name of an action, or raise `ConfigError`."""
        names = [action.name for action in self.actions]
        if name not in names:
            raise ConfigError(f"experiment '{self.name}' has no action '{name}'; there are {', '.join(names)}")
        return name

    def as_dict(self) -> dict[str, Any]:
        """Return what a page needs to offer the experiment."""
        words = {key: getattr(self, key) for key in ("name", "title", "chapter", "question", "command", "code")}
        return words | {
            "controls": [asdict(control) for control in self.controls],
            "actions": [asdict(action) for action in self.actions],
            "worked": [asdict(number) for number in self.worked()],
        }


def _chart(chart: Chart) -> dict[str, Any]:
    kept = {
        key: getattr(chart, key) for key in ("name", "title", "x", "y", "equal", "log", "x_range", "y_range", "lines")
    }
    return kept | {"traces": [_trace(trace) for trace in chart.traces]}


def _trace(trace: ChartTrace) -> dict[str, Any]:
    columns = {key: getattr(trace, key) for key in ("x", "y", "z", "values") if getattr(trace, key) is not None}
    longest = max((len(np.atleast_1d(np.asarray(column))) for column in columns.values()), default=0)
    stride = -(-longest // MAX_POINTS) if trace.kind in ("points", "cloud") else 1
    plain: dict[str, Any] = {
        key: _column(np.atleast_1d(np.asarray(column))[:: max(stride, 1)]) for key, column in columns.items()
    }
    if trace.frames:
        plain["frames"] = [{"x": _column(np.asarray(x)), "y": _column(np.asarray(y))} for x, y in trace.frames]
    return {"name": trace.name, "kind": trace.kind, "color": trace.color, "dashed": trace.dashed, **plain}


def _column(values: np.ndarray[Any, Any]) -> list[Any]:
    if values.dtype.kind not in "fiu":
        return [str(value) for value in values.tolist()]
    rounded = np.round(values.astype(np.float64), 4)
    return rounded.tolist() if np.isfinite(rounded).all() else [_plain(value) for value in rounded.tolist()]


def _plain(value: float | str) -> float | str | None:
    """JSON has no word for a number that is none."""
    if isinstance(value, str):
        return value
    return float(value) if np.isfinite(value) else None

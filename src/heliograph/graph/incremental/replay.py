"""A finished graph replayed as if it grew: one pose at a time with all its factors, by incremental smoothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from heliograph.errors import UnderconstrainedError
from heliograph.graph.incremental.isam2 import ISAM2
from heliograph.graph.incremental.replay_order import ReplayOrder, StartingPoint
from heliograph.graph.incremental.update_result import UpdateResult
from heliograph.graph.model.factor_graph import FactorGraph
from heliograph.graph.model.subgraph import split
from heliograph.graph.model.values import Values

__all__ = ["Replay", "ReplayStep", "replay", "replay_steps"]

Observer: TypeAlias = Callable[[int, UpdateResult], bool]


class ReplayStep(NamedTuple):
    """What arrives together: factors, and how each new variable finds its start."""

    graph: FactorGraph
    sources: tuple[StartingPoint, ...]


@dataclass(slots=True, kw_only=True)
class Replay:
    """What a replay took.

    Parameters
    ----------
    smoother : ISAM2
        As it stands after the last step.
    seconds : list of float
        A step: the update, and the reading of the earlier pose that gave the new one its start.
    reeliminated, relinearized : list of int
        Variables a step.
    waited : int
        Steps whose variables could not be determined yet and were taken with a later one.
    """

    smoother: ISAM2
    seconds: list[float] = field(default_factory=list)
    reeliminated: list[int] = field(default_factory=list)
    relinearized: list[int] = field(default_factory=list)
    waited: int = 0


def replay_steps(graph: FactorGraph, values: Values) -> Iterator[ReplayStep]:
    """Yield a graph's poses in the order of their keys, each with all factors to what came before.

    A pose that nothing joins to earlier ones yet waits until something does. A point comes with the first sighting that
    determines it. Starts come from relative poses and sightings; the values serve only for poses that nothing else
    places: held ones, those with a prior.

    Parameters
    ----------
    graph : FactorGraph
        Made of `Between` and `Prior` of SE2 or SE3, `Landmark` and `Position`.
    values : Values
        One for each variable.

    Raises
    ------
    GraphError
        Other factors or variables, or poses that no chain of relative poses joins to a held one or one with a prior.
    """
    order = ReplayOrder(graph, values)
    held = order.steps_of(graph.fixed)
    parts = split(graph, order.step_of_factors(), order.count)
    for number, (part, sources) in enumerate(zip(parts, order.sources(), strict=True)):
        mine = graph.fixed[held == number]
        if len(mine):
            part.fix(mine)
        yield ReplayStep(part, sources)


def replay(steps: Iterable[ReplayStep], smoother: ISAM2 | None = None, *, observer: Observer | None = None) -> Replay:
    """Give a smoother one step after the other.

    Parameters
    ----------
    steps : iterable of ReplayStep
        As `replay_steps` yields them; what making them takes is not counted.
    smoother : ISAM2, optional
        Empty; default: one with default settings.
    observer : callable, optional
        Told the number of the step and what its update did, off the clock; the replay ends where it returns False.

    Raises
    ------
    UnderconstrainedError
        Some variables are not determined by the whole graph; the message says which.
    """
    done = Replay(smoother=smoother or ISAM2())
    waiting = _Waiting()
    failure: UnderconstrainedError | None = None
    for number, step in enumerate(steps):
        new, seconds = _starts(step.sources, done.smoother, waiting.values)
        factors, values = waiting.joined(step.graph, new)
        result = None
        if waiting.due():
            begin = time.perf_counter()
            try:
                result = done.smoother.update(factors, values)
            except UnderconstrainedError as error:
                failure = error
            seconds += time.perf_counter() - begin
        done.seconds.append(seconds)
        done.reeliminated.append(0 if result is None else result.reeliminated)
        done.relinearized.append(0 if result is None else result.relinearized)
        if result is None:
            waiting.keep(factors, values)
            done.waited += 1
            continue
        waiting = _Waiting()
        if observer is not None and not observer(number, result):
            break
    if failure is not None and waiting.tries:
        done.smoother.update(waiting.graph, waiting.values)  # says what is free, if the whole graph leaves it so
    return done


def _starts(sources: tuple[StartingPoint, ...], smoother: ISAM2, waiting: Values) -> tuple[Values, float]:
    """Return the starts of a step's variables, and the time that reading earlier poses took."""
    values, seconds = Values(), 0.0
    for source in sources:
        if source.origin is None:
            values.insert(source.key, source.relative)
            continue
        if source.origin in values:
            origin = values.at(source.origin)
        elif source.origin in waiting:
            origin = waiting.at(source.origin)
        else:
            begin = time.perf_counter()
            origin = smoother.estimate(source.origin)
            seconds += time.perf_counter() - begin
        values.insert(source.key, origin @ source.relative)
    return values, seconds


class _Waiting:
    """Factors and variables of steps that left something undetermined; tried again ever less often."""

    __slots__ = ("_next", "_steps", "graph", "tries", "values")

    def __init__(self) -> None:
        self.graph, self.values = FactorGraph(), Values()
        self.tries = 0
        self._steps = 0
        self._next = 0

    def joined(self, graph: FactorGraph, values: Values) -> tuple[FactorGraph, Values]:
        """Return what waits together with what comes."""
        if self.tries == 0:
            return graph, values
        for added in graph.groups():
            self.graph.adopt(added)
        if len(graph.fixed):
            self.graph.fix(graph.fixed)
        for family in values.families():
            self.values.insert(*values.block(family))
        return self.graph, self.values

    def due(self) -> bool:
        """Tell whether another try is worth its time: after 1, 2, 4, ... further steps."""
        return self._steps >= self._next

    def keep(self, graph: FactorGraph, values: Values) -> None:
        """Wait with these."""
        if self.due():
            self._next = 2 * self._steps + 1
            self.tries += 1
        self._steps += 1
        self.graph, self.values = graph, values

"""The lab's answers: how long each takes, over whole experiments, with every control at its default and at its ends."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from heliograph.lab import EXPERIMENTS, Control, Experiment
from heliograph.lab.server import PATIENCE, Laboratory

__all__ = ["lab_section", "measure_lab", "settings_to_try"]

_BAR = 100.0  # [ms]


def _ends(control: Control) -> tuple[Any, ...]:
    """Return the values of a control that are not its default: both ends of a slider, or the other choices."""
    if isinstance(control.default, bool):
        return (not control.default,)
    values = control.choices if isinstance(control.default, str) else (control.low, control.high)
    return tuple(value for value in values if value != control.default)


def settings_to_try(experiment: Experiment) -> Iterator[dict[str, Any]]:
    """Yield the defaults, each control at each of its ends, and all sliders at their upper ends together."""
    yield {}
    for control in experiment.controls:
        yield from ({control.name: value} for value in _ends(control))
    sliders = {c.name: c.high for c in experiment.controls if isinstance(c.default, float)}
    if len(sliders) > 1:
        yield sliders


def measure_lab(*, most_steps: int = 2000) -> Iterator[dict[str, Any]]:
    """Yield a row an experiment and setting: times of its answers by the wall, and of its steps by the processor."""
    for experiment in EXPERIMENTS.values():
        for given in settings_to_try(experiment):
            yield _measured(experiment, given, most_steps)


def _measured(experiment: Experiment, given: dict[str, Any], most_steps: int) -> dict[str, Any]:
    laboratory = Laboratory()
    answers: list[float] = []

    def ask(act: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        began = time.perf_counter()
        found = act()
        json.dumps(found)
        answers.append(1e3 * (time.perf_counter() - began))
        return found

    def finished(found: dict[str, Any]) -> dict[str, Any]:
        while found["pending"]:
            found = ask(partial(laboratory.act, found["run"], "show", given))
        return found

    found = finished(ask(partial(laboratory.begin, experiment.name, given)))
    number, steps, later = found["run"], list[float](), 0
    rest = [action.name for action in experiment.actions[1:]]
    for _ in range(most_steps):
        action = experiment.actions[0].name if not found["view"]["done"] else rest.pop(0) if rest else ""
        if not action:
            break
        began = time.process_time()
        found = ask(partial(laboratory.act, number, action, given))
        later += found["pending"]
        found = finished(found)
        steps.append(1e3 * (time.process_time() - began))
    laboratory.close()
    row = {"benchmark": "lab", "experiment": experiment.name, "settings": given, "steps": len(steps), "later": later}
    for name, values in (("cpu", np.array(steps or [0.0])), ("answer_wall", np.array(answers))):
        row |= {f"{name}_ms_{q}": float(np.quantile(values, q / 100)) for q in (50, 99, 100)}
    return row


def lab_section(rows: list[dict[str, Any]], table: Callable[[Sequence[str], Sequence[Sequence[Any]]], str]) -> str:
    """Return the section of BENCHMARKS.md: an experiment a row, the worst of its settings."""
    body = []
    for name in dict.fromkeys(row["experiment"] for row in rows):
        part = [row for row in rows if row["experiment"] == name]
        body.append(
            [
                name,
                len(part),
                sum(row["steps"] for row in part),
                f"{max(row['cpu_ms_50'] for row in part):.0f}",
                f"{max(row['cpu_ms_99'] for row in part):.0f}",
                f"{max(row['cpu_ms_100'] for row in part):.0f}",
                sum(row["later"] for row in part),
                f"{max(row['answer_wall_ms_99'] for row in part):.0f}",
                f"{max(row['answer_wall_ms_100'] for row in part):.0f}",
            ]
        )
    worst = max(row["answer_wall_ms_100"] for row in rows)
    head = ["experiment", "settings", "steps", "step, CPU ms: median", "p99", "max", "told as under way"]
    return (
        f"## Lab: what an answer takes\n\n{table([*head, 'answer, wall ms: p99', 'max'], body)}\n"
        "Whole experiments with every control at its default and at its ends, in process; the worst setting of each. "
        f"An answer waits {1e3 * PATIENCE:.0f} ms for the engine; a step that takes longer (a LiDAR alone that is "
        "lost looks for its place) is told as under way until it is done. Bar: an answer within "
        f"{_BAR:.0f} ms, {'kept' if worst <= _BAR else 'missed'}.\n"
    )

"""Chapter 3: a factor graph of two places on a line, built and solved by hand, and a Kalman filter beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import GraphError
from heliograph.graph import Between, FactorGraph, Isotropic, Marginals, Prior, Values, solve
from heliograph.lab.experiment import (
    Action,
    Chart,
    ChartTrace,
    Control,
    Experiment,
    ExperimentRun,
    ExperimentView,
    Reading,
    Settings,
    WorkedNumber,
)

__all__ = ["EXPERIMENT", "KalmanEstimate", "TwoPlaces", "filtered"]

STEP = 10.0  # what odometry measures [m]
_CONFIDENCE = 1.0  # of the ellipses, in sigmas


@dataclass(frozen=True, slots=True, kw_only=True)
class KalmanEstimate:
    """What a Kalman filter says of the second place: after its prediction, and after the fix [m]."""

    predicted: float
    predicted_sigma: float
    gain: float
    place: float
    sigma: float


def filtered(prior: float, odometry: float, fix: float, measured: float) -> KalmanEstimate:
    """Return the textbook's filter (R. E. Kalman, 1960) in one dimension.

    Parameters
    ----------
    prior, odometry, fix : float
        One-sigma of the first place, of the step and of the fix [m].
    measured : float
        The fix [m].
    """
    variance = prior**2 + odometry**2
    gain = variance / (variance + fix**2)
    return KalmanEstimate(
        predicted=STEP,
        predicted_sigma=float(np.sqrt(variance)),
        gain=gain,
        place=STEP + gain * (measured - STEP),
        sigma=float(np.sqrt((1.0 - gain) * variance)),
    )


class TwoPlaces(ExperimentRun):
    """Two places, and the factors that the settings switch on; solved anew by each step.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = dict(settings)

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - solving is all there is to do
        """Take the settings as they are."""
        self.settings = dict(settings)

    def graph(self) -> tuple[FactorGraph, Values]:
        """Return the graph of the factors that are switched on, and where the solver begins."""
        s, graph, values = self.settings, FactorGraph(), Values()
        values.insert([0, 1], [[0.0], [STEP]])
        if s["prior"]:
            graph.add(Prior(0, [0.0], Isotropic(float(s["prior_sigma"]))))
        if s["odometry"]:
            graph.add(Between(0, 1, [STEP], Isotropic(float(s["odometry_sigma"]))))
        if s["fix"]:
            graph.add(Prior(1, [float(s["measured"])], Isotropic(float(s["fix_sigma"]))))
        return graph, values

    def view(self, settings: Settings) -> ExperimentView:
        """Return the solution, its marginals, and the filter's answer."""
        self.settings = dict(settings)
        graph, values = self.graph()
        try:
            solution = solve(graph, values)
            joint = Marginals(graph, solution.values).joint([0, 1])
        except GraphError as error:
            return ExperimentView(message=f"The engine refuses: {error}", charts=(self._numbers_line(None, None),))
        x = solution.values.at([0, 1])[:, 0]
        sigma = np.sqrt(np.diag(joint))
        readings = [
            Reading(name="x0", label="x0", value=float(x[0]), unit="m"),
            Reading(name="sigma0", label="its sigma", value=float(sigma[0]), unit="m"),
            Reading(name="x1", label="x1", value=float(x[1]), unit="m"),
            Reading(name="sigma1", label="its sigma", value=float(sigma[1]), unit="m"),
            Reading(name="correlation", label="correlation", value=float(joint[0, 1] / sigma.prod()), digits=2),
            Reading(name="chi2", label="chi2", value=float(solution.chi2)),
        ]
        charts = [self._numbers_line(x, sigma), _ellipse_chart(x, joint)]
        message = "The graph is solved."
        if all(self.settings[name] for name in ("prior", "odometry", "fix")):
            kalman = self._kalman()
            readings += [
                Reading(name="kalman_x1", label="Kalman's x1", value=kalman.place, unit="m"),
                Reading(name="kalman_sigma1", label="its sigma", value=kalman.sigma, unit="m"),
                Reading(name="gain", label="Kalman's gain", value=kalman.gain, digits=3),
            ]
            message = (
                f"Filter and graph agree on x1 = {x[1]:.3f} m; the graph moves x0 back to {x[0]:.3f} m as well, "
                "which the filter has left behind at 0."
            )
        return ExperimentView(message=message, readings=tuple(readings), charts=tuple(charts), done=True)

    def _kalman(self) -> KalmanEstimate:
        s = self.settings
        return filtered(*(float(s[name]) for name in ("prior_sigma", "odometry_sigma", "fix_sigma", "measured")))

    def _numbers_line(self, x: NDArray[np.float64] | None, sigma: NDArray[np.float64] | None) -> Chart:
        """Draw the factors, the solution and the filter's answer as bars of one sigma on one axis, a row each."""
        s = self.settings
        rows: list[tuple[str, float, float, int]] = []
        if s["prior"]:
            rows.append(("prior of x0", 0.0, float(s["prior_sigma"]), 3))
        if s["odometry"]:
            rows.append(("odometry: x1 − x0", STEP, float(s["odometry_sigma"]), 4))
        if s["fix"]:
            rows.append(("fix of x1", float(s["measured"]), float(s["fix_sigma"]), 5))
        if x is not None and sigma is not None:
            rows += [("graph: x0", float(x[0]), float(sigma[0]), 1), ("graph: x1", float(x[1]), float(sigma[1]), 1)]
            if all(s[name] for name in ("prior", "odometry", "fix")):
                kalman = self._kalman()
                rows.append(("Kalman: x1", kalman.place, kalman.sigma, 2))
        traces = []
        for height, (name, middle, spread, color) in enumerate(reversed(rows)):
            ends = [middle - spread, middle, middle + spread]
            traces.append(ChartTrace(name=name, kind="interval", x=ends, y=[float(height)] * 3, color=color))
        return Chart(
            name="line", title="What is said, and what comes out (± 1 sigma)", x="place [m]", y="",
            traces=tuple(traces[::-1]), y_range=(-0.7, len(rows) - 0.3),
        )  # fmt: skip


def _ellipse_chart(x: NDArray[np.float64], joint: NDArray[np.float64]) -> Chart:
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    edge = x[:, None] + _CONFIDENCE * np.linalg.cholesky(joint) @ np.stack([np.cos(angle), np.sin(angle)])
    return Chart(
        name="ellipse", title="Joint covariance of both places (1 sigma)", x="x0 [m]", y="x1 [m]", equal=True,
        traces=(
            ChartTrace(name="1 sigma", kind="line", x=edge[0], y=edge[1], color=1),
            ChartTrace(name="solution", kind="points", x=x[:1], y=x[1:], color=2),
        ),
    )  # fmt: skip


def _lesson() -> tuple[WorkedNumber, ...]:
    graph, values = TwoPlaces(EXPERIMENT.settings()).graph()
    x = solve(graph, values).values.at([0, 1])[:, 0]
    return (
        WorkedNumber(text="x0, between its prior 0 and a step that does not fit", value=float(x[0]), digits=3),
        WorkedNumber(text="x1, between odometry's 10 and the fix at 11", value=float(x[1]), digits=2),
    )


CODE = """
from heliograph.graph import Between, FactorGraph, Isotropic, Marginals, Prior, Values, solve

graph, values = FactorGraph(), Values()
values.insert([0, 1], [[0.0], [10.0]])
graph.add(Prior(0, [0.0], Isotropic(1.0)))
graph.add(Between(0, 1, [10.0], Isotropic(1.0)))
graph.add(Prior(1, [11.0], Isotropic(2.0)))
solution = solve(graph, values)
print(solution.values.at([0, 1]).ravel(), Marginals(graph, solution.values).joint([0, 1]))  # 0.167, 10.333
""".strip()

EXPERIMENT = Experiment(
    name="graph",
    title="A factor graph by hand",
    chapter="3: factor graphs",
    question="Three sentences about two places: where the first is, how far it is to the second, and a fix of the "
    "second. They contradict each other by a metre; the sigmas decide who gives in. Leave sentences out, down to none.",
    controls=(
        Control(name="prior", label="Prior of x0 at 0 m", default=True, live=True),
        Control(name="prior_sigma", label="its sigma", default=1.0, low=0.1, high=4.0, step=0.1, unit="m", live=True),
        Control(name="odometry", label="Odometry: 10 m from x0 to x1", default=True, live=True),
        Control(
            name="odometry_sigma", label="its sigma", default=1.0, low=0.1, high=4.0, step=0.1, unit="m", live=True
        ),
        Control(name="fix", label="A fix of x1", default=True, live=True),
        Control(name="fix_sigma", label="its sigma", default=2.0, low=0.1, high=4.0, step=0.1, unit="m", live=True),
        Control(name="measured", label="at", default=11.0, low=6.0, high=14.0, step=0.5, unit="m", live=True),
    ),
    actions=(Action(name="solve", label="Solve", hint="solve the graph as it is"),),
    begin=TwoPlaces,
    command="heliograph solve graph.g2o --solver gn --json",
    code=CODE,
    worked=_lesson,
)  # fmt: skip

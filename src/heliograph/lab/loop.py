"""Chapter 5: drive, drift, come back, close the loop, and see which cliques of the Bayes tree that touched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.graph import (
    ISAM2,
    Between,
    CliqueRecord,
    Diagonal,
    FactorGraph,
    ISAM2Settings,
    UpdateResult,
    Values,
)
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
from heliograph.lie import SE2

__all__ = ["EXPERIMENT", "LoopRun", "shared_drift"]

POSES = 100
_STRIDE = 5  # poses a step
_STEP_NOISE = (1e-4, 0.05, 0.05)  # one-sigma of a step: heading [rad], metres
_LOOP_NOISE = (1e-4, 0.001, 0.001)
_NEVER = 1e3  # no variable moves as far


def circle(drift: float) -> tuple[SE2, SE2]:
    """Return the poses of a circle of 100 steps of a metre, true and as odometry with a drift sees them, (101,) each.

    Parameters
    ----------
    drift : float
        Where odometry ends after the round, off the start [m].
    """
    turn = 2.0 * np.pi / POSES
    truth = SE2.exp(np.arange(POSES + 1)[:, None] * np.array([turn, 1.0, 0.0]))
    seen = truth.matrix.copy()
    seen[:, 0, 2] += drift * np.arange(POSES + 1) / POSES
    return truth, SE2(seen)


class LoopRun(ExperimentRun):
    """A drive round a circle in an incremental smoother.

    Parameters
    ----------
    settings : Settings
        ``drift`` [m], and ``relinearize``: "poses that moved" (the default of iSAM2), or "nothing".
    """

    def __init__(self, settings: Settings) -> None:
        self.truth, self.odometry = circle(float(settings["drift"]))
        keeps = settings.get("relinearize", "poses that moved") == "nothing"
        self.smoother = ISAM2(ISAM2Settings(relinearize_threshold=_NEVER) if keeps else None)
        self.result: UpdateResult | None = None
        self.driven, self.closed, self.rippling = 0, False, False
        self.before: NDArray[np.float64] | None = None
        values, graph = Values(), FactorGraph()
        values.insert(0, self.odometry[0])
        graph.fix(0)
        self.smoother.update(graph, values)

    def step(self, action: str, settings: Settings) -> None:  # noqa: ARG002 - the protocol's
        """Drive on by five poses, or close the loop."""
        if action == "close":
            self.close()
        else:
            self.drive()

    def drive(self) -> None:
        """Add the next five poses, each with the factor that joins it to the one before; stop after the round."""
        self.rippling = False
        for k in range(self.driven, min(self.driven + _STRIDE, POSES)):
            step = self.odometry[k].inverse() @ self.odometry[k + 1]
            graph, values = FactorGraph(), Values()
            values.insert(k + 1, self.smoother.estimate(k) @ step)
            graph.add(Between(k, k + 1, step, Diagonal(_STEP_NOISE)))
            self.result = self.smoother.update(graph, values)
            self.driven = k + 1

    def close(self) -> None:
        """Join the last pose to the first: what odometry has drifted by is given back."""
        self.rippling = self.closed or self.driven >= 10
        if self.closed or self.driven < 10:
            return
        self.before = self.positions()
        graph = FactorGraph()
        seen = self.truth[0].inverse() @ self.truth[self.driven]
        graph.add(Between(0, self.driven, seen, Diagonal(_LOOP_NOISE)))
        self.result = self.smoother.update(graph)
        self.closed = True

    def positions(self) -> NDArray[np.float64]:
        """Return the positions as estimated now, (driven + 1, 2) [m]."""
        return np.asarray(self.smoother.estimate(np.arange(self.driven + 1)).translation)

    def ripple(self, cliques: tuple[CliqueRecord, ...]) -> list[NDArray[np.float64]]:
        """Return the positions while the correction goes down the tree, a level at a time, (driven + 1, 2) each [m].

        Back-substitution solves the root first and every clique after its parent: those that it has reached are where
        they come to stand, the others still where they were. Empty where nothing was closed just now.
        """
        if not self.rippling or self.before is None:
            return []
        level, now = _levels(cliques), self.positions()
        of_pose = np.zeros(len(now), dtype=np.int64)
        for clique in cliques:
            of_pose[list(clique.pivots)] = level[clique.number]
        return [np.where((of_pose < reached)[:, None], now, self.before) for reached in range(max(of_pose) + 1)]

    def given_in(self) -> NDArray[np.float64]:
        """Return by how much each step gave in when the loop was closed, (driven,) [m]."""
        if self.before is None:
            return np.zeros(0)
        moved = self.positions()[: len(self.before)] - self.before
        return np.asarray(np.linalg.norm(np.diff(moved, axis=0), axis=1))

    def view(self, settings: Settings) -> ExperimentView:  # noqa: ARG002 - the protocol's
        """Return the path before and after, how each step gave in, and the tree."""
        now, cliques = self.positions(), self.smoother.cliques()
        touched = sum(clique.touched for clique in cliques)
        gap = float(np.linalg.norm(now[-1] - self.truth.translation[self.driven]))
        readings = [
            Reading(name="poses", label="poses", value=float(self.driven + 1), digits=0),
            Reading(name="gap", label="the last pose is off by", value=gap, unit="m"),
            Reading(name="cliques", label="cliques in the tree", value=float(len(cliques)), digits=0),
            Reading(name="touched", label="made by the last update", value=float(touched), digits=0),
        ]
        if self.result is not None:
            eliminated = float(self.result.reeliminated)
            readings.append(
                Reading(name="reeliminated", label="variables eliminated again", value=eliminated, digits=0)
            )
        given = self.given_in()
        if len(given):
            mean = float(given.mean())
            readings.append(Reading(name="given_in", label="each step gave in by", value=mean, unit="m"))
        ripple = self.ripple(cliques)
        charts = [self._path_chart(now, ripple), _tree_chart(cliques, rippling=bool(ripple))]
        if len(given):
            steps = np.arange(1, len(given) + 1)
            charts.insert(
                1,
                Chart(
                    name="given", title="How much each step gave in", x="step", y="[m]",
                    traces=(ChartTrace(name="", kind="line", x=steps, y=given, color=2),),
                    y_range=(0.0, max(1.5 * float(given.max()), 1e-3)),
                ),
            )  # fmt: skip
        message, done = self._message(touched, len(cliques)), self.driven == POSES
        return ExperimentView(message=message, readings=tuple(readings), charts=tuple(charts), done=done)

    def _path_chart(self, now: NDArray[np.float64], ripple: list[NDArray[np.float64]]) -> Chart:
        truth = self.truth.translation[: self.driven + 1]
        traces = [ChartTrace(name="truth", kind="line", x=truth[:, 0], y=truth[:, 1], color=0, dashed=True)]
        if self.before is not None:
            traces.append(ChartTrace(name="before", kind="line", x=self.before[:, 0], y=self.before[:, 1], color=3))
            x, y = _segments(self.before, now[: len(self.before)])
            frames = tuple(_segments(self.before, places) for places in ripple)
            traces.append(ChartTrace(name="correction", kind="segments", x=x, y=y, color=3, frames=frames))
        frames = tuple((places[:, 0], places[:, 1]) for places in ripple)
        traces.append(ChartTrace(name="estimate", kind="line", x=now[:, 0], y=now[:, 1], color=1, frames=frames))
        traces.append(ChartTrace(name="start", kind="points", x=now[:1, 0], y=now[:1, 1], color=2))
        return Chart(name="path", title="The drive, from above", x="x [m]", y="y [m]", equal=True, traces=tuple(traces))

    def _message(self, touched: int, cliques: int) -> str:
        if self.closed:
            moved = self.result.relinearized if self.result is not None else 0
            return (
                f"The loop is closed: {touched} of {cliques} cliques were made anew. {moved} poses moved so far that "
                "they were linearised again; what neither the loop nor they concern stayed as it was."
            )
        if self.driven == POSES:
            return "Back at the start. Close the loop."
        if self.driven == 0:
            return "Drive: five poses a step. Close the loop whenever you like."
        return f"{self.driven} steps driven. The last update made {touched} of {cliques} cliques: the end of the chain."


def _segments(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y of lines from every other start (N, 2) to its end, parted by NaN."""
    flat = np.stack([start, end, np.full_like(start, np.nan)], axis=1)[::2].reshape(-1, 2)
    return flat[:, 0], flat[:, 1]


def _levels(cliques: tuple[CliqueRecord, ...]) -> dict[int, int]:
    """Return the number of cliques above each one."""
    level: dict[int, int] = {}
    for clique in cliques:  # parents come before their children
        level[clique.number] = level[clique.parent] + 1 if clique.parent is not None else 0
    return level


def _tree_chart(cliques: tuple[CliqueRecord, ...], *, rippling: bool) -> Chart:
    """Draw the Bayes tree in layers, the root on top, what the last update made in another colour."""
    depth = _levels(cliques)
    across: dict[int, float] = {}
    children: dict[int | None, list[int]] = {}
    for clique in cliques:
        children.setdefault(clique.parent, []).append(clique.number)
    leaves = 0.0
    for clique in reversed(cliques):
        below = [across[child] for child in children.get(clique.number, ())]
        across[clique.number] = sum(below) / len(below) if below else leaves
        leaves += not below
    edges: list[tuple[float, float]] = []
    for clique in cliques:
        if clique.parent is not None:
            here, above = (across[clique.number], -depth[clique.number]), (across[clique.parent], -depth[clique.parent])
            edges += [here, above, (float("nan"), float("nan"))]
    lines = np.array(edges).reshape(-1, 2)
    traces = [ChartTrace(name="", kind="segments", x=lines[:, 0], y=lines[:, 1], color=0)]
    for name, touched, color in (("kept", False, 1), ("made by the last update", True, 2)):
        part = [clique.number for clique in cliques if clique.touched is touched]
        x, y = [across[number] for number in part], [-depth[number] for number in part]
        traces.append(ChartTrace(name=name, kind="points", x=x, y=y, color=color))
    if rippling:
        layers = [[number for number in depth if depth[number] == at] for at in range(max(depth.values()) + 1)]
        frames = tuple(([across[n] for n in layer], [float(-depth[n]) for n in layer]) for layer in layers)
        traces.append(ChartTrace(name="the correction is here", kind="points", x=[], y=[], color=3, frames=frames))
    return Chart(name="tree", title="The Bayes tree, root on top", x="", y="depth [cliques]", traces=tuple(traces))


def shared_drift(drift: float = 2.0) -> float:
    """Return by how much each pose gives in when a round of 100 poses with a drift is closed [m]."""
    run = LoopRun({"drift": drift})
    while run.driven < POSES:
        run.drive()
    run.close()
    return float(run.given_in().mean())


CODE = """
from heliograph.lab.loop import LoopRun

run = LoopRun({"drift": 2.0})
while run.driven < 100:
    run.drive()   # ISAM2.update with one pose and one Between at a time
run.close()       # one Between from the last pose to the first
print(run.result.reeliminated, "variables eliminated again", run.given_in().mean())  # 0.02 m each
print(sum(clique.touched for clique in run.smoother.cliques()), "cliques made anew")
""".strip()

EXPERIMENT = Experiment(
    name="loop",
    title="Closing a loop",
    chapter="5: loops and the Bayes tree",
    question="Odometry drifts a little with every step. Drive round the circle, then close the loop: the error is "
    "handed out over all poses, none of them gets a kink; it goes down the tree from its root. Poses that moved far "
    "are linearised again, and their cliques with them; without that, the loop touches the clique of its last pose "
    "and no other.",
    controls=(
        Control(name="drift", label="Drift of a round", default=2.0, low=0.0, high=6.0, step=0.25, unit="m"),
        Control(
            name="relinearize",
            label="The loop relinearises",
            default="poses that moved",
            choices=("poses that moved", "nothing"),
        ),
    ),
    actions=(
        Action(name="drive", label="Drive", hint="drive on by five poses"),
        Action(name="close", label="Close loop", hint="join the last pose to the first"),
    ),
    begin=LoopRun,
    command="heliograph solve graph.g2o --solver isam2 --json   # and, of a run: heliograph loops OUT",
    code=CODE,
    worked=lambda: (WorkedNumber(text="2.0 m over 100 poses: each gives in by", value=shared_drift(), digits=3),),
)

"""`heliograph solve`: a pose graph's optimum."""

from __future__ import annotations

import json as jsonlib
import sys
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.guard.files import plain_file

if TYPE_CHECKING:
    from heliograph.cli.incremental import Incremental
    from heliograph.graph import FactorGraph, ISAM2Settings, PoseGraphFile, Solution, Values
    from heliograph.graph.model.kernels import Kernel

__all__ = ["parse_robust", "solve"]

_ARCHIVE_MAGIC = b"PK"
_TORO = (".graph", ".toro")
_WORDS = {"gn": "Gauss-Newton", "lm": "Levenberg-Marquardt", "dogleg": "Dogleg", "isam2": "iSAM2 after the last pose"}

# By name: the class in `heliograph.graph`, and its customary width (95 % efficient on Gaussian noise, where one is).
_KERNELS = {
    "huber": ("Huber", 1.345),
    "cauchy": ("Cauchy", 2.385),
    "geman-mcclure": ("GemanMcClure", 1.0),
    "tukey": ("Tukey", 4.685),
    "dcs": ("DCS", 1.0),
    "truncated": ("TruncatedLeastSquares", 3.0),
}


_SHOWN = 8  # edges that are listed
_GNC = ("gnc", "gnc-tls", "gnc-gm")  # graduated: false loops are let go


class Solver(str, Enum):
    """Solvers."""

    gn = "gn"
    lm = "lm"
    dogleg = "dogleg"
    isam2 = "isam2"


class Init(str, Enum):
    """Starts."""

    auto = "auto"
    file = "file"
    odometry = "odometry"
    chordal = "chordal"


class Repair(str, Enum):
    """What stands in for information that is not positive semi-definite."""

    clamp = "clamp"
    skip = "skip"


class Missing(str, Enum):
    """What stands in for information that is not there."""

    identity = "identity"


@dataclass(slots=True, kw_only=True)
class _Task:
    """What is to be solved, and where from."""

    graph: FactorGraph
    values: Values
    file: PoseGraphFile | None
    start: str
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    """What the command line asked for."""

    graph: Path
    output: Path | None
    plot: Path | None
    solver: Solver
    init: Init
    robust: str | None
    reading: dict[str, Any]
    limits: dict[str, Any]
    steps: dict[str, Any]
    threads: int
    json: bool


def solve(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="A g2o or TORO file, or an archive of save_graph.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT", help="Solved graph: .g2o, .graph (TORO) or .npz; default: none."),
    ] = None,
    solver: Annotated[Solver, typer.Option("--solver", help="Method.")] = Solver.lm,
    init: Annotated[
        Init,
        typer.Option("--init", help="Where to start; auto: the file, a chordal start or a replay, what is best."),
    ] = Init.auto,
    robust: Annotated[
        str | None,
        typer.Option(
            "--robust",
            metavar="NAME[:WIDTH]",
            help=f"Relative poses: a kernel ({', '.join(_KERNELS)}), or gnc[-tls|-gm].",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance",
            metavar="X",
            min=0.0,
            help="Converged when a step lowers the cost by no more of it.",
        ),
    ] = None,
    max_iterations: Annotated[
        int | None, typer.Option("--max-iterations", metavar="N", min=1, help="Steps tried at most.")
    ] = None,
    repair_information: Annotated[
        Repair | None,
        typer.Option("--repair-information", help="Information that is not positive semi-definite: clamp it or skip."),
    ] = None,
    missing_information: Annotated[
        Missing | None, typer.Option("--missing-information", help="Edges without information get the identity.")
    ] = None,
    skip_unknown: Annotated[
        bool, typer.Option("--skip-unknown", help="Pass over lines of unknown tags and count them.")
    ] = False,
    threads: Annotated[int, typer.Option("--threads", metavar="N", min=1, help="Same bits for any number.")] = 1,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Picture before and after (.png, .pdf, .svg).")
    ] = None,
    skip: Annotated[
        int, typer.Option("--relinearize-skip", metavar="N", min=1, help="isam2: linearise anew every N-th update.")
    ] = 1,
    threshold: Annotated[
        float,
        typer.Option("--relinearize-threshold", metavar="X", min=0.0, help="isam2: of a longer step [rad, m]."),
    ] = 0.1,
    wildfire: Annotated[
        float,
        typer.Option("--wildfire", metavar="X", min=0.0, help="isam2: smaller changes end there [rad, m]."),
    ] = 1e-3,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output file if there is one.")] = False,
    json: options.Json = False,
) -> None:
    """Find the poses that a pose graph makes most likely."""
    reading = {
        "repair_information": repair_information.value if repair_information else "",
        "missing_information": missing_information.value if missing_information else "",
        "skip_unknown": skip_unknown,
    }
    steps = {"relinearize_skip": skip, "relinearize_threshold": threshold, "wildfire": wildfire}
    limits = _limits(solver, tolerance, max_iterations)
    _check_free(output, overwrite=overwrite)
    request = _Request(
        graph=graph, output=output, plot=plot, solver=solver, init=init, robust=robust, reading=reading,
        limits=limits, steps=steps, threads=threads, json=json,
    )  # fmt: skip
    facts = _solved(request)
    typer.echo(jsonlib.dumps(facts, allow_nan=False) if json else "\n".join(_lines(facts)))


def _solved(request: _Request) -> dict[str, Any]:
    """Read, solve and write; notes and warnings go to standard error."""
    from heliograph.graph import ISAM2Settings

    solver, init = request.solver, request.init
    gnc = request.robust is not None and request.robust.partition(":")[0] in _GNC
    kernel = None if request.robust is None or gnc else parse_robust(request.robust)
    for path in (request.output, request.plot):
        _check_folder(path)
    if solver is Solver.isam2:
        init = _replayed(init)
    stage("reading the graph")
    task = _task(request.graph, init, kernel, request.reading)
    _check_output(task, request.output)
    for note in task.notes:
        print(f"note: {note}", file=sys.stderr)
    initial = "chordal" if init is Init.chordal else "auto"
    settings = ISAM2Settings(**request.steps)
    stage("solving")
    if gnc:
        solution: Solution | Incremental = _without_outliers(task, request, settings)
    else:
        solution = _minimise(task, solver, settings, request.limits, initial=initial, threads=request.threads)
    if request.json and init is not Init.chordal and solution.start != "given" and solver is not Solver.isam2:
        print(f"note: start: {solution.start}", file=sys.stderr)
    stage("writing")
    written = _write(task, solution, request.output, request.plot, title=request.graph.stem)
    facts = _facts(request.graph, task, solution, solver, request.robust, request.threads, written)
    for warning in facts["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    return facts


def _replayed(init: Init) -> Init:
    """Return the start of an incremental solver."""
    from heliograph.errors import ConfigError

    if init is Init.chordal:
        raise ConfigError("--init chordal is for the other solvers: isam2 starts poses from its own estimate")
    return Init.odometry


def _check_output(task: _Task, output: Path | None) -> None:
    """See before the work whether the graph can be written in the format asked for."""
    from heliograph.graph import pose_graph_of
    from heliograph.graph.files.g2o import check_toro

    if output is not None and output.suffix in _TORO:
        check_toro(task.file or pose_graph_of(task.graph, task.values))


def _limits(solver: Solver, tolerance: float | None, max_iterations: int | None) -> dict[str, Any]:
    """Return when the solver stops, as `SolverSettings` takes it."""
    from heliograph.errors import ConfigError

    if solver is Solver.isam2 and not (tolerance is None and max_iterations is None):
        raise ConfigError("--tolerance and --max-iterations are for the other solvers: isam2 takes one step a pose")
    given = {"relative_decrease": tolerance, "max_iterations": max_iterations}
    return {name: value for name, value in given.items() if value is not None}


def _minimise(
    task: _Task, solver: Solver, settings: ISAM2Settings, limits: dict[str, Any], *, initial: str, threads: int
) -> Solution | Incremental:
    from heliograph.cli.incremental import solve_incrementally
    from heliograph.graph import SolverSettings
    from heliograph.graph import solve as minimise

    if solver is Solver.isam2:
        return solve_incrementally(task.graph, task.values, settings)
    stop = SolverSettings(**limits)
    return minimise(task.graph, task.values, solver.value, initial=initial, settings=stop, threads=threads)


def _without_outliers(task: _Task, request: _Request, settings: ISAM2Settings) -> Incremental:
    """Solve with false loops let go: one pose at a time, or all at once."""
    from heliograph.cli.incremental import solve_incrementally
    from heliograph.cli.outliers import settings_of, solve_at_once
    from heliograph.errors import ConfigError

    name, probability = settings_of(request.robust or "")
    if request.solver is Solver.isam2:
        from heliograph.graph import OutlierRejection

        if name == "gnc-gm":
            raise ConfigError("--robust gnc-gm is for the other solvers: isam2 minimises a truncated cost (gnc)")
        outliers = OutlierRejection() if probability is None else OutlierRejection(probability=probability)
        return solve_incrementally(task.graph, task.values, settings, outliers)
    if request.solver is not Solver.lm or request.limits:
        raise ConfigError(f"--robust {name} takes --solver lm without limits, or --solver isam2")
    return solve_at_once(task.graph, task.values, name, probability, request.threads)


def parse_robust(text: str) -> Kernel:
    """Return the kernel of ``NAME`` or ``NAME:WIDTH``.

    Raises
    ------
    ConfigError
        An unknown name, or a width that is no positive number.
    """
    import heliograph.graph as engine
    from heliograph.errors import ConfigError, closest

    name, _, width = text.partition(":")
    if name not in _KERNELS:
        raise ConfigError(
            f"--robust knows no '{name}'; there are {', '.join((*_KERNELS, *_GNC))}{closest(name, (*_KERNELS, *_GNC))}"
        )
    cls, default = _KERNELS[name]
    try:
        number = float(width) if width else default
    except ValueError:
        number = float("nan")
    if not 0.0 < number < float("inf"):
        raise ConfigError(f"--robust {text}: the width '{width}' is not a positive number of standard deviations")
    kernel: Kernel = getattr(engine, cls)(number)
    return kernel


def _check_folder(path: Path | None) -> None:
    """Refuse an output that cannot be written before the work, not after it."""
    from heliograph.errors import OutputError

    if path is not None and not path.parent.is_dir():
        raise OutputError(f"cannot write {path}: there is no folder {path.parent}; make it or choose another")


def _check_free(output: Path | None, *, overwrite: bool) -> None:
    """Refuse to replace a file that nobody said may go; an empty one, as `mktemp` makes it, may."""
    from heliograph.errors import OutputError

    if output is not None and not overwrite and output.is_file() and output.stat().st_size:
        raise OutputError(f"{output} exists already; choose another with -o or add --overwrite")


def _task(path: Path, init: Init, kernel: Kernel | None, reading: dict[str, Any]) -> _Task:
    """Read a graph and choose its start."""
    from heliograph.errors import ConfigError
    from heliograph.graph import load_graph, pose_graph_of, read_pose_graph

    if _is_archive(path):
        if kernel is not None:
            raise ConfigError("--robust is for g2o and TORO files; an archive holds the kernels of its factors")
        graph, values = load_graph(path)
        if any(reading.values()):
            raise ConfigError("--repair-information, --missing-information and --skip-unknown are for text files")
        if init is Init.odometry:
            values = pose_graph_of(graph, values).odometry_values()
        return _Task(graph=graph, values=values, file=None, start="file" if init is Init.auto else init.value)
    file = read_pose_graph(path, **reading)
    graph = file.graph(kernel=kernel)
    missing = len(file.missing_ids)
    notes = list(file.notes)
    if init is Init.odometry or missing:
        if init is not Init.odometry:
            total = len(file.pose_ids) + len(file.point_ids)
            whose = "no variable has" if missing == total else f"{missing} of {total} variables lack"
            notes.append(f"{whose} a vertex line in {path.name}, so the poses given are those of the odometry")
        start = init.value if init is Init.chordal else "odometry"
        return _Task(graph=graph, values=file.odometry_values(), file=file, start=start, notes=notes)
    start = "file" if init is Init.auto else init.value
    return _Task(graph=graph, values=file.values(), file=file, start=start, notes=notes)


def _is_archive(path: Path) -> bool:
    try:
        with plain_file(path).open("rb") as file:
            return path.suffix == ".npz" or file.read(2) == _ARCHIVE_MAGIC
    except OSError:
        return path.suffix == ".npz"  # its reader tells what is wrong


def _write(
    task: _Task, solution: Solution | Incremental, output: Path | None, plot: Path | None, *, title: str
) -> list[str]:
    """Write what was asked for and return the names."""
    from heliograph.atomic import atomic_path
    from heliograph.errors import OutputError
    from heliograph.graph import plot_poses, pose_graph_of, save_graph, write_g2o, write_toro

    written = []
    if output is not None:
        if output.suffix == ".npz":
            save_graph(output, task.graph, solution.values)
        else:
            file = pose_graph_of(task.graph, solution.values) if task.file is None else task.file
            writer = write_toro if output.suffix in _TORO else write_g2o
            writer(output, file.with_values(solution.values))
        written.append(str(output))
    if plot is not None:
        figure = plot_poses(task.graph, solution.values, before=task.values, title=title)
        try:
            with atomic_path(plot) as temporary:
                figure.savefig(temporary, dpi=150)
        except ValueError as error:  # an ending that it has no format for
            raise OutputError(f"cannot write {plot}: {error}; use .png, .pdf or .svg") from error
        written.append(str(plot))
    return written


def _facts(
    path: Path,
    task: _Task,
    solution: Solution | Incremental,
    solver: Solver,
    robust: str | None,
    threads: int,
    written: list[str],
) -> dict[str, Any]:
    """Return the account of a solution, as `--json` prints it."""
    from heliograph.graph.batch.solution import doubts
    from heliograph.lie import SE2, SE3

    values = solution.values
    in_plane = len(values.block(SE2)[0])
    poses = in_plane + len(values.block(SE3)[0])
    dof = solution.degrees_of_freedom
    return {
        "graph": str(path),
        "poses": poses,
        "landmarks": len(values) - poses,
        "dimension": 2 if in_plane else 3,
        "edges": len(task.graph),
        "held": len(task.graph.fixed),
        "solver": solver.value,
        "robust": robust,
        "threads": threads,
        "init": task.start,
        "start": solution.start,
        "initial_chi2": solution.initial_chi2,
        "final_chi2": solution.chi2,
        "final_cost": solution.cost,
        "degrees_of_freedom": dof,
        "chi2_per_dof": solution.chi2 / dof if dof > 0 else None,
        "iterations": solution.iterations,
        "status": solution.status,
        "solve_seconds": solution.seconds["total"],
        "seconds": dict(solution.seconds),
        **getattr(solution, "facts", {}),
        "notes": task.notes,
        "warnings": list(doubts(solution.status, solution.iterations, solution.cost, dof)),
        "written": written,
    }


def _lines(facts: dict[str, Any]) -> list[str]:
    """Return an account in words."""
    points = f", {facts['landmarks']} landmarks" if facts["landmarks"] else ""
    where = "the plane" if facts["dimension"] == 2 else "space"
    per_dof = "" if facts["chi2_per_dof"] is None else f", {facts['chi2_per_dof']:.4g} a degree of freedom"
    robust = f"; cost with {facts['robust']} {facts['final_cost']:.6g}" if facts["robust"] else ""
    stages = ", ".join(f"{name} {seconds:.3f}" for name, seconds in facts["seconds"].items() if name != "total")
    lines = [
        f"{facts['poses']} poses in {where}{points}, {facts['edges']} edges, {facts['held']} held",
        f"start: {facts['init'] if facts['start'] == 'given' else facts['start']}",
        f"chi2 {facts['initial_chi2']:.6g} -> {facts['final_chi2']:.6g}{per_dof}{robust}",
        f"{facts['iterations']} iterations of {_WORDS[facts['solver']]} in {facts['solve_seconds']:.3f} s"
        + (f" ({stages})" if stages else ""),
    ]
    if facts["solver"] == "isam2":
        lines.append(
            f"an update {facts['mean_ms']:.3f} ms on average, {facts['p50_ms']:.3f} median, "
            f"{facts['p99_ms']:.3f} for 99 %, {facts['max_ms']:.3f} at most; "
            f"chi2 {facts['last_update_chi2']:.6g} after the last; {facts['bytes_per_pose']:.0f} bytes a pose"
        )
    if "let_go" in facts:
        pairs = [f"{i}-{j}" for i, j in facts["let_go"]]
        rest = f" and {len(pairs) - _SHOWN} more" if len(pairs) > _SHOWN else ""
        lines.append(f"let go: {len(pairs)} edges" + (f": {', '.join(pairs[:_SHOWN])}{rest}" if pairs else ""))
    if facts["written"]:
        lines.append(f"written: {', '.join(facts['written'])}")
    lines.append(f"status: {facts['status']}")
    return lines

"""`heliograph loops`: what a run took for a loop and why, and changes of it by hand."""

from __future__ import annotations

import json as jsonlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.errors import ConfigError

if TYPE_CHECKING:
    from heliograph.revision import RunGraph
    from heliograph.slam.loops import LedgerEntry

__all__ = ["loops"]

_SHOWN = 20  # rejected candidates that are listed without --all


def loops(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    explain: Annotated[
        int | None, typer.Option("--explain", metavar="N", help="All that was known of candidate N, with a picture.")
    ] = None,
    revoke: Annotated[
        list[int] | None, typer.Option("--revoke", metavar="N", help="Take loop N back, and solve again.")
    ] = None,
    add: Annotated[
        tuple[int, int] | None,
        typer.Option("--add", metavar="I J", help="Join keyframes I and J by hand, and solve again."),
    ] = None,
    refine: Annotated[
        str | None,
        typer.Option("--refine", metavar="planes", help="Adjust all poses so that walls are thin, and solve again."),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="List rejected candidates too.")] = False,
    json: options.Json = False,
) -> None:
    """List a run's loops; explain one; revoke or add one and solve the run's graph again in seconds; make walls thin.

    A change rewrites trajectory, map, graph and loops.csv; odometry.tum stays.
    """
    from heliograph.output.survey_files import ACCURACY
    from heliograph.revision import open_run_graph

    stage("reading the graph")
    graph = open_run_graph(run)
    if refine not in (None, "planes"):
        raise ConfigError(f"no refinement '{refine}'; there is 'planes'")
    if revoke or add is not None or refine:
        changed = [graph.revoke(number) for number in revoke or []]
        changed += [graph.add(*add)] if add is not None else []
        stage("making walls thin, solving again" if refine else "solving again")
        account = graph.resolve(refine=refine is not None)
        for entry in changed:
            typer.echo(_line(graph, entry))
        if refine:
            typer.echo(_refined(graph.folder))
        typer.echo(f"{account.accepted} loops stand; trajectory, map and graph of {graph.folder} were written anew")
        if (graph.folder / ACCURACY).is_file():
            typer.echo(
                f"warning: the survey in {graph.folder} is of before; run `heliograph survey {graph.folder}` again",
                err=True,
            )
    elif explain is not None:
        entry = graph.ledger[explain]
        picture = _draw(graph, entry)
        typer.echo(jsonlib.dumps(_facts(graph, entry)) if json else "\n".join(_explained(graph, entry, picture)))
    elif json:
        typer.echo(jsonlib.dumps([_facts(graph, entry) for entry in graph.ledger]))
    else:
        typer.echo("\n".join(_listed(graph, everything=everything)))


def _refined(folder: Path) -> str:
    from heliograph.guard.account import read_account

    r = read_account(folder)["graph"]["refined"]
    walls = f"{1e3 * r['thickness_before_m']:.1f} to {1e3 * r['thickness_after_m']:.1f} mm over {r['planes']} planes"
    if r["refined"]:
        return f"walls are thinner: {walls}; a keyframe moved by up to {1e3 * r['moved_m']:.1f} mm"
    return f"left as it was: {r['reason']} ({walls})"


def _listed(graph: RunGraph, *, everything: bool) -> list[str]:
    entries = list(graph.ledger)
    shown = [entry for entry in entries if everything or entry.decision.verdict != "rejected"]
    lines = [_line(graph, entry) for entry in shown]
    hidden = len(entries) - len(shown)
    counts = {verdict: sum(entry.decision.verdict == verdict for entry in entries)
              for verdict in ("accepted", "held", "rejected", "revoked")}  # fmt: skip
    summary = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    lines.append(f"{len(graph.store)} keyframes, {len(entries)} candidates: {summary}")
    if hidden:
        lines.append(f"--all lists the {hidden} rejected ones too; --explain N tells all of one")
    return lines


def _line(graph: RunGraph, entry: LedgerEntry) -> str:
    e = entry.evidence
    seconds = [1e-9 * (graph.store[k].stamp_ns - graph.store[0].stamp_ns) for k in (e.query, e.match)]
    return (
        f"{entry.number:4d}  keyframe {e.query} ({seconds[0]:.1f} s) to {e.match} ({seconds[1]:.1f} s), "
        f"{e.disagreement:.3f} m from odometry, overlap {e.overlap:.0%}: {entry.decision.text}"
    )


def _explained(graph: RunGraph, entry: LedgerEntry, picture: Path) -> list[str]:
    import numpy as np

    e = entry.evidence
    sigma = np.sqrt(np.diag(e.covariance))
    odom = np.sqrt(np.diag(e.odom_covariance))
    return [
        _line(graph, entry),
        f"proposed by {e.source}, likeness {e.score:.2f}; {e.agreeing} of {e.starts} starts ended here, "
        f"lead over the next pose {e.lead:.2f}",
        f"overlap {e.overlap_query:.0%} of the query's local map, {e.overlap_match:.0%} of the match's; "
        f"{e.inliers:.0%} of the matches fit, residual median {1e3 * e.residuals.median:.1f} mm",
        f"sigma of the loop {1e3 * sigma[3:].max():.0f} mm, {np.degrees(sigma[:3].max()):.2f} deg; of odometry there "
        f"{1e3 * odom[3:].max():.0f} mm, {np.degrees(odom[:3].max()):.2f} deg",
        f"squared distance of the two {e.odom_mahalanobis:.1f}, about 6 where they agree",
        f"not observable: {', '.join(e.blind) or 'nothing'}",
        f"blur of the joined maps {e.blur_before:.3f} before, {e.blur_after:.3f} after",
        f"picture: {picture}",
    ]


def _draw(graph: RunGraph, entry: LedgerEntry) -> Path:
    """Draw both local maps from above at the loop's pose, the match's in blue and the query's in orange."""
    from heliograph.cli.align import draw_pair
    from heliograph.slam.loops import local_map

    e, config = entry.evidence, graph.config.loops
    last = len(graph.store) - 1
    target = local_map(
        graph.store, e.match, range(max(0, e.match - config.before), min(e.match + config.after, last) + 1)
    )
    source = local_map(graph.store, e.query, range(max(0, e.query - config.before), e.query + 1))
    path = graph.folder / f"loop_{entry.number}.png"
    draw_pair(path, target, source, e.T_match_query)
    return path


def _facts(graph: RunGraph, entry: LedgerEntry) -> dict[str, Any]:
    e, d = entry.evidence, entry.decision
    return {
        "number": entry.number,
        "query": e.query,
        "match": e.match,
        "query_stamp_ns": graph.store[e.query].stamp_ns,
        "match_stamp_ns": graph.store[e.match].stamp_ns,
        "verdict": d.verdict,
        "reason": d.reason,
        "text": d.text,
        "overlap": e.overlap,
        "disagreement_m": e.disagreement,
        "T_match_query": e.T_match_query.tolist(),
    }

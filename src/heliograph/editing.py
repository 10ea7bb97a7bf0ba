"""A plan of edits applied to a run's folder: always to what the run itself left, so that a plan can be taken back."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from heliograph.atomic import output_errors
from heliograph.data import GraphAccount
from heliograph.edits import EDITS, RunEdits, read_edits
from heliograph.errors import DataError, closest
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.revision import RunGraph, open_run_graph, sessions_of
from heliograph.slam.loops import Ledger
from heliograph.slam.loops.ledger_file import read_ledger

__all__ = ["UNEDITED", "apply_edits"]

UNEDITED = "loops_unedited.csv"
"""The ledger as the run left it, beside the edited one."""


def apply_edits(folder: Path | str, plan: Path | str) -> GraphAccount:
    """Apply a plan to a run: solve its graph anew and write its files, in seconds.

    The ledger that it begins from is the run's own, whatever was applied before: the same plan gives the same files,
    and an empty one gives back the run. Keyframes stay as they are; what reads them from here on, `localize` and
    `merge` among them, leaves out what the plan removes.

    Raises
    ------
    FormatError
        The folder is none of a run, or the plan is none.
    DataError
        The plan names a loop, a keyframe or a session that there is not; nothing was changed.
    OutputError
        A file cannot be written; the run is as it was.
    """
    folder, edits = Path(folder), read_edits(plan)
    run = open_run_graph(folder)
    kept = folder / UNEDITED
    ledger = read_ledger(kept if kept.is_file() else folder / "loops.csv", run.config.loops)
    _check_sessions(run, edits)
    _forbid(ledger, edits, run)
    edited = replace(run, ledger=ledger, edits=edits)
    for query, match in edits.added:
        edited.add(query, match)
    first = not kept.is_file()
    with output_errors(folder):
        if first:
            shutil.copyfile(folder / "loops.csv", kept)
    try:
        return edited.resolve(beside={EDITS: plain_file(plan, SETTINGS).read_text(encoding="utf-8")})
    except BaseException:
        if first:
            kept.unlink(missing_ok=True)
        raise


def _check_sessions(run: RunGraph, edits: RunEdits) -> None:
    known = sessions_of(run.facts)
    for name in edits.dropped:
        if name not in known:
            listed = ", ".join(known) or "none: it is a run by itself"
            raise DataError(f"there is no session '{name}' to drop; there are {listed}{closest(name, tuple(known))}")
    if known and set(known) == set(edits.dropped):
        raise DataError("the plan drops every session, and a map of nothing is none")


def _forbid(ledger: Ledger, edits: RunEdits, run: RunGraph) -> None:
    known = sessions_of(run.facts)
    ranges = [known[name] for name in edits.dropped]
    for query, match in edits.forbidden:
        numbers = [e.number for e in ledger if (e.evidence.query, e.evidence.match) == (query, match)]
        if not numbers:
            raise DataError(
                f"there is no loop of keyframes {query} and {match} to forbid; `heliograph loops` lists them"
            )
        _revoke(ledger, numbers)
    crossing = [
        e.number for e in ledger.accepted() if any((e.evidence.query in r) != (e.evidence.match in r) for r in ranges)
    ]
    _revoke(ledger, crossing)


def _revoke(ledger: Ledger, numbers: Sequence[int]) -> None:
    for number in numbers:
        if ledger[number].decision.verdict == "accepted":
            ledger.revoke(number)

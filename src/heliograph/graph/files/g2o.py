"""Pose graphs as g2o and TORO text files, lossless: numbers, ids, order and direction come back as they were."""

from __future__ import annotations

import codecs
import difflib
import re
from collections import Counter
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import atomic_path
from heliograph.errors import ConfigError, DataError, FormatError
from heliograph.graph.files.information import repaired
from heliograph.graph.files.isam_text import as_g2o
from heliograph.graph.files.odometry_start import distinct
from heliograph.graph.files.offsets import sensor_offsets
from heliograph.graph.files.posegraph import PoseGraphFile
from heliograph.graph.files.row_kinds import KINDS
from heliograph.graph.files.tables import Table, as_kind, parse_tables, written
from heliograph.guard.files import TABLE, plain_file

__all__ = ["check_toro", "read_pose_graph", "write_g2o", "write_toro"]

_TO_G2O = {"VERTEX2": "VERTEX_SE2", "EDGE2": "EDGE_SE2", "VERTEX3": "VERTEX_SE3:QUAT", "EDGE3": "EDGE_SE3:QUAT"}
_TO_TORO = {g2o: toro for toro, g2o in _TO_G2O.items()}
_FIX_PER_LINE = 20
_SPACED = re.compile(rb"(?m)^([ \t]*(?:VERTEX|EDGE)_SE3)[ \t]*:[ \t]*QUAT(?=[ \t])")
# Tags that are seen in the field without one meaning. RTAB-Map has a class of this name, which neither reads nor writes
# and leaves such links out of its files; it measures `R_pitch R_roll (-up_body) - gravity_world`, what descends from it
# `R' world - body`.
_UNSETTLED = {
    "EDGE_SE3_GRAVITY": ": its numbers mean one thing in one program and another in the next; write "
    "EDGE_SE3_PRIORVEC, the id, a direction of the world, the same as the body sees it, and the information; or pass "
    "over it (--skip-unknown)",
}
_NEAR = 0.85  # likeness of an unknown tag and a known one from which one is suggested for the other


def read_pose_graph(
    path: Path | str,
    *,
    repair_information: Literal["", "clamp", "skip"] = "",
    missing_information: Literal["", "identity"] = "",
    skip_unknown: bool = False,
) -> PoseGraphFile:
    """Read a g2o, TORO or iSAM file.

    Comments (``#``, ``%``, ``;``, ``//``, also behind numbers), PARAMS, TORO's EQUIV lines and blank lines are passed
    over; vertex lines may be missing, all or some, or be there twice if they say the same.

    Parameters
    ----------
    path : Path or str
        The file.
    repair_information : str
        What is done with information matrices that are not positive semi-definite: ``clamp`` sets their negative
        eigenvalues to zero, ``skip`` leaves their edges out; by default they are an error.
    missing_information : str
        ``identity``: edges without information have unit sigmas; by default they are an error.
    skip_unknown : bool
        Pass over lines of unknown tags, which are written back as they were; by default they are an error.

    Returns
    -------
    PoseGraphFile
        Its `notes` say what was repaired, passed over or renumbered.

    Raises
    ------
    FormatError
        The file cannot be read, holds no graph, mixes two and three dimensions, or a line is truncated, has a word
        that is no number, NaN, an unknown tag, a zero quaternion, an information matrix that is not positive
        semi-definite, or an id that another line has given another value. Names line, cause and remedy.
    ConfigError
        An option has another value.
    """
    _check_choice("repair_information", repair_information, ("", "clamp", "skip"))
    _check_choice("missing_information", missing_information, ("", "identity"))
    path = Path(path)
    data, identity = _text(path), missing_information == "identity"
    tables, rest = parse_tables(path, data, identity=identity)
    if any(text.startswith(("VERTEX_SE3", "EDGE_SE3")) for _, text in rest):  # perhaps "VERTEX_SE3 : QUAT"
        tables, rest = parse_tables(path, _SPACED.sub(rb"\1:QUAT", data), identity=identity)
    fixed, fixed_line, others, notes = _other_lines(path, rest, skip_unknown=skip_unknown)
    if not tables:
        raise FormatError(path, "holds neither a vertex nor an edge; give a g2o or TORO pose graph")
    dimension = tables[0].kind.dimension
    for table in tables:
        if table.kind.dimension != dimension:
            raise FormatError(
                path,
                f"line {table.line[0]}: {table.kind.tag} has {table.kind.dimension} dimensions where "
                f"{tables[0].kind.tag} (line {tables[0].line[0]}) has {dimension}; split the file",
            )
    tables, renumbered = as_g2o(tables)
    tables, repairs = repaired(path, tables, repair_information)
    tables, doubled = _once(tables)
    graph = PoseGraphFile(
        dimension=dimension,
        tables=tuple(tables),
        fixed=fixed,
        fixed_line=fixed_line,
        others=tuple(others),
        offsets=sensor_offsets(path, dimension, others),
        notes=(*notes, *renumbered, *repairs, *doubled),
    )
    _check_ids(path, graph)
    known = np.concatenate([graph.pose_ids, graph.point_ids, graph.plane_ids])
    unknown = np.setdiff1d(fixed, known) if len(fixed) else fixed
    if len(unknown):
        line = fixed_line[np.argmax(fixed == unknown[0])]
        raise FormatError(path, f"line {line}: FIX names id {unknown[0]}, which no vertex or edge has; remove it")
    return graph


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        allowed = ", ".join(repr(choice) for choice in choices if choice)
        raise ConfigError(f"{name}={value!r}: it is {allowed}, or empty")


def _text(path: Path) -> bytes:
    """Return the text of a file with lines that end in a line feed."""
    try:
        data = plain_file(path, TABLE).read_bytes()
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror}); give a g2o or TORO file") from error
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) or b"\0" in data[:64]:
        raise FormatError(path, "is no text of one byte a character (UTF-16?); save it as UTF-8 or ASCII")
    data = data.removeprefix(codecs.BOM_UTF8)
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def write_g2o(path: Path | str, graph: PoseGraphFile) -> None:
    """Write a pose graph in the words of g2o, every number to the bit; TORO's Euler angles become quaternions.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    _write(Path(path), graph, [as_kind(table, _TO_G2O.get(table.kind.tag, table.kind.tag)) for table in graph.tables])


def write_toro(path: Path | str, graph: PoseGraphFile) -> None:
    """Write a pose graph in the words of TORO; quaternions become roll, pitch and yaw.

    Raises
    ------
    DataError
        It holds landmarks, priors or fixed poses, which TORO has no words for.
    OutputError
        The file cannot be written.
    """
    check_toro(graph)
    _write(Path(path), graph, [as_kind(table, _TO_TORO.get(table.kind.tag, table.kind.tag)) for table in graph.tables])


def check_toro(graph: PoseGraphFile) -> None:
    """Raise `DataError` where a pose graph holds what TORO has no words for; see `write_toro`."""
    for table in graph.tables:
        if _TO_TORO.get(table.kind.tag, table.kind.tag) not in _TO_G2O:
            raise DataError(f"TORO has no word for {table.kind.tag} ({len(table)} lines); write a g2o file instead")
    if len(graph.fixed):
        raise DataError(f"TORO has no word for the {len(graph.fixed)} fixed poses; write a g2o file instead")


def _write(path: Path, graph: PoseGraphFile, tables: list[Table]) -> None:
    data = written(tables, [*graph.others, *_fix_lines(graph)])
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _fix_lines(graph: PoseGraphFile) -> list[tuple[int, str]]:
    """Return FIX lines as they stood; those that stood nowhere come behind everything."""
    by_line: dict[int, list[str]] = {}
    for line, name in zip(graph.fixed_line.tolist(), graph.fixed.tolist(), strict=True):
        by_line.setdefault(line, []).append(str(name))
    loose = by_line.pop(0, [])
    lines = [(line, "FIX " + " ".join(names)) for line, names in by_line.items()]
    after = np.iinfo(np.int64).max
    return lines + [
        (after, "FIX " + " ".join(loose[k : k + _FIX_PER_LINE])) for k in range(0, len(loose), _FIX_PER_LINE)
    ]


def _other_lines(
    path: Path, rest: list[tuple[int, str]], *, skip_unknown: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], list[tuple[int, str]], list[str]]:
    """Return the ids of FIX lines, their lines, the lines that are kept as they are, and what is said of them."""
    fixed: list[int] = []
    lines: list[int] = []
    kept = []
    unknown: Counter[str] = Counter()
    for line, text in rest:
        tag, *words = text.split() or [text]
        # TORO's EQUIV only repeats which ids saw one place: the edges between them say so too.
        if tag.startswith(("#", "%", ";", "//", "PARAMS")) or tag == "EQUIV":
            kept.append((line, text))
        elif tag == "FIX":
            try:
                ids = np.array([int(word) for word in _uncommented(words)], dtype=np.int64).tolist()
            except (ValueError, OverflowError):
                raise FormatError(path, f"line {line}: '{text[:60]}' names ids that are not whole numbers") from None
            fixed += ids
            lines += [line] * len(ids)
        elif skip_unknown:
            kept.append((line, text))
            unknown[tag] += 1
        else:
            raise FormatError(path, f"line {line}: unknown tag {tag[:40]!a}{_near(tag)}")
    notes = []
    if unknown:
        named = ", ".join(f"{tag[:40]} ({count})" for tag, count in unknown.most_common(8))
        notes = [f"passed over: lines of unknown tags, {named}"]
    return np.array(fixed, dtype=np.int64), np.array(lines, dtype=np.int64), kept, notes


def _uncommented(words: list[str]) -> list[str]:
    """Return the words before a comment."""
    ends = (k for k, word in enumerate(words) if word.startswith(("#", "%", ";", "//")))
    return words[: next(ends, len(words))]


def _near(tag: str) -> str:
    """Return what a message adds to an unknown tag: the one that it may be meant for, or the way on."""
    if tag in _UNSETTLED:
        return _UNSETTLED[tag]
    digits = re.sub(r"\D", "", tag)
    longer = [known for known in KINDS if known.startswith(f"{tag}:")]
    alike = [known for known in KINDS if re.sub(r"\D", "", known) == digits]
    near = longer or difflib.get_close_matches(tag.upper(), alike, n=1, cutoff=_NEAR)
    if near:
        return f"; did you mean '{near[0]}'?"
    return "; remove its lines, or read with skip_unknown (--skip-unknown) to pass over them"


def _once(tables: list[Table]) -> tuple[list[Table], list[str]]:
    """Return the tables without vertex lines that repeat another one number by number, and how many those were."""
    out, repeated = [], 0
    for table in tables:
        if table.kind.role in ("pose", "point", "plane") and len(distinct(table.ids)) < len(table):
            _, first, which = np.unique(table.ids[:, 0], return_index=True, return_inverse=True)
            again = np.setdiff1d(np.arange(len(table)), first)
            same = (table.numbers[again] == table.numbers[first[which.reshape(-1)[again]]]).all(axis=1)
            drop = again[same]
            repeated += len(drop)
            table = table.rows(np.setdiff1d(np.arange(len(table)), drop)) if len(drop) else table
        out.append(table)
    return out, [f"passed over: vertex lines that repeat an earlier one ({repeated})"] if repeated else []


def _check_ids(path: Path, graph: PoseGraphFile) -> None:
    """Refuse an id that two vertex lines give, or that is a pose here and a landmark there."""
    given = graph.of_role("pose", "point", "plane")
    if given:
        ids, lines = np.concatenate([t.ids[:, 0] for t in given]), np.concatenate([t.line for t in given])
        order = np.lexsort((lines, ids))
        same = np.flatnonzero(np.diff(ids[order]) == 0)
        if len(same):
            first, second = order[same[0]], order[same[0] + 1]
            raise FormatError(
                path,
                f"line {lines[second]}: id {ids[second]} was given another value in line {lines[first]} already; "
                "renumber one",
            )
    both = np.intersect1d(graph.pose_ids, graph.point_ids) if len(graph.point_ids) else graph.point_ids
    if len(both):
        table = next(t for t in graph.tables if (t.ids == both[0]).any())
        line = table.line[np.argmax((table.ids == both[0]).any(axis=1))]
        raise FormatError(
            path, f"line {line}: id {both[0]} is a pose in one line and a landmark in another; renumber one"
        )

"""Pose graphs as g2o and TORO text files, lossless: numbers, ids, order and direction come back as they were."""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import atomic_path
from heliograph.errors import DataError, FormatError, closest
from heliograph.graph.files.posegraph import PoseGraphFile
from heliograph.graph.files.row_kinds import KINDS
from heliograph.graph.files.tables import Table, as_kind, parse_tables, written

__all__ = ["check_toro", "read_pose_graph", "write_g2o", "write_toro"]

_TO_G2O = {"VERTEX2": "VERTEX_SE2", "EDGE2": "EDGE_SE2", "VERTEX3": "VERTEX_SE3:QUAT", "EDGE3": "EDGE_SE3:QUAT"}
_TO_TORO = {g2o: toro for toro, g2o in _TO_G2O.items()}
_FIX_PER_LINE = 20


def read_pose_graph(path: Path | str) -> PoseGraphFile:
    """Read a g2o or TORO file.

    Comments, PARAMS, TORO's EQUIV lines and blank lines are passed over; vertex lines may be missing, all or some.

    Raises
    ------
    FormatError
        The file cannot be read, holds no graph, mixes two and three dimensions, or a line is truncated, has a word
        that is no number, NaN, an unknown tag, a zero quaternion, an information matrix that is not positive
        semi-definite, or an id that another line has given already. Names line, cause and remedy.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror}); give a g2o or TORO file") from error
    tables, rest = parse_tables(path, data.removeprefix(codecs.BOM_UTF8))
    fixed, fixed_line, others = _other_lines(path, rest)
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
    _check_offsets(path, tables, others)
    graph = PoseGraphFile(
        dimension=dimension, tables=tuple(tables), fixed=fixed, fixed_line=fixed_line, others=tuple(others)
    )
    _check_ids(path, graph)
    unknown = np.setdiff1d(fixed, np.concatenate([graph.pose_ids, graph.point_ids])) if len(fixed) else fixed
    if len(unknown):
        line = fixed_line[np.argmax(fixed == unknown[0])]
        raise FormatError(path, f"line {line}: FIX names id {unknown[0]}, which no vertex or edge has; remove it")
    return graph


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
    path: Path, rest: list[tuple[int, str]]
) -> tuple[NDArray[np.int64], NDArray[np.int64], list[tuple[int, str]]]:
    """Return the ids of FIX lines, their lines, and the lines that are kept as they are."""
    fixed: list[int] = []
    lines: list[int] = []
    kept = []
    for line, text in rest:
        tag, *words = text.split() or [text]
        # TORO's EQUIV only repeats which ids saw one place: the edges between them say so too.
        if tag.startswith(("#", "PARAMS")) or tag == "EQUIV":
            kept.append((line, text))
        elif tag == "FIX":
            try:
                ids = np.array([int(word) for word in words], dtype=np.int64).tolist()
            except (ValueError, OverflowError):
                raise FormatError(path, f"line {line}: '{text[:60]}' names ids that are not whole numbers") from None
            fixed += ids
            lines += [line] * len(ids)
        else:
            hint = closest(tag, KINDS) or f"; known are {', '.join(KINDS)}, FIX, PARAMS and comments"
            raise FormatError(path, f"line {line}: unknown tag {tag[:40]!a}{hint}")
    return np.array(fixed, dtype=np.int64), np.array(lines, dtype=np.int64), kept


def _check_offsets(path: Path, tables: list[Table], others: list[tuple[int, str]]) -> None:
    """Refuse sensors that do not sit at their pose: their measurements would be read in the wrong frame."""
    offsets = {}
    for line, text in others:
        words = text.split()
        if words[0] == "PARAMS_SE3OFFSET":
            try:
                number, *offset = (float(word) for word in words[1:])
            except ValueError:
                raise FormatError(path, f"line {line}: PARAMS_SE3OFFSET takes an id and x y z qx qy qz qw") from None
            offsets[int(number)] = (line, offset)
    for table in tables:
        for number in np.unique(table.parameter).tolist() if table.kind.parameter else ():
            line, offset = offsets.get(number, (0, [0.0] * 6 + [1.0]))
            if len(offset) != 7 or any(offset[:6]) or offset[6] == 0.0:
                raise FormatError(
                    path,
                    f"line {line}: the offset {number} of {table.kind.tag} is not the identity; express the "
                    "measurements in the frame of the pose",
                )


def _check_ids(path: Path, graph: PoseGraphFile) -> None:
    """Refuse an id that two vertex lines give, or that is a pose here and a landmark there."""
    given = graph.of_role("pose", "point")
    if given:
        ids, lines = np.concatenate([t.ids[:, 0] for t in given]), np.concatenate([t.line for t in given])
        order = np.lexsort((lines, ids))
        same = np.flatnonzero(np.diff(ids[order]) == 0)
        if len(same):
            first, second = order[same[0]], order[same[0] + 1]
            raise FormatError(
                path,
                f"line {lines[second]}: id {ids[second]} was given in line {lines[first]} already; renumber one",
            )
    both = np.intersect1d(graph.pose_ids, graph.point_ids) if len(graph.point_ids) else graph.point_ids
    if len(both):
        table = next(t for t in graph.tables if (t.ids == both[0]).any())
        line = table.line[np.argmax((table.ids == both[0]).any(axis=1))]
        raise FormatError(
            path, f"line {line}: id {both[0]} is a pose in one line and a landmark in another; renumber one"
        )

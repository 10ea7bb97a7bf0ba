"""Ground control points, check points and tape lengths: what a surveyor knows of the place, as factors on a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, freeze
from heliograph.chi_square import chi_square_cdf
from heliograph.errors import DataError, FormatError
from heliograph.graph import Diagonal, FactorGraph, Isotropic, Landmark, Marginals, Prior, Range, Symbol, Values, solve
from heliograph.io.files.poses import read_poses
from heliograph.io.files.table import TextTable, read_table
from heliograph.lie import SE3, interpolate_se3, se3, so3
from heliograph.slam.gnss.alignment import aligned_tracks
from heliograph.survey.coordinates import CoordinateSystem
from heliograph.survey.placed_run import PlacedRun

__all__ = ["ControlPoint", "ControlResidual", "TapeLength", "read_control_points", "tied"]

X, E, P = Symbol("X"), Symbol("E"), Symbol("P")
_SIGMA = 0.02  # of coordinates that come without one [m]
_PICKED = 0.02  # how well a point is picked in the map, or a stamp held over a mark [m]
_FARTHEST = 100.0  # a picked point farther from the way belongs to another run [m]
_TILT = 1e-4  # by how much gravity may point beside the ellipsoid's normal [rad]
_BLUNDER = 1e-3  # chance of a residual below which something is wrong with its point (Baarda's 0.001)
_TESTABLE = 1e-4  # share of a residual's variance below which the point itself decides where the run goes there
_BEARING = math.radians(15.0)  # that control points must span, seen from their middle, to tell a heading


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoint:
    """A mark of which the coordinates are known, and where it is in the run.

    Parameters
    ----------
    name : str
    p_system : (3,) float64
        Easting, northing, height; NaN where only a tape ends there [m].
    sigma : float
        One-sigma of a coordinate [m].
    p_map : (3,) float64
        Where it was picked in the run's map [m].
    keyframe : int
        That saw it from nearest.
    check : bool
        Whether it is held out, to check by.
    """

    name: str
    p_system: Array
    sigma: float
    p_map: Array
    keyframe: int
    check: bool

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def known(self) -> bool:
        """Whether it has coordinates."""
        return bool(np.isfinite(self.p_system).all())


@dataclass(frozen=True, slots=True, kw_only=True)
class TapeLength:
    """A distance that was measured between two points of the table.

    Parameters
    ----------
    a, b : str
        Names of the points.
    length, sigma : float
        [m].
    """

    a: str
    b: str
    length: float
    sigma: float = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlResidual:
    """How far a point of the solved run lies from what is known of it.

    Parameters
    ----------
    name : str
        Name of the point, or names of both ends of a tape.
    kind : str
        ``"control"``, ``"check"`` or ``"tape"``.
    before, after : (3,) float64
        Run less known, east-north-up, without and with the control points; of a tape (dl, 0, 0) [m].
    sigma : float
        [m].
    chance : float
        That a residual is as long as `after` or longer where all sigmas are true: Baarda's test [1]_. It is 1 where
        nothing else tells of the point.

    References
    ----------
    .. [1] W. Baarda, "A testing procedure for use in geodetic networks", 1968.
    """

    name: str
    kind: str
    before: Array
    after: Array
    sigma: float
    chance: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def suspect(self) -> bool:
        """Whether the residual is so long that the point, the place it was picked at or its sigma must be wrong."""
        return self.chance < _BLUNDER


def read_control_points(path: Path | str, run: PlacedRun) -> list[ControlPoint]:
    """Read control points from a CSV with a header.

    Columns: ``id``; ``easting``, ``northing``, ``height`` in the survey's system (all three empty for a mere end of a
    tape); ``map_x``, ``map_y``, ``map_z`` as picked in the run's map, or ``stamp``, when the imu frame's origin, or the
    point ``arm_x``, ``arm_y``, ``arm_z`` in it, was over the mark; ``sigma`` [m]; ``role``: ``control`` or ``check``.

    Raises
    ------
    FormatError
        The file is no such table.
    DataError
        A point lies outside of the run's way, in time or space.
    """
    table = read_table(Path(path))
    names = table.words("id", "name", "point")
    if names is None:
        raise FormatError(path, f"has no column id (its columns: {', '.join(table.names)})")
    axes = (("easting", "x", "east"), ("northing", "y", "north"), ("height", "z", "up"))
    known = np.stack([table.numbers(*column) for column in axes], axis=-1)
    sigmas = table.numbers("sigma", "sigma_m") if table.has("sigma", "sigma_m") else np.full(len(table), _SIGMA)
    roles = table.words("role", "use", "kind") or ["control"] * len(table)
    p_map, keyframes = _picked(table, run)
    _check_rows(table, names, known, p_map)
    away = np.linalg.norm(run.T_map_imu[keyframes, :3, 3] - p_map, axis=1)
    points = []
    for k, name in enumerate(names):
        if away[k] > _FARTHEST:
            raise DataError(f"control point {name} lies {away[k]:.0f} m from the way of the run: is it of another one?")
        points.append(ControlPoint(
            name=name.strip(), p_system=known[k], sigma=float(sigmas[k]) if sigmas[k] > 0.0 else _SIGMA, p_map=p_map[k],
            keyframe=int(keyframes[k]), check=roles[k].strip().lower().startswith("check"),
        ))  # fmt: skip
    return points


def _check_rows(table: TextTable, names: Sequence[str], known: Array, p_map: Array) -> None:
    """Raise what is wrong with a row of the table."""
    seen: set[str] = set()
    for k, name in enumerate(names):
        where = f"line {table.lines[k]}: point {name.strip()}"
        if name.strip() in seen:
            raise FormatError(table.path, f"{where} is there twice; every point needs a name of its own")
        seen.add(name.strip())
        if not np.isfinite(p_map[k]).all():
            raise FormatError(table.path, f"{where} has no place in the run; fill in map_x, map_y, map_z or stamp")
        if np.isfinite(known[k]).any() != np.isfinite(known[k]).all():
            raise FormatError(table.path, f"{where} has some of its coordinates only; give all three or none")


def _picked(table: TextTable, run: PlacedRun) -> tuple[Array, NDArray[np.int64]]:
    """Return the points (N, 3) in the map, picked there or by their times, and the keyframes (N,) that hold them.

    A picked point is held by the keyframe that was nearest, a stamped one by the keyframe of that time: where a way
    closes, the nearest one may be of another lap.
    """
    if table.has("map_x"):
        picked = np.stack([table.numbers(f"map_{axis}") for axis in "xyz"], axis=-1)
        away = np.linalg.norm(np.nan_to_num(picked)[:, None] - run.T_map_imu[None, :, :3, 3], axis=-1)
        return picked, np.argmin(away, axis=1)
    stamps = table.stamps_ns("stamp", "time", "timestamp")
    trajectory = read_poses(run.folder / "trajectory.tum", stamped=True)
    outside = (stamps < trajectory.stamps_ns[0]) | (stamps > trajectory.stamps_ns[-1])
    if outside.any():
        line = table.lines[int(np.flatnonzero(outside)[0])]
        first, last = (1e-9 * trajectory.stamps_ns[[0, -1]]).tolist()
        raise DataError(f"{table.path}: line {line}: its stamp is not within the run, {first:.1f} to {last:.1f} s")
    T = interpolate_se3(trajectory.stamps_ns, trajectory.T_frame_body, stamps)
    arm = np.zeros((len(table), 3))
    if table.has("arm_x"):
        arm = np.stack([table.numbers(f"arm_{axis}") for axis in "xyz"], axis=-1)
    after = np.clip(np.searchsorted(run.stamps_ns, stamps), 1, max(len(run.stamps_ns) - 1, 1))
    before = after - 1
    if len(run.stamps_ns) == 1:
        return se3.act(T, arm), np.zeros(len(table), np.int64)
    nearer = stamps - run.stamps_ns[before] < run.stamps_ns[after] - stamps
    return se3.act(T, arm), np.where(nearer, before, after)


def tied(
    run: PlacedRun, points: Sequence[ControlPoint], tapes: Sequence[TapeLength], system: CoordinateSystem
) -> tuple[PlacedRun, list[ControlResidual]]:
    """Solve the run with control points and tapes; check points take no part.

    Parameters
    ----------
    run : PlacedRun
        Placed by fixes, or not: then at least three control points place it.
    points, tapes
    system : CoordinateSystem
        That of the points' coordinates.

    Raises
    ------
    DataError
        Too few points to place the run, or a tape whose end is in no table.
    """
    graph, values = run.graph.copy(), run.values.copy()
    control = [point for point in points if point.known and not point.check]
    known = {point.name: system.to_enu(point.p_system[None])[0] for point in points if point.known}
    if run.origin_deg is None:
        _place(graph, values, control, known)
    names = {point.name: n for n, point in enumerate(points)}
    T = run.T_map_imu
    for n, point in enumerate(points):
        local = se3.act(se3.inverse(T[point.keyframe]), point.p_map)
        graph.add(Landmark(X(point.keyframe), P(n), local, Isotropic(_PICKED)))
        values.insert(P(n), point.p_map)
        if point.known and not point.check:
            graph.add(Landmark(E(0), P(n), known[point.name], Isotropic(point.sigma)))
    for tape in tapes:
        if missing := [end for end in (tape.a, tape.b) if end not in names]:
            raise DataError(f"the tape ends at '{missing[0]}', which is no point of the table: {', '.join(names)}")
        graph.add(Range(P(names[tape.a]), P(names[tape.b]), tape.length, Isotropic(tape.sigma)))
    found = solve(graph, values, "lm", initial="given")
    origin = (
        run.origin_deg if run.origin_deg is not None else np.array([*np.degrees(system.origin[:2]), system.origin[2]])
    )
    solved = replace(run, graph=graph, values=found.values, origin_deg=origin)
    marginals = Marginals(graph, found.values)
    rows = [
        _residual(point, known[point.name], values, found.values, marginals, n)
        for n, point in enumerate(points) if point.known
    ]  # fmt: skip
    rows += [_tape_residual(tape, values, found.values, marginals, names) for tape in tapes]
    return solved, rows


def _place(graph: FactorGraph, values: Values, control: Sequence[ControlPoint], known: dict[str, Array]) -> None:
    """Add the frame of a run that no fix has placed."""
    a = np.stack([point.p_map for point in control]) if control else np.zeros((0, 3))
    b = np.stack([known[point.name] for point in control]) if control else np.zeros((0, 3))
    spread = np.linalg.svd(a[:, :2] - a[:, :2].mean(axis=0), compute_uv=False) if len(a) > 2 else np.zeros(2)
    if len(a) < 3 or spread[1] < math.sin(_BEARING) * spread[0]:
        raise DataError(
            f"{len(a)} control points do not place a run without fixes: three are needed that do not lie on a line"
        )
    T_enu_map = aligned_tracks(a, b, np.array([point.sigma for point in control]), level=True)
    T = se3.inverse(T_enu_map)
    values.insert(E(0), SE3(np.ascontiguousarray(T)))
    graph.add(Prior(E(0), SE3(np.ascontiguousarray(T)), Diagonal(np.array([_TILT, _TILT, 3.0, 1e4, 1e4, 1e4]))))


def _residual(
    point: ControlPoint, p_enu: Array, before: Values, after: Values, marginals: Marginals, n: int
) -> ControlResidual:
    was, now = (
        (np.asarray(v.at(P(n))) - v.at(E(0)).matrix[:3, 3]) @ v.at(E(0)).matrix[:3, :3] - p_enu for v in (before, after)
    )
    R_enu = after.at(E(0)).matrix[:3, :3].T
    J = np.hstack([R_enu, so3.hat(now + p_enu), -np.eye(3)])
    C = J @ marginals.joint([int(P(n)), int(E(0))]) @ J.T
    return ControlResidual(
        name=point.name, kind="check" if point.check else "control", before=was, after=now, sigma=point.sigma,
        chance=_chance(now, C, point.sigma, point.check),
    )  # fmt: skip


def _tape_residual(
    tape: TapeLength, before: Values, after: Values, marginals: Marginals, names: dict[str, int]
) -> ControlResidual:
    a, b = P(names[tape.a]), P(names[tape.b])
    was, now = (np.asarray(v.at(b)) - np.asarray(v.at(a)) for v in (before, after))
    direction = now / np.linalg.norm(now)
    J = np.concatenate([-direction, direction])[None]
    off = np.array([float(np.linalg.norm(now)) - tape.length])
    along = np.array([1.0, 0.0, 0.0])
    return ControlResidual(
        name=f"{tape.a}-{tape.b}", kind="tape", before=(float(np.linalg.norm(was)) - tape.length) * along,
        after=off * along, sigma=tape.sigma,
        chance=_chance(off, J @ marginals.joint([int(a), int(b)]) @ J.T, tape.sigma),
    )  # fmt: skip


def _chance(residual: Array, C: Array, sigma: float, held_out: bool = False) -> float:
    """Return the chance of a residual (m,) or a longer one; `C` is the covariance of where the solved run has it."""
    if held_out:
        S, basis = C + sigma**2 * np.eye(len(C)), np.eye(len(C))
    else:
        left, axes = np.linalg.eigh(sigma**2 * np.eye(len(C)) - C)
        basis = axes[:, left > _TESTABLE * sigma**2]
        S = basis.T @ (sigma**2 * np.eye(len(C)) - C) @ basis
    if basis.shape[1] == 0:
        return 1.0
    told = basis.T @ residual
    return 1.0 - chi_square_cdf(float(told @ np.linalg.solve(S, told)), basis.shape[1])

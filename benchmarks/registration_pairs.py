"""Pairs of simulated scans with exact truth: places, beams, overlaps and starts drawn from a seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from heliograph.lie import se3, so3
from heliograph.sim.places import PLACES
from heliograph.sim.sensors import LidarModel, measure_ranges
from heliograph.sim.world import SimulatedWorld

__all__ = ["Pair", "draw_pairs", "pose_error", "random_pose", "random_scan", "write_pairs"]

_PLACES = {"warehouse": 14.0, "room": 4.0, "street": 25.0, "aisles": 10.0}
_BEAMS = ((32, 1024, 16.0), (64, 1024, 22.5), (128, 1024, 22.5))
_REACH = 0.5
_FEWEST = 5000


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two clouds (N, 3) float32, the truth and a start (4, 4), the place, the beams, and the source's true overlap."""

    target: NDArray[np.float32]
    source: NDArray[np.float32]
    T_target_source: NDArray[np.float64]
    start: NDArray[np.float64]
    place: str
    beams: int
    overlap: float


def random_scan(
    world: SimulatedWorld, T: NDArray[np.float64], model: LidarModel, rng: np.random.Generator
) -> NDArray[np.float32]:
    rays = model.directions()
    poses = np.repeat(T[None], rays.shape[1], axis=0)
    hit = world.cast(rays, poses, min_range=model.min_range, max_range=model.max_range, threads=1)
    ranges = measure_ranges(hit, model, rng)
    return (rays * ranges[..., None])[ranges > 0.0].astype(np.float32)


def random_pose(row: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    T = np.eye(4)
    tilt = np.radians(3.0) * rng.normal(size=2)
    T[:3, :3] = so3.from_rpy(tilt[0], tilt[1], row[3] + rng.uniform(-0.5, 0.5))
    T[:3, 3] = [*row[:2], row[2] + rng.uniform(-0.3, 0.6)]
    return T


def _unit(rng: np.random.Generator) -> NDArray[np.float64]:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def draw_pairs(count: int, seed: int = 0, *, max_offset: float = 1.0, max_turn_deg: float = 15.0) -> Iterator[Pair]:
    """Yield pairs whose overlaps are spread evenly over 0.3 to 1 and whose starts are up to the given error away."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        name = list(_PLACES)[k % len(_PLACES)]
        place = PLACES[name](np.random.default_rng([seed, k]))
        way, spacing = place.course.sample(0.25)
        beams, columns, tilt = _BEAMS[int(rng.integers(len(_BEAMS)))]
        model = LidarModel(beams=beams, columns=columns, elevation_deg=(-tilt, tilt), max_range=80.0)
        wanted = rng.uniform(0.3, 1.0)
        best: tuple[float, tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64], float]] | None = None
        for _ in range(12):
            a = int(rng.integers(len(way)))
            b = (a + int(rng.uniform(0.0, _PLACES[name]) / spacing)) % len(way)
            Ta, Tb = random_pose(way[a], rng), random_pose(way[b], rng)
            target, source = random_scan(place.world, Ta, model, rng), random_scan(place.world, Tb, model, rng)
            if min(len(target), len(source)) < _FEWEST:  # the course leaves the street there
                continue
            truth = np.linalg.inv(Ta) @ Tb
            some = source[:: max(1, len(source) // 4000)] @ truth[:3, :3].T + truth[:3, 3]
            distance, _ = cKDTree(target[::2]).query(some, distance_upper_bound=_REACH)
            overlap = float(np.mean(np.isfinite(distance)))
            if best is None or abs(overlap - wanted) < best[0]:
                best = (abs(overlap - wanted), (target, source, truth, overlap))
            if best[0] < 0.05:
                break
        assert best is not None
        target, source, truth, overlap = best[1]
        turn, offset = np.radians(max_turn_deg) * rng.uniform() * _unit(rng), max_offset * rng.uniform() * _unit(rng)
        error = np.eye(4)
        error[:3, :3], error[:3, 3] = so3.exp(turn), offset
        yield Pair(target=target, source=source, T_target_source=truth, start=truth @ error, place=name, beams=beams,
                   overlap=overlap)  # fmt: skip


def write_pairs(folder: Path, count: int, seed: int = 0) -> list[Path]:
    """Write pairs as NPZ files where they are not there yet, and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{seed}_{k:03d}.npz" for k in range(count)]
    if not all(file.exists() for file in files):
        for file, pair in zip(files, draw_pairs(count, seed), strict=True):
            np.savez(file, target=pair.target, source=pair.source, T=pair.T_target_source, start=pair.start,
                     place=pair.place, beams=pair.beams, overlap=pair.overlap)  # fmt: skip
    return files


def pose_error(T: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses."""
    d = se3.log(np.linalg.inv(truth) @ T)
    return float(np.linalg.norm((np.linalg.inv(truth) @ T)[:3, 3])), float(np.linalg.norm(d[:3]))

"""Pairs of clouds to align without a start: keyframes and simulated scans, of one place and of different ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.registration_pairs import pose_error, random_pose, random_scan
from heliograph.arrays import freeze
from heliograph.io.files.clouds import read_cloud
from heliograph.lie import se3, so3
from heliograph.registration import align
from heliograph.sim.places import PLACES, Place
from heliograph.sim.sensors import LidarModel

__all__ = ["GlobalPair", "keyframe_pairs", "simulated_pairs", "write_global_pairs"]

Cloud = NDArray[np.float32]
Pose = NDArray[np.float64]
_REACH = 0.5
_APART = 30  # keyframes between two of a pair
_FEWEST = 3000
_SPANS = {"warehouse": 25.0, "room": 8.0, "street": 30.0, "aisles": 20.0}
_BEAMS = ((32, 1024, 16.0), (64, 1024, 22.5))


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalPair:
    """Two clouds and what is known of them.

    Parameters
    ----------
    target, source : (N, 3) float32
        Each in its sensor's frame [m].
    truth : (4, 4) float64
        ``T_target_source``; NaN where the clouds show different worlds.
    overlap : float
        The smaller of the two shares of points with another within half a metre.
    kind : str
        ``"same"``: overlap of 0.3 or more; ``"apart"``: one world, overlap under 0.1; ``"other"``: different worlds.
    name : str
        Where it is from.
    """

    target: Cloud
    source: Cloud
    truth: Pose
    overlap: float
    kind: str
    name: str

    def __post_init__(self) -> None:
        freeze(self)


def _overlap(target: Cloud, source: Cloud, T: Pose) -> float:
    there = se3.act(T, source.astype(np.float64))
    shares = []
    for a, b in ((target, there), (there, target)):
        some = b[:: max(1, len(b) // 3000)]
        distance, _ = cKDTree(a).query(some, distance_upper_bound=_REACH)
        shares.append(float(np.mean(np.isfinite(distance))))
    return min(shares)


def keyframe_pairs(folder: Path, count: int, seed: int) -> Iterator[GlobalPair]:
    """Yield pairs of one recording's keyframes, half of them with overlap; their poses refined from those stored.

    Pairs whose refinement leaves the stored pose by more than 0.5 m or 5 degrees are left out: nothing says which is
    right.
    """
    files = sorted((folder / "Scans").glob("*.pcd"))
    stored = np.loadtxt(folder / "optimized_poses.txt").reshape(-1, 3, 4)
    apart = _APART if len(files) > 2 * _APART else 0
    rng, left = np.random.default_rng(seed), {"same": count // 2, "apart": count - count // 2}
    taken: set[tuple[int, int]] = set()
    for _ in range(100 * count):
        i, j = (int(k) for k in rng.integers(len(files), size=2))
        if abs(i - j) <= apart or (i, j) in taken or not any(left.values()):
            continue
        taken.add((i, j))
        target, source = (read_cloud(files[k]).points for k in (i, j))
        Ti, Tj = (np.vstack([stored[int(files[k].stem)], [0.0, 0.0, 0.0, 1.0]]) for k in (i, j))
        T, known = se3.inverse(Ti) @ Tj, True
        overlap = _overlap(target, source, T)
        if overlap >= 0.2:
            refined = align(target, source, start=T).T_target_source
            known = refined is not None and _near(refined, T)
            T = refined if refined is not None else T
            overlap = _overlap(target, source, T)
        kind = "same" if overlap >= 0.3 and known else "apart" if overlap < 0.1 else ""
        if left.get(kind, 0) > 0:
            left[kind] -= 1
            yield GlobalPair(target=target, source=source, truth=T, overlap=overlap, kind=kind, name=folder.name)


def _near(A: Pose, B: Pose) -> bool:
    distance, angle = pose_error(A, B)
    return distance < 0.5 and np.degrees(angle) < 5.0


def _turned(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Pose]:
    """Turn a cloud about its sensor, mostly about the vertical; and the way back."""
    R = so3.from_rpy(*(np.radians(10.0) * rng.normal(size=2)), rng.uniform(-np.pi, np.pi))
    back = np.eye(4)
    back[:3, :3] = R.T
    return np.ascontiguousarray(cloud @ R.T.astype(np.float32)), back


def simulated_pairs(count: int, seed: int) -> Iterator[GlobalPair]:
    """Yield pairs of simulated scans with exact truth, turned at random: of one place, places apart, other worlds."""
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        name = list(_SPANS)[k % len(_SPANS)]
        kind = ("same", "apart", "same", "other")[(k // len(_SPANS)) % 4]
        kind = "same" if name == "room" and kind == "apart" else kind  # a room is one place
        beams, columns, tilt = _BEAMS[int(rng.integers(len(_BEAMS)))]
        model = LidarModel(beams=beams, columns=columns, elevation_deg=(-tilt, tilt), max_range=80.0)
        pair = _draw(name, kind, model, rng)
        if pair is not None:
            yield pair


def _draw(name: str, kind: str, model: LidarModel, rng: np.random.Generator) -> GlobalPair | None:
    place = PLACES[name](rng)
    if kind == "other":  # streets differ by their seed; a hall is another hall's twin, so it gets a street or a room
        other = "street" if name == "street" else str(rng.choice([n for n in ("street", "room") if n != name]))
        clouds = [_scan_somewhere(p, model, rng)[0] for p in (place, PLACES[other](rng))]
        source, _ = _turned(clouds[1], rng)
        nowhere = np.full((4, 4), np.nan)
        return GlobalPair(target=clouds[0], source=source, truth=nowhere, overlap=0.0, kind=kind, name=name)
    wanted = rng.uniform(0.3, 0.95)
    best: tuple[float, GlobalPair] | None = None
    for _ in range(25):
        (target, Ta), (source, Tb) = (_scan_somewhere(place, model, rng) for _ in range(2))
        if kind == "same" and np.linalg.norm(Ta[:3, 3] - Tb[:3, 3]) > _SPANS[name]:
            continue
        truth = se3.inverse(Ta) @ Tb
        overlap = _overlap(target, source, truth)
        if (kind == "same") != (overlap >= 0.3) or (kind == "apart" and overlap >= 0.1):
            continue
        turned, back = _turned(source, rng)
        pair = GlobalPair(target=target, source=turned, truth=truth @ back, overlap=overlap, kind=kind, name=name)
        if best is None or abs(overlap - wanted) < best[0]:
            best = (abs(overlap - wanted), pair)
        if kind == "apart" or best[0] < 0.1:
            break
    return None if best is None else best[1]


def _scan_somewhere(place: Place, model: LidarModel, rng: np.random.Generator) -> tuple[Cloud, Pose]:
    way, _ = place.course.sample(0.25)
    for _ in range(20):
        T = random_pose(way[int(rng.integers(len(way)))], rng)
        cloud = random_scan(place.world, T, model, rng)
        if len(cloud) >= _FEWEST:
            break
    return cloud, T


def write_global_pairs(folder: Path, pairs: Iterator[GlobalPair], stem: str) -> list[Path]:
    """Write pairs as NPZ files where they are not there yet, and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    done = folder / f"{stem}.done"
    if not done.exists():
        for k, pair in enumerate(pairs):
            np.savez(folder / f"{stem}_{k:03d}.npz", target=pair.target, source=pair.source, T=pair.truth,
                     overlap=pair.overlap, kind=pair.kind, name=pair.name, start=np.eye(4))  # fmt: skip
        done.touch()
    return sorted(folder.glob(f"{stem}_*.npz"))

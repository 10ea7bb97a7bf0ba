"""What a registration says it cannot see: alarms over draws of noise, remapping beside none, the cost of updates."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.config import AlignConfig
from heliograph.lie import se3
from heliograph.registration import InformationAnalysis, align, analyse_information, analyse_planes

__all__ = ["alarms", "blind_section", "remapping", "update_cost"]

Array = NDArray[np.float64]
_POINTS, _WEIGHT, _THRESHOLD = 1200, 2500.0, 1e5
_VARIANCE = 4e-4
_NOISE_DEG = (0.5, 2.0, 5.0)


def _faces(rng: np.random.Generator, ends: int) -> tuple[Array, Array]:
    """Return a corridor along x, closed by `ends` points on two walls."""
    cloud, normals = [], []
    for axis, side in ((1, 1.0), (1, -1.0), (2, 1.2), (2, -1.2)):
        p = rng.uniform((-12, -1, -1.2), (12, 1, 1.2), (_POINTS // 4, 3))
        p[:, axis] = side
        cloud.append(p)
        normals.append(np.tile(np.eye(3)[axis], (len(p), 1)))
    for x in (-12.0, 12.0):
        p = rng.uniform((x, -1, -1.2), (x, 1, 1.2), (ends // 2, 3))
        cloud.append(p)
        normals.append(np.tile([1.0, 0.0, 0.0], (len(p), 1)))
    return np.concatenate(cloud), np.concatenate(normals)


def _round(rng: np.random.Generator, keep: Array) -> tuple[Array, Array]:
    """Return a tube (`keep` 0, 1, 1) or a ball (1, 1, 1) of radius 2.5 m; the ball's centre is off the origin."""
    n = rng.normal(size=(_POINTS, 3)) * keep
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    along = rng.uniform(-12, 12, (_POINTS, 1)) * (1.0 - keep)
    return 2.5 * n + along + keep.min() * np.array([3.0, -2.0, 1.0]), n


def _ground(rng: np.random.Generator) -> tuple[Array, Array]:
    return rng.uniform((-8, -8, -1.5), (8, 8, -1.5), (_POINTS, 3)), np.tile([0.0, 0.0, 1.0], (_POINTS, 1))


_SCENES: dict[str, tuple[Callable[[np.random.Generator], tuple[Array, Array]], dict[str, list[int]]]] = {
    "corridor": (lambda rng: _faces(rng, 0), {"translation": [0]}),
    "tunnel": (lambda rng: _round(rng, np.array([0.0, 1.0, 1.0])), {"translation": [0], "rotation": [0]}),
    "plane": (_ground, {"translation": [0, 1], "rotation": [2]}),
    "sphere": (lambda rng: _round(rng, np.ones(3)), {"rotation": [0, 1, 2]}),
    "closed corridor": (lambda rng: _faces(rng, 60), {}),
}


def alarms(*, draws: int = 200) -> list[dict[str, Any]]:
    """Rates of missed and false alarms of the calibrated test and of one fixed threshold, by scene and noise."""
    rows = []
    for name, (make, blind) in _SCENES.items():
        for noise in _NOISE_DEG:
            sigma = np.radians(noise)
            counts = {"calibrated": np.zeros(2), "threshold": np.zeros(2)}
            for seed in range(draws):
                rng = np.random.default_rng(seed)
                points, normals = make(rng)
                turned = normals + sigma * rng.normal(size=normals.shape)
                turned /= np.linalg.norm(turned, axis=1, keepdims=True)
                weights = np.full(len(points), _WEIGHT)
                found = analyse_planes(points, turned, weights, np.full(len(points), sigma**2))
                counts["calibrated"] += _mistakes(found, blind)
                fixed = analyse_information(found.information, threshold=_THRESHOLD)
                counts["threshold"] += _mistakes(fixed, blind)
            for test, (missed, false) in counts.items():
                rows.append({"case": "alarms", "scene": name, "noise_deg": noise, "test": test, "draws": draws,
                             "missed": missed / draws, "false": false / draws})  # fmt: skip
    return rows


def _mistakes(found: InformationAnalysis, blind: dict[str, list[int]]) -> Array:
    """Whether a blind direction was missed or points elsewhere, and whether one was named that is seen."""
    missed = false = False
    for kind in ("rotation", "translation"):
        wanted = blind.get(kind, [])
        named = [d for d in getattr(found, kind) if d.blind]
        off = any(np.linalg.norm(d.direction[wanted]) < 0.98 for d in named) if wanted else bool(named)
        missed = missed or len(named) < len(wanted)
        false = false or len(named) > len(wanted) or off
    return np.array([missed, false], dtype=np.float64)


def remapping(*, draws: int = 20) -> list[dict[str, Any]]:
    """Align scans of a corridor from a start that is right along it: how far each way carries them off."""
    rows = []
    for remap in (True, False):
        errors = []
        for seed in range(draws):
            rng = np.random.default_rng(seed)
            truth = se3.exp([0.02, -0.03, 0.05, 0.4, 0.1, -0.05])
            start = truth @ se3.exp([0.02, 0.0, 0.03, 0.0, 0.05, 0.05])
            start[0, 3] = truth[0, 3]
            clouds = []
            for _ in range(2):
                points = np.concatenate([_faces(rng, 0)[0] for _ in range(10)])
                clouds.append(points + 0.02 * rng.normal(size=points.shape))
            source = se3.act(se3.inverse(truth), clouds[1]).astype(np.float32)
            config = AlignConfig(remap=remap)
            result = align(clouds[0].astype(np.float32), source, start=start, config=config)
            if result.T_target_source is not None:
                errors.append(result.T_target_source[:3, 3] - truth[:3, 3])
        e = np.array(errors)
        rows.append({"case": "remapping", "remap": remap, "along_mm": float(1e3 * np.sqrt(np.mean(e[:, 0] ** 2))),
                     "across_mm": float(1e3 * np.sqrt(np.mean(e[:, 1:] ** 2)))})  # fmt: skip
    return rows


def update_cost(*, states: int = 24) -> list[dict[str, Any]]:
    """Time one update of a filter with m residuals: by the information of the state, and by the textbook's gain."""
    rng = np.random.default_rng(0)
    P = np.diag(rng.uniform(0.01, 1.0, states))
    rows = []
    for m in (100, 300, 1000, 3000, 10_000, 30_000, 100_000):
        H, r = rng.normal(size=(m, states)), rng.normal(size=m)
        textbook = _seconds(lambda P=P, H=H, r=r: _by_gain(P, H, r)) if m <= 3000 else None
        ours = _seconds(lambda P=P, H=H, r=r: _by_information(P, H, r))
        rows.append({"case": "update", "points": m, "ours_ms": 1e3 * ours,
                     "textbook_ms": None if textbook is None else 1e3 * textbook})  # fmt: skip
    return rows


def _by_information(P: Array, H: Array, r: Array) -> Array:
    """Solve for the state: a matrix of its size, whatever the number of residuals."""
    return np.linalg.solve(H.T @ H / _VARIANCE + np.linalg.inv(P), H.T @ r / _VARIANCE)


def _by_gain(P: Array, H: Array, r: Array) -> Array:
    """Apply the textbook's gain: a matrix with a row and a column a residual."""
    return P @ H.T @ np.linalg.solve(H @ P @ H.T + _VARIANCE * np.eye(len(r)), r)


def _seconds(work: Callable[[], object]) -> float:
    best = np.inf
    for _ in range(5):
        begin = time.process_time()
        work()
        best = min(best, time.process_time() - begin)
    return float(best)


def _slope(rows: list[dict[str, Any]], key: str) -> float:
    """Power of the points that the time grows with, from the larger half of the sizes."""
    some = [(r["points"], r[key]) for r in rows if r[key]]
    x, y = np.log(np.array(some[-3:])).T
    return float(np.polyfit(x, y, 1)[0])


def blind_section(rows: list[dict[str, Any]], table: Callable[[Sequence[str], Sequence[Any]], str]) -> str:
    """Return alarms, remapping and update cost."""
    text = "## Degeneracy\n\n"
    found = [r for r in rows if r["case"] == "alarms"]
    body = []
    for scene, noise in dict.fromkeys((r["scene"], r["noise_deg"]) for r in found):
        pair = {r["test"]: r for r in found if (r["scene"], r["noise_deg"]) == (scene, noise)}
        rates = [
            f"{100 * pair[test][kind]:.1f}" for test in ("calibrated", "threshold") for kind in ("missed", "false")
        ]
        body.append([scene, f"{noise:g}", *rates])
    head = ["scene", "noise deg", "missed %", "false %", "threshold: missed %", "threshold: false %"]
    text += table(head, body)
    if found:
        text += (
            f"\n{found[0]['draws']} draws each of {_POINTS} points whose normals are turned by noise; alarms of "
            "`analyse_planes`, which knows the noise, beside one fixed eigenvalue for all. Missed: a blind direction "
            "was not named; false: one that is seen was, or a wrong one.\n"
        )
    kept = {r["remap"]: r for r in rows if r["case"] == "remapping"}
    if len(kept) == 2:
        on, off = kept[True], kept[False]
        text += (
            f"\nA corridor aligned from a start that is right along it: {on['along_mm']:.1f} mm off along it with "
            f"remapping, {off['along_mm']:.1f} without; across {on['across_mm']:.1f} and {off['across_mm']:.1f} mm.\n"
        )
    cost = [r for r in rows if r["case"] == "update"]
    if cost:
        numbers = [
            [r["points"], f"{r['ours_ms']:.3f}", f"{r['textbook_ms']:.1f}" if r["textbook_ms"] else "-"] for r in cost
        ]
        text += "\nOne update of 24 states:\n\n" + table(["points", "information ms", "textbook gain ms"], numbers)
        text += (
            f"\nFitted to the three largest sizes of each, time grows with the points to the power "
            f"{_slope(cost, 'ours_ms'):.2f}, and {_slope(cost, 'textbook_ms'):.2f} for the gain `P Hᵀ (H P Hᵀ + R)⁻¹`, "
            "whose matrix has a row and a column a point; it is left out where it would not fit.\n"
        )
    return text

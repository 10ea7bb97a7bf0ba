"""Registration of two clouds beside small_gicp and Open3D: simulated pairs with exact truth, and one real pair."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.registration_pairs import pose_error, write_pairs
from heliograph.io.files.clouds import read_cloud
from heliograph.lie import se3, so3

__all__ = ["SYSTEMS", "compare_pairs", "compare_starts", "registration_section"]

SYSTEMS = (
    ("heliograph", "gicp"), ("heliograph", "vgicp"), ("heliograph", "point-to-plane"), ("small_gicp", "GICP"),
    ("small_gicp", "VGICP"), ("small_gicp", "PLANE_ICP"), ("open3d", "GICP"), ("open3d", "point-to-plane"),
)  # fmt: skip
_WORKER = Path(__file__).with_name("registration_worker.py")
_Floats = NDArray[np.float64]
_RIGHT, _RIGHT_DEG = 0.1, 1.0
_NEAR, _NEAR_DEG = 0.05, 0.5


class _Worker:
    """A system in a process of its own, which answers one pair at a time."""

    def __init__(self, python: Path, system: str, method: str) -> None:
        self._child = subprocess.Popen(
            [python, _WORKER, system, method],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip

    def ask(self, file: Path) -> dict[str, Any] | None:
        """Return the answer for one pair; None where the system cannot run here."""
        assert self._child.stdin is not None and self._child.stdout is not None
        try:
            print(file, file=self._child.stdin, flush=True)
        except BrokenPipeError:
            return None
        line = self._child.stdout.readline()
        return json.loads(line) if line else None

    def close(self) -> None:
        """End it."""
        self._child.stdin.close() if self._child.stdin else None
        self._child.wait()


def _alternated(files: Sequence[Path], python_of: Callable[[str], Path]) -> dict[tuple[str, str], list[Any]]:
    """Let every system answer a pair before any answers the next."""
    workers = {key: _Worker(python_of(key[0]), *key) for key in SYSTEMS}
    answers: dict[tuple[str, str], list[Any]] = {key: [] for key in SYSTEMS}
    for file in (files[0], *files):  # the first pair twice: it pays for what is loaded once
        for key, worker in workers.items():
            answers[key].append(worker.ask(file))
    for worker in workers.values():
        worker.close()
    return {key: some[1:] for key, some in answers.items() if all(a is not None for a in some)}


def compare_pairs(work: Path, python_of: Callable[[str], Path], *, count: int, seed: int) -> list[dict[str, Any]]:
    """Align simulated pairs with every system in turn; one row a system."""
    files = write_pairs(work / "pairs", count, seed)
    truths = [np.load(file)["T"] for file in files]
    rows = []
    for (system, method), answers in _alternated(files, python_of).items():
        errors = np.array([pose_error(np.array(a["T"]), T) for a, T in zip(answers, truths, strict=True)])
        right = (errors[:, 0] < _RIGHT) & (np.degrees(errors[:, 1]) < _RIGHT_DEG)
        rows.append(_row("pairs", system, method, errors, right, answers))
    return rows


def compare_starts(data: Path, work: Path, python_of: Callable[[str], Path], *, starts: int) -> list[dict[str, Any]]:
    """Align the real pair from starts half a metre and ten degrees off; one row a system."""
    target, source = (read_cloud(data / f"{name}.ply").points for name in ("target", "source"))
    truth = np.loadtxt(data / "T_target_source.txt")
    rng, files = np.random.default_rng(0), []
    work.mkdir(parents=True, exist_ok=True)
    for k in range(starts):
        axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        off = se3.from_rotation_translation(so3.exp(np.radians(10.0) * axis), 0.5 * way)
        files.append(work / f"start_{k:02d}.npz")
        np.savez(files[-1], target=target, source=source, start=truth @ off)
    rows = []
    for (system, method), answers in _alternated(files, python_of).items():
        errors = np.array([pose_error(np.array(a["T"]), truth) for a in answers])
        right = (errors[:, 0] < _NEAR) & (np.degrees(errors[:, 1]) < _NEAR_DEG)
        rows.append(_row("starts", system, method, errors, right, answers))
    return rows


def _row(
    case: str, system: str, method: str, errors: _Floats, right: NDArray[np.bool_], answers: Sequence[Any]
) -> dict[str, Any]:
    good = errors[right] if right.any() else np.full((1, 2), np.nan)
    return {
        "case": case,
        "system": system,
        "method": method,
        "pairs": len(errors),
        "success": float(right.mean()),
        "median_mm": float(1e3 * np.median(good[:, 0])),
        "rmse_mm": float(1e3 * np.sqrt(np.mean(good[:, 0] ** 2))),
        "median_deg": float(np.degrees(np.median(good[:, 1]))),
        "cpu_ms": float(np.median([a["cpu_ms"] for a in answers])),
        "wall_ms": float(np.median([a["wall_ms"] for a in answers])),
    }


def registration_section(rows: list[dict[str, Any]], table: Callable[[Sequence[str], Sequence[Any]], str]) -> str:
    """Return both tables with what they are held against."""
    head = ["system", "method", "success", "median mm", "rmse mm", "median deg", "cpu ms", "wall ms"]
    text = "## Registration of two clouds\n\n"
    for case, title in (("pairs", "simulated pairs"), ("starts", "starts of one real pair")):
        some = [r for r in rows if r["case"] == case]
        if not some:
            continue
        body = [[r["system"], r["method"], f"{r['success']:.3f}", f"{r['median_mm']:.2f}", f"{r['rmse_mm']:.2f}",
                 f"{r['median_deg']:.4f}", f"{r['cpu_ms']:.1f}", f"{r['wall_ms']:.1f}"] for r in some]  # fmt: skip
        text += f"{some[0]['pairs']} {title}:\n\n" + table(head, body) + "\n" + _verdict(some) + "\n"
    return text + (
        "\nOne thread each, every system on a pair before any on the next; thinning, normals, trees are in the time. "
        "Simulated: warehouse, room, street and aisles seen by 32, 64 or 128 beams, overlaps of 0.3 to 1, starts up to "
        "1 m and 15 degrees off; right is within 0.1 m and 1 degree, errors are of the right ones. The real pair "
        "(small_gicp's example) is right within 50 mm and 0.5 degrees of a rival's answer, which is all the truth that "
        "there is. Rivals: 0.25 m leaf, 1 m gate, 30 iterations. On a busy machine the processor's time is the one to "
        "compare.\n"
    )


def _verdict(rows: list[dict[str, Any]]) -> str:
    """Say how ours stand beside the best rival."""
    ours = [r for r in rows if r["system"] == "heliograph"]
    rivals = [r for r in rows if r["system"] != "heliograph"]
    if not ours or not rivals:
        return ""
    best = max(r["success"] for r in rivals)
    accurate = min(r["median_mm"] for r in rivals if r["success"] >= best - 0.02)
    fastest = min(r["cpu_ms"] for r in rivals if r["success"] >= best - 0.02)
    lines = []
    for r in ours:
        accuracy, speed = r["median_mm"] / accurate, r["cpu_ms"] / fastest
        lines.append(f"{r['method']}: success {r['success']:.3f} (best rival {best:.3f}), median error {accuracy:.2f} ")
        lines.append(f"and time {speed:.2f} of the best rival that is as often right (bars: 0.5 each).\n")
    return "".join(lines)

"""Draw the pictures of docs/failures.md: simulated recordings run as they are, and run with one thing wrong.

    python docs/figures/failures.py docs/images

Each picture has the healthy map on the left and the failure on the right, both from above or from the side.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.cli.main import main
from heliograph.io.files.clouds import read_cloud
from heliograph.report.colors import HEIGHT, scale
from heliograph.report.png import encode_png
from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording

Array = NDArray[np.float64]
SECONDS = 10.0
SIZE, GAP = 420, 12  # pixels of a panel, between the two
WRONG_MOUNTING = "[T_imu_lidar]\ntranslation = [0.3, -0.2, 0.0]\nquaternion_xyzw = [0.0, 0.0, 0.0871557, 0.9961947]\n"


def run(recording: Path, out: Path, *options: str) -> NDArray[np.float64]:
    """Run a recording and return its map."""
    if main(["run", str(recording), "-o", str(out), "-q", "--keep-moving", *options]):
        sys.exit(f"{out.name} did not run")
    return read_cloud(out / "map.ply").points.astype(np.float64)


def panel(
    points: NDArray[np.float64], axes: tuple[int, int], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """Return points seen along the third axis as a square picture, brighter where there are more."""
    step = float((high - low).max()) / SIZE
    cells = np.floor((points[:, axes] - low) / step).astype(np.int64)
    inside = ((cells >= 0) & (cells < SIZE)).all(axis=1)
    counts = np.zeros((SIZE, SIZE))
    np.add.at(counts, (SIZE - 1 - cells[inside, 1], cells[inside, 0]), 1.0)
    share = np.minimum(np.log1p(counts) / max(np.log1p(np.percentile(counts[counts > 0], 95)), 1e-9), 1.0)
    picture = scale(HEIGHT)[(share * 255).astype(np.int64)]
    return np.where(counts[..., None] > 0, picture, [13.0, 19.0, 28.0]).astype(np.uint8)


def beside(
    file: Path, healthy: NDArray[np.float64], failed: NDArray[np.float64], axes: tuple[int, int] = (0, 1)
) -> None:
    """Write two maps side by side at one scale."""
    low = np.percentile(healthy[:, axes], 0.5, axis=0) - 0.7
    high = np.percentile(healthy[:, axes], 99.5, axis=0) + 0.7
    middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
    panels = [panel(points, axes, middle - half, middle + half) for points in (healthy, failed)]
    bar = np.full((SIZE, GAP, 3), 255, dtype=np.uint8)
    file.write_bytes(encode_png(np.concatenate([panels[0], bar, panels[1]], axis=1)))


def draw(images: Path, work: Path) -> None:
    """Make all six."""
    room = work / "room"
    write_recording(room, SCENARIOS["room"].thinned(beams=32, columns=512, duration=SECONDS), seed=1)
    healthy = run(room, work / "healthy")
    walls = healthy[(healthy[:, 2] > -0.3) & (healthy[:, 2] < 0.5)]

    def level(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return points[(points[:, 2] > -0.3) & (points[:, 2] < 0.5)]

    (work / "mounting.toml").write_text(WRONG_MOUNTING)
    plain = ["--no-repair", "--no-loops"]
    failed = run(room, work / "mounting", "--extrinsic", str(work / "mounting.toml"), *plain)
    beside(images / "failure_mounting.png", walls, level(failed))
    late = work / "late"
    scenario = SCENARIOS["room"].varied(imu={"clock_offset": 0.08}).thinned(beams=32, columns=512, duration=SECONDS)
    write_recording(late, scenario, seed=1)
    beside(images / "failure_clock.png", walls, level(run(late, work / "clock", *plain)))
    failed = run(room, work / "smear", "--set", "cloud.deskew=off", *plain)
    beside(images / "failure_smear.png", walls, level(failed))
    failed = run(room, work / "tilt", "--sensors", "lidar", *plain)
    beside(images / "failure_tilt.png", healthy, failed, (0, 2))
    shifted = healthy.copy()
    turn = np.array([[np.cos(0.12), -np.sin(0.12)], [np.sin(0.12), np.cos(0.12)]])
    shifted[:, :2] = shifted[:, :2] @ turn.T + [0.9, -0.5]
    beside(images / "failure_loop.png", walls, level(np.concatenate([healthy, shifted])))
    tunnel = work / "tunnel"
    write_recording(tunnel, SCENARIOS["tunnel"].thinned(beams=16, columns=256, duration=12.0), seed=1)
    beside(
        images / "failure_tunnel.png",
        run(tunnel, work / "through"),
        run(tunnel, work / "blind", "--sensors", "lidar", *plain),
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        draw(Path(sys.argv[1]), Path(folder))

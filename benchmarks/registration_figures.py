"""Pictures of `docs/theory/registration.md`: python -m benchmarks.registration_figures FOLDER."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from heliograph.config import AlignConfig, RunConfig
from heliograph.lie import se3
from heliograph.odometry import make_odometry
from heliograph.registration import align
from heliograph.sim import SCENARIOS, simulate

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

Array = NDArray[np.float64]


def two_walls(seed: int = 0) -> tuple[Array, Array, Array]:
    """Return two scans of two walls that meet and the floor between them, and the pose of the second."""
    rng = np.random.default_rng(seed)
    clouds = []
    for _ in range(2):
        faces = []
        for axis, place in ((0, 4.0), (1, 4.0), (2, -1.5)):
            p = rng.uniform((-4, -4, -1.5), (4, 4, 2.0), (6000, 3))
            p[:, axis] = place + 0.01 * rng.normal(size=len(p))
            faces.append(p)
        clouds.append(np.concatenate(faces))
    truth = se3.exp([0.01, -0.02, 0.06, 0.25, -0.2, 0.05])
    return clouds[0], se3.act(se3.inverse(truth), clouds[1]), truth


def settling(method: str, most: int = 30) -> list[float]:
    """Return the error [m] after each iteration on one level."""
    target, source, truth = two_walls()
    a, b = target.astype(np.float32), source.astype(np.float32)
    errors = [float(np.linalg.norm(truth[:3, 3]))]
    for k in range(1, most + 1):
        config = AlignConfig(levels=1, gate=4.0, kernel=0.0, iterations=k, remap=False)
        T = align(a, b, method=method, config=config).T_target_source
        errors.append(float("nan") if T is None else float(np.linalg.norm((se3.inverse(truth) @ T)[:3, 3])))
    return errors


def _draw_settling(ax: Axes) -> None:
    for method in ("point-to-plane", "point-to-point"):
        ax.semilogy(1e3 * np.array(settling(method)), marker=".", label=method)
    ax.set(xlabel="iterations", ylabel="error [mm]", title="Two walls and a floor")
    ax.legend()


def _draw_cost(ax: Axes) -> None:
    lines = (Path(__file__).parent / "results" / "blind.jsonl").read_text().splitlines()
    rows = [r for r in map(json.loads, lines) if r["case"] == "update"]
    points = np.array([r["points"] for r in rows])
    ax.loglog(points, [r["ours_ms"] for r in rows], marker=".", label="information, 24 x 24")
    some = [(r["points"], r["textbook_ms"]) for r in rows if r["textbook_ms"] is not None]
    ax.loglog(*zip(*some, strict=True), marker=".", label="textbook gain, m x m")
    ax.set(xlabel="points m", ylabel="ms", title="One update of the filter")
    ax.legend()


def _draw_tunnel(ax: Axes) -> None:
    # The beams end before the tunnel does, so nothing but its niches tells where along it the sensor is.
    scenario = SCENARIOS["tunnel"].thinned(beams=32, columns=256, duration=30.0).varied(lidar={"max_range": 15.0})
    simulation = simulate(scenario, seed=1, threads=1)
    for label, sensors in (("with the IMU", {"lidar", "imu"}), ("without", {"lidar"})):
        odometry = make_odometry(RunConfig(), simulation.rig, frozenset(sensors), threads=1)
        messages = [m for m in simulation if "imu" in sensors or hasattr(m, "points")]
        results = [r for m in messages for r in odometry.add(m)] + odometry.finish()
        ends = np.array([r.end_ns for r in results])
        truth = simulation.truth.pose(ends)
        # The first pose of a run is its own frame: motion since then, along the tunnel, beside the truth's.
        gone = np.linalg.norm(np.stack([r.T_odom_imu[:3, 3] - results[0].T_odom_imu[:3, 3] for r in results]), axis=1)
        true = np.linalg.norm(truth[:, :3, 3] - truth[0, :3, 3], axis=1)
        seconds = (ends - ends[0]) * 1e-9
        ax.plot(seconds, gone - true, label=label)
        print(f"tunnel {label}: {gone[-1] - true[-1]:+.2f} m of {true[-1]:.1f} m at the end")
    ax.set(xlabel="time [s]", ylabel="along the tunnel, too far by [m]", title="A tunnel that shows no motion")
    ax.legend()


def main() -> None:
    """Draw the three."""
    folder = Path(sys.argv[1])
    for name, draw in (("two_walls", _draw_settling), ("update_cost", _draw_cost), ("tunnel", _draw_tunnel)):
        figure, ax = plt.subplots(figsize=(6.0, 3.4), layout="constrained")
        draw(ax)
        ax.grid(alpha=0.3)
        figure.savefig(folder / f"{name}.png", dpi=110)
        plt.close(figure)


if __name__ == "__main__":
    main()

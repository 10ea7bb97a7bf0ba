"""A tunnel shows no motion along itself. The log of every scan says so: which direction, and how badly.

python examples/tunnel_degeneracy.py FIGURE.png [SECONDS]
"""

from __future__ import annotations

import sys

import matplotlib as mpl
import numpy as np

from heliograph.config import RunConfig
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, simulate

mpl.use("Agg")
from matplotlib import pyplot as plt


def main() -> None:
    scenario = SCENARIOS["tunnel"].thinned(
        beams=32, columns=256, duration=float(sys.argv[2]) if len(sys.argv) > 2 else 40
    )
    simulation = simulate(scenario, seed=1, threads=2)
    config = RunConfig()
    odometry = make_odometry(config, simulation.rig, frozenset({"lidar", "imu"}), threads=2)
    results = [result for message in simulation for result in odometry.add(message)] + odometry.finish()
    seconds = np.array([r.end_ns - results[0].end_ns for r in results]) * 1e-9
    # Shares of the translation information: they sum to 1, and 1/3 each would be even in all directions.
    shares = np.stack([r.eigenvalues_translation for r in results])
    p = np.stack([r.T_odom_imu[:2, 3] for r in results])
    heading = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
    along = np.abs(np.stack([r.weak_direction[:2] for r in results]) @ heading)
    blind = np.array([r.status == "degenerate" for r in results])
    sigma = np.array([np.sqrt(heading @ r.pose_covariance[3:5, 3:5] @ heading) for r in results])
    print(f"{blind.sum()} of {len(results)} scans are degenerate; least share of information {shares[1:, 0].min():.4f}")
    if blind.any():
        print(f"in those the weak direction lies along the tunnel: cosine {np.median(along[blind]):.3f}")
    p_truth = simulation.truth.pose(np.array([r.end_ns for r in results]))[:, :2, 3]
    error = np.linalg.norm(p - p[0], axis=1) - np.linalg.norm(p_truth - p_truth[0], axis=1)
    print(f"along the tunnel at the end: 1-sigma {sigma[-1]:.3f} m, error {error[-1]:+.3f} m")

    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(8, 6), layout="constrained")
    upper.semilogy(seconds[1:], np.maximum(shares[1:], 1e-6))
    upper.axhline(config.filter.degenerate_translation, color="k", ls=":")
    upper.set(ylabel="share of the information")
    upper.legend(["weakest", "middle", "strongest", "counts as blind"])
    lower.plot(seconds, np.abs(error), seconds, sigma)
    lower.set(xlabel="time [s]", ylabel="along the tunnel [m]")
    lower.legend(["error", "1-sigma"])
    figure.savefig(sys.argv[1], dpi=100)


if __name__ == "__main__":
    main()

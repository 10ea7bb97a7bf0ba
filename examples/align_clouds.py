"""Two scans of a room and of a corridor: the pose between them, its sigmas, and what could not be seen.

python examples/align_clouds.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heliograph.lie import se3
from heliograph.registration import AlignResult, align


def walls(rng: np.random.Generator, *, ends: bool) -> NDArray[np.float64]:
    """Return points on floor, ceiling and two walls along x, and on the walls that close it where asked."""
    a, b = rng.uniform(-1.0, 1.0, (2, 20000))
    one = np.ones_like(a)
    sides = [(12 * a, 2 * b, -1.2 * one), (12 * a, 2 * b, 1.2 * one), (12 * a, 2 * one, 1.2 * b), (12 * a, -2 * one, b)]
    if ends:
        sides += [(12 * one, 2 * a, 1.2 * b), (-12 * one, 2 * a, 1.2 * b)]
    cloud = np.concatenate([np.stack(side, axis=1) for side in sides])
    return np.asarray(cloud + 0.02 * rng.normal(size=cloud.shape))


def report(name: str, result: AlignResult, truth: NDArray[np.float64]) -> None:
    """Print a result beside the truth."""
    print(f"{name}: {result.status} after {result.iterations} iterations, {result.inliers} inliers")
    print(f"  overlap {result.overlap_source:.0%} of the source, {result.overlap_target:.0%} of the target")
    if result.T_target_source is None or result.covariance is None:
        return
    error, sigma = se3.log(se3.inverse(truth) @ result.T_target_source), np.sqrt(np.diag(result.covariance))
    print("  error  [mrad, mm]", np.round(1e3 * error, 2))
    print("  sigma  [mrad, mm]", np.round(1e3 * sigma, 2))
    for blind in result.observability.blind if result.observability else ():
        print(f"  not observable: {blind}, probability {blind.probability:.2f}")


def main() -> None:
    """Align both pairs."""
    rng = np.random.default_rng(0)
    truth = se3.exp([0.02, -0.03, 0.10, 0.4, 0.1, -0.05])
    for name, ends in (("room", True), ("corridor", False)):
        target = walls(rng, ends=ends).astype(np.float32)
        source = se3.act(se3.inverse(truth), walls(rng, ends=ends)).astype(np.float32)
        report(name, align(target, source), truth)


if __name__ == "__main__":
    main()

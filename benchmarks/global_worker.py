"""One system that aligns pairs without a start, in its own environment: files in, one JSON line a pair out."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cloud = NDArray[np.float32]
Answer = dict[str, Any]


def heliograph(_method: str) -> Callable[[Cloud, Cloud], Answer]:
    """Return ours with its defaults."""
    from heliograph.registration import align

    def run(target: Cloud, source: Cloud) -> Answer:
        result = align(target, source, start="global")
        T = result.T_target_source
        best = result.start if T is None else T
        return {"T": best.tolist(), "accepted": T is not None, "reason": result.reason}

    return run


def kiss_matcher(method: str) -> Callable[[Cloud, Cloud], Answer]:
    """Return KISS-Matcher with the given voxel [m], refined by small_gicp; accepted by its count of inliers."""
    import kiss_matcher as package
    import small_gicp

    config = package.KISSMatcherConfig(float(method))

    def run(target: Cloud, source: Cloud) -> Answer:
        matcher = package.KISSMatcher(config)
        found = matcher.estimate(source, target)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = found.rotation, np.asarray(found.translation).ravel()
        if found.valid:
            T = small_gicp.align(
                target.astype(np.float64), source.astype(np.float64), init_T_target_source=T, registration_type="GICP",
                downsampling_resolution=0.25, max_correspondence_distance=1.0, num_threads=1, max_iterations=30,
            ).T_target_source  # fmt: skip
        inliers = matcher.get_num_final_inliers()
        return {"T": T.tolist(), "accepted": bool(found.valid) and inliers >= 5, "inliers": inliers}

    return run


def main() -> None:
    """Answer pair after pair."""
    system, method = sys.argv[1:3]
    run = {"heliograph": heliograph, "kiss_matcher": kiss_matcher}[system](method)
    for line in sys.stdin:
        with np.load(line.strip()) as pair:
            target, source = pair["target"], pair["source"]
        cpu, wall = time.process_time(), time.perf_counter()
        answer = run(target, source)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        print(json.dumps({**answer, "cpu_ms": 1e3 * cpu, "wall_ms": 1e3 * wall}), flush=True)


if __name__ == "__main__":
    main()

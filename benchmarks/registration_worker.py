"""One system that aligns pairs, in its own environment: files in on standard input, one JSON line a pair out."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_LEAF, _GATE, _ITERATIONS = 0.25, 1.0, 30
Cloud = NDArray[np.float32]
Pose = NDArray[np.float64]
Align = Callable[[Cloud, Cloud, Pose], Pose]


def heliograph(method: str) -> Align:
    """Return ours with its defaults."""
    from heliograph.registration import align

    def run(target: Cloud, source: Cloud, start: Pose) -> Pose:
        T = align(target, source, start=start, method=method).T_target_source
        return np.eye(4) if T is None else T

    return run


def small_gicp(method: str) -> Align:
    """Return small_gicp with a 25 cm leaf and a gate of 1 m."""
    import small_gicp as package

    return lambda target, source, start: package.align(
        target.astype(np.float64), source.astype(np.float64), init_T_target_source=start, registration_type=method,
        voxel_resolution=1.0, downsampling_resolution=_LEAF, max_correspondence_distance=_GATE, num_threads=1,
        max_iterations=_ITERATIONS,
    ).T_target_source  # fmt: skip


def open3d(method: str) -> Align:
    """Return Open3D with the same leaf and gate."""
    import open3d as package

    pipelines = package.pipelines.registration
    criteria = pipelines.ICPConvergenceCriteria(max_iteration=_ITERATIONS)
    search = package.geometry.KDTreeSearchParamKNN(10)

    def run(target: Cloud, source: Cloud, start: Pose) -> Pose:
        clouds = []
        for points in (target, source):
            vector = package.utility.Vector3dVector(points.astype(np.float64))
            cloud = package.geometry.PointCloud(vector).voxel_down_sample(_LEAF)
            cloud.estimate_normals(search)
            clouds.append(cloud)
        if method == "GICP":
            kind = pipelines.TransformationEstimationForGeneralizedICP()
            return pipelines.registration_generalized_icp(
                clouds[1], clouds[0], _GATE, start, kind, criteria
            ).transformation
        kind = pipelines.TransformationEstimationPointToPlane()
        return np.asarray(pipelines.registration_icp(clouds[1], clouds[0], _GATE, start, kind, criteria).transformation)

    return run


def main() -> None:
    """Answer pair after pair."""
    system, method = sys.argv[1:3]
    run = {"heliograph": heliograph, "small_gicp": small_gicp, "open3d": open3d}[system](method)
    for line in sys.stdin:
        with np.load(line.strip()) as pair:
            target, source, start = pair["target"], pair["source"], pair["start"]
        cpu, wall = time.process_time(), time.perf_counter()
        T = np.asarray(run(target, source, np.ascontiguousarray(start)))
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        print(json.dumps({"T": T.tolist(), "cpu_ms": 1e3 * cpu, "wall_ms": 1e3 * wall}), flush=True)


if __name__ == "__main__":
    main()

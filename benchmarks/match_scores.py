"""How far the matches of a scan err together: their score at the true pose, against a map made of true poses.

With all matches independent, the pose that a scan would correct to, in units of its own covariance, is a unit normal an
axis. Its mean square tells how many matches count as one within a scan; the mean square of its mean over 50 scans, how
much of that is the same error again in each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from heliograph.arrays import Array, Points
from heliograph.cloud import deskew, range_gate
from heliograph.config import RunConfig
from heliograph.data import Scan
from heliograph.maps import VoxelMap
from heliograph.odometry.filter.matching import AdaptiveNoise, Thinning
from heliograph.registration import MatchSettings, linearize, true_share
from heliograph.sim import SCENARIOS, Scenario, simulate

__all__ = ["SCORE_SCENARIOS", "measure_scores", "scores_section"]

_Rows = list[dict[str, Any]]
_SETTLES = 5  # scans until the noise has been learnt
_BLOCK = 50
_PATH_POINTS = 25  # of the true path within a sweep

SCORE_SCENARIOS: dict[str, Scenario] = {
    name: SCENARIOS[name].thinned(beams=32, columns=512, duration=16.0)
    for name in ("room", "demo", "warehouse", "storeys")
}


def measure_scores(names: Sequence[str], *, seeds: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Yield one row a recording."""
    for seed in seeds:
        for name in names:
            z, matches = _scores(SCORE_SCENARIOS[name], seed)
            blocks = z[: len(z) // _BLOCK * _BLOCK].reshape(-1, _BLOCK, 6).mean(axis=1)
            together = float(np.mean(blocks**2))
            own = float(np.mean(z**2))
            lasting = max(together - own / _BLOCK, 0.0)
            yield {
                "scenario": name,
                "seed": seed,
                "scans": len(z),
                "square": own,
                "lasting": together,
                "lasting_axes": np.mean(blocks**2, axis=0).tolist(),
                "systematic": float(np.sqrt(lasting * 3.0 / matches)),
            }


def _scores(scenario: Scenario, seed: int) -> tuple[Array, float]:
    """Return the whitened errors of pose, (N, 6), and the usual number of matches."""
    config, simulation = RunConfig(), simulate(scenario, seed)
    local_map, thinning = VoxelMap(config.map), Thinning(config.cloud)
    noise, z, matches = AdaptiveNoise(config.filter.sigma), [], []
    for scan in simulation:
        if not isinstance(scan, Scan):
            continue
        points, T = _deskewed(scan, simulation, config)
        picked = thinning.pick(points)
        if len(local_map) > 0:
            scale = config.filter.kernel * noise.sigma
            settings = MatchSettings(
                gate=config.filter.gate * scale,
                kernel=scale,
                sigma=noise.sigma,
                fallback_stride=config.filter.fallback_stride,
            )
            sums = linearize(local_map, np.ascontiguousarray(points[picked]), T, settings)
            found = true_share(sums)
            covariance = np.linalg.pinv(found.information())
            z.append(covariance @ found.gradient(sums.gradient) / np.sqrt(np.diag(covariance)))
            matches.append(sums.matches)
            noise = noise.updated(sums.rms, config.filter)
        local_map.insert(points, T)
    return np.array(z[_SETTLES:]), float(np.median(matches))


def _deskewed(scan: Scan, simulation: Any, config: RunConfig) -> tuple[Points, Array]:  # noqa: ANN401
    """Return the points of a scan in the imu frame at its end, by the true motion, and the true pose there."""
    keep = range_gate(scan.points, config.cloud.min_range, config.cloud.max_range)
    stamps = np.unique(np.linspace(scan.stamp_ns, scan.end_ns, _PATH_POINTS).astype(np.int64))
    motion = simulation.truth.motion(stamps)
    points = deskew(
        scan.points[keep],
        scan.offsets_ns[keep],
        stamp_ns=scan.stamp_ns,
        path_stamps_ns=stamps,
        R_odom_body=motion.R_world_body,
        p_odom=motion.p_world,
        T_body_lidar=simulation.rig.T_imu_lidar,
        threads=1,
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = motion.R_world_body[-1], motion.p_world[-1]
    return points, T


def scores_section(rows: _Rows, table: Callable[[Sequence[str], Sequence[Any]], str]) -> str:
    """Return the table: a line a scenario."""
    body = []
    for name in dict.fromkeys(r["scenario"] for r in rows):
        some = [r for r in rows if r["scenario"] == name]
        own, lasting, share = (float(np.mean([r[k] for r in some])) for k in ("square", "lasting", "systematic"))
        worst = max(max(r["lasting_axes"]) for r in some)
        body.append([name, len(some), f"{own:.2f}", f"{lasting:.3f}", f"{worst:.2f}", f"{share:.4f}"])
    head = ["scenario", "seeds", "mean square", "of the mean over 50 scans", "its worst axis", "systematic"]
    text = (
        "## Matches that err together\n\nScores of scans at their true poses, all matches counted as independent.\n\n"
    )
    return text + table(head, body)

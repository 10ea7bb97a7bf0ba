"""A second lap in a saved map of which a fifth has changed: errors in the map's frame, and whether the sigmas hold."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from heliograph.arrays import Array
from heliograph.cli.main import main
from heliograph.config import RunConfig
from heliograph.io import read_tum
from heliograph.lie import se3, so3
from heliograph.localization import Localizer, open_map
from heliograph.metrics import align
from heliograph.odometry import make_odometry
from heliograph.sim import SCENARIOS, Simulation, Truth, simulate
from heliograph.sim.simulate import EPOCH_NS
from heliograph.sim.world import Primitive, SimulatedWorld
from heliograph.sim.write import write_recording

__all__ = ["changed_world", "measure"]

_MOVABLE = 3.1  # largest half-extent of what somebody moves: cartons, containers [m]
_SMALLEST = 0.15  # a post or a deck stays [m]


def changed_world(world: SimulatedWorld, share: float, rng: np.random.Generator) -> tuple[SimulatedWorld, list[int]]:
    """Move things until ``share`` of those that can be moved are elsewhere; return the world and which they are."""
    things = list(world.primitives)
    movable = [
        k for k, p in enumerate(things) if p.shape == "box" and p.half.min() > _SMALLEST and p.half.max() < _MOVABLE
    ]
    moved = sorted(rng.choice(movable, round(share * len(movable)), replace=False).tolist())
    for k in moved:
        things[k] = _elsewhere(things[k], rng)
    return SimulatedWorld(things), moved


def _elsewhere(thing: Primitive, rng: np.random.Generator) -> Primitive:
    """Return a thing pushed a way along its own length, turned a little, and now and then of another size."""
    along = thing.R_world_local[:, int(np.argmax(thing.half[:2]))]
    center = thing.center + rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.6) * along
    turned = thing.R_world_local @ so3.from_rpy(0.0, 0.0, rng.normal(0.0, 0.1))
    return replace(thing, center=center, R_world_local=turned, half=thing.half * rng.uniform(0.7, 1.0, 3))


def measure(name: str, seed: int, share: float, *, columns: int = 512) -> dict[str, Any]:
    """Map one lap, change the world, localise a second lap, and compare with the truth."""
    scenario = SCENARIOS[name].thinned(columns=columns)
    rng = np.random.default_rng([31, seed])
    first = simulate(scenario, seed)
    second = simulate(scenario, seed + 1)  # another body, other noise, the same course
    second.world, moved = changed_world(first.world, share, rng)
    with TemporaryDirectory() as folder:
        root = Path(folder)
        write_recording(root / "first", scenario, seed)
        main(["run", str(root / "first" / "recording.mcap"), "-o", str(root / "map")])
        facts = _lap(root / "map", _map_in_world(root / "map", first.truth), second)
    return {
        "scenario": name,
        "seed": seed,
        "share_of_things": share,
        "share_of_returns": _share_seen(second, set(moved)),
        **facts,
    }


def _share_seen(simulation: Simulation, moved: set[int]) -> float:
    """Return the share of the second lap's returns that lie on what has moved, by one sweep in twenty."""
    lidar, world = simulation.scenario.lidar, simulation.world
    stamps = np.arange(EPOCH_NS, EPOCH_NS + simulation.duration_ns, 2_000_000_000)
    hit = on_moved = 0
    for T in simulation.truth.lidar_pose(stamps):
        poses = np.tile(T, (lidar.columns, 1, 1))
        seen = world.cast(lidar.directions(), poses, min_range=lidar.min_range, max_range=lidar.max_range).primitive
        hit += int((seen >= 0).sum())
        on_moved += int(np.isin(seen, list(moved)).sum())
    return round(on_moved / max(hit, 1), 3)


def _lap(folder: Path, T_world_map: Array, second: Simulation) -> dict[str, Any]:
    config = RunConfig()
    localizer = Localizer(open_map(folder, config), config)
    odometry = make_odometry(config, second.rig, frozenset({"lidar", "imu"}), 1)
    errors, squared, states, matching, tracking = [], [], [], 0.0, 0.0
    for message in second:
        began = time.process_time()
        results = odometry.add(message)
        between = time.process_time()
        for result in results:
            found = localizer.add(result)
            states.append(found.state)
            if found.T_map_imu is not None and found.covariance is not None:
                T_world_imu = second.truth.pose(np.array([result.end_ns]))[0]
                e = se3.log(se3.inverse(T_world_map @ found.T_map_imu) @ T_world_imu)
                errors.append(e)
                squared.append(float(e @ np.linalg.solve(found.covariance, e)))
        matching += between - began
        tracking += time.process_time() - between
    off = np.linalg.norm(np.array(errors)[:, 3:], axis=1)
    return {
        "scans": len(states),
        "localised": round(states.count("localised") / len(states), 3),
        "ate_mm": round(1e3 * float(np.sqrt(np.mean(off**2))), 2),
        "max_mm": round(1e3 * float(off.max()), 2),
        "nees": round(float(np.mean(squared)), 2),
        "tracking_over_odometry": round(tracking / matching, 3),
        "gone": round(max((s.gone for s in localizer.changes.changes().submaps), default=0.0), 3),
    }


def _map_in_world(folder: Path, truth: Truth) -> Array:
    """Return where the map's frame lies by all poses of the run that made it."""
    run = read_tum(folder / "trajectory.tum")
    return align(run.T_frame_body, truth.pose(run.stamps_ns))


if __name__ == "__main__":
    import argparse
    import json

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", nargs="?", default="warehouse")
    parser.add_argument("--seed", type=int, default=201)
    parser.add_argument("--share", type=float, default=0.5)
    given = parser.parse_args()
    print(json.dumps(measure(given.scenario, given.seed, given.share)))

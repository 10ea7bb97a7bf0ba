"""Three recordings, two of one place and one of another, each mapped by itself, and their runs merged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from heliograph.arrays import Array
from heliograph.cli.main import main
from heliograph.io import read_tum
from heliograph.io.files.clouds import read_cloud
from heliograph.metrics import align
from heliograph.sim import SCENARIOS, Scenario, Simulation, simulate
from heliograph.sim.map_error import map_error
from heliograph.sim.world import SimulatedWorld
from heliograph.sim.write import write_recording

__all__ = ["measure"]

_NEAR = 3_000_000  # a merged stamp is this near to its session's [ns]


def _sessions(seed: int) -> dict[str, tuple[Scenario, int]]:
    """Return the beginning of a walk, its end from before that in motion, and a walk elsewhere."""
    demo = SCENARIOS["demo"]
    first = replace(demo, walk=replace(demo.walk, duration=20.0))
    second = replace(demo, walk=replace(demo.walk, begin=12.0))
    return {"first": (first, seed), "second": (second, seed), "elsewhere": (SCENARIOS["room"], seed)}


def measure(seed: int) -> dict[str, Any]:
    """Merge and compare with the truth."""
    with TemporaryDirectory() as folder:
        root = Path(folder)
        simulations = {}
        for name, (scenario, number) in _sessions(seed).items():
            simulations[name] = simulate(scenario, number)
            write_recording(root / "recordings" / name, scenario, number)
            main(["run", str(root / "recordings" / name / "recording.mcap"), "-o", str(root / name), "--quiet"])
        main(["merge", *(str(root / name) for name in simulations), "-o", str(root / "merged")])
        told = json.loads((root / "merged" / "run.json").read_text())
        return {"seed": seed, **_judged(root, told, simulations)}


def _judged(root: Path, told: dict[str, Any], simulations: dict[str, Simulation]) -> dict[str, Any]:
    facts = {entry["name"]: entry for entry in told["sessions"]}
    merged = read_tum(root / "merged" / "trajectory.tum")
    T_world_map = None
    off = {}
    for name in ("first", "second"):
        simulation = simulations[name]
        stamps = merged.stamps_ns - facts[name]["stamp_shift_ns"]
        own = read_tum(root / name / "trajectory.tum").stamps_ns
        there = np.isin(np.round(stamps / _NEAR), np.round(own / _NEAR)) & (stamps >= own[0]) & (stamps <= own[-1])
        T, T_true = merged.T_frame_body[there], simulation.truth.pose(stamps[there])
        if T_world_map is None:
            T_world_map = align(T, T_true)
        d = np.linalg.norm((T_world_map @ T)[:, :3, 3] - T_true[:, :3, 3], axis=1)
        off[name] = [len(d), *(round(1e3 * float(v), 2) for v in (np.sqrt(np.mean(d**2)), d.max()))]
    assert T_world_map is not None
    points = read_cloud(root / "merged" / "map.ply").points @ T_world_map[:3, :3].T + T_world_map[:3, 3]
    single = read_cloud(root / "first" / "map.ply").points
    alone = read_tum(root / "first" / "trajectory.tum")
    T_alone = align(alone.T_frame_body, simulations["first"].truth.pose(alone.stamps_ns))
    world = simulations["first"].world
    return {
        "sessions": {name: {key: facts[name][key] for key in ("linked", "links")} for name in facts},
        "off_mm": off,
        "wall_mm": _to_surfaces(world, points),
        "wall_first_alone_mm": _to_surfaces(world, single @ T_alone[:3, :3].T + T_alone[:3, 3]),
    }


def _to_surfaces(world: SimulatedWorld, points: Array) -> list[float]:
    """Return median and 95 % quantile of the distance of a map's points to the nearest surface [mm]."""
    error = map_error(world, points)
    return [round(1e3 * value, 2) for value in (error.median, error.p95)]


if __name__ == "__main__":
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=211)
    print(json.dumps(measure(parser.parse_args().seed)))

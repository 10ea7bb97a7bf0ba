"""All experiments, in the lesson's order."""

from __future__ import annotations

from types import MappingProxyType

from heliograph.errors import ConfigError, closest
from heliograph.lab import icp, loop, sensors, side_by_side, sweep, tunnel, two_poses
from heliograph.lab.experiment import Experiment

__all__ = ["EXPERIMENTS", "find_experiment"]

EXPERIMENTS: MappingProxyType[str, Experiment] = MappingProxyType(
    {
        module.EXPERIMENT.name: module.EXPERIMENT
        for module in (sensors, sweep, icp, two_poses, side_by_side, loop, tunnel)
    }
)


def find_experiment(name: str) -> Experiment:
    """Return an experiment by name, or raise `ConfigError` with the names there are."""
    if name not in EXPERIMENTS:
        raise ConfigError(
            f"experiment '{name}' is unknown; there are {', '.join(EXPERIMENTS)}{closest(name, list(EXPERIMENTS))}"
        )
    return EXPERIMENTS[name]

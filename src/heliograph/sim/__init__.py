"""Simulated recordings with exact truth: worlds, motion, LiDAR, IMU, GNSS, and files as drivers write them."""

from heliograph.sim.scenario import SCENARIOS, Scenario, find_scenario
from heliograph.sim.simulate import Simulation, Truth, simulate

__all__ = ["SCENARIOS", "Scenario", "Simulation", "Truth", "find_scenario", "simulate"]

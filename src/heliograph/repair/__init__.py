"""Faults of the sensors' data that can be mended from the data alone: found, applied, and said in one line each."""

from heliograph.repair.find import find_repairs
from heliograph.repair.source import RepairedSource

__all__ = ["RepairedSource", "find_repairs"]

"""Local and global maps."""

from heliograph.maps.global_map import GlobalMap
from heliograph.maps.protocol import LocalMap, PlaneMatches
from heliograph.maps.voxel_map import VoxelMap

__all__ = ["GlobalMap", "LocalMap", "PlaneMatches", "VoxelMap"]

"""Local and global maps."""

from heliograph.maps.feature_map import FeatureMap, FeaturePoints
from heliograph.maps.global_map import GlobalMap, MapCells, MapPoints
from heliograph.maps.kd_tree import KdTreeMap
from heliograph.maps.protocol import NEIGHBOURS, LocalMap, PlaneMatches, WindowedMap
from heliograph.maps.sight import Sight, count_seen_through
from heliograph.maps.tiles import TileSplit, split_tiles
from heliograph.maps.transform import transformed
from heliograph.maps.voxel_map import VoxelMap

__all__ = [
    "NEIGHBOURS",
    "FeatureMap",
    "FeaturePoints",
    "GlobalMap",
    "KdTreeMap",
    "LocalMap",
    "MapCells",
    "MapPoints",
    "PlaneMatches",
    "Sight",
    "TileSplit",
    "VoxelMap",
    "WindowedMap",
    "count_seen_through",
    "split_tiles",
    "transformed",
]

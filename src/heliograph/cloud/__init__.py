"""Point clouds: motion compensation and thinning."""

from heliograph.cloud.deskew import deskew
from heliograph.cloud.downsample import range_gate, voxel_downsample

__all__ = ["deskew", "range_gate", "voxel_downsample"]

"""Point clouds: motion compensation, thinning, scan lines and their features."""

from heliograph.cloud.deskew import deskew
from heliograph.cloud.downsample import range_gate, voxel_downsample
from heliograph.cloud.features import ScanFeatures, scan_features
from heliograph.cloud.scan_lines import LINES_NEED, LineRule, ScanLines, find_line_rule, scan_lines

__all__ = [
    "LINES_NEED",
    "LineRule",
    "ScanFeatures",
    "ScanLines",
    "deskew",
    "find_line_rule",
    "range_gate",
    "scan_features",
    "scan_lines",
    "voxel_downsample",
]

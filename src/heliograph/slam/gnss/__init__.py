"""Satellite fixes in the graph: judged against the odometry, and what they tell of where the map lies on Earth."""

from heliograph.slam.gnss.evidence import FixEvidence, Judgement, Placement
from heliograph.slam.gnss.fixes import GnssFactors
from heliograph.slam.gnss.judge import judge
from heliograph.slam.gnss.kept import KeptFixes, kept_fixes
from heliograph.slam.gnss.table import write_gnss_table

__all__ = [
    "FixEvidence",
    "GnssFactors",
    "Judgement",
    "KeptFixes",
    "Placement",
    "judge",
    "kept_fixes",
    "write_gnss_table",
]

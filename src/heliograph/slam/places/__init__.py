"""Which earlier keyframe looks like this one. A descriptor only ranks: registration decides."""

from heliograph.config import PlacesConfig
from heliograph.slam.places.birds_eye import BirdsEyeDetector
from heliograph.slam.places.levelling import body_guess, level_points, level_pose
from heliograph.slam.places.protocol import Descriptor, LoopDetector, PlaceMatch
from heliograph.slam.places.scan_context import ScanContextDetector

__all__ = [
    "BirdsEyeDetector",
    "Descriptor",
    "LoopDetector",
    "PlaceMatch",
    "ScanContextDetector",
    "body_guess",
    "level_points",
    "level_pose",
    "make_detector",
]


def make_detector(config: PlacesConfig | None = None) -> LoopDetector:
    """Return an empty detector of the configured method."""
    config = config or PlacesConfig()
    return ScanContextDetector(config) if config.method == "scan-context" else BirdsEyeDetector(config)

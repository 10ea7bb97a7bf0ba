"""A run that is placed on Earth, as surveyors take it: coordinate systems, LAS, tracks, control points, accuracy."""

from heliograph.survey.coordinates import CoordinateSystem, find_coordinate_system
from heliograph.survey.deliver import deliver
from heliograph.survey.placed_run import PlacedRun, open_placed_run

__all__ = ["CoordinateSystem", "PlacedRun", "deliver", "find_coordinate_system", "open_placed_run"]

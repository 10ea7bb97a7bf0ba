"""Localisation: a saved map as the fixed part of the estimate."""

from heliograph.localization.changes import Changes, ChangeWatch, SubmapChange
from heliograph.localization.localizer import Localizer, decide
from heliograph.localization.open_map import open_map
from heliograph.localization.records import Localization, LocalizationState
from heliograph.localization.saved_map import SavedMap, SavedSubmap, map_of_keyframes, map_of_points
from heliograph.localization.search import MapPlace, Query, search, weigh

__all__ = [
    "ChangeWatch",
    "Changes",
    "Localization",
    "LocalizationState",
    "Localizer",
    "MapPlace",
    "Query",
    "SavedMap",
    "SavedSubmap",
    "SubmapChange",
    "decide",
    "map_of_keyframes",
    "map_of_points",
    "open_map",
    "search",
    "weigh",
]

"""Registration of a cloud to a map: residuals, robust normal equations, degeneracy."""

from heliograph.registration.degeneracy import Observability, observability
from heliograph.registration.linearize import (
    BLOCKS,
    MapMounting,
    MatchSettings,
    NormalEquations,
    gradient_scatter,
    linearize,
)

__all__ = [
    "BLOCKS",
    "MapMounting",
    "MatchSettings",
    "NormalEquations",
    "Observability",
    "gradient_scatter",
    "linearize",
    "observability",
]

"""Registration of a cloud to a map: residuals, robust normal equations, degeneracy."""

from heliograph.registration.degeneracy import Observability, observability
from heliograph.registration.linearize import MatchSettings, NormalEquations, gradient_scatter, linearize

__all__ = ["MatchSettings", "NormalEquations", "Observability", "gradient_scatter", "linearize", "observability"]

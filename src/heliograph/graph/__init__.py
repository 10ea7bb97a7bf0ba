"""Factor graphs: variables in families, factors between them, and the noise they are weighed with."""

from heliograph.graph.factor import Factor
from heliograph.graph.factor_graph import FactorGraph
from heliograph.graph.factors import Bearing, Between, Landmark, LinearMotion, Position, Prior, Range
from heliograph.graph.families import Family, family_of, vectors
from heliograph.graph.kernels import DCS, Cauchy, GemanMcClure, Huber, TruncatedLeastSquares, Tukey
from heliograph.graph.noise import Constrained, Covariance, Diagonal, Information, Isotropic, SquareRoot
from heliograph.graph.values import Values

__all__ = [
    "DCS",
    "Bearing",
    "Between",
    "Cauchy",
    "Constrained",
    "Covariance",
    "Diagonal",
    "Factor",
    "FactorGraph",
    "Family",
    "GemanMcClure",
    "Huber",
    "Information",
    "Isotropic",
    "Landmark",
    "LinearMotion",
    "Position",
    "Prior",
    "Range",
    "SquareRoot",
    "TruncatedLeastSquares",
    "Tukey",
    "Values",
    "family_of",
    "vectors",
]

"""Registration: of a cloud to a map, of two clouds to each other, and what they cannot see."""

from heliograph.registration.align import align
from heliograph.registration.align_result import AlignResult, ResidualDistribution
from heliograph.registration.blind_directions import (
    DirectionInformation,
    InformationAnalysis,
    analyse_information,
    analyse_planes,
)
from heliograph.registration.degeneracy import Observability, observability
from heliograph.registration.features import FeatureNoise, FeatureRegistration, SweepFeatures, register_features
from heliograph.registration.linearize import (
    BLOCKS,
    MapMounting,
    MatchSettings,
    NormalEquations,
    gradient_scatter,
    linearize,
)
from heliograph.registration.noisy_normals import TrueShare, feigned_deviation, split_information, true_share
from heliograph.registration.remapping import remapped_step, soft_step
from heliograph.registration.surfaces import PreparedCloud, estimate_covariances, estimate_normals, prepare_cloud

__all__ = [
    "BLOCKS",
    "AlignResult",
    "DirectionInformation",
    "FeatureNoise",
    "FeatureRegistration",
    "InformationAnalysis",
    "MapMounting",
    "MatchSettings",
    "NormalEquations",
    "Observability",
    "PreparedCloud",
    "ResidualDistribution",
    "SweepFeatures",
    "TrueShare",
    "align",
    "analyse_information",
    "analyse_planes",
    "estimate_covariances",
    "estimate_normals",
    "feigned_deviation",
    "gradient_scatter",
    "linearize",
    "observability",
    "prepare_cloud",
    "register_features",
    "remapped_step",
    "soft_step",
    "split_information",
    "true_share",
]

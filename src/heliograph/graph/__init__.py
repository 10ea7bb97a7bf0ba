"""Factor graphs: variables in families, factors between them, and the noise they are weighed with.

Each name is imported when it is first used: solving a file needs a third of what stands here.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heliograph.graph.batch.gnc import RobustSettings, RobustSolution, solve_robust
    from heliograph.graph.batch.marginals import Marginals
    from heliograph.graph.batch.solution import Solution
    from heliograph.graph.diagnosis.diagnosis import Diagnosis, diagnose
    from heliograph.graph.diagnosis.free_motion import FreeMotion
    from heliograph.graph.draw import plot_poses, to_dot
    from heliograph.graph.files.archive import load_graph, save_graph
    from heliograph.graph.files.g2o import read_pose_graph, write_g2o, write_toro
    from heliograph.graph.files.odometry_start import odometry_start
    from heliograph.graph.files.posegraph import PoseGraphFile
    from heliograph.graph.files.posegraph_of import pose_graph_of
    from heliograph.graph.incremental.cliques import CliqueRecord, plot_cliques, tree_to_dot
    from heliograph.graph.incremental.fixed_lag import FixedLagSmoother
    from heliograph.graph.incremental.isam2 import ISAM2
    from heliograph.graph.incremental.settings import ISAM2Settings, OutlierRejection
    from heliograph.graph.incremental.update_result import UpdateResult
    from heliograph.graph.model.factor import Factor
    from heliograph.graph.model.factor_graph import FactorGraph
    from heliograph.graph.model.factors import (
        Bearing,
        BearingRange,
        Between,
        Landmark,
        LinearMotion,
        PartialPrior,
        Position,
        Prior,
        Range,
    )
    from heliograph.graph.model.families import Family, family_of, vectors
    from heliograph.graph.model.kernels import DCS, Cauchy, GemanMcClure, Huber, TruncatedLeastSquares, Tukey
    from heliograph.graph.model.noise import Constrained, Covariance, Diagonal, Information, Isotropic, SquareRoot
    from heliograph.graph.model.surfaces import Attitude, Plane, PointToPlane
    from heliograph.graph.model.symbols import Symbol, key_name
    from heliograph.graph.model.values import Values
    from heliograph.graph.problem.settings import SolverSettings
    from heliograph.graph.solver import solve

__all__ = [
    "DCS",
    "ISAM2",
    "Attitude",
    "Bearing",
    "BearingRange",
    "Between",
    "Cauchy",
    "CliqueRecord",
    "Constrained",
    "Covariance",
    "Diagnosis",
    "Diagonal",
    "Factor",
    "FactorGraph",
    "Family",
    "FixedLagSmoother",
    "FreeMotion",
    "GemanMcClure",
    "Huber",
    "ISAM2Settings",
    "Information",
    "Isotropic",
    "Landmark",
    "LinearMotion",
    "Marginals",
    "OutlierRejection",
    "PartialPrior",
    "Plane",
    "PointToPlane",
    "PoseGraphFile",
    "Position",
    "Prior",
    "Range",
    "RobustSettings",
    "RobustSolution",
    "Solution",
    "SolverSettings",
    "SquareRoot",
    "Symbol",
    "TruncatedLeastSquares",
    "Tukey",
    "UpdateResult",
    "Values",
    "diagnose",
    "family_of",
    "key_name",
    "load_graph",
    "odometry_start",
    "plot_cliques",
    "plot_poses",
    "pose_graph_of",
    "read_pose_graph",
    "save_graph",
    "solve",
    "solve_robust",
    "to_dot",
    "tree_to_dot",
    "vectors",
    "write_g2o",
    "write_toro",
]

_HOMES = {
    "batch.gnc": "RobustSettings RobustSolution solve_robust",
    "batch.marginals": "Marginals",
    "batch.solution": "Solution",
    "diagnosis.diagnosis": "Diagnosis diagnose",
    "diagnosis.free_motion": "FreeMotion",
    "draw": "plot_poses to_dot",
    "files.archive": "load_graph save_graph",
    "files.g2o": "read_pose_graph write_g2o write_toro",
    "files.odometry_start": "odometry_start",
    "files.posegraph": "PoseGraphFile",
    "files.posegraph_of": "pose_graph_of",
    "incremental.cliques": "CliqueRecord plot_cliques tree_to_dot",
    "incremental.fixed_lag": "FixedLagSmoother",
    "incremental.isam2": "ISAM2",
    "incremental.settings": "ISAM2Settings OutlierRejection",
    "incremental.update_result": "UpdateResult",
    "model.factor": "Factor",
    "model.factor_graph": "FactorGraph",
    "model.factors": "Bearing BearingRange Between Landmark LinearMotion PartialPrior Position Prior Range",
    "model.families": "Family family_of vectors",
    "model.kernels": "DCS Cauchy GemanMcClure Huber TruncatedLeastSquares Tukey",
    "model.noise": "Constrained Covariance Diagonal Information Isotropic SquareRoot",
    "model.surfaces": "Attitude Plane PointToPlane",
    "model.symbols": "Symbol key_name",
    "model.values": "Values",
    "problem.settings": "SolverSettings",
    "solver": "solve",
}
"""Module below this package -> the names that it has, as imported above."""
_MODULES = {name: module for module, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever the module holds
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

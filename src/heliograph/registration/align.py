"""Registration of two clouds: the ICP family from coarse to fine, with an account of what it could not see."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.config import AlignConfig, GlobalAlignConfig
from heliograph.errors import ConfigError, DataError, closest
from heliograph.lie import se3, so3
from heliograph.registration.align_globally import GlobalStart, find_start
from heliograph.registration.align_levels import (
    METHODS,
    LevelFit,
    explored,
    fit_levels,
    level_matches,
    refine,
    stride_of,
)
from heliograph.registration.align_result import AlignResult, ResidualDistribution
from heliograph.registration.blind_directions import InformationAnalysis, analyse_planes
from heliograph.registration.surfaces import PreparedCloud, prepare_cloud

__all__ = ["align"]

Array = NDArray[np.float64]
_ROTATION_TOLERANCE = 1e-3
_SHARE_OF = 3  # where not all elements are matched, a third of those tells the overlap


def align(
    target: NDArray[np.float32] | Array | PreparedCloud,
    source: NDArray[np.float32] | Array | PreparedCloud,
    *,
    method: str = "gicp",
    start: ArrayLike | str | None = None,
    config: AlignConfig | None = None,
    search: GlobalAlignConfig | None = None,
    threads: int = 1,
) -> AlignResult:
    """Find the pose of one cloud in the frame of another.

    Both clouds are thinned to one element a cube, with the surface that its surroundings make, on several levels;
    Gauss-Newton with a Geman-McClure kernel runs on each, the widest first. `docs/theory/registration.md` has the
    equations.

    Parameters
    ----------
    target, source : (N, 3) float32 or float64, or PreparedCloud
        Points [m], NaN left out. Float32 is used in place.
    method : str
        ``"gicp"`` (plane to plane, nearest partners), ``"vgicp"`` (the same, partners by cubes: fastest),
        ``"point-to-plane"``, ``"point-to-point"`` or ``"point-to-edge"`` (lines only).
    start : (4, 4) array_like or "global", optional
        A guess of ``T_target_source``, within about 1 m and 15 degrees; the identity if not given. ``"global"``: none
        is needed; it is found from features, or refused.
    config : AlignConfig, optional
    search : GlobalAlignConfig, optional
        Search of the global search.
    threads : int
        The result does not depend on it.

    Returns
    -------
    AlignResult
        Clouds that do not overlap have a status, and no pose; so has a global search without enough evidence.

    Raises
    ------
    DataError
        A cloud is empty, a line, of another unit or wrong in shape; the start is no motion.
    ConfigError
        An unknown method, or one that needs cubes without cubes.
    """
    config = config or AlignConfig()
    check_method(method, config)
    watch = AlignStopwatch()
    search_first = isinstance(start, str)
    if isinstance(start, str) and start != "global":
        raise ConfigError(f"start '{start}' is neither a pose nor 'global'")
    T_start = np.eye(4) if isinstance(start, str) else checked_pose(start)
    target, source = prepared(target, "target", config, threads), prepared(source, "source", config, threads)
    watch.lap("prepare")
    if search_first:
        found = find_start(target, source, config, search or GlobalAlignConfig(), threads)
        T_start = _to_given(found.T, target, source)
        watch.lap("start")
        if not found.accepted:
            return _refused(source, T_start, found, method, watch)
    result = align_prepared(target, source, T_start, method, config, threads, watch)
    if search_first and result.status in ("degenerate", "not converged"):
        # A direction that is not seen would keep what the features made of it, which is no guess of anyone's.
        return replace(result, status="refused", T_target_source=None, covariance=None, information=None)
    return result


def align_prepared(
    target: PreparedCloud,
    source: PreparedCloud,
    start: Array,
    method: str,
    config: AlignConfig,
    threads: int,
    watch: AlignStopwatch,
) -> AlignResult:
    """Do the same for clouds, start and settings that were checked."""
    local = start.copy()  # between the clouds less their origins
    local[:3, 3] += start[:3, :3] @ source.origin - target.origin
    fit = fit_levels(target, source, local, method, config, threads)
    if not fit.settled and target.native.levels() > 2:
        # The widest cubes of a small room are half of it: begin with finer ones, and keep what fits better.
        finer = range(target.native.levels() - 2, -1, -1)
        again = fit_levels(target, source, local, method, config, threads, levels=finer)
        fit = again if again.weight > fit.weight else fit
    watch.lap("iterate")
    overlaps = _overlaps(target, source, fit.T, threads)
    analysis = _observability(target, source, fit, config, threads)
    if analysis is not None and analysis.blind:
        other = explored(target, source, fit, local, analysis.blind_basis(), method, config, threads)
        seen = None if other is None else _observability(target, source, other, config, threads)
        if other is not None and seen is not None and len(seen.blind) < len(analysis.blind):
            fit, analysis, overlaps = other, seen, _overlaps(target, source, other.T, threads)
    if config.remap and analysis is not None and analysis.blind and min(overlaps) >= config.min_overlap:
        fit = _held(target, source, fit, local, analysis, method, config, threads)
        overlaps = _overlaps(target, source, fit.T, threads)
    return _answer(target, source, fit, start, analysis, overlaps, method, config, threads, watch)


def _to_given(T: Array, target: PreparedCloud, source: PreparedCloud) -> Array:
    """Return a pose between the clouds less their origins as one between the clouds as they were given."""
    out: Array = T.copy()
    out[:3, 3] += target.origin - T[:3, :3] @ source.origin
    return out


def _refused(
    source: PreparedCloud, start: Array, found: GlobalStart, method: str, watch: AlignStopwatch
) -> AlignResult:
    return AlignResult(
        status="refused",
        method=method,
        T_target_source=None,
        covariance=None,
        information=None,
        start=start,
        iterations=0,
        elements=source.native.size(0),
        matches=0,
        inliers=0,
        overlap_source=found.evidence.overlap if found.evidence is not None else 0.0,
        overlap_target=found.evidence.overlap if found.evidence is not None else 0.0,
        residuals=_distribution(np.zeros((0, 13)), float("nan")),
        observability=None,
        seconds=MappingProxyType(dict(watch.seconds)),
        reason=found.reason,
    )


def _held(
    target: PreparedCloud,
    source: PreparedCloud,
    fit: LevelFit,
    start: Array,
    analysis: InformationAnalysis,
    method: str,
    config: AlignConfig,
    threads: int,
) -> LevelFit:
    """Take the blind directions back to the start and let the others settle again."""
    N = analysis.blind_basis()
    T = fit.T
    for _ in range(3):  # the way back is along a curve; its tangent is taken anew
        back = se3.log(se3.inverse(T) @ start)
        part, *_ = np.linalg.lstsq(_scaled(N), _scaled(back), rcond=None)
        T = se3.retract(T, N @ part)
    moved = LevelFit(**{name: getattr(fit, name) for name in LevelFit.__slots__} | {"T": np.ascontiguousarray(T)})
    return refine(target, source, moved, method, config, threads, N)


def _scaled(columns: Array) -> Array:
    """Rotations count as displacements at ten metres."""
    return np.asarray((columns.T * np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])).T)


def _overlaps(target: PreparedCloud, source: PreparedCloud, T: Array, threads: int) -> tuple[float, float]:
    """Return the share of the source with a counterpart in the target, and the other way round."""
    level = min(1, target.native.levels() - 1)
    reach = target.config.gate * max(target.config.voxel, 0.25 if target.config.voxel == 0.0 else 0.0)
    inverse = np.ascontiguousarray(se3.inverse(T))
    # A share of some thousand is known to a hundredth.
    few = replace(target.config, max_elements=target.config.max_elements // _SHARE_OF)
    strides = [stride_of(cloud, level, few) for cloud in (source, target)]
    return (
        target.native.overlap(level, source.native, level, T, reach, threads, strides[0]),
        source.native.overlap(level, target.native, level, inverse, reach, threads, strides[1]),
    )


def _observability(
    target: PreparedCloud, source: PreparedCloud, fit: LevelFit, config: AlignConfig, threads: int
) -> InformationAnalysis | None:
    """Judge the directions by the planes of the matches; None where there are none."""
    level = min(1, target.native.levels() - 1)
    rows = level_matches(target, source, fit.T, "point-to-plane", level, fit.kernel, config, threads)
    if len(rows) < config.min_matches:
        return None
    tilt = rows[:, 10] + np.radians(config.normal_sigma_deg) ** 2
    weights = rows[:, 8] / rows[:, 9]
    return analyse_planes(
        rows[:, :3], rows[:, 3:6], weights, tilt, probability=config.blind_probability, gain=config.blind_gain
    )


def _answer(
    target: PreparedCloud,
    source: PreparedCloud,
    fit: LevelFit,
    start: Array,
    analysis: InformationAnalysis | None,
    overlaps: tuple[float, float],
    method: str,
    config: AlignConfig,
    threads: int,
    watch: AlignStopwatch,
) -> AlignResult:
    rows = level_matches(target, source, fit.T, method, 0, fit.kernel, config, threads, matcher=fit.matcher)
    status, reason = _status(fit, analysis, overlaps, len(rows), config)
    answered = status in ("converged", "degenerate", "not converged")
    T = _to_given(fit.T, target, source)
    # Each element that was matched stands for those that were left out.
    information = _about_origin(stride_of(source, 0, config) * fit.information, source.origin)
    blind = _moved(analysis.blind_basis(), source.origin) if analysis is not None else np.zeros((6, 0))
    watch.lap("judge")
    return AlignResult(
        status=status,
        method=method,
        T_target_source=T if answered else None,
        covariance=_covariance(information, fit.reduced_chi_square, blind, config) if answered else None,
        information=information if answered else None,
        start=start,
        iterations=fit.iterations,
        elements=source.native.size(0),
        matches=len(rows),
        inliers=int(np.count_nonzero(rows[:, 6] ** 2 <= 9.0 * rows[:, 9] * max(fit.reduced_chi_square, 1.0))),
        overlap_source=overlaps[0],
        overlap_target=overlaps[1],
        residuals=_distribution(rows, fit.reduced_chi_square),
        observability=analysis,
        seconds=MappingProxyType(dict(watch.seconds)),
        reason=reason,
    )


def _status(
    fit: LevelFit,
    analysis: InformationAnalysis | None,
    overlaps: tuple[float, float],
    matches: int,
    config: AlignConfig,
) -> tuple[str, str]:
    if matches < config.min_matches or min(overlaps) < config.min_overlap:
        return "no overlap", (
            f"{matches} elements have a partner and {min(overlaps):.0%} of a cloud has a counterpart; needed are "
            f"{config.min_matches} and {config.min_overlap:.0%}"
        )
    if not fit.settled:
        return "not converged", f"the last of {fit.iterations} iterations still moved more than the tolerance"
    if analysis is None or analysis.blind:
        named = "no direction is seen" if analysis is None else ", ".join(str(d) for d in analysis.blind)
        return "degenerate", f"not observable, kept from the start: {named}"
    return "converged", ""


def _covariance(information: Array, chi: float, blind: Array, config: AlignConfig) -> Array:
    """Invert the information, scaled up where the residuals exceed their model; blind directions get the start's."""
    sigma = np.concatenate([np.full(3, np.radians(config.start_sigma_deg)), np.full(3, config.start_sigma)])
    scaled = information / max(chi, 1.0)
    if blind.shape[1]:
        q, _ = np.linalg.qr(blind / sigma[:, None], mode="complete")
        seen = sigma[:, None] * q[:, blind.shape[1] :]
        inner = np.linalg.inv(seen.T @ scaled @ seen + 1e-12 * np.eye(seen.shape[1]))
        held = sigma[:, None] * q[:, : blind.shape[1]]
        return np.asarray(seen @ inner @ seen.T + held @ held.T)
    return np.asarray(np.linalg.inv(scaled + np.diag(1e-9 / sigma**2)))


def _about_origin(information: Array, origin: Array) -> Array:
    """Information about perturbations at the frame's origin, from that about one moved by ``origin``."""
    M: Array = np.eye(6)
    M[3:, :3] = -so3.hat(origin)
    return np.asarray(M.T @ information @ M)


def _moved(columns: Array, origin: Array) -> Array:
    """Perturbations at the moved frame as ones at the frame's origin."""
    out = columns.copy()
    out[3:] += np.cross(origin, columns[:3].T).T
    return np.asarray(out)


def _distribution(rows: Array, chi: float) -> ResidualDistribution:
    r = np.abs(rows[:, 6])
    if len(r) == 0:
        nan = float("nan")
        return ResidualDistribution(rms=nan, median=nan, p90=nan, p99=nan, max=nan, reduced_chi_square=nan)
    median, p90, p99 = (float(q) for q in np.quantile(r, (0.5, 0.9, 0.99)))
    rms = float(np.sqrt(np.mean(r * r)))
    return ResidualDistribution(rms=rms, median=median, p90=p90, p99=p99, max=float(r.max()), reduced_chi_square=chi)


@dataclass(slots=True)
class AlignStopwatch:
    """Wall-clock seconds by the name of what was done."""

    seconds: dict[str, float] = field(default_factory=dict)
    last: float = field(default_factory=time.perf_counter)

    def lap(self, name: str) -> None:
        """Book the time since the last call under a name."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self.last
        self.last = now


def prepared(
    cloud: NDArray[np.float32] | Array | PreparedCloud, name: str, config: AlignConfig, threads: int
) -> PreparedCloud:
    """Return a cloud prepared with these settings."""
    if isinstance(cloud, PreparedCloud):
        if cloud.config != config:
            raise ConfigError(f"{name} was prepared with other settings; give align the same `config`")
        return cloud
    return prepare_cloud(cloud, config, name=name, threads=threads)


def check_method(method: str, config: AlignConfig) -> None:
    """Raise `ConfigError` for a method that there is not, or that needs cubes."""
    if method not in METHODS:
        raise ConfigError(f"method '{method}' is not one of {', '.join(METHODS)}{closest(method, METHODS)}")
    if method == "vgicp" and config.voxel == 0.0:
        raise ConfigError("vgicp finds partners by cubes, which voxel = 0 does not make; use gicp")


def checked_pose(start: ArrayLike | None) -> Array:
    """Return a start as a motion (4, 4), or raise `DataError` if it is none."""
    if start is None:
        return np.eye(4)
    try:
        T = np.array(start, dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError("the start is not a matrix of numbers; give T_target_source, 4x4") from None
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise DataError(f"the start is not a finite 4x4 matrix (shape {T.shape}); give T_target_source")
    R = T[:3, :3]
    off = max(float(np.abs(R @ R.T - np.eye(3)).max()), float(np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max()))
    if off > _ROTATION_TOLERANCE or np.linalg.det(R) < 0.0:
        raise DataError(
            f"the start is no rotation and translation: R R^T misses the identity by {off:.2g}, det R = "
            f"{np.linalg.det(R):.3f}; give T_target_source with an orthonormal, right-handed rotation"
        )
    T[:3, :3] = so3.project(R)
    return T

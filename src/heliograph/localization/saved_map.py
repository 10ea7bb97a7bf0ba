"""A saved map cut into submaps: what a search goes through, and the surfaces that tracking holds on to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Points, freeze
from heliograph.cloud import voxel_downsample
from heliograph.config import AlignConfig, LocalizationConfig, MapConfig, PlacesConfig
from heliograph.errors import DataError
from heliograph.lie import se3
from heliograph.localization.all_headings import HeadingSearch
from heliograph.localization.standing_places import standing_places
from heliograph.maps import VoxelMap, transformed
from heliograph.registration import PreparedCloud, prepare_cloud
from heliograph.slam.places import LoopDetector, level_pose, make_detector

__all__ = ["SavedMap", "SavedSubmap", "map_of_keyframes", "map_of_points"]

_TURNED = 1.0  # a keyframe turned by more than this against a submap's middle has its own: 60 degrees [rad]
_MAX_POINTS = 30_000  # of a cloud that is described
_THINNED = 0.12  # edge of the cubes of which submaps of a bare map keep a point [m]
_BLOCK = 200_000  # points of a bare map that are inserted at once
_EVERYWHERE = 1e9  # a saved map forgets nothing [m]
_FAR = 1e4  # single precision holds a millimetre up to here [m]
_SMALLEST = 500  # points that a map needs
_FLATTEST = 2.0  # extent that it needs along its second axis [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedSubmap:
    """A part of a map as it is seen from a place.

    Parameters
    ----------
    T_map_submap : (4, 4) float64
        The place: z up.
    cloud : PreparedCloud
        Its points in the submap's frame [m].
    covariance : (6, 6) float64
        Covariance of the place in the map, right perturbation [rad^2, m^2]: what the map itself does not know.
    """

    T_map_submap: Array
    cloud: PreparedCloud
    covariance: Array

    def __post_init__(self) -> None:
        freeze(self)


class SavedMap:
    """Submaps with a detector that ranks them, and one `VoxelMap` of all points.

    Parameters
    ----------
    submaps : sequence of SavedSubmap
    surfaces : VoxelMap
        All points of the map, map frame.
    sided : bool
        Whether the clouds tell from where they were seen.
    places : PlacesConfig, optional
    """

    def __init__(
        self, submaps: Sequence[SavedSubmap], surfaces: VoxelMap, *, sided: bool, places: PlacesConfig | None = None
    ) -> None:
        self.submaps, self.surfaces, self.sided = tuple(submaps), surfaces, sided
        self.detector: LoopDetector = make_detector(places)
        for index, submap in enumerate(self.submaps):
            points = submap.cloud.points
            self.detector.add(index, self.detector.describe(thinned(points)))
        self.headings = HeadingSearch([thinned(submap.cloud.points) for submap in self.submaps])
        self._positions = np.stack([s.T_map_submap[:3, 3] for s in self.submaps])
        self._headings = np.stack([s.T_map_submap[:3, 0] for s in self.submaps])

    def __len__(self) -> int:
        return len(self.submaps)

    def nearest(self, T_map_imu: Array) -> SavedSubmap:
        """Return the submap of `nearest_index`."""
        return self.submaps[self.nearest_index(T_map_imu)]

    def nearest_index(self, T_map_imu: Array) -> int:
        """Return the submap whose middle is nearest to a pose; of two as near the one that looks the same way."""
        return int(np.argmin(self._distances(T_map_imu)))

    def around(self, T_map_imu: Array, count: int) -> tuple[SavedSubmap, ...]:
        """Return at most ``count`` submaps nearest to a pose in the sense of `nearest_index`, the nearest first."""
        return tuple(self.submaps[k] for k in np.argsort(self._distances(T_map_imu), kind="stable")[:count])

    def _distances(self, T_map_imu: Array) -> Array:
        off = self._positions - T_map_imu[:3, 3]
        near = np.linalg.norm(off * [1.0, 1.0, 3.0], axis=1)
        return np.asarray(near + 1.0 - self._headings @ T_map_imu[:3, 0])


def thinned(points: Points) -> Points:
    """Return at most `_MAX_POINTS` of the points, evenly."""
    return points[:: 1 + len(points) // _MAX_POINTS]


def align_config(config: LocalizationConfig, *, sided: bool) -> AlignConfig:
    """Return the settings that submaps and queries are prepared and aligned with."""
    return AlignConfig(one_sided=sided, voxel=config.voxel, levels=config.levels)


def map_of_keyframes(
    clouds: Sequence[Points],
    T_map_imu: Array,
    covariances: Callable[[int], Array] | None = None,
    *,
    config: LocalizationConfig | None = None,
    places: PlacesConfig | None = None,
    maps: MapConfig | None = None,
) -> SavedMap:
    """Cut the keyframes of a run into submaps.

    Parameters
    ----------
    clouds : sequence of (N, 3) float32
        One a keyframe, imu frame [m].
    T_map_imu : (K, 4, 4) float64
        Their poses.
    covariances : callable, optional
        Keyframe -> covariance of its pose (6, 6), right perturbation; by default the map is taken as exact.
    config, places, maps : optional

    Raises
    ------
    DataError
        The map is too small to tell places apart.
    """
    config = config or LocalizationConfig()
    settings, surfaces = align_config(config, sided=True), _everything(maps)
    for cloud, T in zip(clouds, T_map_imu, strict=True):
        surfaces.insert(cloud, np.ascontiguousarray(T))
    p = T_map_imu[:, :3, 3]
    _check_extent(sum(len(cloud) for cloud in clouds), surfaces.table()[:, 2:5])
    submaps = []
    for middle in _middles(T_map_imu, config.spacing):
        T = T_map_imu[middle] @ se3.inverse(level_pose(np.ascontiguousarray(T_map_imu[middle])))
        level = np.hypot(*(p - p[middle])[:, :2].T)
        near = np.flatnonzero((level <= config.reach) & (np.abs(p[:, 2] - p[middle, 2]) <= config.reach_up))
        members = near[np.argsort(level[near], kind="stable")[: config.members]]
        parts = [transformed(clouds[k], se3.inverse(T) @ T_map_imu[k]) for k in members]
        part = prepare_cloud(np.concatenate(parts).astype(np.float32), settings, name=f"submap of keyframe {middle}")
        C = np.zeros((6, 6)) if covariances is None else _carried(covariances(middle), T, T_map_imu[middle])
        submaps.append(SavedSubmap(T_map_submap=np.ascontiguousarray(T), cloud=part, covariance=C))
    return SavedMap(submaps, surfaces, sided=True, places=places)


def map_of_points(
    points: NDArray[np.float32] | Array,
    *,
    config: LocalizationConfig | None = None,
    places: PlacesConfig | None = None,
    maps: MapConfig | None = None,
) -> SavedMap:
    """Cut a bare cloud into submaps as they would be seen by who stands on its floors.

    Parameters
    ----------
    points : (N, 3) float32 or float64
        Map frame, z up [m]; NaN is left out.
    config, places, maps : optional

    Raises
    ------
    DataError
        Too few points, too small, in another unit than metres, or without a floor: z does not point up.
    """
    config = config or LocalizationConfig()
    settings, surfaces = align_config(config, sided=False), _everything(maps)
    finite = np.ascontiguousarray(points[np.isfinite(points).all(axis=1)], dtype=np.float32)
    _check_extent(len(finite), finite)
    far = float(np.abs(np.median(finite, axis=0)).max())
    if far > _FAR:
        raise DataError(
            f"the map lies {far:.0f} m from its origin, where single precision blurs it: take an offset off its "
            "coordinates, and add it to the poses"
        )
    for begin in range(0, len(finite), _BLOCK):
        surfaces.insert(finite[begin : begin + _BLOCK], np.eye(4))
    submaps = []
    thin = finite[voxel_downsample(finite, _THINNED)]
    for place in standing_places(finite, config.tile):
        off = thin - place.astype(np.float32)
        near = off[(np.abs(off) <= np.float32(config.view)).all(axis=1)]
        T = se3.from_rotation_translation(np.eye(3), place)
        if len(near) < _SMALLEST:
            continue
        cloud = prepare_cloud(np.ascontiguousarray(near), settings, name=f"submap at {np.round(place, 1).tolist()}")
        submaps.append(SavedSubmap(T_map_submap=T, cloud=cloud, covariance=np.zeros((6, 6))))
    if not submaps:
        raise DataError(
            "nowhere in the map is a floor with room above it: is its z axis up, and is it in metres? Turn it, or give "
            "the folder of a run"
        )
    return SavedMap(submaps, surfaces, sided=False, places=places)


def _carried(covariance: Array, T_map_level: Array, T_map_imu: Array) -> Array:
    """Return the covariance of a body's pose as that of its levelled frame's."""
    carry = se3.adjoint(se3.inverse(T_map_level) @ T_map_imu)
    return np.asarray(carry @ covariance @ carry.T)


def _everything(maps: MapConfig | None) -> VoxelMap:
    config = maps or MapConfig()
    return VoxelMap(replace(config, radius=_EVERYWHERE, window=0.0))


def _check_extent(count: int, points: NDArray[np.floating]) -> None:
    if count < _SMALLEST or len(points) < 3:
        raise DataError(f"the map has {count} points, too few to tell a place by; needed are {_SMALLEST}")
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    extent = np.sort(high - low)
    if extent[1] < _FLATTEST:
        raise DataError(
            f"the map spans {extent[2]:.3g} x {extent[1]:.3g} x {extent[0]:.3g} m, too little to tell a place by: is "
            "it in kilometres? Multiply it by 1000, or map more"
        )
    if extent[2] > 1e5:
        raise DataError(f"the map spans {extent[2]:.3g} m: are its coordinates in millimetres? Divide them by 1000")


def _middles(T: Array, spacing: float) -> list[int]:
    """Return keyframes no two of which stand near each other and look the same way."""
    chosen: list[int] = []
    for k in range(len(T)):
        some = T[chosen]
        near = np.linalg.norm(some[:, :3, 3] - T[k, :3, 3], axis=1) < spacing
        alike = np.einsum("nij,ij->n", some[:, :3, :3], T[k, :3, :3]) > 1.0 + 2.0 * np.cos(_TURNED)
        if not (near & alike).any():
            chosen.append(k)
    return chosen

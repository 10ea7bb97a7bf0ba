"""The map that a run writes, and the cells in which its parts are kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph import _core
from heliograph.arrays import as_array, as_points, as_pose, freeze, frozen
from heliograph.errors import DataError

__all__ = ["GlobalMap", "MapCells", "MapPoints"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapCells:
    """What the cubes of a map have added up: enough to carry on with it elsewhere.

    Parameters
    ----------
    cubes : (M, 3) int32
        Index of each cube along the axes; cube i covers ``[i, i + 1) * voxel``.
    sums : (M, 3) float32
        Sum of its points' offsets from the cube's centre [m].
    intensity : (M,) float32
        Sum of their intensity.
    counts : (M,) float32
        How many points it holds.
    """

    cubes: NDArray[np.int32]
    sums: NDArray[np.float32]
    intensity: NDArray[np.float32]
    counts: NDArray[np.float32]

    def __post_init__(self) -> None:
        counts = frozen("counts", self.counts, np.float32, (None,))
        n = len(counts)
        object.__setattr__(self, "cubes", frozen("cubes", self.cubes, np.int32, (n, 3)))
        object.__setattr__(self, "sums", frozen("sums", self.sums, np.float32, (n, 3)))
        object.__setattr__(self, "intensity", frozen("intensity", self.intensity, np.float32, (n,)))
        object.__setattr__(self, "counts", counts)

    def __len__(self) -> int:
        return len(self.counts)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPoints:
    """Points of a map with what was seen of each.

    Parameters
    ----------
    points : (N, 3) float64
        In the map's frame [m].
    intensity : (N,) float32
        Mean intensity.
    first : (N,) uint32
        Number of the visit that saw it first, as `GlobalMap.merge` was given it.
    """

    points: NDArray[np.float64]
    intensity: NDArray[np.float32]
    first: NDArray[np.uint32]

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.points)


_NONE = np.zeros(0, np.float32)


class GlobalMap:
    """One averaged point a cube, with its mean intensity; memory grows with the volume seen, not with time.

    A cube takes the first 16 384 points that fall into it and leaves the others: by then its mean is known to a
    hundredth of the noise, and sums of floats that grow for ever drift. Cubes are counted from the first one, so that a
    map may lie anywhere; what is 524 284 cubes from there is refused.

    Parameters
    ----------
    voxel : float
        Edge of the cubes [m].
    """

    def __init__(self, voxel: float) -> None:
        if not 0.0 < voxel < np.inf:
            raise DataError(f"voxel is {voxel}, expected an edge above 0 m")
        self.voxel = voxel
        self._native = _core.GlobalMap(voxel)

    def insert(
        self, points_imu: NDArray[np.float32], intensity: NDArray[np.float32] | None, T_map_imu: NDArray[np.float64]
    ) -> None:
        """Add points (N, 3) of the imu frame [m] seen from the pose (4, 4), with one intensity each or None.

        Points that are not finite are left out.

        Raises
        ------
        DataError
            An array of another dtype or shape, a pose that is not finite, or a point too far from the first one.
        """
        points = as_points("points_imu", points_imu)
        values = _NONE if intensity is None else as_array("intensity", intensity, np.float32, (len(points),))
        with _known_reach():
            self._native.insert(points, values, as_pose("T_map_imu", T_map_imu))

    def merge(self, cells: MapCells, T_map_odom: NDArray[np.float64] | None = None, *, visit: int = 0) -> None:
        """Add the cells of a map with cubes of the same edge.

        Parameters
        ----------
        cells : MapCells
            Cells of the map in its own frame, here called odom.
        T_map_odom : (4, 4) float64, optional
            That frame in this map's. The mean of each cell goes, with its weight, into the cube where it comes to lie.
            By default the frames are one, and cell is added to cell.
        visit : int
            Number of the visit that the cells are of, below 2^24.

        Raises
        ------
        DataError
            A pose that is not finite, or a cell too far from the first one.
        """
        T = None if T_map_odom is None else as_pose("T_map_odom", T_map_odom)
        with _known_reach():
            self._native.merge(cells.cubes, cells.sums, cells.intensity, cells.counts, T, visit)

    def cells(self) -> MapCells:
        """Return what the cubes have added up, in the order in which they were first seen."""
        native = self._native
        return MapCells(
            cubes=native.cubes(), sums=native.sums(), intensity=native.intensity_sums(), counts=native.counts()
        )

    def clear(self) -> None:
        """Forget all points, and keep the memory for the next ones."""
        self._native.clear()

    def keep(self, wanted: NDArray[np.bool_]) -> None:
        """Forget the cubes that are not ``wanted`` (M,)."""
        self._native.keep(as_array("wanted", wanted, np.bool_, (len(self),)).view(np.uint8))

    def points(self) -> NDArray[np.float32]:
        """Return the mean point of each cube, (M, 3), map frame [m], in the order in which cubes were first seen."""
        return self.means().astype(np.float32)

    def means(self) -> NDArray[np.float64]:
        """Return the same in double precision, for maps far from the frame's origin."""
        return np.asarray(self._native.points())

    def visits(self) -> NDArray[np.uint32]:
        """Return by how many of the visits merged each cube was seen, (M,), at most 255."""
        return np.asarray(self._native.visits())

    def normals(self, cubes: NDArray[np.uint32]) -> NDArray[np.float32]:
        """Return the normals (K, 3) of the planes that some cubes' means make with those about them; zero for none."""
        return np.asarray(self._native.normals(as_array("cubes", cubes, np.uint32, (None,))))

    def marked_around(self, cubes: NDArray[np.uint32], marked: NDArray[np.bool_]) -> NDArray[np.uint32]:
        """Return of the 26 cubes about some (K,) how many are ``marked`` (M,) and how many hold a point, (K, 2)."""
        marks = as_array("marked", marked, np.bool_, (len(self),)).view(np.uint8)
        return np.asarray(self._native.marked_around(as_array("cubes", cubes, np.uint32, (None,)), marks))

    def intensity(self) -> NDArray[np.float32]:
        """Return the mean intensity of each cube, (M,)."""
        return np.asarray(self._native.intensity())

    def counts(self) -> NDArray[np.float32]:
        """Return how many points each cube averaged, (M,)."""
        return np.asarray(self._native.counts())

    def surfaces(self, thickness: float, *, threads: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the map without the traces of its grid: the points of one surface averaged together.

        A cube's mean goes along the normal onto the plane of the means about it, or of those about a neighbour; means
        that then coincide become one point. A wall on a border between two layers of cubes is one sheet again, and what
        noise threw into the next layer is no point of its own. Where there is no plane, as on poles, wires and in
        foliage, a cube's mean stays what it is.

        Parameters
        ----------
        thickness : float
            The means of a surface scatter about its plane by no more than this (RMS) [m]. More than 0.8 of the noise,
            less than half of the distance between two sheets that are to stay two. Cubes smaller than about four times
            the noise see a surface thicker than wide, which is then none.
        threads : int
            The result does not depend on it.

        Returns
        -------
        points : (N, 3) float32
            In the map frame [m], in the order in which their cubes were first seen.
        intensity : (N,) float32
            Its mean over the same points.

        Notes
        -----
        A moving least-squares projection (D. Levin, Mesh-independent surface interpolation, 2003) of the means,
        weighted by their counts, onto planes. Its bias on curved surfaces is taken back by smoothing the moves
        once more (twicing: J. W. Tukey, Exploratory Data Analysis, 1977).
        """
        found = self.averaged(thickness, threads=threads)
        return found.points.astype(np.float32), found.intensity

    def averaged(self, thickness: float, *, threads: int = 1) -> MapPoints:
        """Return what `surfaces` does in double precision, with the first visit; with 0 the mean of each cube."""
        if thickness == 0.0:
            return MapPoints(points=self.means(), intensity=self.intensity(), first=np.asarray(self._native.first()))
        points, intensity, _, first = self._native.surfaces(float(thickness), threads)
        return MapPoints(points=points, intensity=intensity, first=first)

    @property
    def nbytes(self) -> int:
        """Memory held [bytes]."""
        return int(self._native.bytes())

    def __len__(self) -> int:
        return len(self._native)


@contextmanager
def _known_reach() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise DataError(str(error)) from None

"""Scan context: the greatest height by ring and sector, searched by ring key and compared by sector shift.

References
----------
.. [1] G. Kim, A. Kim, "Scan Context: egocentric spatial descriptor for place recognition within 3D point cloud map",
   IROS 2018.
"""

from __future__ import annotations

import numpy as np

from heliograph.arrays import Array, Mask, Points, as_points
from heliograph.config import PlacesConfig
from heliograph.lie import se3, so3
from heliograph.slam.places.descriptors import DescriptorTable
from heliograph.slam.places.protocol import Descriptor, PlaceMatch

__all__ = ["ScanContextDetector"]

_STEP_M = 0.05  # of a stored height: 255 of them are 12.75 m, above which a wall is as good as any


class ScanContextDetector:
    """Place recognition by scan context [1]_; the guess is a turn about the vertical.

    Parameters
    ----------
    config : PlacesConfig, optional
    """

    def __init__(self, config: PlacesConfig | None = None) -> None:
        self.config = config or PlacesConfig(method="scan-context")
        self._table = DescriptorTable(self.config.rings * self.config.sectors)

    def __len__(self) -> int:
        return len(self._table)

    def describe(self, points_level: Points) -> Descriptor:
        """Return the heights by ring and sector ([1]_ eq. 3), (rings * sectors,)."""
        c = self.config
        p = as_points("points_level", points_level)
        p = p[np.isfinite(p).all(axis=1)]
        radius = np.hypot(p[:, 0], p[:, 1])
        near = radius < c.max_range
        p, radius = p[near], radius[near]
        ring = np.minimum((radius * (c.rings / c.max_range)).astype(np.int64), c.rings - 1)
        angle = np.arctan2(p[:, 1], p[:, 0]) + np.pi
        sector = np.minimum((angle * (c.sectors / (2.0 * np.pi))).astype(np.int64), c.sectors - 1)
        height = np.clip((p[:, 2] + c.floor) / _STEP_M, 1.0, 255.0).astype(np.uint8)
        out = np.zeros(c.rings * c.sectors, dtype=np.uint8)
        np.maximum.at(out, ring * c.sectors + sector, height)
        return out

    def add(self, index: int, descriptor: Descriptor) -> None:
        """Remember a keyframe."""
        self._table.add(index, descriptor)

    def query(self, points_level: Points, *, allowed: Mask, top: int) -> tuple[PlaceMatch, ...]:
        """Return the best of the candidates that the ring key names; the score is one less the distance."""
        rows = self._table.allowed_rows(allowed)
        if len(rows) == 0 or top < 1:
            return ()
        query = self._images(self.describe(points_level)[None])[0]
        images = self._images(self._table.rows(rows))
        keys = np.mean(images > 0.0, axis=2)  # occupancy by ring ([1]_ eq. 8): turning the sensor does not change it
        far = np.sum((keys - np.mean(query > 0.0, axis=1)) ** 2, axis=1)
        chosen = np.argsort(far, kind="stable")[: max(self.config.ring_keys, top)]
        scores, shifts = _best_shift(images[chosen], query)
        order = np.argsort(-scores, kind="stable")[:top]
        return tuple(self._match(int(rows[chosen[k]]), float(scores[k]), int(shifts[k])) for k in order)

    def _images(self, descriptors: Descriptor) -> Array:
        return descriptors.reshape(-1, self.config.rings, self.config.sectors).astype(np.float64)

    def _match(self, row: int, score: float, shift: int) -> PlaceMatch:
        turn = so3.from_rpy(0.0, 0.0, 2.0 * np.pi * shift / self.config.sectors)
        T = se3.from_rotation_translation(turn, np.zeros(3))
        return PlaceMatch(index=self._table.index(row), score=score, T_match_query=T, yaw_only=True)


def _best_shift(images: Array, query: Array) -> tuple[Array, Array]:
    """Return the largest mean cosine between columns ([1]_ eq. 6, 7) of each image (K, R, S) over all shifts."""
    a = images / np.maximum(np.linalg.norm(images, axis=1, keepdims=True), 1e-12)
    b = query / np.maximum(np.linalg.norm(query, axis=0, keepdims=True), 1e-12)
    products = np.fft.irfft(
        (np.fft.rfft(a, axis=2) * np.conj(np.fft.rfft(b, axis=1))).sum(axis=1), n=images.shape[2], axis=1
    )
    full_a, full_b = np.any(images > 0.0, axis=1).astype(float), np.any(query > 0.0, axis=0).astype(float)
    # A column empty on one side is unlike; one empty on both is left out of the mean: a narrow view has many.
    union = (
        full_a.sum(axis=1)[:, None]
        + full_b.sum()
        - np.fft.irfft(np.fft.rfft(full_a, axis=1) * np.conj(np.fft.rfft(full_b)), n=images.shape[2], axis=1)
    )
    likeness = np.clip(products / np.maximum(union, 1.0), 0.0, 1.0)
    shifts = np.argmax(likeness, axis=1)
    return likeness[np.arange(len(images)), shifts], shifts

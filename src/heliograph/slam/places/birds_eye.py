"""The occupancy seen from above: ranked by its Radon spectrum, placed by correlation, lifted by its height profile.

References
----------
.. [1] S. Lu et al., "One RING to rule them all: Radon sinogram for place recognition, orientation and translation
   estimation", IROS 2022.
.. [2] X. Xu et al., "RING++: roto-translation invariant gram for global localization on a sparse scan map", T-RO 2023.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Indices, Mask, Points, as_points, freeze
from heliograph.config import PlacesConfig
from heliograph.lie import se3, so3
from heliograph.slam.places.descriptors import DescriptorTable
from heliograph.slam.places.protocol import Descriptor, PlaceMatch

__all__ = ["BirdsEyeDetector"]

Floats = NDArray[np.float32]

_ANGLES = 60  # projections over half a turn: 3 degrees apart, well inside what registration pulls in
_FREQUENCIES = 12  # of the offset, the constant one left out: down to a twelfth of the picture's diagonal
_LAYERS = 64
_IMAGES = 128  # spectra of pictures that are kept, 84 kB each as configured
_MARGIN = 1.5  # of the picture's side: shifts up to half of it do not wrap around


@dataclass(frozen=True, slots=True, kw_only=True)
class _Parts:
    """A descriptor taken apart: occupied cells (size, size), spectrum (angles, frequencies), heights (layers,)."""

    picture: NDArray[np.bool_]
    spectrum: Floats
    heights: Floats

    def __post_init__(self) -> None:
        freeze(self)


class BirdsEyeDetector:
    """Place recognition by the occupancy of a local map seen from above.

    The Radon transform of the picture turns with the body and shifts along its offsets with its translation; the
    magnitude of its spectrum along the offsets forgets the translation ([1]_, section IV), so its circular correlation
    over the angle ranks places and gives the heading, up to half a turn. Correlation of the pictures themselves decides
    between the two headings, gives the translation and the score; that of the height profiles gives z. A descriptor
    holds the picture as bits, the spectrum and the profile in bytes: 1936 bytes as configured.

    Parameters
    ----------
    config : PlacesConfig, optional
    """

    def __init__(self, config: PlacesConfig | None = None) -> None:
        self.config = config or PlacesConfig()
        self._bits = self.config.size**2 // 8
        self._table = DescriptorTable(self._bits + _ANGLES * _FREQUENCIES + _LAYERS)
        self._images: OrderedDict[int, tuple[_Parts, NDArray[np.complex64]]] = OrderedDict()
        self._padded = _fast_length(int(_MARGIN * self.config.size))

    def __len__(self) -> int:
        return len(self._table)

    def describe(self, points_level: Points) -> Descriptor:
        """Return picture, spectrum and heights as bytes; of a local map of the last keyframes rather than one scan."""
        c = self.config
        p = as_points("points_level", points_level)
        cells = np.floor(p[:, :2] / np.float32(c.cell)) + c.size // 2
        layer = np.floor(p[:, 2] / np.float32(c.layer)) + _LAYERS // 2
        inside = np.isfinite(p).all(axis=1) & (cells >= 0).all(axis=1) & (cells < c.size).all(axis=1)
        inside &= (layer >= 0) & (layer < _LAYERS)
        x, y = cells[inside].astype(np.int64).T
        solid = np.zeros((c.size * c.size, _LAYERS), dtype=bool)
        solid[x * c.size + y, layer[inside].astype(np.int64)] = True
        picture = (solid.sum(axis=1) >= c.min_layers).reshape(c.size, c.size)
        heights = np.sqrt(solid.sum(axis=0).astype(np.float32))
        spectrum = np.sqrt(self._spectrum(picture))
        return np.concatenate([np.packbits(picture.ravel()), _bytes(spectrum), _bytes(heights)])

    def add(self, index: int, descriptor: Descriptor) -> None:
        """Remember a keyframe."""
        self._table.add(index, descriptor)

    def query(self, points_level: Points, *, allowed: Mask, top: int) -> tuple[PlaceMatch, ...]:
        """Return the places of the best ranked candidates, most alike first."""
        rows = self._table.allowed_rows(allowed)
        if len(rows) == 0 or top < 1:
            return ()
        query = self._parts(self.describe(points_level))
        likeness, turns = self._rank(query, rows)
        chosen = np.argsort(-likeness, kind="stable")[: max(self.config.examined, top)]
        placed = self._place(query, rows[chosen], turns[chosen])
        placed.sort(key=lambda match: -match.score)
        return tuple(placed[:top])

    def _spectrum(self, picture: NDArray[np.bool_]) -> Floats:
        """Magnitude over offset frequencies of the Radon transform, (angles, frequencies) ([1]_ eq. 5)."""
        size = self.config.size
        cells = np.argwhere(picture) - (size - 1) / 2.0
        angles = np.pi * np.arange(_ANGLES) / _ANGLES
        bins = _fast_length(int(np.ceil(np.sqrt(2.0) * size)) + 1)
        offset = np.rint(cells @ np.array([np.cos(angles), np.sin(angles)])).astype(np.int64) + bins // 2
        keys = offset + bins * np.arange(_ANGLES)
        sinogram = np.bincount(keys.ravel(), minlength=_ANGLES * bins).reshape(_ANGLES, bins).astype(np.float32)
        return np.asarray(np.abs(np.fft.rfft(sinogram, axis=1)[:, 1 : _FREQUENCIES + 1]), dtype=np.float32)

    def _parts(self, descriptor: Descriptor) -> _Parts:
        size, end = self.config.size, self._bits + _ANGLES * _FREQUENCIES
        return _Parts(
            picture=np.unpackbits(descriptor[: self._bits]).reshape(size, size).astype(bool),
            spectrum=descriptor[self._bits : end].reshape(_ANGLES, _FREQUENCIES).astype(np.float32),
            heights=descriptor[end:].astype(np.float32),
        )

    def _rank(self, query: _Parts, rows: Indices) -> tuple[Array, Indices]:
        """Return the likeness of spectra and the turn in steps of the angle, of each row."""
        stored = self._table.rows(rows)[:, self._bits : self._bits + _ANGLES * _FREQUENCIES]
        a = _standard(stored.reshape(-1, _ANGLES, _FREQUENCIES).astype(np.float32))
        b = _standard(query.spectrum[None])[0]
        products = np.fft.rfft(a, axis=1) * np.conj(np.fft.rfft(b, axis=0))
        likeness = np.fft.irfft(products.sum(axis=2), n=_ANGLES, axis=1)
        turns = np.argmax(likeness, axis=1)
        return np.asarray(likeness[np.arange(len(rows)), turns], dtype=np.float64), turns

    def _place(self, query: _Parts, rows: Indices, turns: Indices) -> list[PlaceMatch]:
        cells = np.asarray(np.argwhere(query.picture) - (self.config.size - 1) / 2.0, dtype=np.float64)
        turned: dict[int, NDArray[np.complex64]] = {}
        found = []
        for row, turn in zip(rows, turns, strict=True):
            match, image = self._stored(int(row))
            best = (-1.0, 0, 0, 0)
            for half in (int(turn), int(turn) + _ANGLES):
                if half not in turned:
                    turned[half] = np.conj(np.fft.rfft2(self._turned(cells, half)))
                best = max(best, (*_peak(np.fft.irfft2(image * turned[half], s=(self._padded,) * 2)), half))
            norm = np.sqrt(max(len(cells), 1) * max(int(match.picture.sum()), 1))
            found.append(self._match(int(row), best, float(norm), _lift(match.heights, query.heights)))
        return found

    def _stored(self, row: int) -> tuple[_Parts, NDArray[np.complex64]]:
        """Return a row taken apart and the spectrum of its picture: the same rows are asked for by many queries."""
        if row not in self._images:
            match = self._parts(self._table.rows(np.array([row]))[0])
            image = np.fft.rfft2(_spread(match.picture), s=(self._padded, self._padded)).astype(np.complex64)
            self._images[row] = match, image
            while len(self._images) > _IMAGES:
                self._images.popitem(last=False)
        self._images.move_to_end(row)
        return self._images[row]

    def _turned(self, cells: Array, steps: int) -> Floats:
        """Picture of the query's occupied cells turned about its middle, zero-padded."""
        angle = np.pi * steps / _ANGLES
        c, s = np.cos(angle), np.sin(angle)
        size = self.config.size
        at = np.rint(cells @ np.array([[c, s], [-s, c]]) + (size - 1) / 2.0).astype(np.int64)
        at = at[(at >= 0).all(axis=1) & (at < size).all(axis=1)]
        out = np.zeros((self._padded, self._padded), dtype=np.float32)
        out[at[:, 0], at[:, 1]] = 1.0
        return out

    def _match(self, row: int, best: tuple[float, int, int, int], norm: float, layers: int) -> PlaceMatch:
        peak, dx, dy, half = best
        c = self.config
        turn = so3.from_rpy(0.0, 0.0, np.pi * half / _ANGLES)
        T = se3.from_rotation_translation(turn, np.array([dx * c.cell, dy * c.cell, layers * c.layer]))
        score = float(np.clip(peak / norm, 0.0, 1.0))
        return PlaceMatch(index=self._table.index(row), score=score, T_match_query=T)


def _fast_length(n: int) -> int:
    """Return the next multiple of 16, whose transforms are quick."""
    return -(-n // 16) * 16


def _bytes(values: Floats) -> Descriptor:
    return np.asarray(np.rint(values.ravel() * (255.0 / max(float(values.max()), 1e-12))), dtype=np.uint8)


def _standard(spectra: Floats) -> Floats:
    """Take each frequency's mean over the angles out and scale to unit length, (K, angles, frequencies)."""
    level = spectra - spectra.mean(axis=1, keepdims=True)
    return np.asarray(level / np.maximum(np.sqrt((level**2).sum(axis=(1, 2), keepdims=True)), 1e-9))


def _spread(picture: NDArray[np.bool_]) -> Floats:
    """Give half a point to the four neighbours of occupied cells: a wall may lie on the other side of a cell's edge."""
    p = picture.astype(np.float32)
    near = np.zeros_like(p)
    near[1:] = np.maximum(near[1:], p[:-1])
    near[:-1] = np.maximum(near[:-1], p[1:])
    near[:, 1:] = np.maximum(near[:, 1:], p[:, :-1])
    near[:, :-1] = np.maximum(near[:, :-1], p[:, 1:])
    return np.asarray(np.maximum(p, np.float32(0.5) * near))


def _peak(correlation: NDArray[np.floating]) -> tuple[float, int, int]:
    n = correlation.shape[0]
    at = int(np.argmax(correlation))
    x, y = divmod(at, n)
    return float(correlation[x, y]), (x + n // 2) % n - n // 2, (y + n // 2) % n - n // 2


def _lift(match: Floats, query: Floats) -> int:
    """Layers by which the query's height profile lies above where the match's fits it best."""
    products = np.correlate(match - match.mean(), query - query.mean(), mode="full")
    return int(np.argmax(products)) - (len(query) - 1)

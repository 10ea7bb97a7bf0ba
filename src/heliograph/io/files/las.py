"""LAS and LAZ through laspy, an optional extra."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.errors import DataError, MissingDependencyError

__all__ = ["extra_columns", "las_header", "las_writer", "load_laspy", "sixteen_bits", "write_las"]

_SCALE = 1e-3
_INSTALL = "pip install 'heliograph[las]'"


def write_las(path: Path, table: Mapping[str, NDArray[np.generic]], comments: Sequence[str]) -> None:
    """Write columns as LAS 1.4, point format 6; LAZ if the suffix says so.

    Coordinates are rounded to a millimetre. Intensity becomes 16 bits: values up to 1 are taken as a fraction of full
    scale, others are rounded and clipped. Other columns become extra dimensions of their own type.

    Raises
    ------
    MissingDependencyError
        laspy, or its LAZ back-end, is not installed.
    DataError
        A coordinate is not finite: LAS stores integers.
    """
    laspy = load_laspy(path.suffix)
    xyz = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    bad = int(np.count_nonzero(~np.isfinite(xyz).all(axis=1)))
    if bad:
        raise DataError(
            f"{bad} of {len(xyz)} points are not finite, which LAS cannot hold; remove them or write a .ply"
        )
    types = {name: column.dtype for name, column in table.items()}
    header = las_header(laspy, types, comments)
    header.offsets = np.floor(xyz.min(axis=0)) if len(xyz) else np.zeros(3)
    las = laspy.LasData(header)
    header.global_encoding.wkt = True  # which point formats from 6 on demand, with a coordinate system or without
    las.x, las.y, las.z = xyz.T
    las.return_number = las.number_of_returns = np.ones(len(xyz), np.uint8)  # 0 is no return's number
    if "intensity" in table:
        las.intensity = sixteen_bits(table["intensity"], float(np.nanmax(table["intensity"], initial=0.0)))
    for name in extra_columns(types):
        las[name] = table[name]
    with las_writer(path, header) as writer:
        writer.write_points(las.points)


@contextmanager
def las_writer(path: Path, header: Any) -> Iterator[Any]:  # noqa: ANN401 - laspy's
    """Yield laspy's writer of a LAS or LAZ file, whose header is complete when the block ends.

    Raises
    ------
    OSError
        The file cannot be written. The compressor, which is not Python's, tells no more of it than that it failed.
    """
    laspy, packed = load_laspy(path.suffix), path.suffix.lower() == ".laz"
    with _HeardFile(path) as file:
        try:
            with laspy.open(file, mode="w", header=header, do_compress=packed, closefd=False) as writer:
                yield writer
        except Exception as error:
            if file.failure is not None:
                raise file.failure from error
            raise


class _HeardFile(io.BufferedRandom):
    """A file that remembers why it could not be written."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path, "w+"))
        self.failure: OSError | None = None

    def write(self, data: Any) -> int:  # noqa: ANN401 - a buffer
        with self._heard():
            return super().write(data)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        with self._heard():
            return super().seek(offset, whence)

    def flush(self) -> None:
        with self._heard():
            super().flush()

    @contextmanager
    def _heard(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = error
            raise


def las_header(laspy: Any, types: Mapping[str, np.dtype[np.generic]], comments: Sequence[str]) -> Any:  # noqa: ANN401
    """Return a header in millimetres from zero for columns of some types."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, _SCALE)
    header.offsets = np.zeros(3)
    header.system_identifier = (comments[0] if comments else "")[:32]
    header.generating_software = "heliograph"
    header.add_extra_dims([laspy.ExtraBytesParams(name=name, type=types[name]) for name in extra_columns(types)])
    return header


def extra_columns(types: Mapping[str, np.dtype[np.generic]]) -> tuple[str, ...]:
    """Return the columns that LAS has no place for."""
    return tuple(name for name in types if name not in ("x", "y", "z", "intensity"))


def load_laspy(suffix: str) -> Any:  # noqa: ANN401 - an optional package without types
    """Return laspy; `MissingDependencyError` where it, or its LAZ back-end, is not installed."""
    try:
        import laspy
    except ImportError as error:
        raise MissingDependencyError(f"writing {suffix} needs laspy: {_INSTALL}; or choose .ply or .pcd") from error
    if suffix.lower() == ".laz" and not laspy.LazBackend.detect_available():
        raise MissingDependencyError(f"writing .laz needs lazrs: {_INSTALL}; or choose .las, .ply or .pcd")
    return laspy


def sixteen_bits(intensity: NDArray[np.generic], brightest: float) -> NDArray[np.uint16]:
    """Return intensities as LAS holds them, where none is larger than ``brightest``."""
    values = np.nan_to_num(intensity.astype(np.float64))
    scale = 65535.0 if 0.0 < brightest <= 1.0 else 1.0
    return np.clip(np.rint(values * scale), 0, 65535).astype(np.uint16)

"""How much a file may ask for, whatever it says about itself."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config import InputConfig

__all__ = ["MAX_NS", "ReadLimits"]

MAX_NS = 1 << 62
"""Farthest stamp that is taken for a time, 146 years from 1970 [ns]: differences of two must fit 64 bits as well."""

_MEGABYTE = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadLimits:
    """Bounds on memory and disk that hold for every reader.

    Parameters
    ----------
    chunk : int
        Bytes that one chunk or message may unpack to.
    ratio : float
        How many times its size a compressed file, or all compressed parts of one, may unpack to; below ``chunk`` it
        may always.
    reserve : int
        Bytes of the temporary folder's disk that are left free.
    topics : int
        Topics of one recording.
    """

    chunk: int = 256 * _MEGABYTE
    ratio: float = 1000.0
    reserve: int = 64 * _MEGABYTE
    topics: int = 10_000

    @classmethod
    def of(cls, config: InputConfig) -> ReadLimits:
        """Return the limits that a configuration sets."""
        return cls(chunk=round(config.max_chunk * _MEGABYTE), ratio=config.max_unpack_ratio)

    def chunk_message(self, size: int) -> str:
        """Return what is said of a chunk that is too large."""
        sizes = f"{size / _MEGABYTE:.0f} MB or more, and input.max_chunk allows {self.chunk / _MEGABYTE:.0f} MB"
        return f"it unpacks to {sizes}"

    def ratio_message(self) -> str:
        """Return what is said of a part that makes a file unpack to too much."""
        return (
            f"the file's parts unpack to more than {self.ratio:g} times their size, which no recording does; "
            "input.max_unpack_ratio allows more of one that is to be trusted"
        )

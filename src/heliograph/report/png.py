"""PNG files from arrays; 20 lines here save an image library in the install."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

__all__ = ["data_uri", "encode_png"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COMPRESSION = 4  # level 6 takes three times as long for 4 % less


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """Return an (H, W, 3) RGB or (H, W, 4) RGBA image as a PNG file (PNG specification, sections 5, 9)."""
    height, width, channels = image.shape
    # Filter 2 ("up"): each row as the difference to the row above, which deflates better than the colours themselves.
    rows = image.reshape(height, width * channels)
    filtered = np.empty((height, width * channels + 1), dtype=np.uint8)
    filtered[:, 0] = 2
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    colour_type = {3: 2, 4: 6}[channels]
    header = struct.pack(">IIBBBBB", width, height, 8, colour_type, 0, 0, 0)
    body = zlib.compress(filtered.tobytes(), _COMPRESSION)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")


def data_uri(png: bytes) -> str:
    """Return a PNG as the text of an image source."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

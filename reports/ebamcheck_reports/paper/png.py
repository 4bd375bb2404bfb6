"""A binary image as PNG, one bit a pixel (PNG specification, ISO/IEC 15948)."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray


def png(black: NDArray[np.bool_]) -> bytes:
    """Write an image (height, width), first row on top, true pixels black and false ones white."""
    height, width = black.shape
    rows = np.packbits(~black, axis=1)
    unfiltered = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(unfiltered, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def data_uri(black: NDArray[np.bool_]) -> str:
    """Return the image as a ``data:`` address, which needs no file beside the page."""
    return "data:image/png;base64," + base64.b64encode(png(black)).decode("ascii")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

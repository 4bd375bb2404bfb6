"""Images as PNG (ISO/IEC 15948) with a palette, as data URLs that a picture can contain."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
DEPTH, PALETTE = 8, 3
"""Bits of a pixel, and the colour type of images whose pixels are indices of a palette."""


def png_address(pixels: NDArray[np.uint8], palette: NDArray[np.uint8]) -> str:
    """Return the data address of an image.

    Parameters
    ----------
    pixels
        (rows, columns) indices of colours, the uppermost row first.
    palette
        (256, 3) red, green and blue.
    """
    return "data:image/png;base64," + base64.b64encode(png(pixels, palette)).decode("ascii")


def png(pixels: NDArray[np.uint8], palette: NDArray[np.uint8]) -> bytes:
    """Return the file of an image; parameters as of :func:`png_address`."""
    rows, columns = pixels.shape
    # Each row begins with the number of its filter: none.
    lines = np.zeros((rows, columns + 1), np.uint8)
    lines[:, 1:] = pixels
    header = struct.pack(">IIBBBBB", columns, rows, DEPTH, PALETTE, 0, 0, 0)
    chunks = (
        (b"IHDR", header),
        (b"PLTE", palette.astype(np.uint8).tobytes()),
        (b"IDAT", zlib.compress(lines.tobytes(), 9)),
        (b"IEND", b""),
    )
    return SIGNATURE + b"".join(_chunk(name, data) for name, data in chunks)


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

"""Images of layers in an SL1 archive, and their contours.

An SL1 archive is a zip file with one PNG image per layer, 8 bits per pixel, 255 where there is material.
"""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_IMAGE = re.compile(r"\D*(\d+)\.png")

Bits = NDArray[np.bool_]


def archived_images(path: Path) -> Iterator[tuple[int, Bits]]:
    """Images of an archive: number of the layer, and mask of the solid pixels (H, W), with rows upwards.

    :class:`BackendFailed` is raised if the archive or an image in it cannot be read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            for name in sorted(archive.namelist()):
                if match := _IMAGE.fullmatch(name):
                    yield int(match[1]), solid_pixels(archive.read(name))
    except (OSError, zipfile.BadZipFile, zlib.error) as error:
        raise BackendFailed(f"the archive that PrusaSlicer wrote cannot be read: {error}") from None


def solid_pixels(png: bytes) -> Bits:
    """Mask (H, W) of the pixels of an 8-bit grey PNG image that are brighter than half, with rows upwards.

    See the PNG specification, ISO/IEC 15948, sections 9 (filters) and 11 (chunks).
    """
    if not png.startswith(SIGNATURE):
        raise BackendFailed("an image that PrusaSlicer wrote is no PNG file")
    at, data, width, height, kind = len(SIGNATURE), b"", 0, 0, b""
    while at + 12 <= len(png):
        size, word = int.from_bytes(png[at : at + 4], "big"), png[at + 4 : at + 8]
        body = png[at + 8 : at + 8 + size]
        if word == b"IHDR":
            width, height, kind = (
                int.from_bytes(body[:4], "big"),
                int.from_bytes(body[4:8], "big"),
                body[8:13],
            )
        elif word == b"IDAT":
            data += body
        at += 12 + size
    raw = zlib.decompress(data)
    if kind != b"\x08\x00\x00\x00\x00" or len(raw) != height * (width + 1):
        raise BackendFailed("an image that PrusaSlicer wrote is not grey with 8 bits a pixel")
    rows = np.frombuffer(raw, np.uint8).reshape(height, width + 1)
    bits: Bits = unfiltered(rows)[::-1] > 127
    return bits


def unfiltered(rows: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Undo the filters of the rows of a grey image (H, 1 + W); the first column holds their types."""
    if not rows[:, 0].any():
        return rows[:, 1:]
    image = np.zeros((len(rows), rows.shape[1] - 1), np.uint8)
    above = np.zeros(image.shape[1], np.uint8)
    for k, row in enumerate(rows):
        if row[0] == 0:
            image[k] = row[1:]
        elif row[0] == 1:
            image[k] = np.cumsum(row[1:], dtype=np.uint8)
        elif row[0] == 2:
            image[k] = row[1:] + above
        else:
            raise BackendFailed(
                f"an image that PrusaSlicer wrote has rows of filter {row[0]}, which it never uses"
            )
        above = image[k]
    return image


def contours(solid: Bits) -> list[Floats]:
    """Contours half way between solid and empty pixel centres, with the solid on the left.

    Rings (n, 2) are in pixels from the corner of the image; their last point is their first one.
    """
    from skimage.measure import find_contours

    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    if not rows.size:
        return []
    row, column = int(rows[0]), int(columns[0])
    # A margin of empty pixels closes every contour.
    window = np.pad(solid[row : rows[-1] + 1, column : columns[-1] + 1], 1).astype(np.float64)
    found: list[Floats] = find_contours(  # type: ignore[no-untyped-call]
        window, 0.5, fully_connected="low", positive_orientation="low"
    )
    corner = np.array([column - 0.5, row - 0.5])
    return [_straight(ring[:, ::-1] + corner) for ring in found]


def _straight(ring: Floats) -> Floats:
    """Leave out the points inside straight runs of a ring of half pixels."""
    points = ring[:-1]
    ahead, behind = np.roll(points, -1, axis=0) - points, points - np.roll(points, 1, axis=0)
    corners = points[ahead[:, 0] * behind[:, 1] != ahead[:, 1] * behind[:, 0]]
    return np.concatenate([corners, corners[:1]])

"""Images of layers in an SL1 archive, a zip file with a grey PNG image for each, 255 where there is material; and their
contours."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats

_IMAGE = re.compile(r"\D*(\d+)\.png")

Bits = NDArray[np.bool_]


def archived_images(path: Path) -> Iterator[tuple[int, Bits]]:
    """Number of each layer and mask (H, W) of its solid pixels, rows upwards; :class:`BackendFailed` where they cannot be read."""
    try:
        with zipfile.ZipFile(path) as archive:
            for name in sorted(archive.namelist()):
                if match := _IMAGE.fullmatch(name):
                    yield int(match[1]), solid_pixels(archive.read(name))
    except (OSError, zipfile.BadZipFile, zlib.error) as error:
        raise BackendFailed(f"the archive that PrusaSlicer wrote cannot be read: {error}") from None


def solid_pixels(png: bytes) -> Bits:
    """Mask (H, W) of the pixels of an 8-bit grey PNG image that are brighter than half, with rows upwards."""
    from PIL.PngImagePlugin import PngImageFile

    try:
        # `Image.open` would refuse images as large as those of a wide part.
        image = PngImageFile(io.BytesIO(png))
        pixels = np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise BackendFailed(f"an image that PrusaSlicer wrote is no PNG file: {error}") from None
    if image.mode != "L":
        raise BackendFailed("an image that PrusaSlicer wrote is not grey with 8 bits a pixel")
    bits: Bits = pixels[::-1] > 127
    return bits


def contours(solid: Bits) -> list[Floats]:
    """Rings (n, 2), closed, half way between solid and empty pixel centres, solid on the left, in pixels from the image's
    corner."""
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

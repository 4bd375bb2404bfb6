"""Colours that readers tell apart, colour-blind ones too: of lines, and along a scale; and images in them as PNG."""

from __future__ import annotations

import base64
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL import Image

# Okabe and Ito's colours, with Tol's wine in place of their yellow, which is not seen on white
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#882255")
# Lines that lie on each other stay visible by their dashes
DASHES = ("", "9 6", "3 7", "9 4 2 4", "1 5", "14 6", "5 5", "12 3 2 3 2 3")
# Colours from first to last: even to the eye and in grey (van der Walt and Smith 2015, CC0)
VIRIDIS = ((68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140), (40, 174, 128), (94, 201, 98), (173, 220, 48), (253, 231, 37))  # fmt: skip


def mixed(share: float) -> tuple[int, int, int]:
    """Red, green and blue for a share between 0 and 1; what lies beyond has the colour of the end."""
    at = min(max(share, 0.0), 1.0) * (len(VIRIDIS) - 1)
    step = min(int(at), len(VIRIDIS) - 2)
    low, high = VIRIDIS[step], VIRIDIS[step + 1]
    red, green, blue = (round(a + (at - step) * (b - a)) for a, b in zip(low, high, strict=True))
    return red, green, blue


def ramp(share: float) -> str:
    """Colour for a share between 0 and 1, as a picture names it.

    >>> ramp(0.0), ramp(1.0)
    ('#440154', '#fde725')
    """
    return "#" + "".join(f"{part:02x}" for part in mixed(share))


SCALE = np.array([mixed(n / 255.0) for n in range(256)], np.uint8)  # (256, 3) along the scale


def palette_image(pixels: NDArray[np.uint8], palette: NDArray[np.uint8]) -> Image.Image:
    """Image of indices (rows, columns), the uppermost row first, of colours (256, 3)."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.putpalette(palette.astype(np.uint8).tobytes())
    return image


def binary_image(black: NDArray[np.bool_]) -> Image.Image:
    """Image (rows, columns) of one bit a pixel, the uppermost row first: true pixels black, false ones white."""
    from PIL import Image

    return Image.fromarray(np.ascontiguousarray(~black))


def png(image: Image.Image) -> bytes:
    """Return the PNG file of an image."""
    file = BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def png_address(image: Image.Image) -> str:
    """Return the data address of an image, which needs no file beside the page."""
    return "data:image/png;base64," + base64.b64encode(png(image)).decode("ascii")

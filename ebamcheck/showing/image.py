"""Images as PNG data addresses that a picture can contain."""

from __future__ import annotations

import base64
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def palette_image(pixels: NDArray[np.uint8], palette: NDArray[np.uint8]) -> Image.Image:
    """Image of indices of colours.

    Parameters
    ----------
    pixels
        (rows, columns) indices of colours, the uppermost row first.
    palette
        (256, 3) red, green and blue.
    """
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.putpalette(palette.astype(np.uint8).tobytes())
    return image


def binary_image(black: NDArray[np.bool_]) -> Image.Image:
    """Image (rows, columns) of one bit a pixel, the uppermost row first: true pixels black, false ones white."""
    return Image.fromarray(np.ascontiguousarray(~black))


def png(image: Image.Image) -> bytes:
    """Return the PNG file of an image."""
    file = BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def png_address(image: Image.Image) -> str:
    """Return the data address of an image, which needs no file beside the page."""
    return "data:image/png;base64," + base64.b64encode(png(image)).decode("ascii")

"""Parts, cuts and bitmaps of the stencil backend, for its tests."""

from __future__ import annotations

import numpy as np
import pytest
from parts import box, moved
from scipy.spatial.transform import Rotation

from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck_stencil import Stencil
from ebamcheck_stencil.crossings import empty_bitmap, flip, flips_by_layer
from ebamcheck_stencil.literal import LiteralSlices

PROBE = Stencil().probe()
gl = [pytest.mark.gl, pytest.mark.skipif(not PROBE.available, reason=f"stencil: {PROBE.why}")]
BOTH_MODES = pytest.mark.parametrize("mode", ["draw-once", "literal"])


UNIT = box(upper=(1, 1, 1))


def turned(part: Part, axis, angle: float) -> Part:
    """A part rotated about an axis through the origin, angle in radians."""
    return moved(part, Rotation.from_rotvec(angle * np.array(axis, float) / np.linalg.norm(axis)).as_matrix())


def cut(part: Part, heights, **settings) -> Layers:
    with Stencil().prepare(part, Stencil.Settings(**settings)) as prepared:
        return prepared.slice(np.asarray(heights, float))


def as_image(bitmap, view):
    """The bitmap as an image (height, width), row 0 at the least y."""
    bits = np.unpackbits(bitmap.astype("<u8").view(np.uint8), bitorder="little")
    return bits.reshape(view.height_px, view.stride_px)[:, : view.width_px].astype(np.bool_)


def image_at(prepared, height_mm):
    """Image (height, width) of the section of a prepared part at a height, row 0 at the least y."""
    height = np.array([float(height_mm)])
    bitmap = empty_bitmap(prepared._view)
    if isinstance(prepared, LiteralSlices):
        assert sum(prepared._draw(height, bitmap[None, :])) == 1
    else:
        flip(bitmap, flips_by_layer(prepared._crossings, height).pixels)
    return as_image(bitmap, prepared._view)


def same(a: Layers, b: Layers) -> bool:
    columns = ("heights", "points", "ring_starts", "layer_starts", "closed")
    return all(np.array_equal(getattr(a, c), getattr(b, c)) for c in columns)

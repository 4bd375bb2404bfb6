"""Bitmaps of the stencil backend, pixel by pixel: draw-once against the exact section and the literal mode."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from stencil_cuts import image_at
from stencil_parts import box, joined, moved, torus, turned

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models import LADDER
from ebamcheck_stencil import Stencil
from ebamcheck_stencil.field_of_view import SUBPIXELS, FieldOfView, field_of_view
from ebamcheck_stencil.slicer import CLIP_MOVE_PX, FLOAT32_STEP

PROBE = Stencil().probe()
pytestmark = [pytest.mark.gl, pytest.mark.skipif(not PROBE.available, reason=f"stencil: {PROBE.why}")]

SIDE_PX = 1024
MOST_DIFFERING = 8
"""Pixels of 1024 x 1024 whose centres may lie within a lattice step of a contour, and so on either side."""

PARTS = {
    "turned torus": from_arrays(*turned(torus(90, 31, 200, 120), (1, 2, 3), 0.9)),
    "boxes that overlap": from_arrays(
        *turned(joined(box(high=(40, 30, 20)), moved(box(high=(9, 50, 60)), (7, -8, -9))), (3, 1, 2), 0.4)
    ),
    "ladder": LADDER.tessellate(0.06),
}


def fine_pixel(part: Part) -> float:
    return float(part.size[:2].max()) / (SIDE_PX - 6)


def section(part: Part, height: float):
    """Directed segments (S, 4) in which a generic plane cuts the facets, material on their left."""
    corners = part.vertices[part.faces]
    above = corners[:, :, 2] > height
    ends = np.full((len(corners), 4), np.nan)
    for k in range(3):
        a, b, rises = corners[:, k], corners[:, (k + 1) % 3], above[:, (k + 1) % 3]
        for crossed, place in ((rises & ~above[:, k], slice(2, 4)), (above[:, k] & ~rises, slice(0, 2))):
            p, q = a[crossed], b[crossed]
            t = (height - p[:, 2]) / (q[:, 2] - p[:, 2])
            ends[crossed, place] = p[:, :2] + t[:, None] * (q[:, :2] - p[:, :2])
    return ends[~np.isnan(ends).any(axis=1)]


def exact_image(segments, view: FieldOfView):
    """Pixels whose centres have a winding number over 0, by the crossings of each row's line with the segments."""
    step = view.to_mm(np.array([[0, 0], [2, 2]]))
    low, pixel = step[0], step[1] - step[0]
    x0, y0, x1, y1 = segments.T
    first, past = np.ceil((np.sort([y0, y1], axis=0) - low[1]) / pixel[1]).astype(int).clip(0, view.height_px)
    counts = past - first
    which = np.repeat(np.arange(len(segments)), counts)
    row = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
    t = (low[1] + pixel[1] * row - y0[which]) / (y1 - y0)[which]
    x = x0[which] + t * (x1 - x0)[which]
    changes = np.zeros((view.height_px, view.width_px), int)
    np.add.at(changes, (row, np.ceil((x - low[0]) / pixel[0]).astype(int)), np.where(y1 > y0, -1, 1)[which])
    return changes.cumsum(axis=1) > 0


def farthest_px(wrong, contour, view: FieldOfView) -> float:
    """Greatest distance of the centre of a wrong pixel from the contour, in pixels."""
    centres = shapely.points(view.to_mm(2 * np.argwhere(wrong)[:, ::-1]))
    return float(shapely.distance(centres, contour).max(initial=0.0)) / view.pixel_mm


def heights(part: Part, count: int):
    low, high = part.bounds[:, 2]
    return low + (high - low) * (np.arange(count) + 0.371) / count


@pytest.mark.parametrize("name", PARTS)
def test_few_pixels_differ_and_only_within_a_lattice_step_of_the_contour(name):
    part = PARTS[name]
    pixel = fine_pixel(part)
    view = field_of_view(part, pixel)
    assert max(view.width_px, view.height_px) in range(SIDE_PX - 4, SIDE_PX + 1)
    with (
        Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel)) as once,
        Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel, mode="literal")) as literal,
    ):
        for height in heights(part, 6):
            segments = section(part, height)
            exact, drawn = exact_image(segments, view), image_at(once, height)
            assert exact.any()
            contour = shapely.MultiLineString(segments.reshape(-1, 2, 2).tolist())
            assert np.count_nonzero(drawn != exact) <= MOST_DIFFERING
            assert farthest_px(drawn != exact, contour, view) <= 1.0 / SUBPIXELS
            # Clipping rounds once more, and how it does is the driver's.
            clipped = image_at(literal, height)
            assert np.count_nonzero(drawn != clipped) <= 2 * MOST_DIFFERING
            clipped_px = CLIP_MOVE_PX + 4.0 * FLOAT32_STEP * view.viewport_px
            assert farthest_px(clipped != exact, contour, view) <= clipped_px


def test_the_bitmap_is_what_the_contours_are_drawn_around():
    part = PARTS["turned torus"]
    pixel = 0.7
    view = field_of_view(part, pixel)
    with Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel)) as once:
        for height in heights(part, 3):
            region = shapely.union_all(once.slice(np.array([height])).polygons(0))
            x, y = view.to_mm(2 * np.indices((view.width_px, view.height_px)).reshape(2, -1).T).T
            inside = shapely.contains_xy(region, x, y).reshape(view.width_px, view.height_px).T
            assert np.array_equal(inside, image_at(once, height))

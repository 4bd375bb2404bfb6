"""Figures 3 to 5: the binary image of a layer by the paper's method, and its contours."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.comparison import compare
from ebamcheck.errors import BackendFailed, EbamcheckError
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.plugins import registry
from ebamcheck.showing.colours import binary_image, png_address
from ebamcheck_reports.canvas import Canvas, around, outline
from ebamcheck_reports.markup import Markup, element
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.subject import Subject
from ebamcheck_reports.paper.timing import STENCIL

CONTOUR, PIXEL = "#d55e00", "#cfd4da"
WIDTH_PX = 520.0

ENLARGED_PX = 12
"""Half the side of the piece enlarged, in pixels of the image."""

Image = NDArray[np.bool_]


@runtime_checkable
class DrawsBitmaps(Protocol):
    """A prepared part that shows the image from which a layer's contours come."""

    def bitmap(self, height_mm: float) -> Image:
        """Image (height, width) of the section at a height, row 0 at the least y."""
        ...


def measure(subject: Subject) -> tuple[dict[str, Any], list[Markup]]:
    """Draw one layer, compare its contours with the exact ones, and picture both."""
    record: dict[str, Any] = {
        "pixel_mm": published.PIXEL_MM,
        "layer_height_mm": published.LAYER_HEIGHT_MM,
        "layer": subject.layer + 1,
        "height_mm": subject.height_mm,
        "status": "done",
        "why": "",
    }
    try:
        image, contours, bound_mm = draw(subject)
    except EbamcheckError as error:
        return {**record, "status": "not drawn", "why": str(error)}, []
    found = compare(contours, subject.section).iloc[0]
    record |= {
        "width_px": image.shape[1],
        "height_px": image.shape[0],
        "black_px": int(image.sum()),
        "black_area_mm2": float(image.sum()) * published.PIXEL_MM**2,
        "contour_area_mm2": float(contours.areas()[0]),
        "exact_area_mm2": float(subject.section.areas()[0]),
        "rings": int(contours.ring_counts()[0]),
        "points": len(contours.points),
        "exact_points": len(subject.section.points),
        "depth_mm": float(found["depth_mm"]),
        "bound_mm": bound_mm,
    }
    if not image.any():
        return record, []
    return record, [_whole(image, contours), _enlarged(image, contours)]


def draw(subject: Subject) -> tuple[Image, Layers, float]:
    """Binary image of the layer, the contours found in it, and the declared error bound."""
    slicer = registry.available_slicer(STENCIL)
    settings = registry.slicer_settings(STENCIL, {"mode": "literal", "pixel_mm": published.PIXEL_MM})
    with slicer.prepare(subject.part, settings) as prepared:
        if not isinstance(prepared, DrawsBitmaps):
            raise BackendFailed(f"backend {STENCIL!r} of this installation shows no bitmaps: update it")
        # The image first: slicing may release the graphics context, after which nothing can be drawn.
        image = prepared.bitmap(subject.height_mm)
        contours = prepared.slice(subject.section.heights)
    check(image, contours)
    return image, contours, slicer.error_bound_mm(subject.part, settings)


def check(image: Image, contours: Layers) -> None:
    """Refuse an image that does not match the contours."""
    extent_px = [
        int(np.ptp(np.flatnonzero(line))) + 1 if line.any() else 0 for line in (image.any(0), image.any(1))
    ]
    of_contours_px = (
        np.ptp(contours.points, axis=0) / published.PIXEL_MM if len(contours.points) else np.zeros(2)
    )
    if not np.allclose(extent_px, of_contours_px, atol=0.1):
        raise BackendFailed(
            f"{STENCIL}: the image spans {extent_px[0]} x {extent_px[1]} pixels but its contours "
            f"{of_contours_px[0]:g} x {of_contours_px[1]:g}: report this"
        )


def pixel_corner_mm(image: Image, contours: Layers) -> Floats:
    """Where the image's low corner lies, (2,) mm.

    A contour passes midway between a black pixel's centre and a white one's: it leaves the outermost black
    pixels along their outer borders.
    """
    columns, rows = np.flatnonzero(image.any(axis=0)), np.flatnonzero(image.any(axis=1))
    first = np.array([columns[0], rows[0]])
    return np.asarray(contours.points.min(axis=0) - first * published.PIXEL_MM, np.float64)


def _whole(image: Image, contours: Layers) -> Markup:
    low = pixel_corner_mm(image, contours)
    high = low + np.array(image.shape[::-1]) * published.PIXEL_MM
    canvas = Canvas((float(low[0]), float(low[1]), float(high[0]), float(high[1])), WIDTH_PX)
    (x0, y1), (x1, y0) = canvas.pixels(np.stack([low, high])).tolist()
    canvas.body.append(
        element(
            "image", x=f"{x0:.2f}", y=f"{y0:.2f}", width=f"{x1 - x0:.2f}", height=f"{y1 - y0:.2f}",
            preserveAspectRatio="none", href=png_address(binary_image(image[::-1])),
        )
    )  # fmt: skip
    _add_contours(canvas, contours, 1.4)
    return canvas.svg("binary image of the layer (black) and its contours")


def _enlarged(image: Image, contours: Layers) -> Markup:
    """The pixels about the leftmost point of the contours, and the way of marching squares between them."""
    size = published.PIXEL_MM
    low = pixel_corner_mm(image, contours)
    x, y = contours.points[int(np.argmin(contours.points[:, 0]))].tolist()
    centre = np.floor((np.array([x, y]) - low) / size).astype(np.int64) + np.array([ENLARGED_PX // 2, 0])
    x, y = (low + (centre + 0.5) * size).tolist()
    canvas = Canvas(around(x, y, ENLARGED_PX * size), WIDTH_PX)
    reach = np.arange(-ENLARGED_PX - 1, ENLARGED_PX + 2)
    columns, rows = (g.ravel() for g in np.meshgrid(centre[0] + reach, centre[1] + reach))
    inside = (columns >= 0) & (rows >= 0) & (columns < image.shape[1]) & (rows < image.shape[0])
    columns, rows = columns[inside], rows[inside]
    black = image[rows, columns]
    left, bottom = low[0] + columns * size, low[1] + rows * size
    canvas.lines(shapely.union_all(shapely.box(left, bottom, left + size, bottom + size)[black]), fill=PIXEL)
    places = np.column_stack([left, bottom]) + 0.5 * size
    canvas.dots(places[~black], 3.0, "#9aa3ad")
    canvas.dots(places[black], 5.0, "#000")
    _add_contours(canvas, contours, 2.2)
    return canvas.svg("pixels and contour, enlarged")


def _add_contours(canvas: Canvas, contours: Layers, width_px: float) -> None:
    for ring in contours.rings_of(0):
        canvas.lines(shapely.LineString(outline(contours, ring)), stroke=CONTOUR, stroke_width=width_px)

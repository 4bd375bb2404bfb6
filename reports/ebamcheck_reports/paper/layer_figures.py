"""Figures 3 to 8 on one part: the binary image of a layer, its contours split at corners, and its hexagons."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.comparison import compare
from ebamcheck.curves import SPLINE, Curves, fit, fit_deviation
from ebamcheck.errors import BackendFailed, EbamcheckError, GeometryError
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.scan import minimum_rectangle, plan_scan
from ebamcheck.scan.islands.lattice import HEXAGON, hexagons_across, rows_along
from ebamcheck.settings.config import Config
from ebamcheck.showing.colours import COLOURS, binary_image, png_address
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_reports.canvas import Canvas, around, outline
from ebamcheck_reports.markup import DOTS, Markup, element, legend
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.timing import STENCIL
from ebamcheck_reports.sections import scan

AREA_STEP = 8  # Step between the layers that are searched for the largest section
CONTOUR, PIXEL = "#d55e00", "#cfd4da"
ENLARGED_PX = 12  # Half the side of the piece enlarged, in pixels of the image
STRAIGHT, SPLIT = "#1c2126", "#b3261e"
CURVED = tuple(colour for colour in COLOURS if colour != "#000000")

Image = NDArray[np.bool_]
Measured = tuple[dict[str, Any], list[Markup]]  # Part of the record, and the pictures of it


@dataclass(frozen=True, eq=False)
class Subject:
    """A part, what it is, its count of layers, the layer shown, and its largest layer for the partition; sections are exact."""

    part: Part
    about: str
    count: int
    layer: int
    section: Layers
    largest_layer: int
    largest_section: Layers

    @property
    def height_mm(self) -> float:
        """Height of the layer shown."""
        return float(self.section.heights[0])


def find_subject(path: Path | None, units: str) -> Subject:
    """Load the mesh given (InputError if it cannot be read), or make the stand-in, and choose the layer shown and the largest.

    GeometryError if the layers hold no closed contour.
    """
    if path is None:
        part = registry.models(["blade"])["blade"].tessellate(0.05)
        about = "The reference model 'blade' stands in for the Stanford bunny, which is not shipped; its middle layer is shown."
    else:
        part, about = load(path, units), f"The mesh given: {path.name}."
    heights = layer_heights(part, published.LAYER_HEIGHT_MM)
    layer = len(heights) // 2
    if path is not None and len(heights) >= published.CURVE_LAYER:
        layer = published.CURVE_LAYER - 1
    elif path is not None:
        about += f" It has {len(heights)} layers, no layer {published.CURVE_LAYER}: the middle one is shown."
    sampled = np.unique([layer, *range(0, len(heights), AREA_STEP)])
    stack = slice_part(part, heights[sampled])
    largest = int(np.argmax(stack.areas()))
    if not stack.areas()[largest] > 0.0:
        raise GeometryError(
            f"{part.name}: none of {len(sampled)} layers has a closed contour: check its unit and `ebamcheck inspect`"
        )
    shown = int(np.searchsorted(sampled, layer))
    if not stack.areas()[shown] > 0.0:
        about += f" Layer {layer + 1} is empty: that of the greatest area is shown."
        shown = largest
    sections = [stack.take(np.array([k])) for k in (shown, largest)]
    return Subject(part, about, len(heights), int(sampled[shown]), sections[0], int(sampled[largest]), sections[1])


# -- Figures 3 to 5: the image and its contours ----------------------------------------------------


@runtime_checkable
class DrawsBitmaps(Protocol):
    """A prepared part that shows the image from which a layer's contours come."""

    def bitmap(self, height_mm: float) -> Image:
        """Image (height, width) of the section at a height, row 0 at the least y."""
        ...


def measure_bitmap(subject: Subject) -> Measured:
    """Draw one layer by the paper's method, compare its contours with the exact ones, and picture both."""
    record: dict[str, Any] = {
        "pixel_mm": published.PIXEL_MM,
        "layer_height_mm": published.LAYER_HEIGHT_MM,
        "layer": subject.layer + 1,
        "height_mm": subject.height_mm,
        "status": "done",
        "why": "",
    }
    try:
        image, contours, bound_mm = _drawn(subject)
    except EbamcheckError as error:
        return {**record, "status": "not drawn", "why": str(error)}, []
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
        "depth_mm": float(compare(contours, subject.section).iloc[0]["depth_mm"]),
        "bound_mm": bound_mm,
    }
    return record, [_whole(image, contours), _enlarged(image, contours)] if image.any() else []


def _drawn(subject: Subject) -> tuple[Image, Layers, float]:
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
    lines = (image.any(0), image.any(1))
    extent_px = [int(np.ptp(np.flatnonzero(line))) + 1 if line.any() else 0 for line in lines]
    points = contours.points if len(contours.points) else np.zeros((1, 2))
    of_contours_px = np.ptp(points, axis=0) / published.PIXEL_MM
    if not np.allclose(extent_px, of_contours_px, atol=0.1):
        raise BackendFailed(
            f"{STENCIL}: the image spans {extent_px[0]} x {extent_px[1]} pixels but its contours "
            f"{of_contours_px[0]:g} x {of_contours_px[1]:g}: report this"
        )


def pixel_corner_mm(image: Image, contours: Layers) -> Floats:
    """Where the image's low corner lies, (2,) mm: contours leave the outermost black pixels along their outer borders."""
    first = np.array([np.flatnonzero(image.any(axis=k))[0] for k in range(2)])
    return np.asarray(contours.points.min(axis=0) - first * published.PIXEL_MM, np.float64)


def _whole(image: Image, contours: Layers) -> Markup:
    low = pixel_corner_mm(image, contours)
    high = low + np.array(image.shape[::-1]) * published.PIXEL_MM
    canvas = Canvas.of(np.stack([low, high]), 520.0)
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
    leftmost = contours.points[int(np.argmin(contours.points[:, 0]))]
    centre = np.floor((leftmost - low) / size).astype(np.int64) + np.array([ENLARGED_PX // 2, 0])
    x, y = (low + (centre + 0.5) * size).tolist()
    canvas = Canvas(around(x, y, ENLARGED_PX * size), 520.0)
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


# -- Figure 7: split at 140 degrees into straight and curved parts ---------------------------------


def measure_corners(subject: Subject) -> Measured:
    """Split the layer shown, and the largest one where that is another, and picture both."""
    chosen = {subject.layer: subject.section, subject.largest_layer: subject.largest_section}
    found = [_split(layer, section) for layer, section in chosen.items()]
    record = {
        "corner_angle_deg": published.CORNER_ANGLE_DEG,
        "layers_of_part": subject.count,
        "layers": [values for values, _ in found],
    }
    key = (
        ("curved parts, one colour after the other", CURVED[0], ""),
        ("straight parts", STRAIGHT, ""),
        ("where two parts meet", SPLIT, DOTS),
    )
    return record, [legend(key), *(picture for _, picture in found)]


def _split(layer: int, section: Layers) -> tuple[dict[str, Any], Markup]:
    """Fit the exact contours of one layer by the paper's method, count the parts and draw them."""
    curves = fit(section, "paper", corner_angle_deg=published.CORNER_ANGLE_DEG)
    curved, splits = curves.kind == SPLINE, _split_places(curves)
    record = {
        "layer": layer + 1,
        "height_mm": float(section.heights[0]),
        "curve_parts": int(curved.sum()),
        "straight_parts": int((~curved).sum()),
        "splits": len(splits),
        "points": len(section.points),
        "blocks": curves.block_count(),
        "deviation_mm": float(fit_deviation(curves, section)["bulge_mm"].max()),
    }
    spans, canvas = curves.bezier_spans(), Canvas(section.bounds(), 720.0)
    rank = np.cumsum(curved) - 1
    for p in range(curves.kind.size):
        colour, width = (CURVED[int(rank[p]) % len(CURVED)], 3.0) if curved[p] else (STRAIGHT, 2.0)
        canvas.beziers(spans.points[spans.piece == p], stroke=colour, stroke_width=width)
    canvas.dots(splits, 9.0, SPLIT)
    return record, canvas.svg("straight and curved parts of the layer")


def _split_places(curves: Curves) -> Floats:
    """Points at which two parts of a contour meet, (n, 2) mm; a ring of one part has none."""
    rings = [curves.pieces_of(ring) for ring in range(curves.closed.size)]
    places = [curves.piece(p).control[0] for pieces in rings if len(pieces) > 1 for p in pieces]
    return np.array(places, np.float64).reshape(-1, 2)


# -- Figure 8: hexagons by the paper's rule, in the order of its text ------------------------------


def measure_partition(subject: Subject) -> Measured:
    """Partition the largest layer and picture its islands in their order.

    The rectangle has rotations in steps of pi/10 (equation 11) and its hexagons lie along it on every layer; the nearest
    centroid comes next (section 4.2).
    """
    section, rules = subject.largest_section, {"rectangle": "paper", "order": "nearest"}
    config = Config().changed(scan={**rules, "lattice_angle_deg": 0.0, "lattice_shift": False})
    regions = section.polygons(0)
    plan = plan_scan(regions, config, layer=subject.largest_layer, height_mm=float(section.heights[0]))
    figures = plan.metrics.iloc[0]
    bead_mm = config.process.bead_width_mm
    record = {
        "layer": subject.largest_layer + 1,
        "height_mm": float(section.heights[0]),
        "area_mm2": float(figures["area_mm2"]),
        **lattice(shapely.get_coordinates(regions), float(figures["side_mm"])),
        "islands": len(plan.islands),
        "hexagons": int((plan.island_kind == HEXAGON).sum()),
        **rules,
        "covered_fraction": float(figures["covered_fraction"]),
        "bead_width_mm": bead_mm,
    }
    svg = scan.draw(plan, section, 0, bead_mm, "hexagons of the layer and their order")
    return record, [legend(scan.LEGEND), svg]


def lattice(points: Floats, side_mm: float) -> dict[str, Any]:
    """Sides of the enclosing rectangle and the paper's count of hexagons along the short one (section 4.1).

    ``rounded`` is round(L1 / d) + 1; where it is even, one hexagon more is laid. Without a solid that can be
    divided there is no side, and nothing is counted.
    """
    box = minimum_rectangle(points, "paper")
    found: dict[str, Any] = {
        "L1_mm": box.short_mm,
        "L2_mm": box.long_mm,
        "angle_deg": math.degrees(box.angle_rad),
        "d_mm": side_mm,
    }
    if math.isnan(side_mm):
        return {**found, "rounded": None, "case": "none", "n": 0, "rows": 0}
    rounded = math.floor(box.short_mm / side_mm + 0.5) + 1
    return {
        **found,
        "rounded": rounded,
        "case": "odd" if rounded % 2 else "even",
        "n": hexagons_across(box.short_mm, side_mm),
        "rows": rows_along(box.long_mm, side_mm),
    }

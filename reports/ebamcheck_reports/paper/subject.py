"""Subject: the part of Figures 3 to 8, sliced as the paper slices its bunny."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebamcheck.errors import GeometryError
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.plugins.registry import models
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_reports.paper.published import CURVE_LAYER, LAYER_HEIGHT_MM

STAND_IN, STAND_IN_TOLERANCE_MM = "blade", 0.05
"""Model shown if no mesh is given, and the tolerance of its mesh, mm."""

AREA_STEP = 8
"""Step between the layers that are searched for the largest section."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A part and two of its layers.

    Parameters
    ----------
    part
        The part.
    about
        What it is, in a sentence.
    count
        Layers of 0.2 mm that it has.
    layer, section
        Index of the layer shown in Figures 3 to 7, and its exact contours.
    largest_layer, largest_section
        Layer of the greatest area, for the partition, and its exact contours.
    """

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
    """Load the mesh given, or make the stand-in, and choose its layers.

    Raises
    ------
    InputError
        If the mesh cannot be read.
    GeometryError
        If the layers hold no closed contour.
    """
    if path is None:
        part = models([STAND_IN])[STAND_IN].tessellate(STAND_IN_TOLERANCE_MM)
        about = f"The reference model {STAND_IN!r} stands in for the Stanford bunny, which is not shipped; its middle layer is shown."
        return _cut(part, about, None)
    part = load(path, units)
    return _cut(part, f"The mesh given: {path.name}.", CURVE_LAYER - 1)


def _cut(part: Part, about: str, wanted: int | None) -> Subject:
    """Cut the layer wanted, the middle one where there are not so many, and the largest of a sample."""
    heights = layer_heights(part, LAYER_HEIGHT_MM)
    middle = len(heights) // 2
    layer = wanted if wanted is not None and wanted < len(heights) else middle
    if wanted is not None and layer != wanted:
        about += f" It has {len(heights)} layers, no layer {wanted + 1}: the middle one is shown."
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
    return Subject(
        part,
        about,
        len(heights),
        int(sampled[shown]),
        stack.take(np.array([shown])),
        int(sampled[largest]),
        stack.take(np.array([largest])),
    )

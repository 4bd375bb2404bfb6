"""Heights at which a job cuts a part: those of its settings, checked to lie in the part."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.errors import SettingsError
from ebamcheck.layers.heights import checked_heights, is_rising, layer_heights
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config


def cut_heights(part: Part, config: Config) -> Floats:
    """Heights of the cuts by the settings, (L,) mm.

    Raises
    ------
    SettingsError
        If given heights do not increase, or one is outside the part.
    """
    if not config.layers.heights_mm:
        return layer_heights(part, config.layer_height_mm)
    heights = checked_heights(config.layers.heights_mm)
    if not is_rising(heights):
        raise SettingsError("layers.heights_mm must rise from layer to layer: sort them and drop repeats")
    return heights_within(part, heights, "layers.heights_mm")


def heights_within(part: Part, heights: ArrayLike, named: str) -> Floats:
    """Return heights after checking that all of them cut the part; `named` tells messages where they were given.

    A section is that at z = h + 0, so a cut at the lowest point is valid, and one at the highest is empty.

    Raises
    ------
    SettingsError
        If one is not finite, or is outside the part; the message names it, and the range of the part.
    """
    column = checked_heights(heights)
    low, high = part.bounds[:, 2].tolist()
    outside = np.flatnonzero((column < low) | (column > high))
    if outside.size:
        more = f" (and {outside.size - 1} more)" if outside.size > 1 else ""
        raise SettingsError(
            f"{named}: {column[outside[0]]:.10g} mm{more} is outside of the part {part.name!r}, which reaches from "
            f"z = {low:.10g} to {high:.10g} mm"
        )
    return column

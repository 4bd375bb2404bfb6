"""Heights at which a part is cut."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.part import Part

LARGEST_STACK = 1_000_000
"""Layers beyond this count are a mistyped layer height, not a build."""

PARABOLA = 2.0 / 3.0
"""Area of a parabolic bead over its width times its height (Pixner et al. 2020, Materials 13:3310)."""


def bead_height_mm(
    wire_diameter_mm: float, wire_speed_mm_s: float, travel_speed_mm_s: float, bead_width_mm: float
) -> float:
    """Height of one bead from the mass balance ``v_wire pi d^2 / 4 = v_travel A`` with ``A = 2/3 w h``.

    Examples
    --------
    >>> round(bead_height_mm(1.6, 2000 / 60, 10.0, 6.0), 2)
    1.68
    """
    area_mm2 = wire_speed_mm_s * math.pi * wire_diameter_mm**2 / 4.0 / travel_speed_mm_s
    return area_mm2 / (PARABOLA * bead_width_mm)


def layer_heights(part: Part, layer_height: float) -> NDArray[np.float64]:
    """Middle heights of uniform layers from the part's lowest point up, (L,) mm.

    The number of layers is the part's height over the layer height, rounded to the nearest, at least 1;
    layer k spans ``zmin + k h .. zmin + (k + 1) h`` and is cut at its middle.

    Raises
    ------
    SettingsError
        If the layer height is not positive, or would give more than :data:`LARGEST_STACK` layers.
    """
    if not (math.isfinite(layer_height) and layer_height > 0.0):
        raise SettingsError(f"layer height {layer_height} mm: give a positive number of millimetres")
    bottom, top = float(part.bounds[0, 2]), float(part.bounds[1, 2])
    count = max(1, math.ceil((top - bottom) / layer_height - 0.5 - 1e-9))
    if count > LARGEST_STACK:
        raise SettingsError(
            f"layer height {layer_height} mm cuts {top - bottom:g} mm into {count} layers, "
            f"over the limit of {LARGEST_STACK}: give a larger one, or check the unit of the part"
        )
    if count == 1 and top - bottom < layer_height:
        return np.array([0.5 * (bottom + top)])
    return np.asarray(bottom + (np.arange(count) + 0.5) * layer_height, dtype=np.float64)


def checked_heights(heights: ArrayLike) -> NDArray[np.float64]:
    """Heights as a float64 column; raises :class:`SettingsError` where one is not finite."""
    column = np.asarray(heights, dtype=np.float64).reshape(-1)
    if not np.isfinite(column).all():
        k = int(np.flatnonzero(~np.isfinite(column))[0])
        raise SettingsError(f"height {k} is {column[k]}: heights must be finite numbers of millimetres")
    return column

"""Zones of a layer's metal: how high it is on average near and far from the border, and in every small window.

What a zone may be off by follows from its size: metal comes in lines, and the border of a zone runs through one, so that the
zone has up to half a line more or less than its width asks for. Heights are those of the metal when it has levelled, as on the
surface. Metal that fills up or spares what the layers below have left
is not wrong. A window is three beads wide, four lines: one that is missing there is a quarter of its metal.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import ndimage

from ebamcheck.metal import Target, levelled
from ebamcheck.metal.distances import border_distance
from ebamcheck.metal.surface import HALF
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.process import ProcessSettings

HALF_LINE = 0.5
"""Lines that a zone may have more or less than its width over the spacing."""

WINDOW_BEADS = 3.0
"""Width of a window, in bead widths."""

ZONES = ("inside", "edge", "zone")
"""Names of the zones: :func:`deep_cells`, the others, and the worst window."""

NO_ZONES = {
    "inside": math.nan, "edge": math.nan,
    **{f"{zone}_{column}": math.nan for zone in ZONES for column in ("settled", "owed")},
    **{f"{zone}_mm2": 0.0 for zone in ZONES},
    "zone_tolerance": math.nan, "zone_x_mm": math.nan, "zone_y_mm": math.nan,
}  # fmt: skip
"""Figures of a layer without any."""


def deep_cells(inside: Bools, bead_cells: float) -> Bools:
    """Cells of a section that lie further than a bead width from its border, where such cells are a bead wide or more.

    A narrower strip, between two beads along a wall, holds less than a line: it levels with what lies beside it.

    Parameters
    ----------
    inside
        (rows, columns) cells of the section, with at least one beside it that is none.
    bead_cells
        Width of a bead, in cells.

    Examples
    --------
    >>> wall, block = np.zeros((30, 60), bool), np.zeros((30, 60), bool)
    >>> wall[8:22, 1:59], block[1:29, 1:59] = True, True
    >>> [int(deep_cells(cells, 6.0).any(axis=1).sum()) for cells in (wall, block)]
    [0, 16]
    """
    centres = border_distance(inside) > 1.5 * bead_cells
    if not centres.any():
        return centres
    return np.asarray(inside & (border_distance(~centres) <= 0.5 * bead_cells), np.bool_)


def zone_figures(
    target: Target,
    laid_mm: Floats,
    before_mm: Floats,
    parts: tuple[Bools, Bools],
    thickness_mm: float,
    process: ProcessSettings,
) -> dict[str, float]:
    """Figures of the zones of one layer, the columns that :data:`NO_ZONES` names.

    Parameters
    ----------
    laid_mm
        (rows, columns) height of the metal that the layer lays.
    before_mm
        (rows, columns) height of the surface under it over that of the layer below.
    parts
        Cells (rows, columns) of the section by :func:`deep_cells`, and the others.
    """
    deep, rim = parts
    inside, bead_cells = deep | rim, process.bead_width_mm / target.step_mm
    wanted = target.share * thickness_mm
    found: dict[str, float] = dict(NO_ZONES)
    if not inside.any():
        return found
    metal = np.where(inside, target.share, 0.0)
    settled = metal * levelled(laid_mm / np.maximum(metal, HALF), metal, bead_cells)
    owed = metal * (thickness_mm - before_mm)
    for name, zone in (("inside", deep), ("edge", rim)):
        if zone.any():
            whole = float(wanted[zone].sum())
            found |= {
                name: float(laid_mm[zone].sum()) / whole,
                f"{name}_settled": float(settled[zone].sum()) / whole,
                f"{name}_owed": float(owed[zone].sum()) / whole,
                f"{name}_mm2": float(zone.sum()) * target.step_mm**2,
            }
    size = 2 * round(0.5 * WINDOW_BEADS * bead_cells) + 1
    tolerance = process.inside_tolerance * deep + process.edge_tolerance * rim
    sums = (
        ndimage.uniform_filter(np.where(inside, field, 0.0), size, mode="constant")[inside] * size**2
        for field in (wanted, settled, owed, np.ones_like(wanted), tolerance)
    )
    area, laid, missing, cells, allowed = sums
    height, missing, allowed, mm2 = laid / area, missing / area, allowed / cells, cells * target.step_mm**2
    k = int(np.argmax(zone_off(height, missing) / zone_limit(allowed, mm2, process)))
    row, column = (int(at[k]) for at in np.nonzero(inside))
    x_mm, y_mm = (target.origin + (np.array([column, row]) + 0.5) * target.step_mm).tolist()
    return found | {
        "zone_settled": float(height[k]),
        "zone_owed": float(missing[k]),
        "zone_mm2": float(mm2[k]),
        "zone_tolerance": float(allowed[k]),
        "zone_x_mm": x_mm,
        "zone_y_mm": y_mm,
    }


def zone_off(height: ArrayLike, owed: ArrayLike) -> Floats:
    """How far mean heights, in layers, are off one layer, and off what would make the surface right.

    Examples
    --------
    >>> zone_off([1.2, 0.8, 0.8], [1.0, 1.0, 0.7]).round(3)
    array([0.2, 0.2, 0. ])
    """
    height, owed = np.asarray(height, np.float64), np.asarray(owed, np.float64)
    over, under = height - np.maximum(owed, 1.0), np.minimum(owed, 1.0) - height
    return np.asarray(np.maximum(np.maximum(over, under), 0.0), np.float64)


def zone_limit(tolerance: Floats | float, area_mm2: ArrayLike, process: ProcessSettings) -> Floats:
    """What zones may be off by: the tolerance of all of them, and half a line over the lines that are side by side in one.

    Examples
    --------
    >>> zone_limit(0.03, [324.0, 3600.0], ProcessSettings()).round(3)
    array([0.15 , 0.066])
    """
    width_mm = np.sqrt(np.maximum(np.asarray(area_mm2, np.float64), process.bead_width_mm**2))
    return np.asarray(tolerance + HALF_LINE * process.hatch_spacing_mm / width_mm, np.float64)


def tolerances(solid: pd.DataFrame, zone: str, process: ProcessSettings) -> Floats:
    """Tolerance (n,) of a zone on each layer, before that of its size."""
    if zone == "zone":
        return solid["zone_tolerance"].to_numpy(np.float64)
    return np.full(len(solid), process.inside_tolerance if zone == "inside" else process.edge_tolerance)

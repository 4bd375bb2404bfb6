"""Check that every bead lies in the part: its centre line leaves neither the section nor the allowance around it."""

from __future__ import annotations

import math

import numpy as np
import shapely

from ebamcheck.checks.checks import Check
from ebamcheck.checks.metal import wanted_region
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.numeric.kernels import run_each
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config

NAME = "beads inside"

STEP_MM = 0.5
"""Distance of the places looked at along beads."""


def outside_check(nc: NCProgram, layers: Layers, z_of: Floats, config: Config, limit_mm: float) -> Check:
    """Check all metal, whatever its role: no place of a bead's centre line lies outside by more than `limit_mm`.

    Parameters
    ----------
    z_of
        (L,) Z of each of the `layers` in the program.
    limit_mm
        How far a centre line may leave the wanted region.
    """
    rows = np.flatnonzero(
        (nc.beam | nc.wire) & np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1)
    )
    layer = nearest_layer(nc.end[rows, 2], z_of)

    def farthest(k: int) -> tuple[float, int, int, float, float] | None:
        owner, at = nc.samples(rows[layer == k], STEP_MM)
        region = wanted_region(layers.section(k), config)
        if region.is_empty:
            return (math.inf, int(owner[0]), k, *at[0]) if owner.size else None
        shapely.prepare(region)
        out = np.flatnonzero(~shapely.intersects_xy(region, at[:, 0], at[:, 1]))
        if not out.size:
            return None
        away = np.asarray(shapely.distance(shapely.points(at[out]), region))
        first = int(np.argmax(away > limit_mm)) if (away > limit_mm).any() else int(np.argmax(away))
        return float(away.max()), int(owner[out[first]]), k, *at[out[first]]

    every = [place for place in run_each(farthest, range(len(layers))) if place is not None]
    if not every:
        return Check(NAME, True, 0.0, limit_mm, "mm", "", "every bead lies within the part and its allowance")
    wrong = [place for place in every if place[0] > limit_mm]
    away, row, k, x, y = min(wrong, key=lambda place: place[1]) if wrong else max(every)
    how = f"{away:.4g} mm outside of the part" if math.isfinite(away) else "where the part has no section"
    text = f"a bead runs {how}, in layer {k + 1} at ({x:.3f}, {y:.3f})"
    value = max(place[0] for place in every)
    return Check(NAME, not wrong, value, limit_mm, "mm", nc.where(row), text, k, float(x), float(y))

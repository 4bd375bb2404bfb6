"""Checks of the metal that a program lays: as much as the part has, where it has it, and flat.

Their limits are settings of the process; none is taken from what the program reaches.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from ebamcheck.checks.checks import Check
from ebamcheck.checks.deposit import Deposit
from ebamcheck.checks.metal_below import MetalBelow, counts, with_metal
from ebamcheck.checks.metal_zones import tolerances, zone_limit, zone_off
from ebamcheck.checks.narrow_features import narrow_bead
from ebamcheck.checks.remedies import COARSE, TOO_THIN
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import ProcessSettings
from ebamcheck.showing.short_text import counted

NARROW = "narrow features"
"""Name of the check of openings and walls of the part that are narrower than a least that is set."""

DEPOSIT_CHECKS = (
    "metal", "metal of layers", "metal outside", "reach of metal", "holes", NARROW, "height inside", "height at edges",
    "height of layers", "height of zones", "surface",
)  # fmt: skip
"""Names of the checks, in their order."""

LEAST_SPOTS = 1.0
"""Bead spots (a bead width squared, one layer high) by which the metal of a layer may be off in any case: the starts and
ends of its beads."""

LAYER_OUTSIDE = 3.0
"""A single layer may have so many times the share of metal outside that the whole program may."""


OF_LAYER = "of the layer's metal"
"""Unit of a figure that is a share of the metal of a single layer."""

ROUNDING = 1e-9
"""Shares that differ by less are the same."""

SMALL_KG = 0.1
"""A part under this is weighed in milligrams, a heavier one in grams."""


def deposit_checks(
    nc: NCProgram, found: Deposit, config: Config, below: MetalBelow | None = None
) -> list[Check]:
    """Check the metal of a program, see :func:`ebamcheck.checks.deposit.deposit`.

    Parameters
    ----------
    below
        The metal that stands under the program: what holds for a whole part has to hold for it and the program together. None:
        nothing stands there or, under the only layer of a program that does not begin on the plate (``layers.base_mm``), it
        is not known; that layer is then held to the limits of a single one alone.
    """
    solid = with_metal(found.layers)
    if not len(solid):
        return [Check(name, False, math.inf, 0.0, "", "", "no layer has metal") for name in DEPOSIT_CHECKS]
    places = _Places(nc, found)
    alone = below is None and config.base_mm > 0.0 and len(solid) == 1
    built = (below or MetalBelow()).and_layers(solid, config.process)
    return [
        _whole(solid, built, alone, config),
        _of_layers(solid, config, places),
        _outside(solid, built, alone, config, places),
        _reach(solid, config, places),
        _holes(found, places),
        _narrow(found, places),
        _zone(solid, "inside", "height inside", (built, alone), config, places),
        _zone(solid, "edge", "height at edges", (built, alone), config, places),
        _of_zones(solid, ("inside", "edge"), "height of layers", config, places),
        _of_zones(solid, ("zone",), "height of zones", config, places),
        _surface(solid, config, places),
    ]


class _Places:
    """Where layers and places stand in a program."""

    def __init__(self, nc: NCProgram, found: Deposit) -> None:
        self._nc, self._first = nc, found.first_row

    def of(self, layer: int) -> str:
        """``FILE:line`` of the first bead of a layer."""
        row = int(self._first[layer])
        return self._nc.where(row) if row >= 0 else f"{self._nc.files[0].name}:1"


def _named(row: pd.Series, at: str = "") -> str:
    """Return layer, height, and place where it is known, in words."""
    text = f"layer {int(row['layer']) + 1}, Z {row['z_mm']:.3f}"
    return f"{text}, at ({row[f'{at}_x_mm']:.1f}, {row[f'{at}_y_mm']:.1f})" if at else text


def _whole(solid: pd.DataFrame, built: MetalBelow, alone: bool, config: Config) -> Check:
    limit = config.process.mass_tolerance
    wanted, laid = built.wanted_mm3, built.laid_mm3
    off = abs(laid / wanted - 1.0) if wanted > 0.0 else math.inf
    if alone:
        off = float(_off_layers(solid, config)[0])
    density = config.material.density_kg_m3 * 1e-9
    # Milligrams of a small part: what shuts the gate has to show in the figures.
    decimals = 3 if wanted * density >= SMALL_KG else 6
    text = f"{laid * density:.{decimals}f} kg of metal for {wanted * density:.{decimals}f} kg of part"
    return Check("metal", off <= limit, off, limit, "of the part", "", text)


def _of_layers(solid: pd.DataFrame, config: Config, places: _Places) -> Check:
    wanted, laid = solid["wanted_mm3"].to_numpy(), solid["laid_mm3"].to_numpy()
    off = _off_layers(solid, config)
    k = int(np.argmax(off))
    share = f"{laid[k] / wanted[k]:.3f} of its metal" if wanted[k] > 0.0 else "metal, and no section"
    text = f"a layer has {share}: {_named(solid.iloc[k])}"
    where = places.of(int(solid["layer"].iloc[k]))
    limit = config.process.mass_tolerance
    return Check("metal of layers", bool(off[k] <= limit), float(off[k]), limit, "of the layer", where, text)


def _off_layers(solid: pd.DataFrame, config: Config) -> Floats:
    """How far the metal of each layer (n,) is off, beyond the starts and ends of beads, over that of the layer."""
    wanted, laid = solid["wanted_mm3"].to_numpy(), solid["laid_mm3"].to_numpy()
    thickness = np.diff(solid["z_mm"].to_numpy(), prepend=config.base_mm)
    spots = LEAST_SPOTS * config.process.bead_width_mm**2 * np.maximum(thickness, 0.0)
    return np.asarray(np.maximum(np.abs(laid - wanted) - spots, 0.0) / np.maximum(wanted, 1e-9), np.float64)


def _outside(solid: pd.DataFrame, built: MetalBelow, alone: bool, config: Config, places: _Places) -> Check:
    limit = config.process.outside_share
    # A sum whose parts cancel may be under 0 by its rounding.
    outside, laid = np.maximum(solid["outside_mm3"].to_numpy(), 0.0), solid["laid_mm3"].to_numpy()
    whole = max(built.outside_mm3, 0.0) / max(built.laid_mm3, 1e-9)
    share = np.divide(outside, laid, out=np.zeros_like(laid), where=laid > 0.0)
    k = int(np.argmax(share))
    text = (
        f"{100 * whole:.2f} % of the metal lies beside the part, most {100 * share[k]:.2f} % of a layer: "
        f"{_named(solid.iloc[k])}"
    )
    # The figure is that of the whole or of the layer, whichever comes nearer to its own limit.
    layer_limit = limit * LAYER_OUTSIDE
    of_whole = not alone and whole * LAYER_OUTSIDE >= share[k] - ROUNDING
    worst, limit, unit = (
        (whole, limit, "of the metal") if of_whole else (float(share[k]), layer_limit, OF_LAYER)
    )
    wall, remedy = _of_wall(solid, k, config) if worst > limit else ("", "")
    where = places.of(int(solid["layer"].iloc[k]))
    return Check("metal outside", worst <= limit, worst, limit, unit, where, text + wall, remedy=remedy)


def _reach(solid: pd.DataFrame, config: Config, places: _Places) -> Check:
    limit = config.process.outside_reach_mm
    k = int(np.argmax(solid["reach_mm"].to_numpy()))
    row = solid.iloc[k]
    if row["reach_mm"] <= 0.0:
        return Check("reach of metal", True, 0.0, limit, "mm", "", "no metal reaches beside the part")
    text = f"metal reaches {row['reach_mm']:.2f} mm beside the part: {_named(row, 'reach')}"
    wall, remedy = "", ""
    if row["reach_mm"] > limit:
        text += "; a wall, a hole or a corner there is narrower than the bead"
        wall, remedy = _of_wall(solid, k, config)
    where = places.of(int(row["layer"]))
    reach_mm = float(row["reach_mm"])
    return Check(
        "reach of metal", reach_mm <= limit, reach_mm, limit, "mm", where, text + wall, remedy=remedy
    )


def _of_wall(solid: pd.DataFrame, k: int, config: Config) -> tuple[str, str]:
    """What a bead takes that is as narrow as the thinnest wall of a layer, row `k`, and what to do; empty where beads fit its walls."""
    row = solid.iloc[k]
    if not math.isfinite(row["wall_mm"]):
        return "", ""
    thickness = float(np.diff(solid["z_mm"].to_numpy(), prepend=config.base_mm)[k])
    bead = narrow_bead(float(row["wall_mm"]), thickness, config)
    place = f"({row['wall_x_mm']:.1f}, {row['wall_y_mm']:.1f})"
    text = f"; the thinnest wall of that layer, at {place}, is {row['wall_mm']:.1f} mm thick: {bead}"
    return text, COARSE if bead.can_be_laid else TOO_THIN


def _holes(found: Deposit, places: _Places) -> Check:
    """Holes of the sections that beads close, however little metal that is."""
    holes = found.holes
    if not len(holes):
        return Check("holes", True, 0.0, 0.0, "holes", "", "beads lay no metal over the holes of the part")
    first = holes.iloc[0]
    layer = int(first["layer"])
    text = (
        f"{counted(len(holes), 'hole')} on {counted(holes['layer'].nunique(), 'layer')} closed by beads, first one {first['width_mm']:.1f} mm wide: "
        f"{100 * first['covered']:.0f} % of it, layer {layer + 1}, at ({first['x_mm']:.1f}, {first['y_mm']:.1f})"
    )
    return Check("holes", False, float(len(holes)), 0.0, "holes", places.of(layer), text)


def _narrow(found: Deposit, places: _Places) -> Check:
    """Openings and walls of the part that are narrower than a setting allows; of others, narrower than beads can build, it tells."""
    broken = [feature for feature in found.narrow if feature.is_set]
    if not found.narrow:
        return Check(
            NARROW, True, 0.0, 0.0, "features", "", "no opening and no wall is narrower than beads can build"
        )
    told = broken or found.narrow
    first = told[0]
    text = (
        f"{counted(len(told), 'feature')} of the part narrower than {first.than}: first {first.in_words()}, "
        f"layer {first.layer + 1}, at ({first.x_mm:.1f}, {first.y_mm:.1f})"
    )
    where = places.of(first.layer) if broken else ""
    return Check(NARROW, not broken, float(len(broken)), 0.0, "features", where, text)


def _zone(
    solid: pd.DataFrame,
    zone: str,
    name: str,
    known: tuple[MetalBelow, bool],
    config: Config,
    places: _Places,
) -> Check:
    """Mean height of the metal in a zone over all layers, and the layer where it is furthest off."""
    built, alone = known
    height = solid[zone].to_numpy()
    limit = float(tolerances(solid[:1], zone, config.process)[0])
    if alone:
        limit = float(zone_limit(limit, solid[f"{zone}_mm2"].to_numpy()[0], config.process))
    wide, mean = counts(solid, zone, config.process), built.mean(zone)
    if math.isnan(mean):
        return Check(
            name, True, 0.0, limit, "of the height", "", f"no layer is wide enough for a mean ({zone})"
        )
    k = int(np.argmax(np.where(wide, np.abs(height - 1.0), -1.0)))
    text = f"metal is {mean:.3f} layers high on average"
    if wide.any():
        text += f", furthest off {height[k]:.3f}: {_named(solid.iloc[k])}"
    worst = abs(mean - 1.0)
    where = places.of(int(solid["layer"].iloc[k]))
    return Check(name, worst <= limit, worst, limit, "of the height", where, text)


def _of_zones(
    solid: pd.DataFrame, zones: tuple[str, ...], name: str, config: Config, places: _Places
) -> Check:
    """Mean heights of zones on every single layer: the one furthest off for its size."""
    process = config.process
    rows = [
        (float(share), k, zone, float(off), float(limit))
        for zone in zones
        for k, (off, limit, share) in enumerate(_judged(solid, zone, process))
        if math.isfinite(share)
    ]
    if not rows:
        return Check(name, True, 0.0, process.edge_tolerance, "of the height", "", "no layer has metal")
    _, k, zone, off, limit = max(rows)
    row = solid.iloc[k]
    what = {"inside": "inside", "edge": "at its edges", "zone": f"on {row[f'{zone}_mm2']:.0f} mm2"}[zone]
    text = f"a layer's metal is {row[f'{zone}_settled']:.3f} layers high {what}: {_named(row, 'zone' if zone == 'zone' else '')}"
    wall, remedy = _of_wall(solid, k, config) if off > limit else ("", "")
    where = places.of(int(row["layer"]))
    return Check(name, off <= limit, off, limit, "of the height", where, text + wall, remedy=remedy)


def _judged(solid: pd.DataFrame, zone: str, process: ProcessSettings) -> np.ndarray:
    """How far a zone is off on each layer, its limit, and one over the other, (n, 3); NaN where the layer has none."""
    off = zone_off(solid[f"{zone}_settled"], solid[f"{zone}_owed"])
    limit = zone_limit(tolerances(solid, zone, process), solid[f"{zone}_mm2"], process)
    return np.column_stack([off, limit, off / limit])


def _surface(solid: pd.DataFrame, config: Config, places: _Places) -> Check:
    limit = config.process.largest_unevenness_mm
    low, high = solid["low_mm"].to_numpy(), solid["high_mm"].to_numpy()
    side, values = ("low", low) if low.max() > high.max() else ("high", high)
    k = int(np.argmax(values))
    row = solid.iloc[k]
    text = (
        f"the surface comes to lie {values[k]:.2f} mm too {side}: {_named(row, side)}"
        f" (over all layers {low.max():.2f} mm too low to {high.max():.2f} mm too high)"
    )
    where = places.of(int(row["layer"]))
    return Check("surface", bool(values[k] <= limit), float(values[k]), limit, "mm", where, text)

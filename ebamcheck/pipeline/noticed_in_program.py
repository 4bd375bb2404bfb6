"""Findings on plan and program that no gate covers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from ebamcheck.checks.checks import Check
from ebamcheck.checks.consumables import consumed
from ebamcheck.checks.interpass_checks import INTERPASS, within_range
from ebamcheck.checks.metal_rules import BETWEEN, HEIGHTS, NARROW, PART_FILE, SECTIONS, SOLID
from ebamcheck.checks.narrow_features import NarrowFeature
from ebamcheck.checks.process_checks import seam_turns
from ebamcheck.checks.remedies import (
    COARSE,
    FLAT,
    HATCH,
    HOLE,
    LEVELS,
    MISTAKE,
    NARROWER,
    OFF_MESH,
    TOO_THIN,
)
from ebamcheck.findings import Finding, Severity, at_layer
from ebamcheck.heat.melting import entry_limit_k
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.writing.inputs import deposition_heights

LEAST_WIRE = "whether beads are at the least wire of the feeder (process.wire_speed_min_mm_s)"

LESS_METAL = "where sections taper, let layers have less metal than their sections, by what their rims lack (process.mass_tolerance)"

OVERHANG = "overhang"
"""Name of that check."""

STEEP_DEG = 45.0
"""Overhang, from the vertical, over which hardly any process builds without support unless it was tried."""

MOST_NARROW = 8
"""Narrow features that are told one by one."""

ROUNDING_MM = 1e-6
"""Sum of the roundings of heights, far under any layer."""

METAL: Mapping[str, tuple[str, str]] = {
    "metal outside": ("wall-under-bead", COARSE),
    "reach of metal": ("bead-out-of-section", COARSE),
    "holes": ("hole-closed", HOLE),
    "metal": ("metal-excess", f"look at the layers with the most metal in deposit.csv, and {LEAST_WIRE}"),
    "metal of layers": ("metal-excess", f"look at that layer in deposit.csv, and {LEAST_WIRE}"),
    "height inside": (
        "metal-excess",
        "change the spacing (process.bead_spacing), or the side of the hexagons (scan.hexagon_side_mm)",
    ),
    "height at edges": ("metal-excess", "change the inset of the contour beads (scan.contour_offset_mm)"),
    "height of layers": ("metal-excess", f"look at that layer in deposit.csv; {HATCH}"),
    "height of zones": (
        "metal-excess",
        "look at that place in the picture of the metal; " + HATCH,
    ),
    SOLID: ("level-within-layer", LEVELS),
    SECTIONS: ("sections-off-mesh", OFF_MESH),
    BETWEEN: ("lost-between-cuts", FLAT),
    HEIGHTS: ("height-off-part", MISTAKE),
    PART_FILE: ("part-off-file", MISTAKE),
    "surface": (
        "metal-excess",
        f"{LESS_METAL}; else turn the cells and the hatch from layer to layer (scan.lattice_angle_deg, scan.layer_angle_deg), or {NARROWER}",
    ),
}
"""Code and remedy of each check of the metal that fails."""

LACKING: Mapping[str, str] = {
    name: f"look at {what} in deposit.csv, and whether beads are at the most wire of the feeder (process.wire_speed_max_mm_s)"
    for name, what in {"metal": "the layers with the least metal", "metal of layers": "that layer"}.items()
} | {
    "surface": f"at a corner whose tip no round bead fills, allow for machining (process.machining_allowance_mm); {METAL['surface'][1]}"
}
"""Remedies where the metal of a check lacks, other than those of one that has too much."""


def of_metal(checks: Iterable[Check]) -> Iterator[Finding]:
    """What is wrong with the metal of a program, each with its place."""
    for check in checks:
        told = check.name == BETWEEN and check.value > 0.0
        if (check.passed and not told) or check.name == NARROW:
            continue
        code, remedy = METAL[check.name]
        # Excess and lack of metal are one check; its words say which.
        lacks = code == "metal-excess" and (
            "too low" in check.text.split("(over all layers")[0] or _lacks(check.text)
        )
        if lacks:
            code, remedy = "metal-missing", LACKING.get(check.name, remedy)
        yield Finding(
            "warning" if check.passed else "fault",
            code,
            check.text,
            check.where,
            check.value,
            check.limit,
            check.unit,
            check.remedy or remedy,
        )


def of_narrow(features: Sequence[NarrowFeature], heights: Floats, config: Config) -> Iterator[Finding]:
    """Features narrower than beads can build, the narrowest first: a fault where a setting says so, a note where one allows them.

    Parameters
    ----------
    heights
        (L,) heights of the cuts, mm.
    """
    process = config.process
    for feature in features[:MOST_NARROW]:
        allowed = (process.least_wall_mm if feature.is_wall else process.least_hole_mm) is not None
        severity: Severity = "fault" if feature.is_set else "note" if allowed else "warning"
        from_mm, to_mm = heights[feature.first], heights[feature.last]
        through = f", z = {from_mm:.3f} to {to_mm:.3f} mm," if feature.last > feature.first else ""
        bridged = "" if feature.is_wall or feature.is_set else ": it is bridged by the melt"
        yield Finding(
            severity,
            "wall-under-bead" if feature.is_wall else "opening-under-bead",
            f"{feature.in_words()}{through} is narrower than {feature.than}{bridged}",
            _at(feature.layer, heights, config, feature.x_mm, feature.y_mm),
            feature.narrowest_mm,
            feature.least_mm,
            "mm",
            TOO_THIN if feature.is_wall else HOLE,
        )
    if (more := len(features) - MOST_NARROW) > 0:
        last = features[-1]
        yield Finding(
            "warning",
            "wall-under-bead" if last.is_wall else "opening-under-bead",
            f"{more} more features of the part are narrower than beads can build, up to {last.narrowest_mm:.3g} mm",
            _at(last.layer, heights, config, last.x_mm, last.y_mm),
            float(more),
            0.0,
            "features",
            HOLE,
        )


def of_checks(checks: Iterable[Check]) -> Iterator[Finding]:
    """Checks of a program that failed and of which no finding of metal or heat tells: name, place and what to do."""
    for check in checks:
        if not check.passed and check.name not in (*METAL, NARROW, INTERPASS):
            place = ", ".join(text for text in (check.where, check.place) if text)
            yield Finding(
                "fault", "check-failed", f"{check.name}: {check.text}", place, check.value, check.limit, check.unit,
                check.remedy,
            )  # fmt: skip


def _lacks(text: str) -> bool:
    """Whether the words of a check tell less metal than there is to be: in all, of a layer, or as a mean height."""
    if whole := re.search(r"(\d+\.\d+) kg of metal for (\d+\.\d+) kg", text):
        return float(whole[1]) < float(whole[2])
    share = re.search(r"(?:has|metal is) (\d+\.\d+)", text)
    return share is not None and float(share[1]) < 1.0


def of_heat(plan: ScanPlan, config: Config) -> Iterator[Finding]:
    """Layers of which an island is entered above the solidus; over the boiling point the model has no figure."""
    ambient_k = config.process.ambient_temperature_k
    entry_k = plan.metrics["entry_max_k"].to_numpy() + ambient_k
    solidus_k = config.material.solidus_k
    hot = np.flatnonzero(entry_k > solidus_k)
    if hot.size:
        k, boiling_k = int(np.nanargmax(entry_k)), config.material.boiling_k
        beyond = (
            f", up to over the boiling point of {boiling_k:g} K, where it ends"
            if entry_k[k] > boiling_k
            else ""
        )
        yield Finding(
            "warning",
            "heat-above-solidus",
            f"{hot.size} of {len(plan)} layers have islands that the heat model finds above the solidus when the beam "
            f"enters them{beyond}",
            _at(k, plan.heights, config),
            min(float(entry_k[k]), boiling_k),
            solidus_k,
            "K",
            "wait or lower the power (process.interpass)",
        )


def of_interpass(summary: pd.DataFrame, plan: ScanPlan, config: Config) -> Iterator[Finding]:
    """What keeps the part cool: how long the program waits, by its own `summary`, and how far the power goes down."""
    wait_s = float(summary["pause_s"].sum())
    whole_s = wait_s + float(summary["deposit_s"].sum() + summary["travel_s"].sum())
    if wait_s > 0.0:
        yield Finding(
            "note",
            "interpass-wait",
            f"the program waits {wait_s / 3600.0:.3g} of {whole_s / 3600.0:.3g} hours for the part to cool",
            "process.interpass",
            wait_s,
            unit="s",
        )
    share = plan.metrics["power_share"].to_numpy()
    if share.size and np.nanmin(share) < 1.0:
        k, power_w = int(np.nanargmin(share)), config.process.power_w
        yield Finding(
            "note",
            "power-taper",
            f"the beam's power goes down to {100.0 * share[k]:.3g} % of {power_w:g} W as the part gets warm",
            _at(k, plan.heights, config),
            float(share[k] * power_w),
            power_w,
            "W",
        )


def of_limit(checks: Iterable[Check], plan: ScanPlan, config: Config) -> Iterator[Finding]:
    """Layers that the plan, or the balance of the program's text, enters above the interpass limit; see the gate `heat`."""
    limit_k, metrics = entry_limit_k(config), plan.metrics
    at_bead = config.process.interpass_at == "bead"
    planned_k = (
        metrics["entry_max_k"] + config.process.ambient_temperature_k if at_bead else metrics["enter_k"]
    )
    hot = np.flatnonzero(planned_k.to_numpy(np.float64) > limit_k)
    what = "beads" if at_bead else "layers"
    if hot.size:
        k = int(hot[planned_k.to_numpy()[hot].argmax()])
        figure_k, mark = within_range(float(planned_k[k]), config)
        yield Finding(
            "fault",
            "interpass-limit",
            f"the plan enters {what} above {limit_k:.0f} K in {hot.size} of {len(plan)} layers, the hottest at "
            f"{figure_k:.0f} K{mark}",
            _at(k, plan.heights, config),
            figure_k,
            limit_k,
            "K",
            _cooler(config),
        )
        return
    for check in checks:
        if check.name == INTERPASS and not check.passed:
            yield Finding(
                "fault", "interpass-limit", check.text, check.where, check.value, limit_k, check.unit,
                "wait and lower the power as the plan has it: make the program again",
            )  # fmt: skip


def _cooler(config: Config) -> str:
    """What is left to keep a layer under the limit, by the settings that it has been planned with."""
    process = config.process
    if process.interpass == "off":
        return 'wait and lower the power (process.interpass = "both")'
    if process.interpass == "power":
        return 'wait as well (process.interpass = "both"): even the least power that melts the wire leaves the part too hot'
    base = ", cool the table (process.base)" if process.base != "cooled" else ""
    return f"no wait is long enough: raise the limit (process.interpass_limit_k){base}, or lower the power further"


def of_seams(program: NCProgram, heights: Floats, config: Config) -> Iterator[Finding]:
    """Contours that start at a corner of the part, where metal heaps up; `heights` (L,) mm are those of the cuts."""
    row, turn_deg = seam_turns(program)
    corner_deg = 180.0 - config.curves.corner_angle_deg
    at_corner = turn_deg > corner_deg
    if at_corner.any():
        k = int(row[at_corner.argmax()])
        x_mm, y_mm, z_mm = program.start[k].tolist()
        layer = int(
            np.abs(deposition_heights(heights, config.layer_height_mm, config.base_mm) - z_mm).argmin()
        )
        count = int(at_corner.sum())
        yield Finding(
            "warning",
            "seam-at-corner",
            f"{count} of {row.size} closed contours start where they turn by more than {corner_deg:g} degrees",
            _at(layer, heights, config, x_mm, y_mm),
            float(count),
            0.0,
            "contours",
            "spread the seams (process.seam_shift_mm), or leave metal for machining (process.machining_allowance_mm)",
        )


def of_consumables(program: NCProgram, config: Config) -> Iterator[Finding]:
    """Layers before which the operator has to put on a new spool, or put in a new cathode."""
    for found in consumed(program, config):
        if found.changes:
            yield Finding(
                "warning",
                "consumable-change",
                found.check().text,
                f"layer {found.changes[0] + 1}",
                found.total,
                found.holds,
                found.unit,
                "have one at hand, and let the program stop there (M1)",
            )


def of_overhang(checks: Iterable[Check], config: Config) -> Iterator[Finding]:
    """A layer that reaches out steeply, where no angle is set that the process can build."""
    for check in checks:
        if check.name != OVERHANG or config.process.largest_overhang_deg or not check.passed:
            continue
        if check.value > STEEP_DEG:
            yield Finding(
                "warning",
                "steep-overhang",
                f"{check.text}; no angle is set that the process can build, so that a bead's width counts",
                check.where,
                check.value,
                STEEP_DEG,
                check.unit,
                "set it (process.largest_overhang_deg), or support the overhang",
            )


def of_height(part_mm: float, heights: Floats, config: Config) -> Iterator[Finding]:
    """A program that ends beside the top of the part by more of its height than the metal may be off.

    What the metal is held against are sections times the heights of layers, so that no gate sees it. By half a layer any part
    may be off; by more, layers are missing or too many, which is a fault: listed heights (`layers.heights_mm`) have it, and a part of
    less than half a layer.

    Parameters
    ----------
    part_mm
        Height of the part.
    heights
        (L,) heights of the cuts, mm.
    """
    if not len(heights) or config.base_mm > 0.0:
        return
    tops_mm = deposition_heights(heights, config.layer_height_mm)
    ends_mm = float(tops_mm[-1])
    half_mm = 0.5 * float(np.diff(tops_mm, prepend=0.0)[-1])
    limit = config.process.mass_tolerance * part_mm
    ends = "the only layer ends" if len(heights) == 1 else f"{len(heights)} layers end"
    if abs(ends_mm - part_mm) > limit:
        listed = bool(config.layers.heights_mm)
        yield Finding(
            "fault" if abs(ends_mm - part_mm) > half_mm + ROUNDING_MM else "warning",
            "height-off-part",
            f"{ends} at Z {ends_mm:.3f} mm, and the part is {part_mm:.3f} mm high",
            "layers.heights_mm" if listed else "layers.layer_height_mm",
            abs(ends_mm - part_mm),
            limit,
            "mm",
            "list heights for all of the part (layers.heights_mm), and what stands below them (layers.base_mm)" if listed
            else "give a layer height of which the part has a whole number (layers.layer_height_mm), or leave metal for machining",
        )  # fmt: skip


def _at(layer: int, heights: Floats, config: Config, x_mm: float = math.nan, y_mm: float = math.nan) -> str:
    """Name a place in part and program; `heights` (L,) mm are those of the cuts."""
    z_mm = deposition_heights(np.asarray(heights, np.float64), config.layer_height_mm, config.base_mm)[layer]
    return at_layer(layer, float(heights[layer]), x_mm, y_mm, float(z_mm))

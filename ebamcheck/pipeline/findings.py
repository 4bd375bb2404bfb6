"""Findings of a run: what a person has to know beside the gates; every one follows from what the stages return."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.checks.checks import COARSE, FLAT, HATCH, HOLE, LEVELS, MISTAKE, NARROWER, OFF_MESH, TOO_THIN
from ebamcheck.checks.consumables import consumed
from ebamcheck.checks.interpass_checks import INTERPASS, within_range
from ebamcheck.checks.metal_rules import NARROW
from ebamcheck.checks.narrow_features import NarrowFeature
from ebamcheck.checks.process_checks import seam_turns
from ebamcheck.checks.value_checks import loose_limits
from ebamcheck.comparison import Comparison
from ebamcheck.comparison.doubt import doubted_layers
from ebamcheck.curves.gate import CAUSES
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.kernels import Floats
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.nc.control import control
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.nc.motions import NCProgram
from ebamcheck.pipeline.fit import TOLD, FitVerdict
from ebamcheck.preflight.report import Ready
from ebamcheck.preflight.room import of_bodies, suspicions
from ebamcheck.result import Check, Place, Severity
from ebamcheck.scan import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.settings.process_window import outside_window, unusual_layers, wire_speed_mm_s
from ebamcheck.slicers.isolation import Outcome

LEAST_WIRE = "whether beads are at the least wire of the feeder (process.wire_speed_min_mm_s)"
LESS_METAL = "where sections taper, let layers have less metal than their sections, by what their rims lack (process.mass_tolerance)"
OVERHANG = "overhang"  # name of that check
STEEP_DEG = (
    45.0  # overhang, from the vertical, over which hardly any process builds without support unless it was tried
)
MOST_NARROW = 8  # narrow features that are told one by one
ROUNDING_MM = 1e-6  # sum of the roundings of heights, far under any layer

# Code and remedy of each check of the metal that fails
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
    "height of zones": ("metal-excess", "look at that place in the picture of the metal; " + HATCH),
    "metal of the solid": ("level-within-layer", LEVELS),
    "sections of the mesh": ("sections-off-mesh", OFF_MESH),
    "between the cuts": ("lost-between-cuts", FLAT),
    "layers of the part": ("height-off-part", MISTAKE),
    "part of the file": ("part-off-file", MISTAKE),
    "surface": (
        "metal-excess",
        f"{LESS_METAL}; else turn the cells and the hatch from layer to layer (scan.lattice_angle_deg, scan.layer_angle_deg), or {NARROWER}",
    ),
}
# Remedies where the metal of a check lacks, other than those of one that has too much
LACKING: Mapping[str, str] = {
    name: f"look at {what} in deposit.csv, and whether beads are at the most wire of the feeder (process.wire_speed_max_mm_s)"
    for name, what in {"metal": "the layers with the least metal", "metal of layers": "that layer"}.items()
} | {
    "surface": f"at a corner whose tip no round bead fills, allow for machining (process.machining_allowance_mm); {METAL['surface'][1]}"
}


# Severity, unit and remedy of each finding, by its code, where nothing else is said
KINDS: Mapping[str, tuple[Severity, str, str]] = {
    "backend-lost": ("warning", "", ""),
    "backend-unavailable": ("note", "", ""),
    "check-failed": ("fault", "", ""),
    "consumable-change": ("warning", "", "have one at hand, and let the program stop there (M1)"),
    "curve-fell-back": ("note", "", ""),
    "curves-not-lifted": ("note", "", "slice with an exact method"),
    "declared-doubt": ("warning", "mm", "mend thin facets of the mesh there, or forbid it (comparison.doubt_mm = 0)"),
    "facets-turned-over": ("warning", "facets", "look at the sections, or mend the model"),
    "heat-above-solidus": ("warning", "K", "wait or lower the power (process.interpass)"),
    "height-off-part": ("fault", "mm", ""),
    "interpass-limit": ("fault", "K", "wait and lower the power as the plan has it: make the program again"),
    "interpass-wait": ("note", "s", ""),
    "layer-height-fitted": ("note", "", ""),
    "no-evidence": ("warning", "", ""),
    "placeholder-codes": ("warning", "templates", "set the machine maker's codes"),
    "power-taper": ("note", "W", ""),
    "seam-at-corner": ("warning", "contours", "spread the seams (process.seam_shift_mm), or leave metal for machining (process.machining_allowance_mm)"),
    "steep-overhang": ("warning", "", "set it (process.largest_overhang_deg), or support the overhang"),
    "table-as-it-stands": ("warning", "axes", "bring the table to 0 before the program is started"),
    "thin-set-aside": ("note", "rings", "join bodies that nearly touch in the model, or move them apart"),
    "wire-drawn-back": ("warning", "mm", "make sure that the feeder does, or have it done by the codes of machine.wire_start"),
}  # fmt: skip


def _told(
    code: str,
    text: str,
    place: str | Place = "",
    figure: float | None = None,
    limit: float | None = None,
    **other: Any,
) -> Check:
    """A finding of :data:`KINDS`."""
    severity, unit, remedy = KINDS[code]
    named = {"severity": severity, "unit": unit, "remedy": remedy} | other
    return Check.finding(code=code, text=text, place=place, figure=figure, limit=limit, **named)


# -- the part ----------------------------------------------------------------------------------------


def begun_findings(begun: Ready) -> Iterator[Check]:
    """What was done to a part before it is sliced, and the layer height that was chosen for it."""
    if begun.turned:
        text = f"{begun.turned} of {len(begun.part.faces)} facets were turned over"
        yield _told("facets-turned-over", text, "part.fix_orientation", float(begun.turned), 0.0)
    if begun.fitted:
        yield _told("layer-height-fitted", begun.fitted, "layers.fit_height")


def part_findings(found: Inspection, config: Config) -> Iterator[Check]:
    """What follows from part and settings alone: its bodies, size and file, limits set wider, and settings outside of the
    window."""
    yield from of_bodies(found)
    yield from suspicions(found, config)
    yield from loose_limits(config)
    # A job without a program may cut layers that no process can lay.
    yield from outside_window(config, "warning")
    yield from unusual_layers(config)


# -- slicers and their agreement ---------------------------------------------------------------------


def slicer_findings(
    started: Mapping[str, Outcome], outcomes: Mapping[str, Outcome], comparison: Comparison, config: Config
) -> Iterator[Check]:
    """Of the slicers that were started, those that were lost or prove nothing; of all `outcomes`, those that this machine cannot
    run; and agreement that rests on something else than sections."""
    for outcome in started.values():
        if outcome.failure:
            text = f"backend {outcome.name} {outcome.failure}: {outcome.why}"
            yield _told("backend-lost", text, outcome.name)
    for name, why in comparison.without_weight.items():
        text = f"agreement with {name} proves nothing: {why}, the share comparison.evidence_share of bead or layer"
        remedy = f"give {name} settings of a narrower bound, or run without it"
        yield _told("no-evidence", text, name, remedy=remedy)
    yield from doubt_findings(comparison.pairs, config)
    yield from set_aside_findings(comparison.pairs)
    for outcome in outcomes.values():
        if outcome.failure == "unavailable":
            text = f"backend {outcome.name} is not available: {outcome.why}"
            yield _told("backend-unavailable", text, "slicing.backends")


def doubt_findings(pairs: pd.DataFrame, config: Config) -> Iterator[Check]:
    """Layers on which slicers agree only because one of them declares doubt."""
    for a, b, layers, depth_mm, added_mm in doubted_layers(pairs):
        yield _told(
            "declared-doubt",
            f"{a} and {b} agree on {len(layers)} layers only within places that one of them declares doubtful: they are "
            f"{depth_mm:.3g} mm apart, {added_mm:.3g} mm are declared",
            f"layers {', '.join(str(k + 1) for k in layers[:5])}{' ...' if len(layers) > 5 else ''}",
            depth_mm,
            config.comparison.doubt_mm,
        )


def set_aside_findings(pairs: pd.DataFrame) -> Iterator[Check]:
    """Rings and holes that one slicer of a pair has and the other lacks, where both agree without what is thin."""
    if not len(pairs) or not len(rows := pairs[pairs["set_aside"] > 0]):
        return
    first, most = rows.sort_values("layer", kind="stable").iloc[0], int(rows["set_aside"].max())
    names = sorted({f"{a} and {b}" for a, b in zip(rows["a"], rows["b"], strict=True)})
    text = (
        f"{'; '.join(names)}: on {rows['layer'].nunique()} layers they agree once up to {most} rings or holes are set aside "
        f"that only one of them has, of gaps and walls thinner than {2.0 * rows['limit_mm'].max():.3g} mm"
    )
    place = Place(layer=int(first["layer"]), cut_mm=first["height_mm"])
    yield _told("thin-set-aside", text, place, float(most), None)


# -- the profile -------------------------------------------------------------------------------------


def placeholder_codes(config: Config) -> list[str]:
    """Templates of beam and wire that this process uses and that are the default ones of the control."""
    machine, process = config.machine, config.process
    used = ["beam_on", "beam_off", "set_beam", "wire_start", "wire_stop", "set_wire"]
    used += ["set_power"] if process.ramps_beam or process.interpass in ("power", "both") else []
    used += ["wire_retract"] if process.wire_retract_mm > 0.0 else []
    stock, fields = control(machine.control).templates, MachineSettings.model_fields
    codes = {name: getattr(machine, name) for name in used}
    return [n for n, code in codes.items() if code and code in (fields[n].default, stock.get(n, ()))]


def profile_findings(config: Config) -> Iterator[Check]:
    """Codes that stand for those of the machine's maker, where a table has to stand, and what the wire feeder has to do by
    itself."""
    names = placeholder_codes(config)
    if names:
        text = f"the codes of beam and wire are those of the default profile, {len(names)} of them"
        place = ", ".join(f"machine.{name}" for name in names)
        yield _told("placeholder-codes", text, place, float(len(names)), 0.0)
    if axes := [axis.name for axis in config.machine.rotary if config.part.on_table is None]:
        text = (
            f"the program does not command {' and '.join(axes)}: what was proved holds while the table stands at 0, which a layer on a "
            "turned part that was broken off may have left otherwise"
        )
        yield _told("table-as-it-stands", text, "machine.rotary", float(len(axes)), 0.0)
    process = config.process
    if process.wire_retract_mm > 0.0:
        wire_mm_s = wire_speed_mm_s(config, process.bead_width_mm, config.layer_height_mm)
        bare_mm = process.wire_retract_mm / wire_mm_s * process.travel_speed_mm_s
        text = (
            f"{process.wire_retract_mm:g} mm of wire are drawn back at the end of each bead, and no block feeds them forward again: "
            f"unless the feeder does it at the next start, {bare_mm:.3g} mm of every bead have no metal"
        )
        yield _told("wire-drawn-back", text, "process.wire_retract_mm", bare_mm, 0.0)


# -- the fit -----------------------------------------------------------------------------------------


def fit_findings(verdict: FitVerdict) -> Iterator[Check]:
    """Rings that fell back, by cause, and what no method was found for."""
    found = verdict.evidence
    if not found.known:
        text = "the contours do not lie on the edges of the part's mesh, and so the curves follow them as they are"
        yield _told("curves-not-lifted", text)
    for number, cause in enumerate(CAUSES):
        rings = np.flatnonzero((found.cause == number) & (found.method > 0))
        if not number or not rings.size:
            continue
        worst = int(rings[np.argmax((found.value_mm - found.limit_mm)[rings])])
        why, remedy = TOLD[cause]
        text = f"{rings.size} of {found.cause.size} rings fell back to the contour itself, because {why}"
        figures: dict[str, Any] = {}
        if cause in ("sagitta", "plane"):
            value_mm, limit_mm = float(found.value_mm[worst]), float(found.limit_mm[worst])
            figures = {"figure": value_mm, "limit": limit_mm, "unit": "mm"}
        yield _told("curve-fell-back", text, verdict.place_of(worst), remedy=remedy, **figures)


# -- plan and program --------------------------------------------------------------------------------


def metal_findings(checks: Iterable[Check]) -> Iterator[Check]:
    """What is wrong with the metal of a program, each with its place."""
    for check in checks:
        told = check.name == "between the cuts" and check.value > 0.0
        if (check.passed and not told) or check.name == NARROW:
            continue
        code, remedy = METAL[check.name]
        # Excess and lack of metal are one check; its words say which.
        if code == "metal-excess" and _lacks(check.text):
            code, remedy = "metal-missing", LACKING.get(check.name, remedy)
        severity: Severity = "warning" if check.passed else "fault"
        measured = check.value, check.limit, check.unit
        yield Check.finding(severity, code, check.text, check.where, *measured, check.remedy or remedy)


def narrow_findings(features: Sequence[NarrowFeature], heights: Floats, config: Config) -> Iterator[Check]:
    """Features narrower than beads can build, the narrowest first: a fault where a setting says so, a note where one allows
    them."""
    process = config.process
    for feature in features[:MOST_NARROW]:
        allowed = (process.least_wall_mm if feature.is_wall else process.least_hole_mm) is not None
        severity: Severity = "fault" if feature.is_set else "note" if allowed else "warning"
        from_mm, to_mm = heights[feature.first], heights[feature.last]
        through = f", z = {from_mm:.3f} to {to_mm:.3f} mm," if feature.last > feature.first else ""
        bridged = "" if feature.is_wall or feature.is_set else ": it is bridged by the melt"
        code, remedy = ("wall-under-bead", TOO_THIN) if feature.is_wall else ("opening-under-bead", HOLE)
        text = f"{feature.in_words()}{through} is narrower than {feature.than}{bridged}"
        place = _at(feature.layer, heights, config, feature.x_mm, feature.y_mm)
        figures = feature.narrowest_mm, feature.least_mm, "mm"
        yield Check.finding(severity, code, text, place, *figures, remedy)
    if (more := len(features) - MOST_NARROW) > 0:
        last = features[-1]
        code = "wall-under-bead" if last.is_wall else "opening-under-bead"
        text = f"{more} more features of the part are narrower than beads can build, up to {last.narrowest_mm:.3g} mm"
        place = _at(last.layer, heights, config, last.x_mm, last.y_mm)
        yield Check.finding("warning", code, text, place, float(more), 0.0, "features", HOLE)


def failed_checks(checks: Iterable[Check]) -> Iterator[Check]:
    """Checks of a program that failed and of which no finding of metal or heat tells: name, place and what to do."""
    for check in checks:
        if not check.passed and check.name not in (*METAL, NARROW, INTERPASS):
            place = ", ".join(text for text in (check.where, check.place) if text)
            text, said = f"{check.name}: {check.text}", {"unit": check.unit, "remedy": check.remedy}
            yield _told("check-failed", text, place, check.value, check.limit, **said)


def _lacks(text: str) -> bool:
    """Whether the words of a check tell less metal than there is to be: in all, of a layer, or as a mean height."""
    if "too low" in text.split("(over all layers")[0]:
        return True
    if whole := re.search(r"(\d+\.\d+) kg of metal for (\d+\.\d+) kg", text):
        return float(whole[1]) < float(whole[2])
    share = re.search(r"(?:has|metal is) (\d+\.\d+)", text)
    return share is not None and float(share[1]) < 1.0


def heat_findings(plan: ScanPlan, config: Config) -> Iterator[Check]:
    """Layers of which an island is entered above the solidus; over the boiling point the model has no figure."""
    entry_k = plan.metrics["entry_max_k"].to_numpy() + config.process.ambient_temperature_k
    solidus_k = config.material.solidus_k
    hot = np.flatnonzero(entry_k > solidus_k)
    if hot.size:
        k, boiling_k = int(np.nanargmax(entry_k)), config.material.boiling_k
        over = f", up to over the boiling point of {boiling_k:g} K, where it ends"
        beyond = over if entry_k[k] > boiling_k else ""
        text = (
            f"{hot.size} of {len(plan)} layers have islands that the heat model finds above the solidus when the beam "
            f"enters them{beyond}"
        )
        figure_k = min(float(entry_k[k]), boiling_k)
        yield _told("heat-above-solidus", text, _at(k, plan.heights, config), figure_k, solidus_k)


def interpass_findings(summary: pd.DataFrame, plan: ScanPlan, config: Config) -> Iterator[Check]:
    """What keeps the part cool: how long the program waits, by its own `summary`, and how far the power goes down."""
    wait_s = float(summary["pause_s"].sum())
    whole_s = wait_s + float(summary["deposit_s"].sum() + summary["travel_s"].sum())
    if wait_s > 0.0:
        text = f"the program waits {wait_s / 3600.0:.3g} of {whole_s / 3600.0:.3g} hours for the part to cool"
        yield _told("interpass-wait", text, "process.interpass", wait_s)
    share = plan.metrics["power_share"].to_numpy()
    if share.size and np.nanmin(share) < 1.0:
        k, power_w = int(np.nanargmin(share)), config.process.power_w
        least = f"{100.0 * share[k]:.3g} % of {power_w:g} W"
        text = f"the beam's power goes down to {least} as the part gets warm"
        yield _told("power-taper", text, _at(k, plan.heights, config), float(share[k] * power_w), power_w)


def limit_findings(checks: Iterable[Check], plan: ScanPlan, config: Config) -> Iterator[Check]:
    """Layers that the plan, or the balance of the program's text, enters above the interpass limit; see the gate `heat`."""
    limit_k, metrics = entry_limit_k(config), plan.metrics
    at_bead = config.process.interpass_at == "bead"
    ambient_k = config.process.ambient_temperature_k
    planned_k = metrics["entry_max_k"] + ambient_k if at_bead else metrics["enter_k"]
    hot = np.flatnonzero(planned_k.to_numpy(np.float64) > limit_k)
    what = "beads" if at_bead else "layers"
    if hot.size:
        k = int(hot[planned_k.to_numpy()[hot].argmax()])
        figure_k, mark = within_range(float(planned_k[k]), config)
        text = (
            f"the plan enters {what} above {limit_k:.0f} K in {hot.size} of {len(plan)} layers, the hottest at "
            f"{figure_k:.0f} K{mark}"
        )
        place = _at(k, plan.heights, config)
        yield _told("interpass-limit", text, place, figure_k, limit_k, remedy=_cooler(config))
        return
    for check in checks:
        if check.name == INTERPASS and not check.passed:
            yield _told("interpass-limit", check.text, check.where, check.value, limit_k, unit=check.unit)


def _cooler(config: Config) -> str:
    """What is left to keep a layer under the limit, by the settings that it has been planned with."""
    process = config.process
    if process.interpass == "off":
        return 'wait and lower the power (process.interpass = "both")'
    if process.interpass == "power":
        return 'wait as well (process.interpass = "both"): even the least power that melts the wire leaves the part too hot'
    base = ", cool the table (process.base)" if process.base != "cooled" else ""
    return f"no wait is long enough: raise the limit (process.interpass_limit_k){base}, or lower the power further"


def seam_findings(program: NCProgram, heights: Floats, config: Config) -> Iterator[Check]:
    """Contours that start at a corner of the part, where metal heaps up; `heights` (L,) mm are those of the cuts."""
    row, turn_deg = seam_turns(program)
    corner_deg = 180.0 - config.curves.corner_angle_deg
    at_corner = turn_deg > corner_deg
    if at_corner.any():
        x_mm, y_mm, z_mm = program.start[int(row[at_corner.argmax()])].tolist()
        tops_mm = deposition_heights(heights, config.layer_height_mm, config.base_mm)
        layer, count = int(np.abs(tops_mm - z_mm).argmin()), int(at_corner.sum())
        turned = f"start where they turn by more than {corner_deg:g} degrees"
        text = f"{count} of {row.size} closed contours {turned}"
        yield _told("seam-at-corner", text, _at(layer, heights, config, x_mm, y_mm), float(count), 0.0)


def consumable_findings(program: NCProgram, config: Config) -> Iterator[Check]:
    """Layers before which the operator has to put on a new spool, or put in a new cathode."""
    for found in consumed(program, config):
        if found.changes:
            place, text = f"layer {found.changes[0] + 1}", found.check().text
            yield _told("consumable-change", text, place, found.total, found.holds, unit=found.unit)


def overhang_findings(checks: Iterable[Check], config: Config) -> Iterator[Check]:
    """A layer that reaches out steeply, where no angle is set that the process can build."""
    for check in checks:
        if check.name != OVERHANG or config.process.largest_overhang_deg or not check.passed:
            continue
        if check.value > STEEP_DEG:
            text = f"{check.text}; no angle is set that the process can build, so that a bead's width counts"
            yield _told("steep-overhang", text, check.where, check.value, STEEP_DEG, unit=check.unit)


def height_findings(part_mm: float, heights: Floats, config: Config) -> Iterator[Check]:
    """A program that ends beside the top of the part by more of its height than the metal may be off; a fault by more than half a
    layer.

    What the metal is held against are sections times the heights of layers, so that no gate sees it.
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
        yield _told(
            "height-off-part",
            f"{ends} at Z {ends_mm:.3f} mm, and the part is {part_mm:.3f} mm high",
            "layers.heights_mm" if listed else "layers.layer_height_mm",
            abs(ends_mm - part_mm),
            limit,
            severity="fault" if abs(ends_mm - part_mm) > half_mm + ROUNDING_MM else "warning",
            remedy="list heights for all of the part (layers.heights_mm), and what stands below them (layers.base_mm)"
            if listed
            else "give a layer height of which the part has a whole number (layers.layer_height_mm), or leave metal for machining",
        )


def _at(layer: int, heights: Floats, config: Config, x_mm: float = math.nan, y_mm: float = math.nan) -> str:
    """Name a place in part and program; `heights` (L,) mm are those of the cuts."""
    z_mm = deposition_heights(np.asarray(heights, np.float64), config.layer_height_mm, config.base_mm)[layer]
    return str(Place(layer=layer, cut_mm=float(heights[layer]), x_mm=x_mm, y_mm=y_mm, z_mm=float(z_mm)))

"""How often the text of a program preheats, and how warm and even the surface is then, by the balance and the modes of the heat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import Check, count_check
from ebamcheck.checks.heat_again import MODELS_SHARE, plate_k
from ebamcheck.checks.text_heat import scanned_heat, scans_of, text_beads, text_bed_k, text_shapes
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.nc.motions import NCProgram
from ebamcheck.scan.filling.preheat_lines import pass_length_mm, pass_lines
from ebamcheck.scan.heat.preheating import BeamWay, SurfaceK, spot_peak_k
from ebamcheck.scan.plan.preheated import AIM_K, Scanned, asked_for, is_cold, passes_asked, scanned
from ebamcheck.settings.config import Config

LENGTH_SHARE, MOST_PASSES = 0.02, 20000
"""Share of a pass by which the way of a scan may be off that of whole passes; more of these are not counted."""


AT_ONCE_S = 10.0
"""Time that the second balance takes at once."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the part: sections of the layers, and heat and section of what stands when the program begins."""

    sections: list[BaseGeometry]
    before: HeatColumn | None
    under: BaseGeometry | None


@dataclass
class Found:
    """What is found of one scan."""

    layer: int
    on: Scanned
    way: BeamWay
    begins_k: float
    after: SurfaceK | None
    passes: int
    wanted: int
    where: str = ""


def bottoms_of(nc: NCProgram, config: Config) -> np.ndarray:
    """Z of what each layer lies on (L,)."""
    tops = np.nan_to_num(nc.layer_heights, nan=config.base_mm)
    return np.concatenate([[config.base_mm], tops])[: len(tops) + 1]


def found_scans(nc: NCProgram, config: Config, known: Known) -> list[Found]:
    """Follow the heat of the program, and simulate every scan of its text; layers without a scan are told by their beginning."""
    scans, beads, sections = scans_of(nc, config), text_beads(nc, config), known.sections
    bottoms, found = bottoms_of(nc, config), list[Found]()
    on_plate = config.base_mm == 0.0

    def seen(k: int, column: HeatColumn | None) -> None:
        if not asked_for(k, config) or k >= len(sections) or sections[k].is_empty:
            return
        on = scanned(sections, k, float(bottoms[k]), config, known.under)
        begins_k = config.process.ambient_temperature_k if column is None else column.surface_k
        nothing = BeamWay(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        way = scans.get(k, nothing)
        reached = scanned_heat(way, sections, k, float(bottoms[k]), column, config, known.under)
        if reached is None:
            return
        passes = _passes(way, on, config)
        needed = column is None or is_cold(column, config)
        wanted = passes_asked(on, column, config) if needed else 0
        found.append(Found(k, on, way, begins_k, reached[0].read(), passes, wanted, _place_of(nc, k)))

    if on_plate:
        seen(0, None)

    def entered(k: int, column: HeatColumn) -> None:
        if k or not on_plate:
            seen(k, column)

    shapes = text_shapes(nc, config, sections)
    before = None if on_plate else known.before
    text_bed_k(beads, config, shapes, before, sections[0] if sections else None, entered)
    return found


def _place_of(nc: NCProgram, k: int) -> str:
    scans = nc.preheating
    if scans is not None and (scans.layer == k).any():
        return scans.where(int(np.flatnonzero(scans.layer == k)[0]))
    rows = np.flatnonzero(nc.layer == k)
    return nc.where(int(rows[0])) if rows.size else f"{nc.files[0].name}:1"


def _passes(way: BeamWay, on: Scanned, config: Config) -> int:
    """Whole passes that the way under the beam comes to; -1 where it is none."""
    length = float(np.hypot(*(way.end - way.start).T)[way.power_w > 0.0].sum())
    done, n = 0.0, 0
    while n <= MOST_PASSES:
        lines, joined = pass_lines(on.region, config, n)
        own = pass_length_mm(lines, joined)
        if abs(length - done) <= LENGTH_SHARE * own:
            return n
        if own <= 0.0 or done > length:
            return -1
        done, n = done + own, n + 1
    return -1


def count_of(found: list[Found], config: Config) -> Check:
    """Passes of each scan: those set, else the fewest that reach the target by the heat model."""
    faults = []
    for scan in found:
        room = 0 if config.preheat.passes is not None or (scan.layer == 0 and config.base_mm == 0.0) else 1
        if scan.passes < 0:
            faults.append(
                (scan.where, f"before layer {scan.layer + 1} the way of the beam is not that of whole passes")
            )
        elif abs(scan.passes - scan.wanted) > room:
            by = (
                "preheat.passes"
                if config.preheat.passes is not None
                else f"the fewest that come to preheat.target_k + {AIM_K:g} K"
            )
            faults.append(
                (
                    scan.where,
                    f"{scan.passes} passes before layer {scan.layer + 1} in place of {scan.wanted}, {by}",
                )
            )
    total = sum(max(scan.passes, 0) for scan in found)
    return count_check("preheat count", faults, f"{total} passes in {sum(s.passes > 0 for s in found)} scans")


def temperatures_of(nc: NCProgram, found: list[Found], config: Config) -> list[Check]:
    """Temperature, evenness and peak of the scanned surfaces."""
    settings, solidus_k = config.preheat, config.material.solidus_k
    read = [(scan, scan.after) for scan in found if scan.after is not None]
    low = min(read, key=lambda pair: pair[1].mean_k, default=None)
    high = max((p for p in read if p[0].passes), key=lambda pair: pair[1].mean_k, default=None)
    uneven = max((p for p in read if p[0].passes), key=lambda pair: pair[1].spread_k, default=None)
    most_w = max((float(p[0].way.power_w.max(initial=0.0)) for p in read), default=0.0)
    checks = []
    if low is not None:
        text = f"layer {low[0].layer + 1} begins on {low[1].mean_k:.0f} K, preheat.target_k is {settings.target_k:g} K"
        ok = low[1].mean_k >= settings.target_k
        checks.append(
            Check(
                "preheat temperature",
                bool(ok),
                low[1].mean_k,
                settings.target_k,
                "K, at least",
                low[0].where,
                text,
            )
        )
    if high is not None and uneven is not None:
        limit = settings.target_k + settings.over_k
        text = f"preheated to {high[1].mean_k:.0f} K at most, preheat.target_k + over_k is {limit:g} K"
        checks.append(
            Check(
                "preheat overheating",
                bool(high[1].mean_k <= limit),
                high[1].mean_k,
                limit,
                "K",
                high[0].where,
                text,
            )
        )
        spread, at = uneven[1].spread_k, uneven[1]
        text = (
            f"{at.least_k:.0f} K at {at.least_at_mm} to {at.most_k:.0f} K at {at.most_at_mm} before layer {uneven[0].layer + 1}, "
            f"preheat.evenness_k is {settings.evenness_k:g} K"
        )
        checks.append(
            Check(
                "preheat evenness",
                bool(spread <= settings.evenness_k),
                spread,
                settings.evenness_k,
                "K",
                uneven[0].where,
                text,
            )
        )
        peak_k = high[1].mean_k + spot_peak_k(most_w, settings.speed_mm_s, config)
        text = f"the surface comes to {peak_k:.0f} K under a beam of {most_w:g} W and {settings.spot_mm:g} mm, solidus is {solidus_k:g} K"
        checks.append(
            Check("preheat melting", bool(peak_k < solidus_k), peak_k, solidus_k, "K", high[0].where, text)
        )
    return checks


def temperature_again(found: list[Found], config: Config) -> list[Check]:
    """Temperature of the bare plate by a second balance of the heat: between that of all of the plate, and that of what is scanned alone."""
    scan = next((s for s in found if s.layer == 0 and s.after is not None), None)
    if scan is None or scan.after is None or config.base_mm > 0.0 or not scan.way.time_s.size:
        return []
    number = np.floor(np.cumsum(scan.way.time_s) / AT_ONCE_S).astype(np.int64)
    _, of = np.unique(number, return_inverse=True)
    times_s = np.bincount(of, scan.way.time_s).astype(np.float64)
    beam_j = np.bincount(of, scan.way.time_s * scan.way.power_w).astype(np.float64)
    heats_j = config.material.absorptivity * beam_j
    areas_mm2 = scan.on.body.area, scan.on.region.area
    low_k, high_k = sorted(plate_k(max(area, 1e-9), times_s, heats_j, config) for area in areas_mm2)
    off_k = max(low_k - scan.after.mean_k, scan.after.mean_k - high_k, 0.0)
    limit_k = MODELS_SHARE * max(low_k - config.process.ambient_temperature_k, 0.0)
    text = f"the plate is preheated to {scan.after.mean_k:.0f} K, by a second balance of the heat to {low_k:.0f} K"
    text += f" .. {high_k:.0f} K" if high_k > low_k + 1.0 else ""
    return [Check("preheat balance", off_k <= limit_k, off_k, limit_k, "K", scan.where, text)]

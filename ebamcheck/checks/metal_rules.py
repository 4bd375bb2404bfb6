"""Checks of the metal that a program lays: as much as the part has, where it has it, and flat; and of the wire of every bead by its
place.

Their limits are settings of the process, or follow from the bead; none is taken from what the program reaches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from scipy import ndimage

from ebamcheck.checks.checks import COARSE, TOO_THIN, limit_check
from ebamcheck.checks.metal import (
    AT_LIMIT,
    LEAST_OWN,
    STEP_SHARE,
    Asked,
    Deposit,
    bead_sections_mm2,
    zone_limit,
    zone_off,
)
from ebamcheck.checks.narrow_features import narrow_bead
from ebamcheck.geometry.regions import eroded
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import ProcessSettings
from ebamcheck.showing.short_text import counted
from ebamcheck.threads import run_each

NARROW = "narrow features"  # Check of features narrower than a least that is set
# Names of the checks of the metal of all beads together, in their order.
DEPOSIT_CHECKS = (
    "metal", "metal of layers", "metal outside", "reach of metal", "holes", NARROW, "height inside", "height at edges",
    "height of layers", "height of zones", "surface",
)  # fmt: skip
WIRE_OF_BEADS, LAID_ONCE = "wire of beads", "metal laid once"
LEAST_SPOTS = 1.0  # Bead spots, one layer high, by which starts and ends of beads may put a layer off
LAYER_OUTSIDE = 3.0  # Times the share of metal outside that a single layer may have
LEAST_ZONE = 25.0  # Zones of fewer squared bead widths do not count for the mean over all layers
OF_LAYER = "of the layer's metal"
MEAN_ZONES = ("inside", "edge")  # Zones that have a mean over all layers
HIGHEST = 0.35  # Share of a layer to which wrong wire that comes back in every layer may add up
# Share of the height of a single line that its neighbours take when it levels, by a Gaussian of half a bead width: what comes back in
# every layer adds up to one over this.
LEVELLED = 0.43
# Wire that a long bead may lack, or have too much of, over what its place asks for: webs, fins, frames and tapers as planned are within it.
MOST = HIGHEST * LEVELLED
HATCH_ROOM = 1.2  # Over the limit of a contour: a hatch bead has one wire, and cannot follow its place
HEAPED = 0.2  # Share of a layer by which metal may lie too high over a hatch bead: it heaps up along lines
# Lengths of contour, in bead widths, that are judged, wherever they begin: up to 45 bead widths, where hardly anything is levelled along
# the bead. Between two of them limit and error change by less than a tenth.
SPANS = tuple(0.5 * 2.0 ** (0.5 * k) for k in range(14))
LEAST_BEADS = 0.1  # Length of a bead, in bead widths, under which it has hardly a place of its own
MOST_METAL = 1.5  # Metal of a spot over that of the layer: half a bead more than all
STRETCH_BEADS = 3.0  # Length over which metal is averaged: more than ends and turns pile up


@dataclass(frozen=True)
class MetalBelow:
    """Sums over the layers that stand: with them, what holds for a whole part holds for one that is half built."""

    layers: int = 0  # Layers with metal, which were laid
    wanted_mm3: float = 0.0  # Metal that they were to have, have, and have beside the part
    laid_mm3: float = 0.0
    outside_mm3: float = 0.0
    # By MEAN_ZONES: area that counts, and the same times the height of its metal in layers.
    zone_mm2: tuple[float, float] = (0.0, 0.0)
    zone_layers_mm2: tuple[float, float] = (0.0, 0.0)

    def and_layers(self, table: pd.DataFrame, process: ProcessSettings) -> MetalBelow:
        """Return the sums with further layers, rows of :attr:`ebamcheck.checks.metal.Deposit.layers`."""
        solid = _with_metal(table)
        area, height = list(self.zone_mm2), list(self.zone_layers_mm2)
        for k, zone in enumerate(MEAN_ZONES):
            wide = _is_wide(solid, zone, process)
            mm2, layers = (solid[name].to_numpy(np.float64)[wide] for name in (f"{zone}_mm2", zone))
            area[k] += float(mm2.sum())
            height[k] += float((mm2 * layers).sum())
        names = ("wanted_mm3", "laid_mm3", "outside_mm3")
        wanted, laid, outside = (getattr(self, name) + float(solid[name].sum()) for name in names)
        count, zones = self.layers + len(solid), ((area[0], area[1]), (height[0], height[1]))
        return MetalBelow(count, wanted, laid, outside, *zones)

    def mean(self, zone: str) -> float:
        """Mean height of the metal of a zone, in layers; NaN where no layer is wide enough for one."""
        k = MEAN_ZONES.index(zone)
        return self.zone_layers_mm2[k] / self.zone_mm2[k] if self.zone_mm2[k] > 0.0 else float("nan")


def _with_metal(table: pd.DataFrame) -> pd.DataFrame:
    return table[(table["wanted_mm3"] > 0.0) | (table["laid_mm3"] > 0.0)]


def _is_wide(solid: pd.DataFrame, zone: str, process: ProcessSettings) -> Bools:
    """Layers (n,) of which a zone is wide enough to count for the mean over all layers."""
    area = solid[f"{zone}_mm2"].to_numpy(np.float64)
    return np.asarray(area >= LEAST_ZONE * process.bead_width_mm**2, np.bool_)


def deposit_checks(nc: NCProgram, found: Deposit, config: Config, below: MetalBelow | None = None) -> list[Check]:
    """Check the metal of a program, together with the metal `below`, see :func:`ebamcheck.checks.metal.deposit`. None: nothing
    stands there or, under the only layer of a program that does not begin on the plate (``layers.base_mm``), it is not known; that
    layer is then held to the limits of a single one alone."""
    solid = _with_metal(found.layers)
    if not len(solid):
        return [Check(name, False, math.inf, 0.0, "", "", "no layer has metal") for name in DEPOSIT_CHECKS]
    alone = below is None and config.base_mm > 0.0 and len(solid) == 1
    built = (below or MetalBelow()).and_layers(solid, config.process)
    metal = _Metal(nc, found, config, solid, built, alone)
    return [
        *(check(metal) for check in (_whole, _of_layers, _outside, _reach, _holes, _narrow)),
        *(_zone(metal, *of) for of in (("inside", "height inside"), ("edge", "height at edges"))),
        *(_of_zones(metal, *of) for of in ((MEAN_ZONES, "height of layers"), (("zone",), "height of zones"))),
        _surface(metal),
    ]


@dataclass(frozen=True, eq=False)
class _Metal:
    """Metal of a program, with its layers that have some, what is built with them, and whether it is one layer on what nobody
    knows."""

    nc: NCProgram
    found: Deposit
    config: Config
    solid: pd.DataFrame
    built: MetalBelow
    alone: bool

    def column(self, name: str) -> Floats:
        """A column of the layers with metal, (n,)."""
        return np.asarray(self.solid[name].to_numpy(np.float64))

    @property
    def thickness_mm(self) -> Floats:
        """Height of each layer with metal, (n,)."""
        return np.diff(self.column("z_mm"), prepend=self.config.base_mm)

    def off_layers(self) -> Floats:
        """How far the metal of each layer (n,) is off, beyond the starts and ends of beads, over that of the layer."""
        wanted, laid = self.column("wanted_mm3"), self.column("laid_mm3")
        spots = LEAST_SPOTS * self.config.process.bead_width_mm**2 * np.maximum(self.thickness_mm, 0.0)
        return np.maximum(np.abs(laid - wanted) - spots, 0.0) / np.maximum(wanted, 1e-9)

    def where(self, layer: int) -> str:
        """``FILE:line`` of the first bead of a layer."""
        row = int(self.found.first_row[layer])
        return self.nc.where(row) if row >= 0 else f"{self.nc.files[0].name}:1"

    def named(self, k: int, at: str = "") -> str:
        """Layer and height of row `k`, and place where it is known, in words."""
        row = self.solid.iloc[k]
        text = f"layer {int(row['layer']) + 1}, Z {row['z_mm']:.3f}"
        return f"{text}, at ({row[f'{at}_x_mm']:.1f}, {row[f'{at}_y_mm']:.1f})" if at else text

    def judged(self, name: str, k: int, figure: float, limit: float, unit: str, text: str, wall: bool = False) -> Check:
        """Check whose worst layer is row `k`; with what to do about its thinnest `wall`, where it is over its limit."""
        row, remedy = self.solid.iloc[k], ""
        if wall and not figure <= limit and math.isfinite(row["wall_mm"]):
            bead = narrow_bead(float(row["wall_mm"]), float(self.thickness_mm[k]), self.config)
            place = f"({row['wall_x_mm']:.1f}, {row['wall_y_mm']:.1f})"
            text += f"; the thinnest wall of that layer, at {place}, is {row['wall_mm']:.1f} mm thick: {bead}"
            remedy = COARSE if bead.can_be_laid else TOO_THIN
        where = self.where(int(row["layer"]))
        return limit_check(name, figure, limit, unit, text, where, remedy=remedy)


def _whole(metal: _Metal) -> Check:
    limit, built = metal.config.process.mass_tolerance, metal.built
    off = abs(built.laid_mm3 / built.wanted_mm3 - 1.0) if built.wanted_mm3 > 0.0 else math.inf
    if metal.alone:
        off = float(metal.off_layers()[0])
    density = metal.config.material.density_kg_m3 * 1e-9
    # Milligrams of a part under 0.1 kg: what shuts the gate has to show in the figures.
    decimals = 3 if built.wanted_mm3 * density >= 0.1 else 6
    laid, wanted = (f"{mm3 * density:.{decimals}f} kg" for mm3 in (built.laid_mm3, built.wanted_mm3))
    return limit_check("metal", off, limit, "of the part", f"{laid} of metal for {wanted} of part")


def _of_layers(metal: _Metal) -> Check:
    wanted, laid, off = metal.column("wanted_mm3"), metal.column("laid_mm3"), metal.off_layers()
    k = int(np.argmax(off))
    share = f"{laid[k] / wanted[k]:.3f} of its metal" if wanted[k] > 0.0 else "metal, and no section"
    text = f"a layer has {share}: {metal.named(k)}"
    limit = metal.config.process.mass_tolerance
    return metal.judged("metal of layers", k, off[k], limit, "of the layer", text)


def _outside(metal: _Metal) -> Check:
    limit, built = metal.config.process.outside_share, metal.built
    # A sum whose parts cancel may be under 0 by its rounding.
    outside, laid = np.maximum(metal.column("outside_mm3"), 0.0), metal.column("laid_mm3")
    whole = max(built.outside_mm3, 0.0) / max(built.laid_mm3, 1e-9)
    share = np.divide(outside, laid, out=np.zeros_like(laid), where=laid > 0.0)
    k = int(np.argmax(share))
    most = f"most {100 * share[k]:.2f} % of a layer: {metal.named(k)}"
    text = f"{100 * whole:.2f} % of the metal lies beside the part, {most}"
    # The figure is that of the whole or of the layer, whichever comes nearer to its own limit.
    if not metal.alone and whole * LAYER_OUTSIDE >= share[k] - 1e-9:
        return metal.judged("metal outside", k, whole, limit, "of the metal", text, wall=True)
    return metal.judged("metal outside", k, share[k], limit * LAYER_OUTSIDE, OF_LAYER, text, wall=True)


def _reach(metal: _Metal) -> Check:
    limit, reach = metal.config.process.outside_reach_mm, metal.column("reach_mm")
    k = int(np.argmax(reach))
    if reach[k] <= 0.0:
        return Check("reach of metal", True, 0.0, limit, "mm", "", "no metal reaches beside the part")
    text = f"metal reaches {reach[k]:.2f} mm beside the part: {metal.named(k, 'reach')}"
    text += "; a wall, a hole or a corner there is narrower than the bead" if reach[k] > limit else ""
    return metal.judged("reach of metal", k, reach[k], limit, "mm", text, wall=True)


def _holes(metal: _Metal) -> Check:
    """Holes of the sections that beads close, however little metal that is."""
    holes = metal.found.holes
    if not len(holes):
        return Check("holes", True, 0.0, 0.0, "holes", "", "beads lay no metal over the holes of the part")
    first = holes.iloc[0]
    layer = int(first["layer"])
    text = (
        f"{counted(len(holes), 'hole')} on {counted(holes['layer'].nunique(), 'layer')} closed by beads, first one {first['width_mm']:.1f} mm wide: "
        f"{100 * first['covered']:.0f} % of it, layer {layer + 1}, at ({first['x_mm']:.1f}, {first['y_mm']:.1f})"
    )
    return Check("holes", False, float(len(holes)), 0.0, "holes", metal.where(layer), text)


def _narrow(metal: _Metal) -> Check:
    """Openings and walls of the part that are narrower than a setting allows; of others, narrower than beads can build, it
    tells."""
    narrow = metal.found.narrow
    broken = [feature for feature in narrow if feature.is_set]
    text = "no opening and no wall is narrower than beads can build"
    if narrow:
        told = broken or narrow
        first = told[0]
        text = (
            f"{counted(len(told), 'feature')} of the part narrower than {first.than}: first {first.in_words()}, "
            f"layer {first.layer + 1}, at ({first.x_mm:.1f}, {first.y_mm:.1f})"
        )
    where = metal.where(broken[0].layer) if broken else ""
    return Check(NARROW, not broken, float(len(broken)), 0.0, "features", where, text)


def _tolerances(metal: _Metal, zone: str) -> Floats:
    """Tolerance (n,) of a zone on each layer, before that of its size."""
    process = metal.config.process
    if zone == "zone":
        return metal.column("zone_tolerance")
    return np.full(len(metal.solid), process.inside_tolerance if zone == "inside" else process.edge_tolerance)


def _zone(metal: _Metal, zone: str, name: str) -> Check:
    """Mean height of the metal in a zone over all layers, and the layer where it is furthest off."""
    process, height, mean = metal.config.process, metal.column(zone), metal.built.mean(zone)
    limit = float(_tolerances(metal, zone)[0])
    if metal.alone:
        limit = float(zone_limit(limit, metal.column(f"{zone}_mm2")[0], process))
    if math.isnan(mean):
        text = f"no layer is wide enough for a mean ({zone})"
        return Check(name, True, 0.0, limit, "of the height", "", text)
    wide = _is_wide(metal.solid, zone, process)
    k = int(np.argmax(np.where(wide, np.abs(height - 1.0), -1.0)))
    text = f"metal is {mean:.3f} layers high on average"
    text += f", furthest off {height[k]:.3f}: {metal.named(k)}" if wide.any() else ""
    return metal.judged(name, k, abs(mean - 1.0), limit, "of the height", text)


def _of_zones(metal: _Metal, zones: tuple[str, ...], name: str) -> Check:
    """Mean heights of zones on every single layer: the one furthest off for its size."""
    process, rows = metal.config.process, []
    for zone in zones:
        off = zone_off(metal.column(f"{zone}_settled"), metal.column(f"{zone}_owed"))
        limit = zone_limit(_tolerances(metal, zone), metal.column(f"{zone}_mm2"), process)
        known = np.flatnonzero(np.isfinite(off / limit))
        rows += [(off[k] / limit[k], int(k), zone, off[k], limit[k]) for k in known]
    if not rows:
        return Check(name, True, 0.0, process.edge_tolerance, "of the height", "", "no layer has metal")
    _, k, zone, off, limit = max(rows)
    row = metal.solid.iloc[k]
    what = {"inside": "inside", "edge": "at its edges", "zone": f"on {row[f'{zone}_mm2']:.0f} mm2"}[zone]
    place = metal.named(k, "zone" if zone == "zone" else "")
    text = f"a layer's metal is {row[f'{zone}_settled']:.3f} layers high {what}: {place}"
    return metal.judged(name, k, off, float(limit), "of the height", text, wall=True)


def _surface(metal: _Metal) -> Check:
    low, high = metal.column("low_mm"), metal.column("high_mm")
    side, values = ("low", low) if low.max() > high.max() else ("high", high)
    k = int(np.argmax(values))
    every = f"over all layers {low.max():.2f} mm too low to {high.max():.2f} mm too high"
    text = f"the surface comes to lie {values[k]:.2f} mm too {side}: {metal.named(k, side)} ({every})"
    return metal.judged("surface", k, values[k], metal.config.process.largest_unevenness_mm, "mm", text)


# Where beads meet or lie side by side, one may lay what the other leaves: wire is wrong where the place says so by the area of the
# section nearest to it, together with all that lies in its pool, and by the height of the metal over the width of the bead. What counts is the height that the error comes to, over any length of bead. Every pool levels some of it; along the bead it levels an
# error that is not much longer than the bead is wide, and hardly any of a long one.


def bead_wire_check(nc: NCProgram, found: Deposit, config: Config) -> Check:
    """Check that every bead has the wire that its place asks for, over any length of it, by a deposit whose places were `asked`.
    A contour may change its wire along itself, and is judged over every span of :data:`SPANS`; a hatch bead has one wire, and is
    judged as a whole, and where its wire changes."""
    if config.base_mm > 0.0 or not found.asked:
        text = "what the lowest layer lies on, and so what its beads have to level, is not in the program"
        text = text if config.base_mm > 0.0 else "no bead has a place of its own"
        return Check(WIRE_OF_BEADS, True, 0.0, MOST, "of the wire", "", text)
    judged = run_each(lambda asked: _worst_span(nc, asked, config.process.bead_width_mm), found.asked)
    _, off, limit, length_mm, row, _ = max(judged, key=lambda span: span[0])
    beads = sum(span[-1] for span in judged)
    text = f"{beads} beads; over {length_mm:.3g} mm a bead has {1.0 + off:.3g} times the wire that its place asks for"
    layer, at = int(nc.layer[row]), nc.start[row, :2]
    return limit_check(WIRE_OF_BEADS, abs(off), limit, "of the wire", text, nc.where(row), layer, at)


def most_off(length_mm: Floats, bead_mm: float) -> Floats:
    """Wire that spans (m,) of a bead may lack, or have too much of, over what their places ask for."""
    share = bead_mm / np.maximum(length_mm, LEAST_BEADS * bead_mm)
    return np.asarray(MOST * (1.0 + share**2), np.float64)


def _worst_span(nc: NCProgram, asked: Asked, bead_mm: float) -> tuple[float, float, float, float, int, int]:
    """Worst span of the beads of a layer: over its limit, what it is off, limit, length, mm, and motion; and how many beads there
    are."""
    on_contour = nc.ring[asked.row] >= 0
    sums, bead = _Sums(asked), nc.beads.group[asked.row]
    first = np.flatnonzero(np.diff(bead, prepend=-1))
    stop = np.append(first[1:], bead.size)
    begin, end = [first], [stop]
    contour, last_of_bead = np.flatnonzero(on_contour), np.repeat(stop, stop - first)
    for span in SPANS:
        last = np.minimum(sums.reached(contour, span * bead_mm), last_of_bead[contour])
        whole = sums.length(contour, last) >= (span - STEP_SHARE) * bead_mm
        begin.append(contour[whole])
        end.append(last[whole])
    begins, ends = np.concatenate(begin), np.concatenate(end)
    some, until, change = _changes(asked, on_contour, first, stop)
    told = sums.off(some, until, on_contour)
    # Metal heaps up where islands meet, whatever wire a bead has: a change has to be as wrong as the place says.
    told = np.where(change * told > 0.0, np.sign(told) * np.minimum(np.abs(change), np.abs(told)), 0.0)
    off = np.concatenate([sums.off(begins, ends, on_contour), told])
    begins, ends = np.append(begins, some), np.append(ends, until)
    length = sums.length(begins, ends)
    off = np.where(length >= LEAST_BEADS * bead_mm, off, 0.0)
    limit = np.where(on_contour[begins], 1.0, HATCH_ROOM) * most_off(length, bead_mm)
    k = int(np.argmax(np.abs(off) / limit))
    worst, most = float(off[k]), float(limit[k])
    return abs(worst) / most, worst, most, float(length[k]), int(asked.row[begins[k]]), first.size


class _Sums:
    """Sums of the columns of places from the first on, so that any span is a difference of two."""

    def __init__(self, asked: Asked) -> None:
        own, at_limit = (column * asked.along_mm for column in (asked.own, asked.at_limit))
        columns = np.column_stack([asked.laid, asked.least, asked.most, own, at_limit, asked.along_mm])
        self._sums = np.vstack([np.zeros(columns.shape[1]), np.cumsum(columns, axis=0)])
        self._along = np.ascontiguousarray(self._sums[:, -1])

    def reached(self, first: Ints, length_mm: float) -> Ints:
        """Place behind the last one of spans of a length that begin at places `first` (m,)."""
        return np.asarray(np.searchsorted(self._along, self._along[first] + length_mm), np.int64)

    def length(self, first: Ints, stop: Ints) -> Floats:
        """Length (m,) of spans from one place to before another, mm."""
        return np.asarray(self._along[stop] - self._along[first], np.float64)

    def off(self, first: Ints, stop: Ints, on_contour: Bools) -> Floats:
        """Wire of spans (m,) over what their places ask for, less 1: wrong is what all ways say, and the limits of the wire do not
        excuse."""
        span = np.ascontiguousarray((self._sums[stop] - self._sums[first]).T)
        laid, least, most, length = span[:3], span[3:6], span[6:9], np.maximum(span[11], np.finfo(float).tiny)
        own, limit = np.clip(span[9] / length, LEAST_OWN, 1.0) * length, span[10] / length

        def share_off(asked: Floats) -> Floats:
            """How far spans (3, m) are over what is asked for, by each of the three ways."""
            base = np.vstack([asked[:2], own])
            with np.errstate(divide="ignore", invalid="ignore"):
                # A bead that no area is nearest to, or over nothing, has more than any limit.
                return np.where(base > 0.0, (laid - asked) / base, np.where(laid > 0.0, np.inf, 0.0))

        over, under = share_off(most), share_off(least)
        under[2] -= np.where(on_contour[first], 0.0, HEAPED)
        high, low = over.min(axis=0), under.max(axis=0)
        return np.where((high > 0.0) & (limit > -0.5), high, np.where((low < 0.0) & (limit < 0.5), low, 0.0))


def _changes(asked: Asked, on_contour: Bools, begin: Ints, end: Ints) -> tuple[Ints, Ints, Floats]:
    """Parts of hatch beads, which go from place `begin` (B,) to `end`, of another metal than the rest: their ends, and by how
    much."""
    own = asked.own
    starts = np.zeros(own.size, np.bool_)
    starts[begin] = True
    starts[1:] |= ~np.isclose(own[1:], own[:-1], rtol=AT_LIMIT, atol=0.0)
    first = np.flatnonzero(starts)
    stop = np.append(first[1:], own.size)
    bead = np.searchsorted(begin, first, side="right") - 1
    part = ~on_contour[first] & (np.bincount(bead, minlength=begin.size)[bead] > 1)
    first, stop, bead = first[part], stop[part], bead[part]
    metal, along = (np.append(0.0, np.cumsum(column)) for column in (own * asked.along_mm, asked.along_mm))
    laid, length = metal[stop] - metal[first], along[stop] - along[first]
    rest = np.maximum(along[end[bead]] - along[begin[bead]] - length, 1e-9)
    usual = (metal[end[bead]] - metal[begin[bead]] - laid) / rest
    with np.errstate(divide="ignore", invalid="ignore"):
        return first, stop, np.where(usual > 0.0, laid / length / usual - 1.0, 0.0)


def overfill_check(nc: NCProgram, z_of: Floats, config: Config, layers: Layers) -> Check:
    """Most metal that a layer lays in the spot of a bead, a square of its width, over that of the layer; they lie at Z `z_of` (L,).
    A bead more, or one laid again, brings a spot 0.7 times that. Spots count where the section is at least two bead widths wide:
    contours around less lie in each other, and the metal of such layers is judged as a whole."""
    rows = nc.beads.rows
    rows = rows[np.isfinite(nc.start[rows]).all(axis=1) & nc.deposit[rows] & nc.wire[rows]]
    thickness = np.diff(z_of, prepend=config.base_mm)
    mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)

    def fullest(k: int) -> tuple[float, int, Floats, int] | None:
        mine = rows[nc.layer[rows] == k]
        if not (mine.size and thickness[k] > 0.0):
            return None
        bead_mm, across = config.process.bead_width_mm, 6
        cell = bead_mm / across
        row, at = nc.samples(mine, cell)
        pieces, lengths = np.bincount(row, minlength=1)[row], np.nan_to_num(nc.lengths[row])
        along, origin = lengths / pieces, at.min(axis=0) - 2.0 * bead_mm
        size = np.ceil((at.max(axis=0) + 2.0 * bead_mm - origin) / cell).astype(np.int64) + 1
        columns, count = size.tolist()
        i, j = np.floor((at - origin) / cell).astype(np.int64).T
        metal_mm3 = np.bincount(j * columns + i, mm2[row] * lengths / pieces, minlength=count * columns)
        field = np.asarray(metal_mm3.reshape(count, columns), np.float64)
        # Once for the width of the bead, and once for the spot.
        for _ in range(2):
            field = ndimage.uniform_filter(field, across, mode="constant")
        field = field / (cell**2 * float(thickness[k]))
        wide = shapely.buffer(eroded(layers.section(k), bead_mm), bead_mm)
        shapely.prepare(wide)
        excess = np.where(shapely.intersects_xy(wide, at[:, 0], at[:, 1]), field[j, i] - 1.0, 0.0)
        # Mean over the stretch of a bead that ends at each place; what a short bead lacks of a stretch has none.
        bead, ends = nc.beads.group[row], np.cumsum(along)
        sums = np.append(0.0, np.cumsum(excess * along))
        stretch_mm = STRETCH_BEADS * bead_mm
        first = np.searchsorted(ends, ends - stretch_mm, side="right")
        first = np.maximum(first, np.searchsorted(bead, bead))
        mean = (sums[1:] - sums[first]) / stretch_mm
        # Of a bead laid twice the later one is named.
        worst = mean.size - 1 - int(np.argmax(mean[::-1] + 0.0))
        return 1.0 + float(mean[worst]), k, at[worst], int(row[worst])

    found = [spot for spot in run_each(fullest, range(z_of.size)) if spot is not None]
    if not found:
        return Check(LAID_ONCE, True, 0.0, MOST_METAL, "of the layer", "", "no layer lays metal")
    metal, k, at, row = max(found, key=lambda spot: spot[0])
    place = f"layer {k + 1}, at ({at[0]:.1f}, {at[1]:.1f})"
    text = f"a spot gets {metal:.3g} times the metal of its layer: {place}"
    return limit_check(LAID_ONCE, metal, MOST_METAL, "of the layer", text, nc.where(row), k, at)

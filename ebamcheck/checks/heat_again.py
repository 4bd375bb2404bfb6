"""A second balance of a program's heat, in code of its own, and the limits of the heat gate worked out anew.

Plan and check follow one heat column (:mod:`ebamcheck.heat.balance`): with a mistake in it a plan has too short waits, and its
entries are found cool enough. Here the heat is followed in the plainest way, from the data of the material and the text alone:
cells as high as layers, steps of first order. It is coarser, and may differ by :func:`may_differ_k`; more is a mistake, here or
there."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.settings.config import Config

RADIATION_W_MM2K4 = 5.670374e-14  # Stefan-Boltzmann constant (CODATA 2018), by square millimetre
MODELS_SHARE = 0.1  # Of the limit's rise: data of alloys are known no better
# By so many kelvins they may differ in any case: how far metal cools from its melting point until the next bead is not a matter of the
# limit (49 K at most, of five shapes, four alloys and limits from 423 K up).
MODELS_K = 60.0
PLATE_CELLS = 6  # Cells of the base plate
STEPS = 24  # Steps of every time, growing evenly: what is uneven evens out at first
SINGLE_LAYERS, MOST_CELLS = 48, 128  # Uppermost cells of one layer; cells from which others are joined
HOTTEST_K = 6000.0  # End of the data; what is hotter has those of the end
SUMMED = 4000  # Temperatures in the sum of the heat that melts: less than a kelvin apart


def highest_entry_k(config: Config) -> float:
    """Absolute temperature over which no bead may be entered, K: what the process sets, else the limit of the material, never its
    solidus."""
    process, material = config.process, config.material
    if process.interpass_limit_k is not None:
        return min(process.interpass_limit_k, material.solidus_k)
    cooled = process.interpass != "off"
    return min(material.interpass_limit_k, material.solidus_k) if cooled else material.solidus_k


def may_differ_k(config: Config) -> float:
    """By how much two balances of the same heat may differ near the limit, K."""
    rise_k = highest_entry_k(config) - config.process.ambient_temperature_k
    return max(MODELS_SHARE * rise_k, MODELS_K)


def melting_power_w(config: Config, thickness_mm: ArrayLike) -> Floats:
    """Power of the beam at which the wire of a bead, and the metal that is remelted with it, melts from the cold, W. Where the full
    power is too little for both, all of it, or that for the wire alone. `thickness_mm` is the height of what a bead lays where its
    metal is spread over one spacing, at the feed of the process."""
    process, material = config.process, config.material
    each_mm3_s = process.travel_speed_mm_s * process.bead_width_mm * process.bead_spacing
    kg_s = each_mm3_s * np.asarray(thickness_mm, np.float64) * 1e-9 * material.density_kg_m3
    rise_k = max(material.liquidus_k - process.ambient_temperature_k, 0.0)
    kelvin = process.ambient_temperature_k + rise_k * (np.arange(SUMMED) + 0.5) / SUMMED
    sensible = float(np.interp(kelvin, *_data(material.heat_capacity_by_temperature)).mean()) * rise_k
    efficiency = process.melting_efficiency * material.absorptivity
    wire_w = kg_s * (sensible + material.latent_heat_j_kg) / efficiency
    full_w, both_w = process.voltage_kv * process.current_ma, wire_w / (1.0 - process.dilution)
    return np.where(both_w <= full_w, both_w, np.maximum(wire_w, full_w))


def _data(points: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    kelvin, values = np.array(points, np.float64).T
    return kelvin, values


@dataclass(frozen=True, eq=False)
class BeadHeat:
    """Beads of a program in its sequence, as columns (P,): layer, time with the beam off before each, its own time, s, and the heat
    that the part takes up in it, J."""

    layer: Ints
    off_s: Floats
    time_s: Floats
    heat_j: Floats


def entries_k(beads: BeadHeat, sections: Sequence[BaseGeometry], heights_mm: Floats, config: Config) -> Floats:
    """Temperature (P,) of what beads are laid on when the beam comes to them, K, in layers (L,) of sections and heights."""
    shapes = [_Shape.of(s, h) for s, h in zip(sections, heights_mm.tolist(), strict=True)]
    return _entered(_Column(config), beads, shapes)


def _entered(column: _Column, beads: BeadHeat, shapes: Sequence[_Shape]) -> Floats:
    """Temperatures (P,) of what beads are laid on, K; afterwards the column has them on top."""
    found, layer = np.zeros(beads.layer.size), -1
    for bead in range(found.size):
        column.follow(float(beads.off_s[bead]), 0.0)
        found[bead] = column.bed_k
        if beads.layer[bead] != layer:
            layer = int(beads.layer[bead])
            column.lay(shapes[layer])
        column.follow(float(beads.time_s[bead]), float(beads.heat_j[bead]))
    return found


class FollowedHeat:
    """Heat of a part that is half built; a layer laid on it makes another one, and leaves this as it is."""

    def __init__(self, config: Config) -> None:
        self._column = _Column(config)

    def with_layer(self, beads: BeadHeat, section: BaseGeometry, height_mm: float) -> tuple[Floats, FollowedHeat]:
        """Lay one more layer of beads (P,), all of layer 0: temperature of what each is laid on, K, and the heat when the layer is
        done."""
        after = copy.copy(self)
        after._column = self._column.copied()
        return _entered(after._column, beads, [_Shape.of(section, height_mm)]), after


def plate_k(area_mm2: float, times_s: Floats, heats_j: Floats, config: Config) -> float:
    """Temperature of the upper side of a bare base plate after times (n,) in which it takes up heat (n,) there, K."""
    shape = _Shape(config.process.base_plate_mm / PLATE_CELLS, area_mm2, 0.0, 0.0, 0.0)
    column = _Column(config)
    column.lay_plate(shape)
    for time_s, heat_j in zip(times_s.tolist(), heats_j.tolist(), strict=True):
        column.follow(time_s, heat_j)
    return column.bed_k


@dataclass(frozen=True)
class _Shape:
    """A layer: its height, section, outer border, border of its holes, and their area; mm."""

    height: float
    area: float
    outer: float
    inner: float
    holes: float

    @classmethod
    def of(cls, section: BaseGeometry, height_mm: float) -> _Shape:
        parts = [p for p in shapely.get_parts(section) if p.geom_type == "Polygon"]
        outer = sum(p.exterior.length for p in parts)
        filled = sum(shapely.Polygon(p.exterior).area for p in parts)
        area = sum(p.area for p in parts)
        inner = sum(p.length for p in parts) - outer
        return cls(height_mm, float(area), float(outer), float(inner), float(filled - area))


class _Column:
    """Temperatures of plate and layers, from the table up."""

    def __init__(self, config: Config) -> None:
        process, material = config.process, config.material
        self._ambient = process.ambient_temperature_k
        self._cooled, self._plate_mm = process.base == "cooled", process.base_plate_mm
        self._glow = material.emissivity * RADIATION_W_MM2K4
        kelvin = np.arange(HOTTEST_K)
        capacity = np.interp(kelvin, *_data(material.heat_capacity_by_temperature))
        wide_k = max(material.liquidus_k - material.solidus_k, 1.0)
        melts = (kelvin >= material.solidus_k) & (kelvin < material.solidus_k + wide_k)
        capacity += np.where(melts, material.latent_heat_j_kg / wide_k, 0.0)
        self._content = np.cumsum(1e-9 * material.density_kg_m3 * capacity)
        self._conductivity = 1e-3 * np.interp(kelvin, *_data(material.conductivity_by_temperature))
        self._laid = np.zeros((0, 5))  # of each layer what a shape has of it
        self._first = np.zeros(0, np.int64)  # of the layers in each cell above the plate
        self._lost = False
        self._kelvin = np.zeros(0)
        self._height = self._area = self._shining = np.zeros(0)

    @property
    def bed_k(self) -> float:
        """Temperature of the uppermost layer or of the one under it, whichever is warmer."""
        if self._lost:
            return math.nan
        return float(self._kelvin[-2:].max()) if len(self._laid) else self._ambient

    def copied(self) -> _Column:
        """Return another one that goes on by itself."""
        result = copy.copy(self)
        result._kelvin = self._kelvin.copy()  # which alone is written to where it lies
        return result

    def lay(self, shape: _Shape) -> None:
        """Put a cold layer on top; the first one lies on a plate as wide as it is."""
        if shape.area <= 0.0:
            return
        plate = 0 if len(self._laid) else PLATE_CELLS
        self._laid = np.vstack([self._laid, astuple(shape)])
        self._first = np.append(self._first, len(self._laid) - 1)
        self._kelvin = np.append(self._kelvin, np.full(plate + 1, self._ambient))
        self._height = np.append(self._height, [*[self._plate_mm / PLATE_CELLS] * plate, shape.height])
        self._area = np.append(self._area, np.full(plate + 1, shape.area))
        if self._kelvin.size > MOST_CELLS:
            self._join()
        # Surface by which each layer sees the chamber: its sides, its top as far as none lies on it, and what overhangs. The walls of a
        # channel that is open above see as much of it as its opening, the more of it the nearer they are to that.
        height, area, outer, inner, holes = self._laid.T
        filled = area + holes
        seen = outer * height + np.maximum(filled - np.append(filled[1:], holes[-1]), 0.0)
        seen[1:] += np.maximum(filled[1:] - filled[:-1], 0.0)
        below = int(np.flatnonzero(holes <= 0.0).max(initial=-1)) + 1
        if below < holes.size:
            depth = np.cumsum(height[::-1])[::-1][below:] - 0.5 * height[below:]
            wall = inner[below:] * height[below:]
            nearer = wall * np.exp(-0.5 * depth * inner[below:] / holes[below:])
            opening = min(float(holes[-1]), float(wall.sum()))
            seen[below:] += opening * nearer / max(float(nearer.sum()), 1e-12)
        shining = np.add.reduceat(self._glow * np.asarray(seen, np.float64), self._first)
        self._shining = np.concatenate([np.zeros(PLATE_CELLS), shining])

    def lay_plate(self, cell: _Shape) -> None:
        """Make this a bare plate of cells, the uppermost of which radiates and takes up the heat; no layer may follow."""
        self._laid = np.array([astuple(cell)] * PLATE_CELLS)
        self._kelvin = np.full(PLATE_CELLS, self._ambient)
        self._height, self._area = (np.full(PLATE_CELLS, value) for value in (cell.height, cell.area))
        self._shining = np.append(np.zeros(PLATE_CELLS - 1), self._glow * cell.area)

    def _join(self) -> None:
        """Join pairs of cells between the plate and the uppermost layers: their volume and, nearly, their heat stay."""
        pairs = (self._first.size - SINGLE_LAYERS) // 2
        low = np.arange(self._first.size - pairs)
        low[:pairs] *= 2
        low[pairs:] += pairs
        starts = np.concatenate([np.arange(PLATE_CELLS), PLATE_CELLS + low])
        volume = self._height * self._area
        whole = np.add.reduceat(volume, starts)
        self._kelvin = np.add.reduceat(volume * self._kelvin, starts) / whole
        self._height = np.add.reduceat(self._height, starts)
        self._area, self._first = whole / self._height, self._first[low]

    def follow(self, time_s: float, heat_j: float) -> None:
        """Let a time go by in which the uppermost layer takes up heat."""
        # A feed of nothing never ends: what comes after it has no temperature.
        self._lost |= not (math.isfinite(time_s) and math.isfinite(heat_j))
        if self._lost or time_s <= 0.0 or not len(self._laid):
            return
        tables = self._content, self._conductivity
        cells = self._height, self._area, self._shining
        _follow(self._kelvin, cells, tables, self._ambient, self._cooled, time_s, heat_j / time_s)


@kernel
def _follow(
    kelvin: Floats, cells: tuple[Floats, Floats, Floats], tables: tuple[Floats, Floats], ambient: float, cooled: bool,
    time: float, power: float,
) -> None:  # fmt: skip
    """Let a time go by, to second order; `kelvin` (n,) goes from its start to its end."""
    # Cells are height, section, and surface that radiates times its emissivity, from the table up; tables are heat content, J/mm^3, and
    # conductivity, W/mm K, at every kelvin; the uppermost cell takes up `power`, W.
    (height, area, shining), (content, conductivity) = cells, tables
    count = kelvin.size
    pivot, right, link = np.empty(count), np.empty(count), np.empty(count)
    now, whole, data_at = np.empty(count), np.empty(count), np.empty(count)
    for step in range(STEPS):
        span = (2 * step + 1) / STEPS**2 * time
        # A whole step with the data at its start, one with those in its middle, and two halves of it. Each is implicit, with the data of
        # the material at given temperatures, those half-way to its end: heat is taken up along the whole of it, so that the heat of
        # fusion counts however fast a cell melts or freezes.
        for part in range(4):
            if part == 0:
                data_at[:], now[:] = kelvin, kelvin
            elif part == 1:
                data_at[:], now[:] = 0.5 * (kelvin + now), kelvin
            elif part == 2:
                whole[:], data_at[:] = now, 0.75 * kelvin + 0.25 * now
                now[:] = kelvin
            else:
                data_at[:] = 0.5 * (now + whole)
            below, took = 0.0, span if part < 2 else 0.5 * span
            for i in range(count):
                at, was = data_at[i], now[i]
                k = min(max(int(at), 0), conductivity.size - 1)
                a = min(max(int(min(was, 2.0 * at - was)), 0), content.size - 2)
                b = min(max(int(max(was, 2.0 * at - was)), a + 1), content.size - 1)
                half = 0.5 * height[i] / (conductivity[k] * area[i])
                held = (content[b] - content[a]) / (b - a) * height[i] * area[i] / took
                glow = shining[i] * (at**2 + ambient**2) * (at + ambient)
                pivot[i], right[i] = held + glow, held * was + glow * ambient
                if i > 0:
                    link[i] = 1.0 / (below + half)
                    pivot[i - 1] += link[i]
                    # The row before is whole now, and can be taken out of this one.
                    factor = link[i] / pivot[i - 1]
                    pivot[i] += link[i] - factor * link[i]
                    right[i] += factor * right[i - 1]
                elif cooled:
                    pivot[0] += 1.0 / half
                    right[0] += ambient / half
                below = half
            right[count - 1] += power
            now[count - 1] = right[count - 1] / pivot[count - 1]
            for i in range(count - 2, -1, -1):
                now[i] = (right[i] + link[i + 1] * now[i + 1]) / pivot[i]
        # What two halves differ by from the whole is the error of one order: twice it is taken out.
        kelvin[:] = 2.0 * now - whole

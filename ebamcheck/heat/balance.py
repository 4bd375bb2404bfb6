"""One-dimensional heat balance of a whole program: a column of layers that grows on the base plate.

Each layer has an area, an outer and an inner perimeter. Heat is conducted along z, by the tables of the material
(conductivity, heat capacity, heat of fusion); the temperature is uniform over a section. Heat leaves by radiation (T^4):

- the top, the outer sides and the ledges between layers of different outlines radiate to the chamber;
- the walls of a channel radiate into each other, and lose heat only through its open top. A wall at the depth z under
  the opening sees it with the view factor (X^2 + 1/2) / sqrt(X^2 + 1) - X, X = z/D, of a ring on the wall of a cylinder
  (Howell, Catalog of Radiation Heat Transfer Configuration Factors, ring on a cylinder to its end), with the hydraulic
  diameter D = 4 area/perimeter of the channel. Reflections make the opening blacker than its walls: it radiates with
  the emissivity 1 / (1 + (1/eps - 1) a/A) of a grey cavity with walls and floor of area A behind an opening of area a
  (Siegel and Howell, Thermal Radiation Heat Transfer). A deep channel of uniform temperature thus loses as much as a black
  disc in its opening; exchange between walls along the channel is neglected. A channel that is closed above loses nothing.

A layer is deposited as metal at chamber temperature, all at once when the layer begins, and absorbs the beam's
heat evenly over the layer's time. The plate is as wide as the lowest layer; it does not radiate, and loses heat only to
a cooled table under it. Time steps are implicit (two stages, second order, Newton), so any step is stable, and the heat
put in equals that stored, passed to the table and radiated, to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.marching import BeadTimes, ColumnFields, bed_temperature_k, driven
from ebamcheck.heat.medium import STEFAN_BOLTZMANN_W_M2K4, EnthalpyTables, enthalpy_tables
from ebamcheck.kernels import Floats, Ints
from ebamcheck.settings.config import Config

LARGEST_CELL_MM = 2.5
"""Largest height of a cell of the column: heat spreads over 20 times as far during a layer of one minute."""

GROWTH = 0.05
"""Largest height of a joined cell of layers below, over its depth under the surface: the temperature field below a heated
surface is the smoother the deeper it is."""

JOINED_FROM_MM = 10.0
"""Depth from which cells are joined."""

NO_TIME: Floats = np.zeros(1)


@dataclass(frozen=True)
class LayerShape:
    """One layer for the balance: thickness, area of metal, outer and inner perimeter, and area of its holes."""

    thickness_mm: float
    area_mm2: float
    outer_mm: float
    inner_mm: float = 0.0
    hole_mm2: float = 0.0

    @classmethod
    def of(cls, section: BaseGeometry, thickness_mm: float) -> LayerShape:
        """Return the shape of a layer from its section; lines and points in the section are ignored."""
        parts = [part for part in shapely.get_parts(section) if part.geom_type == "Polygon"]
        holes = [shapely.Polygon(ring) for part in parts for ring in part.interiors]
        return cls(
            thickness_mm=thickness_mm,
            area_mm2=float(sum(part.area for part in parts)),
            outer_mm=float(sum(part.exterior.length for part in parts)),
            inner_mm=float(sum(hole.exterior.length for hole in holes)),
            hole_mm2=float(sum(hole.area for hole in holes)),
        )


@dataclass(eq=False)
class HeatColumn:
    """The column at one moment of a program; it grows by :meth:`lay`, and time passes by :meth:`advance`.

    `config`: settings: plate, base, chamber and material; `tables`: tables of the material; None: those of the settings'
    material.
    """

    config: Config
    tables: EnthalpyTables | None = None
    absorbed_j: float = 0.0
    base_j: float = 0.0
    radiated_j: float = 0.0
    content: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) heat content of the cells above that at ambient temperature, from the base up, J/mm^3."""
    warm_plate: Floats = field(default_factory=lambda: np.zeros(0))
    """The same for the base plate before the first layer, if it was preheated; empty: it is cold."""
    _cells: Floats = field(default_factory=lambda: np.zeros((5, 0)))
    _top: int = 0
    _under: int = 0
    _fields: ColumnFields | None = None
    """The cells in the form that kernels read; None before there are any."""

    def __post_init__(self) -> None:
        """Use the material of the settings if no tables are given."""
        if self.tables is None:
            self.tables = enthalpy_tables(self.config)

    @property
    def _material(self) -> EnthalpyTables:
        assert self.tables is not None
        return self.tables

    @property
    def edges_mm(self) -> Floats:
        """(n + 1,) borders of the cells, as heights above the base."""
        return np.concatenate([[0.0], np.cumsum(self._cells[0])])

    @property
    def temperature_k(self) -> Floats:
        """(n,) absolute temperatures of the cells."""
        return self._material.temperature(self.content)

    @property
    def surface_k(self) -> float:
        """Mean temperature of the uppermost layer, K; ambient before there is any."""
        if not len(self.content):
            return self._bare_k
        size = self._cells[0, self._top :]
        return float(self._material.temperature(self.content[self._top :]) @ size / size.sum())

    @property
    def _bare_k(self) -> float:
        """Temperature of the bare base plate, before the first layer, K."""
        if not len(self.warm_plate):
            return self.config.process.ambient_temperature_k
        return float(self._material.temperature(self.warm_plate[-1]))

    @property
    def bed_k(self) -> float:
        """Temperature of the metal on which the next bead is laid, K: the warmer of the uppermost layer and the one under it."""
        if self._fields is None:
            return self._bare_k
        return float(bed_temperature_k(self.content, self._fields, self._under, self._top))

    @property
    def mean_rise_k(self) -> float:
        """Mean temperature of the column above ambient, K."""
        if not len(self.content):
            return 0.0
        rise_k = self.temperature_k - self.config.process.ambient_temperature_k
        return float(np.average(rise_k, weights=self._cells[0] * self._cells[1]))

    @property
    def stored_j(self) -> float:
        """Heat in the column above that at ambient temperature."""
        return float((self.content * self._cells[0] * self._cells[1]).sum())

    def copy(self) -> HeatColumn:
        """Return an independent copy of the column."""
        return HeatColumn(
            self.config, self.tables, self.absorbed_j, self.base_j, self.radiated_j,
            self.content.copy(), self.warm_plate, self._cells, self._top, self._under, self._fields,
        )  # fmt: skip

    def lay(self, shape: LayerShape) -> None:
        """Lay a cold layer on top; the first layer also adds the plate under it."""
        if not len(self.content):
            self._stack(LayerShape(self.config.process.base_plate_mm, shape.area_mm2, 0.0))
            if len(self.warm_plate):
                self.content[:] = self.warm_plate
        self._under, self._top = self._top, len(self.content)
        self._stack(shape)
        joined = joined_cells(self._cells[0], self._cells[1], self._cells[4], self._under)
        self._join(joined)
        self._update_fields()

    def lay_plate(self, area_mm2: float) -> None:
        """Make this the column of a bare base plate, whose uppermost cell takes up the heat; no layer may follow."""
        self._stack(LayerShape(self.config.process.base_plate_mm, area_mm2, 0.0))
        self._under = self._top = len(self.content) - 1
        self._update_fields()

    def _update_fields(self) -> None:
        """Compute the radiating surface of each cell, and the fields for the kernels."""
        size, area, outer, inner, hole = self._cells
        surface_mm2 = radiating_mm2(size, area, outer, inner, hole, self.config.material.emissivity)
        process, material = self.config.process, self._material
        self._fields = (
            material.temperature_k,
            material.theta_w_mm,
            material.step_j_mm3,
            size,
            area,
            1e-6 * STEFAN_BOLTZMANN_W_M2K4 * surface_mm2,
            process.ambient_temperature_k,
            process.base == "cooled",
        )

    def _stack(self, shape: LayerShape) -> None:
        count = max(1, math.ceil(shape.thickness_mm / LARGEST_CELL_MM))
        row = [shape.thickness_mm / count, shape.area_mm2, shape.outer_mm, shape.inner_mm, shape.hole_mm2]
        self._cells = np.column_stack([self._cells, np.tile(np.array(row)[:, None], count)])
        self._cells = np.ascontiguousarray(self._cells)
        self.content = np.concatenate([self.content, np.zeros(count)])

    def _join(self, owner: Ints) -> None:
        """Join the cells that have the same owner (n,); volumes, surfaces and heat are kept."""
        if owner[-1] + 1 == len(owner):
            return
        size = np.bincount(owner, self._cells[0])
        volume = self._cells[0] * self._cells[1]
        self.content = np.bincount(owner, self.content * volume) / np.bincount(owner, volume)
        sides = [np.bincount(owner, row * self._cells[0]) / size for row in self._cells[1:]]
        self._cells = np.ascontiguousarray([size, *sides])
        self._top, self._under = int(owner[self._top]), int(owner[self._under])

    def advance(self, duration_s: float, energy_j: float = 0.0) -> None:
        """Let time pass while the uppermost layer takes up heat."""
        if duration_s > 0.0 and self._fields is not None:
            self.drive((NO_TIME, np.array([duration_s]), np.array([energy_j], np.float64)))

    def wait_until(self, bed_k: float, longest_s: float) -> float:
        """Let time pass, in growing steps, until the metal under the next bead is no warmer than `bed_k`; returns the wait, s.

        The wait ends after the step that exceeds `longest_s`.
        """
        return float(self.drive((NO_TIME, NO_TIME, NO_TIME), bed_k, longest_s)[1][0])

    def drive(
        self, beads: BeadTimes, limit_k: float = math.inf, longest_s: float = math.inf
    ) -> tuple[Floats, Floats]:
        """Heat the uppermost layer bead by bead: :meth:`advance` over the time before each bead, then over its own.

        `beads`: time with the beam off before each bead, s, its own time, s, and the energy taken up in it, J; (n,) each;
        `limit_k`: interpass temperature: the wait before a bead ends once the metal under it is no warmer; `longest_s`:
        after a longer wait for one bead the remaining beads are left out.

        Returns `bed_k`, `wait_s`: (n,) temperature of the metal under each bead when the beam arrives, K, and the wait
        before it, s.
        """
        if self._fields is None:
            bed_k = np.full(len(beads[0]), self._bare_k)
            return bed_k, np.where(bed_k > limit_k, math.inf, 0.0)
        counted = np.array([self.absorbed_j, self.base_j, self.radiated_j])
        found = driven(self.content, self._fields, self._under, self._top, beads, limit_k, longest_s, counted)
        self.absorbed_j, self.base_j, self.radiated_j = counted.tolist()
        return found


def radiating_mm2(
    size: Floats, area: Floats, outer: Floats, inner: Floats, hole: Floats, emissivity: float
) -> Floats:
    """Surface (n,) of each cell by which it radiates to the chamber, times its emissivity, mm^2."""
    whole = area + hole
    ledge = np.maximum(whole - np.append(whole[1:], hole[-1:]), 0.0)
    ledge[1:] += np.where(outer[:-1] > 0.0, np.maximum(whole[1:] - whole[:-1], 0.0), 0.0)
    result = emissivity * (outer * size + ledge)
    closed = np.flatnonzero(hole <= 0.0)
    bottom = closed[-1] + 1 if len(closed) else 0
    if bottom < len(size) and emissivity > 0.0:
        open_mm, wall, width = size[bottom:], inner[bottom:], hole[bottom:]
        # The floor is as wide as the channel at its bottom.
        black = 1.0 / (1.0 + (1.0 / emissivity - 1.0) * width[-1] / (wall @ open_mm + width[0]))
        below_mm = np.cumsum(open_mm[::-1])[::-1] - 0.5 * open_mm
        along = below_mm * wall / (4.0 * width)
        seen = (along**2 + 0.5) / np.sqrt(along**2 + 1.0) - along
        result[bottom:] += black * seen * wall * open_mm
    return result


def joined_cells(size: Floats, area: Floats, hole: Floats, under: int) -> Ints:
    """Owner (n,) of each cell after neighbours that are thin for their depth are joined; from `under` on none is.

    Cells beside a step of the outline, or where a channel begins or ends, stay.
    """
    whole, count = area + hole, len(size)
    steps = np.ones(count, np.bool_)
    steps[1:-1] = np.abs(whole[1:-1] - whole[2:]) > GROWTH * area[1:-1]
    steps[1:-1] |= (hole[1:-1] > 0.0) != (hole[2:] > 0.0)
    begins, below, joined = np.zeros(count, np.bool_), 0.0, 0.0
    for i, (mm, step) in reversed(list(enumerate(zip(size.tolist(), steps.tolist(), strict=True)))):
        begins[i] = step or i >= under - 1 or below < JOINED_FROM_MM or joined + mm > GROWTH * below
        joined, below = mm if begins[i] else joined + mm, below + mm
    owner = np.cumsum(begins[::-1])[::-1]
    return np.asarray(owner[0] - owner, np.int64)

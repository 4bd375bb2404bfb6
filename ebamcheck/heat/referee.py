"""The referee: a second heat model, independent of the modes, by explicit finite differences of the heat content.

It has whole cells instead of cut ones, a moving beam instead of heated islands, data that depend on temperature, heat of
fusion, and radiation by T^4. It is slower and coarser in space; it shows the error of what the linear model neglects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.raster import islands_in_cells, oriented_rings
from ebamcheck.heat.enthalpy import EnthalpyTables, enthalpy_tables
from ebamcheck.heat.medium import STEFAN_BOLTZMANN_W_M2K4
from ebamcheck.heat.referee_steps import Beam, Body, Readings, heated_by_beam
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

STABLE = 0.9
"""Time step over the longest stable one."""

HALF = 0.5
"""Share of a cell in the section from which it counts as whole."""


BEAM_SHARE = 0.25
"""Standard deviation of the beam's heat over the width of the bead: 95 % of it falls on the bead."""


@dataclass(frozen=True, eq=False)
class Referee:
    """A section extruded to its base, in box-shaped cells.

    Parameters
    ----------
    origin
        (2,) lower left corner, mm.
    cell_mm
        (3,) width, depth and height of a cell.
    solid
        (rows, columns) whether a vertical column of cells is metal.
    layers
        Number of cells from the surface (index 0) down to the base.
    cooled
        Whether the base is held at the ambient temperature; else it is insulated.
    tables
        Tables of the material.
    radiation_w_mm2k4
        Heat flux that the surface radiates, over T^4 - Ta^4.
    ambient_k
        Temperature of the chamber, and initial temperature.
    sigma_mm
        Standard deviation of the beam's heat.
    boiling_j_mm3
        Heat content at the boiling point: any excess leaves the surface as vapour.
    """

    origin: Floats
    cell_mm: Floats
    solid: Bools
    layers: int
    cooled: bool
    tables: EnthalpyTables
    radiation_w_mm2k4: float
    ambient_k: float
    sigma_mm: float
    boiling_j_mm3: float

    @property
    def longest_step_s(self) -> float:
        """Longest time step: :data:`STABLE` times the longest stable one."""
        rate = 2.0 * self.tables.greatest_diffusivity_mm2_s * float((1.0 / self.cell_mm**2).sum())
        return STABLE / rate

    @property
    def body(self) -> Body:
        """The body in the form that the kernels of the time steps read."""
        return Body(
            self.tables.temperature_k,
            self.tables.theta_w_mm,
            self.tables.step_j_mm3,
            self.solid,
            self.cell_mm,
            self.cooled,
            self.radiation_w_mm2k4,
            self.ambient_k,
            self.boiling_j_mm3,
        )

    def cold(self) -> Floats:
        """Heat content (layers, rows, columns) of a body at the ambient temperature, J/mm^3."""
        return np.zeros((self.layers, *self.solid.shape))

    def stored_j(self, content: Floats) -> float:
        """Heat in the body above that at ambient temperature."""
        return float(content[:, self.solid].sum() * self.cell_mm.prod())

    def reading(self, islands: NDArray[np.object_]) -> tuple[Ints, Ints, Floats]:
        """Cells of the surface that make up islands: first entry of each island (I + 1,), cells, weights."""
        points, (rings, first_ring) = oriented_rings(islands, self.origin, self.cell_mm[:2])
        owner, cell, share = islands_in_cells(points, rings, first_ring, self.solid.shape)
        kept = (share > 0.0) & self.solid.ravel()[cell]
        owner, cell, share = owner[kept], cell[kept], share[kept]
        total = np.bincount(owner, share, len(islands))
        first = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(islands)))])
        return first.astype(np.int64), cell, share / total[owner]


@dataclass(frozen=True, eq=False)
class Verdict:
    """Result of a simulation by the referee.

    Parameters
    ----------
    entry_k
        (I,) mean temperature rise above ambient of each island when the beam enters it; NaN for one without cells.
    content
        Heat content at the end, (layers, rows, columns) J/mm^3.
    absorbed_j, to_base_j, radiated_j, evaporated_j
        Energy balance.
    hottest_k
        Greatest temperature reached.
    """

    entry_k: Floats
    content: Floats
    absorbed_j: float
    to_base_j: float
    radiated_j: float
    evaporated_j: float
    hottest_k: float


def referee(section: BaseGeometry, config: Config, height_mm: float, cell_mm: float) -> Referee:
    """Lay cells of about the given width over a section.

    Raises
    ------
    GeometryError
        If no cell lies in the section.
    """
    x0, y0, x1, y1 = section.bounds
    columns, rows = max(1, round((x1 - x0) / cell_mm)), max(1, round((y1 - y0) / cell_mm))
    depth_mm = max(height_mm, 0.0) + config.process.base_plate_mm
    layers = max(2, round(depth_mm / cell_mm))
    cell = np.array([(x1 - x0) / columns, (y1 - y0) / rows, depth_mm / layers])
    x, y = np.meshgrid(x0 + np.arange(columns) * cell[0], y0 + np.arange(rows) * cell[1])
    boxes = shapely.box(x, y, x + cell[0], y + cell[1])
    solid = shapely.area(shapely.intersection(boxes, section)) >= HALF * cell[0] * cell[1]
    if not solid.any():
        raise GeometryError(f"the section has no room for a cell of {cell_mm:g} mm: give smaller cells")
    tables = enthalpy_tables(config)
    return Referee(
        origin=np.array([x0, y0]),
        cell_mm=cell,
        solid=np.asarray(solid, np.bool_),
        layers=layers,
        cooled=config.process.base == "cooled",
        tables=tables,
        radiation_w_mm2k4=1e-6 * config.material.emissivity * STEFAN_BOLTZMANN_W_M2K4,
        ambient_k=config.process.ambient_temperature_k,
        sigma_mm=BEAM_SHARE * config.process.bead_width_mm,
        boiling_j_mm3=float(tables.heat_content(config.material.boiling_k)),
    )


def judged(
    model: Referee,
    content: Floats,
    lines: Floats,
    begin_s: Floats,
    end_s: Floats,
    power_w: float,
    islands: NDArray[np.object_],
    entered_s: Floats,
    until_s: float,
) -> Verdict:
    """Move a beam along lines, and read the temperature of islands when the beam enters them.

    Parameters
    ----------
    content
        Heat content at the beginning.
    lines
        (V, 4) x0, y0, x1, y1 in the sequence in which they are driven, mm.
    begin_s, end_s
        (V,) times at which the beam is at their ends.
    power_w
        Absorbed power.
    islands
        (I,) polygons.
    entered_s
        (I,) times at which they are read.
    until_s
        End of the simulation.
    """
    first, cells, weights = model.reading(islands)
    readings = np.argsort(entered_s, kind="stable")
    times_s = time_steps(until_s, model.longest_step_s, entered_s)
    state = content.copy()
    path = np.column_stack([lines - np.tile(model.origin, 2), begin_s, end_s])
    entry_k, balance = heated_by_beam(
        state,
        model.body,
        Beam(path, power_w, model.sigma_mm),
        Readings(readings.astype(np.int64), np.asarray(entered_s, np.float64), first, cells, weights),
        times_s,
    )
    entry_k[np.diff(first) == 0] = np.nan
    return Verdict(entry_k, state, *balance.tolist())


def time_steps(until_s: float, longest_s: float, entered_s: Floats) -> Floats:
    """Times (n + 1,) of the steps, from 0 to the end: equally spaced ones, and those at which islands are read.

    An island is read exactly when it is entered: half a step later it would hold heat from its own pass of the beam.
    """
    steps = max(1, math.ceil(until_s / longest_s))
    even = np.linspace(0.0, until_s, steps + 1)
    return np.union1d(even, np.clip(entered_s, 0.0, until_s))

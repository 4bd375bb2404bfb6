"""How much work a job will be, whole or in slabs, worked out from the mesh and the settings in a fraction of a second.

Time and memory are those of the parts that were measured, on a core of 2020s make, and right within a factor of three or so.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import crossing_counts
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.slabs import facet_count, is_binary_stl
from ebamcheck.result import Check, Level
from ebamcheck.settings.config import Config

RUN, CHECK = "run", "check"  # jobs: all the way to a program, or slicing and comparison alone
EVERY = (RUN, CHECK)
HOUSE_SLICERS = 4  # slicers of the house, which a job runs where the settings name none
START_S = 6.0  # start of the interpreter and of the slicers' processes
SLICE_S, COMPARE_S, FIT_S = 3e-6, 8e-6, 3e-5  # time a point and method, a point and pair, and a point
ISLAND_S = 0.012  # time an island of partition, filling and thermal order
BEAD_S = 1.4e-4  # time a millimetre of bead of writing, reading back and laying a program
# Memory of the job itself, of each method's process, of a facet and of a point, each a method
BASE_MB, METHOD_MB, FACET_MB, POINT_MB = 450.0, 250.0, 4e-4, 1e-4
# Islands of an ordinary layer, and fewest and most beads across one (`ebamcheck.scan.islands.lattice`)
ZONES, BEADS_ACROSS = 60, (4, 12)
CUT = 0.3  # islands that the border cuts off, over those that fit along it
SQRT3 = math.sqrt(3.0)


@dataclass(frozen=True)
class Workload:
    """What a job makes, and what it takes; points are those of one exact contour of all layers, and a job without a program has no
    islands."""

    layers: int
    points: int
    islands: int
    bead_mm: float
    time_s: float
    memory_mb: float


def workload(part: Part, heights: Floats, config: Config, job: str) -> Workload:
    """Estimate what a job of a part makes and takes."""
    points = int(crossing_counts(part, heights).sum())
    work = _of_slicing(len(heights), points, len(part.faces), config)
    if job != RUN:
        return work
    area, border = mean_section(part)
    islands = round(len(heights) * islands_of_layer(area, border, config))
    bead_mm = len(heights) * (area / config.process.hatch_spacing_mm + border)
    time_s = work.time_s + FIT_S * points + ISLAND_S * islands + BEAD_S * bead_mm
    return replace(work, islands=islands, bead_mm=bead_mm, time_s=time_s)


def _of_slicing(layers: int, points: int, facets: int, config: Config, slabs: int = 1) -> Workload:
    """What slicing and comparison take, with all facets of a mesh, or of the largest of some slabs, in memory."""
    methods, at_once = _methods(config), min(points, config.slicing.block_points)
    time_s = START_S * slabs + points * (SLICE_S * methods + COMPARE_S * methods * (methods - 1) / 2)
    each_mb = METHOD_MB + FACET_MB * facets
    memory_mb = BASE_MB + _side_by_side(config) * each_mb + POINT_MB * at_once * methods
    return Workload(layers, points, 0, 0.0, time_s, memory_mb)


def mean_section(part: Part) -> tuple[float, float]:
    """Area, mm2, and length of the outline, mm, of the mean section: volume, and area of the sides, over the height."""
    height_mm = float(part.size[2])
    if height_mm <= 0.0:
        return 0.0, 0.0
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    sides = 0.5 * float(np.hypot(normals[:, 0], normals[:, 1]).sum())
    return abs(part.volume) / height_mm, sides / height_mm


def islands_of_layer(area_mm2: float, border_mm: float, config: Config) -> float:
    """Islands of a layer of an area and an outline, those that the border cuts counted as well."""
    if area_mm2 <= 0.0:
        return 0.0
    if config.scan.partition == "whole":
        return 1.0
    width = _width_mm(area_mm2, border_mm, config)
    within_mm2 = max(area_mm2 - border_mm * config.process.bead_width_mm, 0.0)
    return within_mm2 / (0.5 * SQRT3 * width**2) + CUT * border_mm / width


def _width_mm(area_mm2: float, border_mm: float, config: Config) -> float:
    """Width of a cell: that of the settings, else planned as the partition plans it."""
    if config.scan.hexagon_side_mm is not None:
        return SQRT3 * config.scan.hexagon_side_mm
    spacing = config.process.hatch_spacing_mm
    width = SQRT3 * math.sqrt(2.0 * area_mm2 / (3.0 * SQRT3 * ZONES))
    if border_mm > 0.0:
        width = min(width, 2.0 * area_mm2 / border_mm)
    return min(max(round(width / spacing), BEADS_ACROSS[0]), BEADS_ACROSS[1]) * spacing


def machine_memory_mb() -> float:
    """Memory of this machine, MB."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") * 1e-6


def work_checks(work: Workload, config: Config, yes: bool) -> Iterator[Check]:
    """Hold the work against what the settings allow without a question; with `yes` it is told and goes on."""
    limits = config.work
    memory_mb = limits.most_memory_mb or machine_memory_mb()
    for name, what, figure, limit, unit in (
        ("layers", "layers", float(work.layers), float(limits.most_layers), "layers"),
        ("points", "contour points", float(work.points), float(limits.most_points), "points"),
        ("islands", "islands", float(work.islands), float(limits.most_islands), "islands"),
        ("memory", "of memory", work.memory_mb, memory_mb, "MB"),
        ("time", "of computation", work.time_s, limits.most_time_s, "s"),
    ):
        what = what.removesuffix("s") if figure == 1.0 and unit == what.split()[-1] else what
        text = f"{'about ' if name not in ('layers', 'points') else ''}{_amount(figure, unit)} {what}"
        if name == "islands" and not work.islands:
            continue
        if figure <= limit:
            yield Check.preflight(f"work: {name}", "pass", text, figure, limit, unit)
            continue
        setting = {"memory": "most_memory_mb", "time": "most_time_s"}.get(name, f"most_{name}")
        text += f", over {_amount(limit, unit)} (work.{setting})"
        remedy = "give --yes to go on all the same, raise the setting, or take thicker layers or larger cells"
        level: Level = "warning" if yes else "fault"
        yield Check.preflight(f"work: {name}", level, text, figure, limit, unit, remedy, () if yes else EVERY)


def refuse_work(part: Part, heights: Floats, config: Config, yes: bool) -> None:
    """Refuse to slice a part with one slicer where that is more work than the settings allow; the message names figure, limit and
    setting."""
    alone = config.slicing.model_copy(update={"backends": ("",), "witnesses": ()})
    one = config.model_copy(update={"slicing": alone})
    for check in work_checks(workload(part, heights, one, CHECK), config, yes):
        if check.level == "fault":
            raise SettingsError(f"{check.text}: {check.remedy}")


def _amount(figure: float, unit: str) -> str:
    """Write a count, a time or an amount of memory as people say it.

    >>> _amount(1234567.0, "points"), _amount(5400.0, "s"), _amount(95.0, "s"), _amount(2300.0, "MB")
    ('1,234,567', '1.5 hours', '1.6 minutes', '2.3 GB')
    """
    if unit == "s":
        scales = ((3600.0, "hours"), (60.0, "minutes"), (-math.inf, "s"))
        scale, name = next((least, name) for least, name in scales if figure >= least)
        return f"{figure / max(scale, 1.0):.2g} {name}"
    if unit == "MB":
        return f"{figure * 1e-3:.2g} GB" if figure >= 1000.0 else f"{figure:.0f} MB"
    return f"{figure:,.0f}"


# -- slabs -----------------------------------------------------------------------------------------

FACETS_A_SLAB = 4_000_000  # facets of a slab at most where the settings do not say how many slabs there are
MOST_SLABS = 10_000  # as many as the settings allow
COLUMNS_MB = 1.3e-5  # of every facet of the file: two heights and, mostly once, its number


def wanted_slabs(path: Path, config: Config) -> int:
    """Slabs in which a part is checked; 1: whole, as a part is that fits into memory."""
    if config.slicing.slabs is not None:
        return config.slicing.slabs
    if not is_binary_stl(path):
        return 1
    facets, side_by_side = facet_count(path), _side_by_side(config)
    limit_mb = config.work.most_memory_mb or machine_memory_mb()
    if (
        BASE_MB + side_by_side * (METHOD_MB + FACET_MB * facets) <= limit_mb
        and METHOD_MB + FACET_MB * facets <= config.slicing.memory_limit_mb
    ):
        return 1
    # Of what is left of the memory a half: a slab has the facets that span it besides its own.
    room_mb = min(
        (limit_mb - BASE_MB - COLUMNS_MB * facets - side_by_side * METHOD_MB) / (side_by_side + 1),
        config.slicing.memory_limit_mb - METHOD_MB,
    )
    facets_a_slab = min(0.5 * room_mb / FACET_MB, FACETS_A_SLAB)
    return min(math.ceil(facets / facets_a_slab), MOST_SLABS) if facets_a_slab >= 1.0 else 1


def slab_workload(facets: int, most_facets: int, layers: int, points: int, slabs: int, config: Config) -> Workload:
    """Estimate what a check in slabs makes and takes, of a file and its largest slab of so many facets, and points of one exact
    contour of all layers."""
    work = _of_slicing(layers, points, most_facets, config, slabs)
    return replace(work, memory_mb=work.memory_mb + COLUMNS_MB * facets + FACET_MB * most_facets)


def _methods(config: Config) -> int:
    named = len({*config.slicing.backends, *config.slicing.witnesses})
    return named if config.slicing.backends else HOUSE_SLICERS + named


def _side_by_side(config: Config) -> int:
    return min(_methods(config), config.slicing.processes or os.cpu_count() or 1)

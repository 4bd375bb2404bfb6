"""Limits of the checks of layers against mesh, file and record, each with a figure planted just inside and just outside."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import shapely
from command_line import write_stl
from limit_cases import Case, upwards
from parts import box, join

from ebamcheck.checks import consumables
from ebamcheck.checks.mesh_checks import between_check, heights_check, sections_check, solid_check
from ebamcheck.checks.part_file import file_check
from ebamcheck.layers.stack import from_polygons
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import Part
from ebamcheck.program import Check
from ebamcheck.settings.config import Config
from ebamcheck.verification import gates_again, tables_again

CONFIG = Config().changed(layers={"layer_height_mm": 1.5})
CUTS = (np.arange(4) + 0.5) * 1.5


def block(high_mm: float = 6.0) -> Part:
    return box((0, 0, 0), (40, 40, high_mm))


def cut_higher(f: float) -> Check:
    return heights_check(block(), CUTS + f * 1e-3, CONFIG)


def wider(f: float) -> Check:
    section = shapely.box(0, 0, 40.0 + f * 0.25, 40)
    return sections_check(block(), from_polygons(CUTS, [[section]] * 4), CONFIG)


def lower_solid(f: float) -> Check:
    """A part that ends within its last layer: layers add so much to it."""
    part = block(6.0 / (1.0 + f * 0.02))
    return solid_check(part, from_polygons(CUTS, [[shapely.box(0, 0, 40, 40)]] * 4), CONFIG).check


def between(part: Part, **process: float) -> Check:
    """What the layers of a part do not show, judged by other settings."""
    layers = from_polygons(CUTS, [[shapely.box(0, 0, 40, 40)]] * 4)
    return between_check(part, layers, CONFIG.changed(process=process))


def gap_between(f: float) -> Check:
    """A gap of 0.9 mm between two cuts, and the least hole so many times as wide."""
    return between(join(block(2.6), box((0, 0, 3.5), (40, 40, 6))), least_hole_mm=f * 0.9)


def rim_between(f: float) -> Check:
    """A rim of 0.9 mm between two cuts, and the least wall so many times as thick."""
    return between(join(block(), box((-3, -3, 2.6), (43, 43, 3.5))), least_wall_mm=f * 0.9)


def rim_reaching(f: float) -> Check:
    """A rim that reaches so many times as far as sides are uneven."""
    reach = f * 1.5
    return between(
        join(block(), box((-reach, -reach, 2.6), (40 + reach, 40 + reach, 3.5))),
        least_wall_mm=5.0,
        outside_reach_mm=1.5,
    )


@cache
def from_file() -> tuple[tempfile.TemporaryDirectory, Part]:
    folder = tempfile.TemporaryDirectory()
    return folder, load(write_stl(box((0, 0, 0), (10, 10, 100)), Path(folder.name) / "block.stl"))


def stretched(f: float) -> Check:
    """A part higher than in its file, by so much of its size."""
    part = from_file()[1]
    by = f * 1e-4 * float(np.linalg.norm(part.size)) / part.size[2]
    return file_check(replace(part, vertices=part.vertices * (1.0, 1.0, 1.0 + by)), CONFIG)


def said(name: str, same: bool) -> Check:
    return Check(name, bool(same), 0.0, 0.0, "faults", "", "")


def recorded(value: float, off: float) -> Check:
    return said("recorded figures", gates_again._same(value, value + off))


def of_tables(value: float, off: float) -> Check:
    columns = [pd.Series([value]), pd.Series([value + off])]
    return said("tables", tables_again._same(*columns).all())


def of_lengths(f: float) -> Check:
    columns = [pa.table({"x_mm": [value]}) for value in (0.0, f * 1e-6)]
    return said("tables", not tables_again._of_columns("beads.parquet", *columns))


def of_plate(f: float) -> Check:
    return said("parts of the plate", consumables._same(2.0, 2.0 * (1.0 + f * 1e-9)))


def judged(check: str, limits: str, plant) -> Case:
    return upwards(check, limits, plant, judge=lambda found: found)


CASES: tuple[Case, ...] = (
    judged("layers of the part", "checks.PLACE_MM", cut_higher),
    judged("sections of the mesh", "curves.section_tolerance_mm", wider),
    judged("metal of the solid", "process.mass_tolerance", lower_solid),
    judged("between the cuts", "process.least_hole_mm", gap_between),
    judged("between the cuts", "process.least_wall_mm", rim_between),
    judged("between the cuts", "process.outside_reach_mm", rim_reaching),
    judged("part of the file", "checks.SAME_SIZE", stretched),
    judged("recorded figures", "gates_again.SAME_FIGURE", lambda f: recorded(0.0, f * 1e-6)),
    judged("recorded figures", "gates_again.SAME_FIGURE", lambda f: recorded(1e6, f * 1.0)),
    judged("tables", "tables_again.SAME_FIGURE", lambda f: of_tables(1e6, f)),
    judged("tables", "tables_again.NOTHING", lambda f: of_tables(0.0, f * 1e-9)),
    judged("tables", "tables_again.SAME_LENGTH_MM", of_lengths),
    judged("parts of the plate", "consumables.SAME_MASS", of_plate),
)

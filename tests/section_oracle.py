"""Sections as oracles of slicers: by the kit's plain means, and of the corpus as other programs have measured them."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import shapely

from ebamcheck.mesh.part import Part
from ebamcheck.testing.solids import house_rule, section


def exact_section(part: Part, z: float) -> shapely.Geometry:
    """Region of positive winding in the plane z = h + 0."""
    return shapely.union_all(section(part, z, house_rule))


def depth_beyond(found: shapely.Geometry, true: shapely.Geometry, bound_mm: float) -> float:
    """Area by which `found` breaks its promise: true eroded lies in found, found in true dilated."""
    lost = true.buffer(-bound_mm, quad_segs=32).difference(found)
    gained = found.difference(true.buffer(bound_mm, quad_segs=32))
    return float(lost.area + gained.area)


def simple_sections(corpus: Path) -> dict[str, list[dict[str, str]]]:
    """Rows of the corpus's table by file, from below: of sections on whose area and loops all programs agree."""
    by_file = defaultdict(list)
    with (corpus / "REFERENCE.csv").open(newline="", encoding="utf-8") as table:
        for row in csv.DictReader(table):
            if row["simple"] == "1" and (corpus / row["file"]).exists():
                by_file[row["file"]].append(row)
    return {file: sorted(rows, key=lambda row: float(row["z"])) for file, rows in by_file.items()}

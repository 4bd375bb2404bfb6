"""Part: what was read from the file, and whether it is a solid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck_reports import words
from ebamcheck_reports.figures import counted, shown
from ebamcheck_reports.markup import Markup, element, facts, figure, join, paragraph, section, table
from ebamcheck_reports.run_data import RunData

DEFECTS = (
    ("open_edges", "edges with one facet only (a hole in the surface)"),
    ("nonmanifold_edges", "edges with more than two facets"),
    ("inconsistent_edges", "edges whose two facets face opposite ways"),
    ("inside_out_bodies", "closed bodies whose facets face inwards"),
    ("open_bodies", "bodies that do not close"),
    ("duplicate_facets", "facets that occur more than once"),
    ("degenerate_facets", "facets with a repeated corner"),
    ("zero_area_facets", "facets without area"),
)


def render(run: RunData) -> Markup:
    """Say what the part is and which defects it has."""
    part, heights = run.part_of("part"), run.part_of("heights")
    found = part["inspection"]
    return section(
        "part",
        "Part",
        "The mesh must be a closed solid: every edge shared by two facets that face the same way. Good is a part without "
        "open, inconsistent or inside-out places.",
        facts(
            [
                ("file", part["source"]),
                ("name", part["name"]),
                ("SHA-256 of the file", element("code", part["sha256"] or part["mesh_sha256"])),
                ("unit of the file", _unit(part)),
                ("slicing direction", _vector(part["direction"])),
                ("size as placed", join([" × ".join(shown(v) for v in found["size_mm"]), " mm"])),
                ("lowest corner", join(["(", ", ".join(shown(v) for v in found["lower_mm"]), ") mm"])),
                ("volume", figure(found["volume_mm3"], "mm³")),
                ("facets, vertices, bodies", f"{found['facets']}, {found['vertices']}, {found['bodies']}"),
                (
                    "layers",
                    (
                        f"{counted(heights['count'], 'layer')} from z = {shown(heights['first_mm'])} to "
                        f"{shown(heights['last_mm'])} mm, layer height {shown(heights['layer_height_mm'])} mm"
                    ),
                ),
            ]
        ),
        _verdict(found),
        table(
            ("defect", "count"),
            [(what, int(found[key])) for key, what in DEFECTS],
            class_="narrow",
            numbers=("count",),
        ),
        *[paragraph("Note: ", note) for note in found["notes"]],
        paragraph(
            "Layers are counted from 1 at the bottom, as in the tables of the run and in the names of the program's files.",
            class_="small",
        ),
    )


def _verdict(found: dict[str, object]) -> Markup:
    verdict = str(found["verdict"])
    said = join([element("b", verdict), ": ", found["why"], ". ", words.meaning(words.FAULTS, verdict)])
    return element("div", said, class_=f"note {'good' if found['passed'] else 'bad'}")


def _unit(part: Mapping[str, Any]) -> str:
    """Unit, and where it comes from; runs of earlier versions do not tell that."""
    return f"{part['units']} ({part['units_from']})" if "units_from" in part else part["units"]


def _vector(direction: list[float]) -> str:
    named = {(0.0, 0.0, 1.0): "+Z of the file", (0.0, 0.0, -1.0): "−Z of the file", (1.0, 0.0, 0.0): "+X of the file",
             (-1.0, 0.0, 0.0): "−X of the file", (0.0, 1.0, 0.0): "+Y of the file", (0.0, -1.0, 0.0): "−Y of the file"}  # fmt: skip
    numbers = "(" + ", ".join(shown(v) for v in direction) + ")"
    return named.get(tuple(float(v) for v in direction), numbers)  # type: ignore[arg-type]

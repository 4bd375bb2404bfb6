"""Part and slicers: what was read from the file, whether it is a solid, and the methods that cut it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck_reports import words
from ebamcheck_reports.markup import (
    Markup,
    counted,
    element,
    facts,
    figure,
    join,
    paragraph,
    row,
    section,
    shown,
    table,
)
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


def part(run: RunData) -> Markup:
    """Say what the part is and which defects it has."""
    given, heights = run.part_of("part"), run.part_of("heights")
    found = given["inspection"]
    # Runs of earlier versions do not tell where the unit comes from.
    unit = f"{given['units']} ({given['units_from']})" if "units_from" in given else given["units"]
    layers = (
        f"{counted(heights['count'], 'layer')} from z = {shown(heights['first_mm'])} to "
        f"{shown(heights['last_mm'])} mm, layer height {shown(heights['layer_height_mm'])} mm"
    )
    said = (
        element("b", found["verdict"]),
        ": ",
        found["why"],
        ". ",
        words.meaning(words.FAULTS, found["verdict"]),
    )
    rows = [(what, int(found[key])) for key, what in DEFECTS]
    return section(
        "part",
        "Part",
        "The mesh must be a closed solid: every edge shared by two facets that face the same way. Good is a part without "
        "open, inconsistent or inside-out places.",
        facts(
            [
                ("file", given["source"]),
                ("name", given["name"]),
                ("SHA-256 of the file", element("code", given["sha256"] or given["mesh_sha256"])),
                ("unit of the file", unit),
                ("slicing direction", _vector(given["direction"])),
                ("size as placed", f"{' × '.join(shown(v) for v in found['size_mm'])} mm"),
                ("lowest corner", f"({', '.join(shown(v) for v in found['lower_mm'])}) mm"),
                ("volume", figure(found["volume_mm3"], "mm³")),
                ("facets, vertices, bodies", f"{found['facets']}, {found['vertices']}, {found['bodies']}"),
                ("layers", layers),
            ]
        ),
        element("div", join(said), class_=f"note {'good' if found['passed'] else 'bad'}"),
        table(("defect", "count"), rows, class_="narrow", numbers=("count",)),
        *[paragraph("Note: ", note) for note in found["notes"]],
        paragraph(
            "Layers are counted from 1 at the bottom, as in the tables of the run and in the names of the program's files.",
            class_="small",
        ),
    )


def _vector(direction: list[float]) -> str:
    for axis, value in zip("XYZ", direction, strict=True):
        if sorted(map(abs, direction)) == [0.0, 0.0, 1.0] and value:
            return f"{'+' if value > 0 else '−'}{axis} of the file"
    return f"({', '.join(shown(v) for v in direction)})"


# -- slicers ---------------------------------------------------------------------------------------

# What happens to a vertex or face in the plane of a layer, by the rule that a method declares
PLANES = {
    "half-open": "belongs to the layer above the plane, exactly",
    "undefined": "left to rounding; such layers are not compared",
}


def slicers(run: RunData) -> Markup:
    """One row a method, failures before the table."""
    primary = run.manifest.get("primary", "")
    made = paragraph("The program is made from the contours of ", element("b", primary), ".")
    none = paragraph(element("b", "No method found a contour, so no program was made."), class_="note bad")
    ended = ("slicer", "status", "method", "runs on", "kind", "error bound", "rings", "points")
    rules = (
        "slicer",
        "height bound",
        "plane through a vertex or face",
        "what counts as solid",
        "settings",
        "versions",
    )
    return section(
        "slicers",
        "Slicers",
        "The part is cut into layers by several methods that share no code, so that a fault of one is seen against the others. "
        "Good is at least two methods that ran to their end, each with a small promised error.",
        *[_failure(name, record) for name, record in run.backends.items() if record["status"] != "done"],
        made if primary else none,
        table(ended, [_ended(*item) for item in run.backends.items()], class_="slicers", numbers=ended[5:]),
        paragraph(
            "Error bound: the promise of the method, how far its contour may lie from the section of the mesh. Exact methods cut "
            "every facet by arithmetic; sampled ones look at the part along a grid. Times and peak memory stand in timings.json.",
            class_="small",
        ),
        table(rules, [_rules(*item) for item in run.backends.items()], numbers=rules[1:2], class_="onscreen"),
    )


def _failure(name: str, record: Mapping[str, Any]) -> Markup:
    status = record["status"]
    head = element("b", f"{name} {words.meaning(words.STATUS, status)}")
    said = join([head, ": ", record["why"] or "no reason was given"])
    return element("div", said, class_=f"note {'bad' if status in words.LOST else 'warn'}", data_backend=name)


def _ended(name: str, record: Mapping[str, Any]) -> Markup:
    done, kind = record["status"] == "done", "exact" if record["exact"] else "sampled"
    status = element("span", "✔ done" if done else f"✘ {record['status']}", class_="pass" if done else "fail")
    figures = [element("td", class_="number")] * 3
    if done:
        figures = [figure(record["error_bound_mm"], "mm"), figure(record["rings"]), figure(record["points"])]
    cells = (element("b", name), status, record["summary"], record["device"], kind, *figures)
    return row(cells, class_=None if done else "bad")


def _rules(name: str, record: Mapping[str, Any]) -> tuple[Any, ...]:
    plane = words.meaning(PLANES, record["coplanar_rule"])
    settings, versions = _listed(record["settings"]), _listed(record["versions"])
    bound = figure(record["height_bound_mm"], "mm")
    return element("b", name), bound, plane, record["inside_rule"], settings, versions


def _listed(values: Mapping[str, Any]) -> Markup:
    told = [f"{k} = {shown(v) if isinstance(v, float) else v}" for k, v in sorted(values.items())]
    return join(told or ["–"], element("br"))

"""Slicers: the methods that cut the part, their devices, their declared error bounds, and how they ended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck_reports import words
from ebamcheck_reports.figures import shown
from ebamcheck_reports.markup import Markup, element, figure, join, paragraph, section, table
from ebamcheck_reports.run_data import RunData


def render(run: RunData) -> Markup:
    """One row a method, failures before the table."""
    primary = run.manifest.get("primary", "")
    return section(
        "slicers",
        "Slicers",
        "The part is cut into layers by several methods that share no code, so that a fault of one is seen against the others. "
        "Good is at least two methods that ran to their end, each with a small promised error.",
        *[_failure(name, record) for name, record in run.backends.items() if record["status"] != "done"],
        paragraph("The program is made from the contours of ", element("b", primary), ".")
        if primary
        else paragraph(element("b", "No method found a contour, so no program was made."), class_="note bad"),
        table(
            (
                "slicer",
                "status",
                "method",
                "runs on",
                "kind",
                "error bound",
                "rings",
                "points",
            ),
            [_row(name, record) for name, record in run.backends.items()],
            class_="slicers",
            numbers=("error bound", "rings", "points"),
        ),
        paragraph(
            "Error bound: the promise of the method, how far its contour may lie from the section of the mesh. Exact methods cut "
            "every facet by arithmetic; sampled ones look at the part along a grid. Times and peak memory stand in timings.json.",
            class_="small",
        ),
        table(
            (
                "slicer",
                "height bound",
                "plane through a vertex or face",
                "what counts as solid",
                "settings",
                "versions",
            ),
            [_rules(name, record) for name, record in run.backends.items()],
            numbers=("height bound",),
            class_="onscreen",
        ),
    )


def _failure(name: str, record: Mapping[str, Any]) -> Markup:
    status = record["status"]
    said = join(
        [
            element("b", f"{name} {words.meaning(words.STATUS, status)}"),
            ": ",
            record["why"] or "no reason was given",
        ]
    )
    return element("div", said, class_=f"note {'bad' if status in words.LOST else 'warn'}", data_backend=name)


def _row(name: str, record: Mapping[str, Any]) -> Markup:
    done = record["status"] == "done"
    cells: list[Any] = [
        element("b", name),
        element("span", "✔ done" if done else f"✘ {record['status']}", class_="pass" if done else "fail"),
        record["summary"],
        record["device"],
        "exact" if record["exact"] else "sampled",
    ]
    figures: list[Any] = (
        [
            figure(record["error_bound_mm"], "mm"),
            figure(record["rings"]),
            figure(record["points"]),
        ]
        if done
        else ["", "", ""]
    )
    body = [element("td", c) for c in cells] + [element("td", f, class_="number") for f in figures]
    return element("tr", *body, class_=None if done else "bad")


def _rules(name: str, record: Mapping[str, Any]) -> tuple[Any, ...]:
    rule = {
        "half-open": "belongs to the layer above the plane, exactly",
        "undefined": "left to rounding; such layers are not compared",
    }
    return (
        element("b", name),
        figure(record["height_bound_mm"], "mm"),
        words.meaning(rule, record["coplanar_rule"]),
        record["inside_rule"],
        _listed(record["settings"]),
        _listed(record["versions"]),
    )


def _listed(values: Mapping[str, Any]) -> Markup:
    if not values:
        return join(["–"])
    return join(
        (f"{k} = {shown(v) if isinstance(v, float) else v}" for k, v in sorted(values.items())), element("br")
    )

"""Program: files, totals, checks, excerpts, and the path as read back from the text."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.program import read_program
from ebamcheck_reports import check_places, program_picture
from ebamcheck_reports.figures import counted, duration, percent
from ebamcheck_reports.markup import (
    Markup,
    collapsed,
    element,
    facts,
    figure,
    join,
    mark,
    paragraph,
    picture,
    section,
    table,
)
from ebamcheck_reports.run_data import RunData, layer_name
from ebamcheck_reports.sections import preheating

MOST_FILES = 12
EXCERPT_LINES = 40
SHORT_HASH = 16

WHAT = (
    "The path is written as NC text for the machine's control. An independent reader then reads the text back and checks the syntax, the "
    "states of beam and wire, the limits of the machine, and that the path still is the part. Good is every check passed."
)


def render(run: RunData) -> Markup:
    """Totals, checks, files, picture and excerpts."""
    record = run.part_of("program")
    if not record:
        return section("program", "Program", WHAT, paragraph("No program was written.", class_="note bad"))
    return section(
        "program",
        "Program",
        WHAT,
        _status(record),
        _totals(record),
        element("h3", "Checks"),
        paragraph(
            "The section check compares the program with the contours of ",
            element("b", record["witness"]),
            ".",
        ),
        _checks(run),
        *check_places.render(run),
        *preheating.render(run),
        *_kinematics(run),
        element("h3", "Path of one layer as read back from the text"),
        *_picture(run),
        element("h3", "Files"),
        *_files(record),
        *_excerpts(run, record),
    )


def _kinematics(run: RunData) -> list[Markup]:
    """Feed that the axes reach along the contours, compared with a program of one line per contour point."""
    paths = run.part_of("kinematics")
    if not paths:
        return []
    columns = ("contours as", "blocks", "time", "at constant feed", "dips", "least feed", "metal too much")
    rows = [
        (
            {"program": "this program", "polyline": "one line for each contour point"}[name],
            figure(path["blocks"]),
            duration(path["time_s"]),
            duration(path["constant_feed_s"]),
            figure(path["dips"]),
            figure(path["least_share"], text=percent(path["least_share"])),
            figure(path["excess_mm3_per_m"], "mm3/m"),
        )
        for name, path in paths.items()
    ]
    text = (
        "Axes cannot turn a corner at full feed. Where the feed dips under the share of the settings while wire and beam go on, the bead "
        "grows (the paper's Figure 6). Starts and ends of beads are left out."
    )
    return [
        element("h3", "Feed along the contours"),
        paragraph(text),
        table(columns, rows, numbers=columns[1:]),
    ]


def _status(record: Mapping[str, Any]) -> Markup:
    good = bool(record["validated"])
    line = "; VALIDATED" if good else "; NOT VALIDATED"
    said = join(["Every file carries the line ", element("code", line), "."])
    return element("div", said, class_=f"note {'good' if good else 'bad'}")


def _totals(record: Mapping[str, Any]) -> Markup:
    total = record["totals"]
    pause_s = total.get("pause_s", 0.0)  # a run of an earlier version has none
    time = total["deposit_s"] + total["travel_s"] + pause_s
    return facts(
        [
            (
                "time at constant feed",
                figure(time, text=duration(time)),
            ),
            ("of that with beam on", figure(total["deposit_s"], text=duration(total["deposit_s"]))),
            ("of that in rapid moves", figure(total["travel_s"], text=duration(total["travel_s"]))),
            ("of that waiting", figure(pause_s, text=duration(pause_s))),
            ("motions", figure(total["motions"])),
            ("contour path", figure(total["contour_mm"], "mm")),
            ("hatch path", figure(total["hatch_mm"], "mm")),
            ("moves with beam off", figure(total["travel_mm"], "mm")),
            ("wire", figure(total["wire_mm"], "mm")),
            ("mass of the wire", figure(total["wire_kg"], "kg")),
        ]
    )


def _checks(run: RunData) -> Markup:
    rows = [
        element(
            "tr",
            element("td", element("b", c["name"])),
            element("td", figure(c["value"]), class_="number"),
            element("td", figure(c["limit"]), class_="number"),
            element("td", c["unit"]),
            element("td", mark(c["passed"]), class_="result"),
            element("td", c["text"]),
            element("td", element("code", c["where"]) if c["where"] else ""),
            class_=None if c["passed"] else "bad",
        )
        for c in sorted(run.checks, key=lambda c: bool(c["passed"]))
    ]
    return table(
        ("check", "value", "limit", "unit", "result", "in words", "worst or first place"),
        rows,
        class_="checks",
        numbers=("value", "limit"),
    )


def _files(record: Mapping[str, Any]) -> list[Markup]:
    files = record["files"]
    blocks = sum(int(f["blocks"]) for f in files)
    rows = [
        (
            element("code", f["name"]),
            figure(f["blocks"]),
            element("code", f["sha256"][:SHORT_HASH], title=f["sha256"]),
        )
        for f in files[:MOST_FILES]
    ]
    parts = [
        paragraph(
            f"{counted(len(files), 'file')} with {blocks} numbered blocks, in the folder ",
            element("code", "program/"),
            ".",
        ),
        table(
            ("file", "blocks", f"SHA-256 (first {SHORT_HASH} of 64)"),
            rows,
            class_="narrow",
            numbers=("blocks",),
        ),
    ]
    if len(files) > MOST_FILES:
        parts.append(
            paragraph(f"… and {len(files) - MOST_FILES} more; all of them with their hashes are in run.json.")
        )
    return parts


def _subprogram(run: RunData) -> tuple[int, str] | None:
    """Middle layer and the file that holds its path."""
    table_, layer = run.table("program.csv"), run.middle_layer
    if layer is None or "file" not in table_ or layer >= len(table_):
        return None
    return layer, str(table_["file"].iloc[layer])


def _picture(run: RunData) -> list[Markup]:
    chosen = _subprogram(run)
    if chosen is None:
        return [paragraph("There is no path of the middle layer to draw.")]
    layer, file = chosen
    try:
        program = read_program(run.folder.program_folder / file, run.config)
    except InputError as error:
        return [paragraph(f"{file} cannot be read back: {error}", class_="note bad")]
    # A subprogram holds one layer; a program of one file holds them all.
    alone = file != run.part_of("program")["files"][0]["name"]
    svg = program_picture.draw(program, f"path of {file}", None if alone else layer)
    if svg is None:
        return [paragraph(f"{file} commands no motion in the plane.")]
    name = layer_name(layer, float(run.layer_table["height_mm"].iloc[layer]))
    return [element("div", program_picture.key(), picture(svg, f"{file} ({name})."), class_="together")]


def _excerpts(run: RunData, record: Mapping[str, Any]) -> list[Markup]:
    names = [record["files"][0]["name"]] if record["files"] else []
    chosen = _subprogram(run)
    names += [chosen[1]] if chosen and chosen[1] not in names else []
    return [_excerpt(run, name) for name in names]


def _excerpt(run: RunData, name: str) -> Markup:
    path = run.folder.program_folder / name
    if not path.is_file():
        return paragraph(f"{name} is not in the folder any more.", class_="note bad")
    with path.open(encoding="latin-1") as file:
        lines = [line.rstrip("\n") for line in islice(file, EXCERPT_LINES)]
    return collapsed(f"{name}, first {counted(len(lines), 'line')}", element("pre", "\n".join(lines)))

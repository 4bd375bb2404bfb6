"""Program: files, totals, checks, preheating, excerpts, and the path as read back from the text."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.program import read_program
from ebamcheck_reports import program_pictures
from ebamcheck_reports.markup import (
    Markup,
    collapsed,
    counted,
    duration,
    element,
    facts,
    figure,
    figure_duration,
    figure_percent,
    figures_of,
    join,
    legend,
    mark,
    paragraph,
    picture,
    row,
    section,
    table,
)
from ebamcheck_reports.run_data import RunData, layer_name

MOST_FILES, EXCERPT_LINES, SHORT_HASH = 12, 40, 16

WHAT = (
    "The path is written as NC text for the machine's control. An independent reader then reads the text back and checks the syntax, the "
    "states of beam and wire, the limits of the machine, and that the path still is the part. Good is every check passed."
)


def render(run: RunData) -> Markup:
    """Totals, checks, files, picture and excerpts."""
    record = run.part_of("program")
    if not record:
        return section("program", "Program", WHAT, paragraph("No program was written.", class_="note bad"))
    good = bool(record["validated"])
    line = element("code", "; VALIDATED" if good else "; NOT VALIDATED")
    status = join(["Every file carries the line ", line, "."])
    witness = element("b", record["witness"])
    return section(
        "program",
        "Program",
        WHAT,
        element("div", status, class_=f"note {'good' if good else 'bad'}"),
        _totals(record),
        element("h3", "Checks"),
        paragraph("The section check compares the program with the contours of ", witness, "."),
        _checks(run),
        *program_pictures.failed_checks(run),
        *_preheating(run),
        *_kinematics(run),
        element("h3", "Path of one layer as read back from the text"),
        *_picture(run),
        element("h3", "Files"),
        *_files(record),
        *_excerpts(run, record),
    )


def _totals(record: Mapping[str, Any]) -> Markup:
    total = record["totals"]
    pause_s = total.get("pause_s", 0.0)  # a run of an earlier version has none
    lengths = (
        ("motions", "motions", ""),
        ("contour path", "contour_mm", "mm"),
        ("hatch path", "hatch_mm", "mm"),
        ("moves with beam off", "travel_mm", "mm"),
        ("wire", "wire_mm", "mm"),
        ("mass of the wire", "wire_kg", "kg"),
    )
    return facts(
        [
            ("time at constant feed", figure_duration(total["deposit_s"] + total["travel_s"] + pause_s)),
            ("of that with beam on", figure_duration(total["deposit_s"])),
            ("of that in rapid moves", figure_duration(total["travel_s"])),
            ("of that waiting", figure_duration(pause_s)),
            *figures_of(total, lengths),
        ]
    )


def _checks(run: RunData) -> Markup:
    rows = []
    for c in sorted(run.checks, key=lambda c: bool(c["passed"])):
        result, where = element("td", mark(c["passed"]), class_="result"), c["where"]
        cells = (
            element("b", c["name"]),
            figure(c["value"]),
            figure(c["limit"]),
            c["unit"],
            result,
            c["text"],
        )
        rows.append(row((*cells, element("code", where) if where else ""), class_=None if c["passed"] else "bad"))
    columns = ("check", "value", "limit", "unit", "result", "in words", "worst or first place")
    return table(columns, rows, class_="checks", numbers=("value", "limit"))


def _preheating(run: RunData) -> list[Markup]:
    """Scans before layers, the temperature that they reach by the text, and the way of the beam; nothing without preheating."""
    settings, record = run.config.preheat, run.part_of("program")
    if settings.when == "off":
        return []
    names = [str(file["name"]) for file in record["files"]]
    layers = [layer_of_preheat(run.config.machine.program_name, name.rpartition(".")[0]) for name in names]
    scans = [(layer, name) for layer, name in zip(layers, names, strict=True) if layer is not None]
    texts = {check["name"]: str(check["text"]) for check in record["checks"]}
    said = {
        "preheat count": "passes",
        "preheat temperature": "temperature",
        "preheat evenness": "evenness",
        "preheat melting": "under the beam",
    }
    before = ", ".join(str(layer + 1) for layer, _ in scans) or "none"
    beam = f"{settings.current_ma:g} mA at {run.config.process.voltage_kv:g} kV, {settings.spot_mm:g} mm wide, {settings.speed_mm_s:g} mm/s"
    lines = f"{settings.pattern}, {settings.spacing_mm:g} mm apart; then a wait of {settings.soak_s:g} s"
    told = facts(
        [
            ("scans", f"{counted(len(scans), 'subprogram')}, before layer {before}"),
            ("beam", beam),
            ("lines", lines),
            *((name, texts[key]) for key, name in said.items() if key in texts),
        ]
    )
    return [element("h3", "Preheating"), told, *(_preheating_picture(run, scans[0][1]) if scans else [])]


def _preheating_picture(run: RunData, file: str) -> list[Markup]:
    try:
        program = read_program(run.folder.program_folder / file, run.config)
    except InputError as error:
        return [paragraph(f"{file} cannot be read back: {error}", class_="note bad")]
    svg = program_pictures.draw(program, f"way of the beam in {file}")
    if svg is None:
        return []
    caption = f"{file}: the beam preheats, as read back from the text."
    return [element("div", picture(svg, caption), class_="together")]


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
            figure_percent(path["least_share"]),
            figure(path["excess_mm3_per_m"], "mm3/m"),
        )
        for name, path in paths.items()
    ]
    text = (
        "Axes cannot turn a corner at full feed. Where the feed dips under the share of the settings while wire and beam go on, the bead "
        "grows (the paper's Figure 6). Starts and ends of beads are left out."
    )
    head = element("h3", "Feed along the contours")
    return [head, paragraph(text), table(columns, rows, numbers=columns[1:])]


# -- files and their text --------------------------------------------------------------------------


def _files(record: Mapping[str, Any]) -> list[Markup]:
    files = record["files"]
    blocks = sum(int(f["blocks"]) for f in files)
    rows = []
    for f in files[:MOST_FILES]:
        code = element("code", f["sha256"][:SHORT_HASH], title=f["sha256"])
        rows.append((element("code", f["name"]), figure(f["blocks"]), code))
    columns = ("file", "blocks", f"SHA-256 (first {SHORT_HASH} of 64)")
    counts = f"{counted(len(files), 'file')} with {blocks} numbered blocks, in the folder "
    parts = [
        paragraph(counts, element("code", "program/"), "."),
        table(columns, rows, class_="narrow", numbers=("blocks",)),
    ]
    if len(files) > MOST_FILES:
        more = len(files) - MOST_FILES
        parts.append(paragraph(f"… and {more} more; all of them with their hashes are in run.json."))
    return parts


def _subprogram(run: RunData) -> tuple[int, str] | None:
    """Middle layer and the file that holds its path."""
    program, layer = run.table("program.csv"), run.middle_layer
    if layer is None or "file" not in program or layer >= len(program):
        return None
    return layer, str(program["file"].iloc[layer])


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
    svg = program_pictures.draw(program, f"path of {file}", None if alone else layer)
    if svg is None:
        return [paragraph(f"{file} commands no motion in the plane.")]
    name = layer_name(layer, float(run.layer_table["height_mm"].iloc[layer]))
    drawn = picture(svg, f"{file} ({name}).")
    return [element("div", legend(program_pictures.LEGEND), drawn, class_="together")]


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

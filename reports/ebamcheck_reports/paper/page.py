"""``paper.html`` and ``paper.json``; every number of the page is one of the record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import replacing
from ebamcheck.pipeline.run_folder import plain
from ebamcheck_reports.markup import Markup, element, paragraph, section, table
from ebamcheck_reports.pages import page
from ebamcheck_reports.paper import sections
from ebamcheck_reports.paper.job import Reproduction

PAGE, RECORD = "paper.html", "paper.json"

TITLES = (
    ("overview", "Overview"),
    ("timing", "Slicing time (Figure 9)"),
    ("bitmap", "Binary image and contours (Figures 3 to 5)"),
    ("corners", "Split at 140° (Figure 7)"),
    ("polar", "Error of the fit (Figures 10 and 11)"),
    ("partition", "Hexagons and their order (Figure 8)"),
)

STYLE = Markup(
    "td.yes{color:var(--good);font-weight:600}td.no,td.partly{font-weight:600}td.no{color:var(--bad)}"
)


def write(found: Reproduction, folder: Path) -> None:
    """Write both files, whole or not at all."""
    text, record = document(found), as_text(found.record) + "\n"
    with replacing(folder / PAGE) as new_page, replacing(folder / RECORD) as new_record:
        new_page.write_text(text, encoding="utf-8")
        new_record.write_text(record, encoding="utf-8")


def as_text(record: Mapping[str, Any], ensure_ascii: bool = False) -> str:
    """Return the record as strict JSON with sorted keys."""
    return json.dumps(plain(record), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=ensure_ascii)


def document(found: Reproduction) -> str:
    """Build the page."""
    record = found.record
    titles = dict(TITLES)
    parts = [
        _overview(record),
        sections.timing(titles["timing"], record["timing"]),
        sections.bitmap(titles["bitmap"], record, found.pictures["bitmap"]),
        sections.corners(titles["corners"], record, found.pictures["corners"]),
        sections.polar(titles["polar"], record["polar"], found.pictures["polar"]),
        sections.partition(titles["partition"], record, found.pictures["partition"]),
    ]
    main = element("main", *parts)
    return page("ebamcheck: the paper, reproduced", _header(record), main, _footer(record), style=STYLE)


def _header(record: Mapping[str, Any]) -> Markup:
    links = [element("a", title, href=f"#{anchor}") for anchor, title in TITLES]
    return element(
        "header",
        element("h1", "The paper, reproduced"),
        paragraph(
            "The figures and numbers of “Slicing Algorithm and Partition Scanning Strategy for 3D Printing Based on GPU Parallel "
            f"Computing”, made again by ebamcheck {record['ebamcheck']} on stand-in parts, beside the paper's own values."
        ),
        element("nav", *links),
    )


def _overview(record: Mapping[str, Any]) -> Markup:
    rows = [
        element(
            "tr",
            *(element("td", row[key]) for key in ("figure", "paper", "ours")),
            element("td", row["comparable"], class_=row["comparable"]),
            element("td", row["why"]),
        )
        for row in record["comparison"]
    ]
    subject = record["subject"]
    return section(
        "overview",
        "Overview",
        "What the paper shows, what came out here, and whether the two may be set against each other.",
        table(("figure of the paper", "the paper's value", "ours", "comparable?", "why not, or what it proves"), rows),
        paragraph(
            "Figures 3 to 8 are shown on ", element("b", subject["part"]), ". ", subject["about"],
            " The paper publishes no meshes; its times, errors and counts belong to parts that nobody else has.",
        ),
    )  # fmt: skip


def _footer(record: Mapping[str, Any]) -> Markup:
    machine, effort = record["machine"], record["effort"]
    return element(
        "footer",
        paragraph(
            f"Effort: {effort['name']}. Machine: {machine['system']}, {machine['processors']} processors. Every figure is from ",
            element("code", RECORD),
            " beside this page.",
        ),
    )

"""The paper's figures made one after the other; ``paper.html`` and ``paper.json``, in which every number of the page stands."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ebamcheck import __version__
from ebamcheck.atomic_file import replacing
from ebamcheck.json_values import plain
from ebamcheck_reports.markup import (
    Markup,
    counted,
    duration,
    element,
    header,
    page,
    paragraph,
    percent,
    row,
    section,
    shown,
    table,
)
from ebamcheck_reports.paper import layer_figures, polar, published, sections, timing
from ebamcheck_reports.paper.published import Effort, Note

PAGE, RECORD = "paper.html", "paper.json"

TITLES = (
    ("overview", "Overview"),
    ("timing", "Slicing time (Figure 9)"),
    ("bitmap", "Binary image and contours (Figures 3 to 5)"),
    ("corners", "Split at 140° (Figure 7)"),
    ("polar", "Error of the fit (Figures 10 and 11)"),
    ("partition", "Hexagons and their order (Figure 8)"),
)

STYLE = "td.yes{color:var(--good);font-weight:600}td.no,td.partly{font-weight:600}td.no{color:var(--bad)}"


@dataclass(frozen=True)
class Reproduction:
    """Content of ``paper.json``, and the pictures of the page by section."""

    record: dict[str, Any]
    pictures: dict[str, list[Markup]]


def reproduce(effort: Effort, bunny: Path | None, units: str, note: Note) -> Reproduction:
    """Make every figure, beginning with the cheap ones that may fail on a given mesh; figures 3 to 8 on the mesh `bunny`, if
    any."""
    subject = layer_figures.find_subject(bunny, units)
    note(f"figures 3 to 8: {subject.part.name}, layer {subject.layer + 1}")
    found = {
        "bitmap": layer_figures.measure_bitmap(subject),
        "corners": layer_figures.measure_corners(subject),
        "partition": layer_figures.measure_partition(subject),
        "polar": polar.measure(effort, note),
    }
    record: dict[str, Any] = {
        "ebamcheck": __version__,
        "effort": asdict(effort),
        "machine": {"system": platform.platform(), "processors": os.cpu_count()},
        "subject": {
            "part": subject.part.name,
            "about": subject.about,
            "facets": len(subject.part.faces),
            "size_mm": subject.part.size.tolist(),
            "sha256": subject.part.source_sha256 or subject.part.sha256,
        },
        **{name: values for name, (values, _) in found.items()},
        "timing": timing.measure(effort, note),
    }
    keys = ("figure", "paper", "ours", "comparable", "why")
    record["comparison"] = [dict(zip(keys, values, strict=True)) for values in compared(record)]
    return Reproduction(record, {name: pictures for name, (_, pictures) in found.items()})


def compared(record: Mapping[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """For each figure of the paper: its value, ours, whether the two are comparable, and why, or what that proves."""
    claimed = f"{100 * published.CLAIMED_REDUCTION:.1f} %"
    given, found, sizes = (
        record["polar"]["paper"]["reductions"],
        record["partition"],
        record["timing"]["sizes"],
    )
    polyline, fit = published.POLYLINE_ERROR, published.FIT_ERROR
    printed = ", ".join(f"{t:g}" for t in published.TOLERANCES_MM[:4])
    laid = ", ".join(f"{size['tolerance_mm']:g}" for size in sizes[:4])
    return [
        (
            "Figures 3 to 5: binary image and contours",
            "pixel 0.1 mm, layer 0.2 mm; pictures only",
            _our_bitmap(record["bitmap"]),
            "partly",
            "Method, pixel and layer height are the paper's; its mesh is not published, and it gives no accuracy to compare with.",
        ),
        (
            "Figure 7: split at 140°",
            f"{published.CURVE_PARTS} curve parts in layer {published.CURVE_LAYER} of the bunny",
            f"{record['subject']['part']}, {_our_parts(record['corners']['layers'])}",
            "partly",
            ("The rule is the paper's. The count is a property of the part, and of size, pose and mesh of the bunny, which the paper does "
            "not give: an equal number would prove nothing."),
        ),
        (
            "Figure 8: hexagons",
            "a picture; neither d nor L1, L2 are given",
            (f"L1 {shown(found['L1_mm'], 'mm')}, L2 {shown(found['L2_mm'], 'mm')}, d {shown(found['d_mm'], 'mm')}, "
            f"n = {found['n']}: {counted(found['hexagons'], 'hexagon')}"),
            "partly",
            "Rectangle, rule and order are the paper's; its mesh and side d are not published.",
        ),
        (
            "Figure 9: time of 4488 layers",
            f"{published.SLICING_S:g} s (abstract; {published.SLICING_TEXT_S} s in the text), {published.FACETS:,} facets",
            _our_times(sizes[-1]),
            "no",
            f"Another part and another machine: an {published.DEVICE} there, "
            f"{record['timing']['devices'].get(timing.LITERAL) or 'no renderer'} for the stencil here."
            + _reached(record["effort"]),
        ),
        (
            "Section 5.2: arithmetic of the error",
            f"{claimed} less error",
            f"from the paper's own ranges: range {percent(given['range'])}, maximum {percent(given['max'])}",
            "yes",
            f"The two ranges do not by themselves give {claimed}; RMS and mean are not published.",
        ),
        (
            "Figures 10 and 11: error ranges",
            f"({polyline.low_mm:.4f}, {polyline.high_mm:.4f}) → ({fit.low_mm:.4f}, {fit.high_mm:.4f}) mm",
            "; ".join(_our_errors(model) for model in record["polar"]["models"]),
            "no",
            "Other parts; the paper names neither the layer, nor the size of the bunny, nor the tolerance of its reference.",
        ),
        (
            "Section 5.1: tolerances and file sizes",
            f"{printed}, … mm for {published.SIZES_MB[0]:g} .. {published.SIZES_MB[-1]:g} MB",
            f"{laid}, … mm for {sizes[0]['size_mb']:.2f} .. {sizes[-1]['size_mb']:.2f} MB",
            "partly",
            ("In the paper's list 0.4 and 0.8 stand in swapped places: a finer tolerance cannot make the smaller file. The stand-in is shaped to "
            "give files of about these sizes. The paper's MB are 2^20 bytes: 1,483,132 facets make 70.72 of them."),
        ),
    ]  # fmt: skip


def _our_bitmap(found: Mapping[str, Any]) -> str:
    if found["status"] != "done":
        return f"not drawn: {found['why']}"
    return (
        f"{found['width_px']} × {found['height_px']} pixels, {counted(found['rings'], 'contour')}, at most "
        f"{shown(found['depth_mm'], 'mm')} from the exact section"
    )


def _our_parts(layers: list[dict[str, Any]]) -> str:
    return "; ".join(
        f"layer {f['layer']}: {counted(f['curve_parts'], 'curve part')}, {counted(f['straight_parts'], 'straight part')}"
        for f in layers
    )


def _our_times(largest: Mapping[str, Any]) -> str:
    times = [f"{name} {duration(t['total_s'])}" for name, t in largest["times"].items() if t["status"] == "done"]
    return f"{largest['facets']:,} facets: {', '.join(times) or 'no backend is available'}"


def _reached(effort: Mapping[str, Any]) -> str:
    whole = effort["finest_mm"] <= min(published.TOLERANCES_MM)
    return "" if whole else " Here only a smaller file was cut (--full cuts all)."


def _our_errors(model: Mapping[str, Any]) -> str:
    before, fitted = model["polyline"]["polar"], next(iter(model["fits"].values()))
    after = fitted["polar"]
    return (
        f"{model['model']} ({before['low_mm']:.4f}, {before['high_mm']:.4f}) → ({after['low_mm']:.4f}, {after['high_mm']:.4f}) mm, "
        f"RMS {percent(fitted['reductions']['polar']['rms'])} less (on {model['polar_rings']} of {model['layers']} layers)"
    )


# -- the files -------------------------------------------------------------------------------------


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
    drawn = {
        "bitmap": sections.bitmap,
        "corners": sections.corners,
        "polar": sections.polar,
        "partition": sections.partition,
    }
    parts = [
        _overview(record),
        sections.timing(titles["timing"], record["timing"]),
        *(make(titles[name], record[name], found.pictures[name]) for name, make in drawn.items()),
    ]
    head = header(
        "The paper, reproduced",
        "The figures and numbers of “Slicing Algorithm and Partition Scanning Strategy for 3D Printing Based on GPU Parallel "
        f"Computing”, made again by ebamcheck {record['ebamcheck']} on stand-in parts, beside the paper's own values.",
        TITLES,
    )
    machine = record["machine"]
    said = f"Effort: {record['effort']['name']}. Machine: {machine['system']}, {machine['processors']} processors. Every figure is from "
    foot = element("footer", paragraph(said, element("code", RECORD), " beside this page."))
    return page("ebamcheck: the paper, reproduced", head, element("main", *parts), foot, style=STYLE)


def _overview(record: Mapping[str, Any]) -> Markup:
    rows = [
        row(
            (
                *(r[key] for key in ("figure", "paper", "ours")),
                element("td", r["comparable"], class_=r["comparable"]),
                r["why"],
            )
        )
        for r in record["comparison"]
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

"""The table at the top: for each figure of the paper its value, ours, and whether the two are comparable."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck_reports.figures import counted, duration, percent, shown
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.timing import LITERAL

YES, PARTLY, NO = "yes", "partly", "no"


def comparison(record: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows with the keys ``figure, paper, ours, comparable, why``, from the other parts of the record."""
    made = (_bitmap, _corners, _partition, _slicing, _claim, _polar, _tolerances)
    return [
        dict(zip(("figure", "paper", "ours", "comparable", "why"), make(record), strict=True))
        for make in made
    ]


def _bitmap(record: Mapping[str, Any]) -> tuple[str, ...]:
    found = record["bitmap"]
    if found["status"] == "done":
        ours = (
            f"{found['width_px']} × {found['height_px']} pixels, {counted(found['rings'], 'contour')}, at most "
            f"{shown(found['depth_mm'], 'mm')} from the exact section"
        )
    else:
        ours = f"not drawn: {found['why']}"
    return (
        "Figures 3 to 5: binary image and contours",
        "pixel 0.1 mm, layer 0.2 mm; pictures only",
        ours,
        PARTLY,
        "Method, pixel and layer height are the paper's; its mesh is not published, and it gives no accuracy to compare with.",
    )


def _corners(record: Mapping[str, Any]) -> tuple[str, ...]:
    layers = record["corners"]["layers"]
    ours = "; ".join(
        f"layer {f['layer']}: {counted(f['curve_parts'], 'curve part')}, {counted(f['straight_parts'], 'straight part')}"
        for f in layers
    )
    return (
        "Figure 7: split at 140°",
        f"{published.CURVE_PARTS} curve parts in layer {published.CURVE_LAYER} of the bunny",
        f"{record['subject']['part']}, {ours}",
        PARTLY,
        (
            "The rule is the paper's. The count is a property of the part, and of size, pose and mesh of the bunny, which the paper does "
            "not give: an equal number would prove nothing."
        ),
    )


def _partition(record: Mapping[str, Any]) -> tuple[str, ...]:
    found = record["partition"]
    return (
        "Figure 8: hexagons",
        "a picture; neither d nor L1, L2 are given",
        (
            f"L1 {shown(found['L1_mm'], 'mm')}, L2 {shown(found['L2_mm'], 'mm')}, d {shown(found['d_mm'], 'mm')}, "
            f"n = {found['n']}: {counted(found['hexagons'], 'hexagon')}"
        ),
        PARTLY,
        "Rectangle, rule and order are the paper's; its mesh and side d are not published.",
    )


def _slicing(record: Mapping[str, Any]) -> tuple[str, ...]:
    largest = record["timing"]["sizes"][-1]
    renderer = record["timing"]["devices"].get(LITERAL)
    times = {name: t["total_s"] for name, t in largest["times"].items() if t["status"] == "done"}
    ours = ", ".join(f"{name} {duration(s)}" for name, s in times.items()) or "no backend is available"
    reached = (
        ""
        if record["effort"]["finest_mm"] <= min(published.TOLERANCES_MM)
        else " Here only a smaller file was cut (--full cuts all)."
    )
    return (
        "Figure 9: time of 4488 layers",
        f"{published.SLICING_S:g} s (abstract; {published.SLICING_TEXT_S} s in the text), {published.FACETS:,} facets",
        f"{largest['facets']:,} facets: {ours}",
        NO,
        f"Another part and another machine: an {published.DEVICE} there, {renderer or 'no renderer'} for the stencil here.{reached}",
    )


def _claim(record: Mapping[str, Any]) -> tuple[str, ...]:
    given = record["polar"]["paper"]["reductions"]
    return (
        "Section 5.2: arithmetic of the error",
        f"{100 * published.CLAIMED_REDUCTION:.1f} % less error",
        f"from the paper's own ranges: range {percent(given['range'])}, maximum {percent(given['max'])}",
        YES,
        f"The two ranges do not by themselves give {100 * published.CLAIMED_REDUCTION:.1f} %; RMS and mean are not published.",
    )


def _polar(record: Mapping[str, Any]) -> tuple[str, ...]:
    parts = []
    for row in record["polar"]["models"]:
        low, high = (row["polyline"]["polar"][key] for key in ("low_mm", "high_mm"))
        fitted = next(iter(row["fits"].values()))
        after = fitted["polar"]
        parts.append(
            f"{row['model']} ({low:.4f}, {high:.4f}) → ({after['low_mm']:.4f}, {after['high_mm']:.4f}) mm, "
            f"RMS {percent(fitted['reductions']['polar']['rms'])} less (on {row['polar_rings']} of {row['layers']} layers)"
        )
    polyline, fit = published.POLYLINE_ERROR, published.FIT_ERROR
    return (
        "Figures 10 and 11: error ranges",
        f"({polyline.low_mm:.4f}, {polyline.high_mm:.4f}) → ({fit.low_mm:.4f}, {fit.high_mm:.4f}) mm",
        "; ".join(parts),
        NO,
        "Other parts; the paper names neither the layer, nor the size of the bunny, nor the tolerance of its reference.",
    )


def _tolerances(record: Mapping[str, Any]) -> tuple[str, ...]:
    sizes = record["timing"]["sizes"]
    given = ", ".join(f"{s['tolerance_mm']:g}" for s in sizes[:4])
    printed = ", ".join(f"{t:g}" for t in published.TOLERANCES_MM[:4])
    return (
        "Section 5.1: tolerances and file sizes",
        f"{printed}, … mm for {published.SIZES_MB[0]:g} .. {published.SIZES_MB[-1]:g} MB",
        f"{given}, … mm for {sizes[0]['size_mb']:.2f} .. {sizes[-1]['size_mb']:.2f} MB",
        PARTLY,
        (
            "In the paper's list 0.4 and 0.8 stand in swapped places: a finer tolerance cannot make the smaller file. The stand-in is shaped to "
            "give files of about these sizes. The paper's MB are 2^20 bytes: 1,483,132 facets make 70.72 of them."
        ),
    )

"""The sections of the page, each from its part of the record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ebamcheck_reports.charts import Series, log_chart
from ebamcheck_reports.markup import (
    Markup,
    element,
    facts,
    figure,
    figure_percent,
    figures_of,
    join,
    number,
    paragraph,
    percent,
    picture,
    section,
    table,
)
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.timing import REPEAT_UNDER_S

Record = Mapping[str, Any]

# Figures whose reductions are told, each by its name
REDUCTIONS = (("range", "range"), ("max", "maximum"), ("rms", "RMS"), ("mean_abs", "mean absolute"))


# -- Figure 9 --------------------------------------------------------------------------------------


def timing(title: str, record: Record) -> Markup:
    """Times over the sizes, drawn and as a table, and what differs from the paper."""
    given, sizes = record["paper"], record["sizes"]
    names = list(sizes[0]["times"])
    done = [n for n in names if any(s["times"][n]["status"] == "done" for s in sizes)]
    facets = [s["facets"] for s in sizes]
    chart = log_chart(
        [Series(n, facets, [number(s["times"][n]["total_s"]) for s in sizes]) for n in done],
        Series("the paper's last model, on its machine", [given["facets"]], [given["seconds_in_text"]]),
        "facets",
        "seconds for all layers",
    )
    caption = "Both axes are logarithmic. The red dot is the one time that the paper gives in figures."
    return section(
        "timing",
        title,
        f"One part, {record['summary']}, tessellated at the paper's tolerances and cut into {sizes[0]['layers']} layers of 0.2 mm. Times are of "
        "preparing the mesh in memory and slicing it, without reading the file.",
        picture(chart, caption),
        _times(names, sizes),
        *_how_timed(record, sizes[-1]),
        *_differences(given),
    )


def _times(names: Sequence[str], sizes: Sequence[Record]) -> Markup:
    columns = ("tolerance, mm", "facets", "MB", *(f"{n}, s" for n in names))
    rows = []
    for size in sizes:
        megabytes = figure(size["size_mb"], text=f"{size['size_mb']:.2f}")
        times = [_time(size["times"][name]) for name in names]
        rows.append([figure(size["tolerance_mm"]), figure(size["facets"]), megabytes, *times])
    return table(columns, rows, numbers=columns)


def _time(found: Record) -> Markup | str:
    total_s = found["total_s"]
    if found["status"] != "done":
        return str(found["status"])
    return figure(total_s, text=f"{total_s:,.3g}" if total_s < 1000.0 else f"{total_s:,.0f}")


def _how_timed(record: Record, last: Record) -> list[Markup]:
    """Say how many layers each time rests on, and on what it ran."""
    rows = []
    for name, device in record["devices"].items():
        found = last["times"][name]
        measured, figures = f"{found['status']}: {found['why']}", ("", "")
        if found["status"] == "done":
            scaled = "scaled to all" if found["layers"] < last["layers"] else "nothing scaled"
            measured = f"{found['layers']} of {last['layers']} layers, {scaled}"
            figures = (figure(found["prepare_s"], "s"), figure(found["slice_s"], "s"))
        rows.append((name, device, measured, *figures))
    columns = ("method", "runs on", "measured", "preparing", "slicing what was measured")
    return [
        element("h3", f"How the times of the largest file ({last['facets']} facets) were taken"),
        table(columns, rows, numbers=columns[3:]),
        paragraph(
            "“stencil, literal” is the paper's method: for each layer all facets above it are drawn, at 0.1 mm a pixel. It is always measured on "
            "a sample of layers, evenly spread. One run each after a warm-up, the better of two where it took "
            f"less than {REPEAT_UNDER_S:g} s."
        ),
    ]


def _differences(given: Record) -> list[Markup]:
    tolerances = ", ".join(f"{t:g}" for t in given["tolerances_mm"])
    seconds, in_text = figure(given["seconds"], "s"), figure(given["seconds_in_text"], "s")
    low, high = (figure(given["sizes_mb"][k], "MB") for k in (0, -1))
    items = (
        (
            *(
                "The paper's ",
                seconds,
                " (abstract; ",
                in_text,
                " in section 5.1) are for ",
                figure(given["facets"]),
            ),
            *(" facets and ", figure(given["layers"]), f" layers on an {given['device']}."),
        ),
        (
            "That part is not published; this one has the same layers and about the same file sizes, but another section.",
        ),
        (
            *(f"Its tolerances are printed as {tolerances} mm for files of ", low, " to ", high),
            ": 0.4 and 0.8 stand in swapped places, since the sizes rise all the way. Here 0.8 comes before 0.4.",
        ),
        ("Whether the paper's time holds the reading of the file, or the contours, is not said.",),
    )
    head = element("h3", "Why the times are not comparable")
    return [head, element("ul", *(element("li", *item) for item in items))]


# -- Figures 3 to 8 --------------------------------------------------------------------------------


def bitmap(title: str, found: Record, pictures: Sequence[Markup]) -> Markup:
    """Image and contours of one layer."""
    what = (
        "One layer drawn by the paper's stencil method at its pixel (0.1 mm), and the contours that marching squares finds in the image. "
        "Good is a contour within the declared bound of the exact section."
    )
    if found["status"] != "done":
        why = paragraph(f"The image could not be drawn: {found['why']}", class_="note warn")
        return section("bitmap", title, what, why)
    image = join([figure(found["width_px"]), " × ", figure(found["height_px"]), " pixels"])
    points = join([figure(found["points"]), " / ", figure(found["exact_points"])])
    areas = (
        ("black pixels", "black_px", ""),
        ("area of the black pixels", "black_area_mm2", "mm²"),
        ("area within the contours", "contour_area_mm2", "mm²"),
        ("exact area of the mesh's section", "exact_area_mm2", "mm²"),
        ("contours", "rings", ""),
    )
    errors = (("depth of the difference", "depth_mm", "mm"), ("declared bound", "bound_mm", "mm"))
    told = [_layer(found), ("image", image), *figures_of(found, areas)]
    told += [("points of contours / exact section", points), *figures_of(found, errors)]
    caption = (
        "Left: the binary image, black where the ray of the pixel is in the part (Figure 3), with its contours in orange (Figure 5). "
        "Right: its leftmost place enlarged, pixel centres as dots and the contour between them (Figure 4)."
    )
    drawn = picture(element("div", *pictures, class_="beside"), caption)
    return section("bitmap", title, what, facts(told), drawn)


def corners(title: str, record: Record, pictures: Sequence[Markup]) -> Markup:
    """Parts of the contours of the layer shown, and of the largest one where that is another."""
    counts = (
        ("curve parts", "curve_parts", ""),
        ("straight parts", "straight_parts", ""),
        ("places where two parts meet", "splits", ""),
        ("points of the contours", "points", ""),
        ("blocks of NC program", "blocks", ""),
        ("greatest distance of curve and contour", "deviation_mm", "mm"),
    )
    shown = []
    for found, svg in zip(record["layers"], pictures[1:], strict=True):
        caption = f"Parts of layer {found['layer']}. A closed curve without a split is one part."
        shown += [facts([_layer(found), *figures_of(found, counts)]), picture(svg, caption)]
    return section(
        "corners",
        title,
        "A contour splits where the angle between two segments is under 140°, and at the ends of straight runs; what is curved becomes "
        "one spline. (That straight runs end a curve is ebamcheck's reading of the paper's “straight-line part and curved part”.)",
        paragraph(
            f"The paper finds {published.CURVE_PARTS} curve parts in layer {published.CURVE_LAYER} of the bunny, and no sharp point in it."
        ),
        pictures[0],
        *shown,
    )


def partition(title: str, found: Record, pictures: Sequence[Markup]) -> Markup:
    """Hexagons of the largest layer."""
    case = {
        "odd": "odd: as many hexagons along L1",
        "even": "even: one more, so that n is odd",
        "none": "no solid that can be divided",
    }[found["case"]]
    sides = (
        ("short side L1", "L1_mm", "mm"),
        ("long side L2", "L2_mm", "mm"),
        ("direction of L1", "angle_deg", "°"),
        ("side d (planned from area and bead)", "d_mm", "mm"),
    )
    counts = (
        ("hexagons that hold metal, slivers merged", "hexagons", ""),
        ("islands, thin walls included", "islands", ""),
    )
    told = [
        _layer(found),
        *figures_of(found, sides),
        ("round(L1 / d) + 1", join([figure(found["rounded"]), ", ", case])),
        ("n × rows laid over the rectangle", join([figure(found["n"]), " × ", figure(found["rows"])])),
        *figures_of(found, counts),
        ("order", f"{found['order']}: nearest to any processed centroid (section 4.2)"),
        ("covered by beads", figure_percent(found["covered_fraction"])),
    ]
    return section(
        "partition",
        title,
        "The layer of the greatest area, divided by the paper's rule: enclosing rectangle among ten rotations (equation 11), n hexagons of "
        "side d along its short side L1, √3 d apart, and rows of them along L2.",
        facts(told),
        *pictures[:1],
        picture(pictures[1], "Islands in the colour and number of their order, from a random (seeded) first one."),
        paragraph(
            "The rule of the text contradicts the aim of the paper's conclusion: the island nearest to those processed is a neighbour that "
            "is still hot, while the conclusion wants a long time between neighbours.",
            class_="note warn",
        ),
    )  # fmt: skip


def _layer(found: Record) -> tuple[str, Markup]:
    return "layer", join([figure(found["layer"]), ", z = ", figure(found["height_mm"], "mm")])


# -- Figures 10 and 11 -----------------------------------------------------------------------------


def polar(title: str, record: Record, pictures: Sequence[Markup]) -> Markup:
    """Error ranges and reductions: the paper's, and those of each model."""
    captions = (
        "As Figure 10: the place of the greatest polar error on the middle layer of the first model, enlarged.",
        "As Figure 11: polar errors of the outer contour of that layer, fit as written in the paper.",
    )
    return section(
        "polar",
        title,
        "How far the contour of a medium mesh lies from that of a fine one, measured along rays from the centre of the enveloping rectangle, "
        "and how far the fitted curve does. Good is a fit with less error than the polyline that it was made from.",
        element("h3", "The paper's own figures"),
        *_published(record["paper"]),
        element("h3", f"Here: tolerance {record['medium_mm']:g} mm against {record['fine_mm']:g} mm"),
        _errors(record["models"]),
        element("h3", "Reduction of the error by the fit, each figure named"),
        *_reductions(record),
        _finding(record["models"]),
        *map(picture, pictures, captions),
    )


def _published(given: Record) -> list[Markup]:
    stages = (("sliced polyline", "polyline_mm", 0), ("fitted curve", "fit_mm", 1))
    rows = [[name, *map(figure, (*given[key], given["range_mm"][k], given["max_mm"][k]))] for name, key, k in stages]
    reductions = [_percent(given["reductions"][key]) for key in ("low_end", "high_end", "range", "max")]
    columns = ("", "least, mm", "greatest, mm", "range, mm", "maximum, mm")
    claimed = given["claimed_reduction"]
    note = paragraph(
        "The paper calls the reduction ", figure(claimed, text=f"{100 * claimed:.1f} %"), " without saying of what. Its ranges do not "
        "by themselves give that: none of these four does, and it publishes neither RMS nor mean.",
        class_="note warn",
    )  # fmt: skip
    return [table(columns, [*rows, ["reduction", *reductions]], class_="narrow", numbers=columns), note]


def _errors(models: Sequence[Record]) -> Markup:
    columns = ("model", "facets", "measured", "polar least, mm", "polar greatest, mm", "polar RMS, mm",
               "polar mean abs., mm", "normal RMS, mm")  # fmt: skip
    rows = []
    for row in models:
        first: tuple[Any, ...] = (row["model"], figure(row["facets"]))
        stages = [("sliced polyline", row["polyline"]), *((f"fit {n}", f) for n, f in row["fits"].items())]
        for stage, found in stages:
            errors = [figure(found["polar"][f"{key}_mm"]) for key in ("low", "high", "rms", "mean_abs")]
            rows.append((*first, stage, *errors, figure(found["normal"]["rms_mm"])))
            first = ("", "")
    return table(columns, rows, numbers=(columns[1], *columns[3:]))


def _reductions(record: Record) -> list[Markup]:
    columns, given = ("", "fit", "error", *(name for _, name in REDUCTIONS)), record["paper"]["reductions"]
    unknown = figure(None, text="not given")
    known = (_percent(given["range"]), _percent(given["max"]), unknown, unknown)
    rows = [("the paper's bunny", "as written in the paper", "polar", *known)]
    rows += [
        (row["model"], name, kind, *(_percent(values[key]) for key, _ in REDUCTIONS))
        for row in record["models"]
        for name, found in row["fits"].items()
        for kind, values in found["reductions"].items()
    ]
    rings = ", ".join(f"{r['polar_rings']} of {r['layers']} layers of {r['model']}" for r in record["models"])
    note = paragraph(
        f"Negative: the fit has more error. The polar error is defined where every ray meets a contour once: {rings} (outer rings). "
        "The normal distance is defined everywhere, holes included.",
        class_="small",
    )
    return [table(columns, rows, numbers=columns[3:]), note]


def _finding(models: Sequence[Record]) -> Markup:
    """What was found, in one sentence that holds for the figures above it."""
    rms, most = (_extent(models, key) for key in ("rms", "max"))
    return paragraph(
        f"Found: on these models the paper's fit changes the RMS normal error by {rms} and the greatest one by {most} (a reduction is "
        "positive). Nearly all points that it goes through are crossings of the plane with edges of the mesh: they lie on chords of the true "
        "surface, not on it. A curve through points that are in error keeps their error, and removes only the chords between them; how much "
        "that is worth depends on the mesh more than on the fit. Where edges run along the wall (the impeller's round plate, the only part of it "
        "with a polar error) the points are exact, and the fit removes nearly all of the error.",
        class_="note warn",
    )


def _extent(models: Sequence[Record], key: str) -> str:
    """Least and greatest reduction of the normal error by the fit as written, over all models."""
    found = [number(next(iter(row["fits"].values()))["reductions"]["normal"][key]) for row in models]
    known = [value for value in found if math.isfinite(value)]
    return f"{percent(min(known))} to {percent(max(known))}" if known else "an undefined amount"


def _percent(value: Any) -> Markup:
    text = percent(value)
    return figure(value, text="0.00 %" if text == "-0.00 %" else text)

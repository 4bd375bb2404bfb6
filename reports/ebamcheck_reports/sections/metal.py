"""Metal: the metal that the program deposits, layer by layer, against that of the part."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.checks.metal import FIELD_FILE, read_field
from ebamcheck.checks.rules import names_of
from ebamcheck.showing.markup import inline
from ebamcheck_reports import metal_picture
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.figures import percent
from ebamcheck_reports.markup import Markup, element, facts, figure, paragraph, picture, section, table
from ebamcheck_reports.run_data import RunData

QUESTION = (
    "The text of the program is run over a height field: every motion with beam and wire on lays the metal that its wire "
    "speed and feed give, whatever a comment says. Good is as much metal as the part has, where the part is, and flat."
)


def render(run: RunData) -> Markup:
    """Build the section; runs of earlier versions have no table of it."""
    if not (run.folder.path / "deposit.csv").is_file():
        return section(
            "metal", "Metal", QUESTION, paragraph("This run did not weigh its metal.", class_="note")
        )
    layers = run.table("deposit.csv")
    solid = layers[layers["wanted_mm3"] > 0.0]
    checks = [check for check in run.checks if check["name"] in CHECKS]
    rows = [
        element(
            "tr",
            element("td", check["name"]),
            element("td", "pass" if check["passed"] else "FAIL"),
            element("td", check["text"]),
        )
        for check in checks
    ]
    return section(
        "metal",
        "Metal",
        QUESTION,
        _totals(solid),
        table(("check", "", "found"), rows, class_="onscreen"),
        *_worst(run, layers),
        *_charts(solid),
    )


CHECKS = (*names_of("deposit"), "mass balance")
"""Checks of the program that are about its metal."""


def _totals(solid: pd.DataFrame) -> Markup:
    laid, wanted = float(solid["laid_mm3"].sum()), float(solid["wanted_mm3"].sum())
    ratio = (solid["laid_mm3"] / solid["wanted_mm3"]).to_numpy()
    outside = float(solid["outside_mm3"].sum()) / max(laid, 1e-9)
    return facts(
        [
            ("metal over part", figure(laid / max(wanted, 1e-9), text=percent(laid / max(wanted, 1e-9)))),
            (
                "least layer",
                figure(ratio.min(initial=np.inf), text=percent(float(ratio.min(initial=np.inf)))),
            ),
            ("greatest layer", figure(ratio.max(initial=0.0), text=percent(float(ratio.max(initial=0.0))))),
            ("beside the part", figure(outside, text=percent(outside))),
            ("surface too low, at most", figure(float(solid["low_mm"].max()), "mm")),
            ("surface too high, at most", figure(float(solid["high_mm"].max()), "mm")),
        ]
    )


def _worst(run: RunData, layers: pd.DataFrame) -> list[Markup]:
    """Picture of the worst layer with its worst places circled; none for a run of an earlier version."""
    file = run.folder.path / FIELD_FILE
    if not file.is_file():
        return []
    field, layer, thickness_mm = read_field(file)
    found = layers[layers["layer"] == layer + 1].iloc[0]
    name = f"layer {layer + 1}, Z {found['z_mm']:.3f}"
    svg = metal_picture.draw(
        field,
        run.folder.read_layers(run.part_of("program")["witness"]).section(layer),
        thickness_mm,
        run.config.process.largest_unevenness_mm,
        name,
        _places(found, thickness_mm),
    )
    caption = (
        f"The layer that comes nearest to a limit, {name}, as the program's text lays it on those below: its own metal, and the "
        "surface when it is done. Rings mark the places that the checks name."
    )
    return [picture(inline(svg, "paper"), caption, name="metal-worst")]


def _places(
    found: pd.Series[Any], thickness_mm: float
) -> tuple[list[metal_picture.Place], list[metal_picture.Place]]:
    """Worst places of a layer on its metal and on its surface, with their figures."""
    metal = {
        "zone": f"window {found['zone_settled']:.2f} of {thickness_mm:.2f} mm",
        "reach": f"{found['reach_mm']:.2f} mm beside the part",
    }
    surface = {"low": f"{found['low_mm']:.2f} mm too low", "high": f"{found['high_mm']:.2f} mm too high"}

    def placed(names: dict[str, str]) -> list[metal_picture.Place]:
        return [
            (float(found[f"{key}_x_mm"]), float(found[f"{key}_y_mm"]), text)
            for key, text in names.items()
            if np.isfinite(found[f"{key}_x_mm"]) and found.get(f"{key}_mm", 1.0) > 0.0
        ]

    return placed(metal), placed(surface)


def _charts(solid: pd.DataFrame) -> list[Markup]:
    layer = solid["layer"]
    mass = line_chart(
        [
            Series("metal over part", layer, solid["laid_mm3"] / solid["wanted_mm3"]),
            Series("height inside", layer, solid["inside"]),
            Series("height at edges", layer, solid["edge"]),
        ],
        "layer",
        "over that of the part",
    )
    surface = line_chart(
        [
            Series("too high", layer, solid["high_mm"]),
            Series("too low", layer, -solid["low_mm"]),
            Series("reach beside the part", layer, solid["reach_mm"]),
        ],
        "layer",
        "mm",
    )
    return [
        element(
            "figure",
            mass,
            element(
                "figcaption",
                "Metal of each layer, and its mean height further and nearer than a bead width from the border.",
            ),
        ),
        element(
            "figure",
            surface,
            element(
                "figcaption",
                "The surface over and under its height while it is built, and how far metal reaches beside the part.",
            ),
        ),
    ]

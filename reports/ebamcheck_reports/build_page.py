"""The page of a live build: heights planned, measured and corrected, and layers published, verified and refused."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.errors import InputError
from ebamcheck.kernels import Floats
from ebamcheck.live.heights import bead_limits
from ebamcheck.live.heights_table import TABLE, heights_plot, read_heights
from ebamcheck.live.publishing import JOURNAL, LAYERS, SETTINGS, read_certificate, read_journal
from ebamcheck.live.verifying import VerifiedLayer, read_verified
from ebamcheck.settings.config import Config, load_config
from ebamcheck_reports.markup import (
    Markup,
    collapsed,
    counted,
    duration,
    element,
    facts,
    figure,
    page,
    paragraph,
    percent,
    picture,
    section,
    shown,
    table,
)

WHAT_HEIGHTS = (
    "Each layer is planned on the height that was measured under it, and the rest is spread anew, so that the last one ends at the part's "
    "top. Good is a top within half the least layer."
)
WHAT_LAYERS = (
    "Each published layer is a program of its own, which passed every gate before it was published, and can be verified from its text, the part and "
    "its settings alone. Good is every layer verified."
)
WHAT_REFUSED = "Readings that were not used, and layers that were kept back: nothing that is published came from them."

SHORT_HASH = 12


@dataclass(frozen=True, eq=False)
class _Build:
    """Content of the folder of a build."""

    config: Config
    part: dict[str, Any]
    heights: dict[str, Floats]
    certificates: dict[int, dict[str, Any]]
    verified: dict[str, VerifiedLayer]
    entries: list[dict[str, Any]]


def document(folder: Path) -> str:
    """Build the page of the build in a folder; InputError if its journal, a certificate or its table of heights cannot be read."""
    build = _read(folder)
    name = str(build.part["name"])
    main = element("main", _summary(build), _heights(build), _layers(build), _refused(build))
    said = paragraph(f"Folder {folder.name}, by its journal.")
    return page(f"ebamcheck live: {name}", element("header", element("h1", f"Live build of {name}"), said), main)


def _read(folder: Path) -> _Build:
    entries = list(read_journal(folder / JOURNAL))
    names = [str(entry["name"]) for entry in entries if entry.get("kind") == "layer"]
    found = [read_certificate(folder / LAYERS / name) for name in names]
    certificates = {int(certificate["layer"]): certificate for certificate in found}
    if not certificates:
        raise InputError(f"{folder}: no layer was published yet")
    first = certificates[min(certificates)]
    config = load_config(folder / LAYERS / str(first["name"]) / SETTINGS)
    heights = read_heights(folder / TABLE) if (folder / TABLE).is_file() else {}
    return _Build(config, first["part"], heights, certificates, read_verified(folder), entries)


# -- summary -----------------------------------------------------------------------------------------


def _summary(build: _Build) -> Markup:
    grown, thick = build.heights.get("grown_mm", np.zeros(0)), build.heights.get("thickness_mm", np.zeros(0))
    share = grown / thick - 1.0 if grown.size else np.zeros(1)
    growth = f"{percent(float(np.mean(share)))} over the height that was planned, give or take {percent(float(np.std(share)))}"
    tries = Counter(str(entry["code"]) for entry in build.entries if entry.get("kind") == "refused")
    refused = ", ".join(f"{count} {code}" for code, count in sorted(tries.items())) or "nothing"
    time_s = sum(float(c["layer_s"]) + float(c["wait_s"]) for c in build.certificates.values())
    told = facts(
        [
            ("part", f"{build.part['name']}, SHA-256 {str(build.part['sha256'])[:SHORT_HASH]}"),
            ("layers", f"{len(build.certificates)} published, {grown.size} measured"),
            ("growth", growth),
            ("greatest deviation of a layer", shown(_most(build, "deviation_mm"), "mm")),
            ("greatest cusp", shown(_most(build, "cusp_mm"), "mm")),
            ("time of the layers", duration(time_s)),
            ("feed", _feeds(build)),
            ("refused", refused),
        ]
    )
    what = "What was built, how its layers grew, and what came in."
    return section("summary", "Summary", what, _banner(build), told)


def _banner(build: _Build) -> Markup:
    """Whether the top is where it should be, and whether the layers verify from their text; None while the build goes on."""
    tolerance_mm = 0.5 * bead_limits(build.config).least_mm
    passed, said = None, f"The build stands at layer {max(build.certificates)}."
    ended = next((entry for entry in build.entries if entry.get("kind") == "done"), None)
    if ended is not None:
        off_mm = float(ended["off_mm"])
        passed = abs(off_mm) <= tolerance_mm
        said = f"The top came out {off_mm:+.3f} mm off, of {tolerance_mm:.3f} mm (half the least layer)."
    proof = "Nobody has verified its layers from their text yet: ebamcheck verify BUILD --part PART does."
    if build.verified:
        published = {str(found["name"]) for found in build.certificates.values()}
        good = sum(layer.passed for name, layer in build.verified.items() if name in published)
        proof = f"{good} of {len(build.certificates)} published layers verify from their text alone."
        passed = passed and good == len(build.certificates)
    word = {True: "BUILT AND VERIFIED", False: "OUT OF TOLERANCE", None: "GOING ON"}[passed]
    if passed and not build.verified:
        word = "BUILT"
    parts = (element("strong", word), paragraph(said), paragraph(proof))
    return element("div", *parts, class_=f"banner {'good' if passed else 'bad'}")


def _most(build: _Build, column: str) -> float:
    values = np.abs(build.heights.get(column, np.zeros(1)))
    return float(np.nanmax(values)) if values.size else 0.0


def _feed(build: _Build, found: dict[str, Any]) -> Any:
    """Feed of a layer, mm/s, by its certificate or else by the settings."""
    return found.get("travel_speed_mm_s", build.config.process.travel_speed_mm_s)


def _feeds(build: _Build) -> str:
    usual = Counter(float(_feed(build, found)) for found in build.certificates.values())
    told = [f"{speed:g} mm/s in {counted(count, 'layer')}" for speed, count in usual.most_common(3)]
    return ", ".join(told) + (f", {len(usual) - 3} others" if len(usual) > 3 else "")


# -- heights and layers ------------------------------------------------------------------------------


# Columns of the table of heights, by their names on the page
HEIGHTS = {
    "base, mm": "base_mm",
    "planned top, mm": "planned_top_mm",
    "corrected top, mm": "corrected_top_mm",
    "measured top, mm": "measured_top_mm",
    "deviation, mm": "deviation_mm",
    "height, mm": "thickness_mm",
    "as grown, mm": "grown_mm",
    "cusp, mm": "cusp_mm",
}


def _heights(build: _Build) -> Markup:
    if not build.heights:
        return section("heights", "Heights", WHAT_HEIGHTS, paragraph("No layer was measured yet."))
    columns, layers = ("layer", *HEIGHTS), build.heights["layer"]
    rows = [
        (figure(int(layer)), *(_mm(float(build.heights[name][k])) for name in HEIGHTS.values()))
        for k, layer in enumerate(layers)
    ]
    caption = "Heights over the layers: planned at the beginning, corrected when the layer was published, and measured; height, cusp and deviation."
    drawn = picture(Markup(heights_plot(build.heights)), caption)
    listed = collapsed(f"Table of {counted(len(layers), 'layer')}", table(columns, rows, numbers=columns))
    return section("heights", "Heights", WHAT_HEIGHTS, drawn, listed)


def _mm(value: float) -> Any:
    return figure(value, text=f"{value:.3f}") if np.isfinite(value) else "not planned"


def _layers(build: _Build) -> Markup:
    columns = (
        "layer", "program", "SHA-256", "islands", "gates open", "feed, mm/s", "wait, s", "time, s", "from its text",
    )  # fmt: skip
    rows = []
    for layer, found in sorted(build.certificates.items()):
        seen = build.verified.get(str(found["name"]))
        text = "not verified yet"
        if seen is not None:
            text = f"{seen.checks} checks passed" if seen.passed else seen.why
        called, gates = str(found["called"]), found["gates"]
        rows.append(
            (
                figure(layer),
                element("code", called),
                element("code", str(found["files"][called])[:SHORT_HASH]),
                figure(found["islands"]),
                f"{sum(bool(g['passed']) for g in gates)} of {len(gates)}",
                figure(_feed(build, found)),
                figure(found["wait_s"]),
                figure(found["layer_s"]),
                text,
            )
        )
    numbers = ("layer", "islands", "feed, mm/s", "wait, s", "time, s")
    listed = collapsed(f"Table of {counted(len(rows), 'layer')}", table(columns, rows, numbers=numbers))
    return section("layers", "Layers", WHAT_LAYERS, listed)


def _refused(build: _Build) -> Markup:
    kept = [entry for entry in build.entries if entry.get("kind") in ("refused", "kept")]
    rows = [tuple(str(entry.get(key, "")) for key in ("kind", "code", "reason")) for entry in kept]
    none = paragraph("Nothing was refused or kept back.")
    return section("refused", "Refused", WHAT_REFUSED, table(("answer", "code", "reason"), rows) if rows else none)

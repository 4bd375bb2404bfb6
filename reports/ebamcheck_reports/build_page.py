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
from ebamcheck_reports.figures import counted, duration, percent, shown
from ebamcheck_reports.markup import (
    Markup,
    collapsed,
    element,
    facts,
    figure,
    paragraph,
    picture,
    section,
    table,
)
from ebamcheck_reports.pages import page

WHAT_HEIGHTS = (
    "Each layer is planned on the height that was measured under it, and the rest is spread anew, so that the last one ends at the part's "
    "top. Good is a top within half the least layer."
)
WHAT_LAYERS = (
    "Each published layer is a program of its own, which passed every gate before it was published, and can be verified from its text, the part and "
    "its settings alone. Good is every layer verified."
)
WHAT_REFUSED = (
    "Readings that were not used, and layers that were kept back: nothing that is published came from them."
)

SHORT_HASH = 12


@dataclass(frozen=True, eq=False)
class _Build:
    """Content of the folder of a build."""

    folder: Path
    config: Config
    part: dict[str, Any]
    heights: dict[str, Floats]
    certificates: dict[int, dict[str, Any]]
    verified: dict[str, VerifiedLayer]
    entries: list[dict[str, Any]]

    @property
    def ended(self) -> dict[str, Any] | None:
        """Journal entry of the end of the build; None while it goes on."""
        return next((entry for entry in self.entries if entry.get("kind") == "done"), None)


def document(folder: Path) -> str:
    """Build the page of the build in a folder.

    Raises
    ------
    InputError
        If its journal, a certificate or its table of heights cannot be read.
    """
    build = _read(folder)
    name = str(build.part["name"])
    main = element("main", _summary(build), _heights(build), _layers(build), _refused(build))
    head = element(
        "header", element("h1", f"Live build of {name}"), paragraph(f"Folder {folder.name}, by its journal.")
    )
    return page(f"ebamcheck live: {name}", head, main)


def _read(folder: Path) -> _Build:
    entries = list(read_journal(folder / JOURNAL))
    certificates: dict[int, dict[str, Any]] = {}
    for entry in entries:
        if entry.get("kind") == "layer":
            found = read_certificate(folder / LAYERS / str(entry["name"]))
            certificates[int(found["layer"])] = found
    if not certificates:
        raise InputError(f"{folder}: no layer was published yet")
    first = certificates[min(certificates)]
    config = load_config(folder / LAYERS / str(first["name"]) / SETTINGS)
    table_file = folder / TABLE
    heights = read_heights(table_file) if table_file.is_file() else {}
    return _Build(folder, config, first["part"], heights, certificates, read_verified(folder), entries)


# -- summary -----------------------------------------------------------------------------------------


def _summary(build: _Build) -> Markup:
    tolerance_mm = 0.5 * bead_limits(build.config).least_mm
    ended = build.ended
    if ended is None:
        passed, said = None, f"The build stands at layer {max(build.certificates)}."
    else:
        off_mm = float(ended["off_mm"])
        passed = abs(off_mm) <= tolerance_mm
        said = f"The top came out {off_mm:+.3f} mm off, of {tolerance_mm:.3f} mm (half the least layer)."
    good = sum(layer.passed for name, layer in build.verified.items() if name in _names(build))
    if not build.verified:
        proof = "Nobody has verified its layers from their text yet: ebamcheck verify BUILD --part PART does."
    else:
        proof = f"{good} of {len(build.certificates)} published layers verify from their text alone."
        passed = passed and good == len(build.certificates)
    word = {True: "BUILT AND VERIFIED", False: "OUT OF TOLERANCE", None: "GOING ON"}[passed]
    if passed and not build.verified:
        word = "BUILT"
    banner = element(
        "div",
        element("strong", word),
        paragraph(said),
        paragraph(proof),
        class_=f"banner {'good' if passed else 'bad'}",
    )
    grown, thick = build.heights.get("grown_mm", np.zeros(0)), build.heights.get("thickness_mm", np.zeros(0))
    share = grown / thick - 1.0 if grown.size else np.zeros(1)
    tries = Counter(str(entry["code"]) for entry in build.entries if entry.get("kind") == "refused")
    return section(
        "summary",
        "Summary",
        "What was built, how its layers grew, and what came in.",
        banner,
        facts(
            [
                ("part", f"{build.part['name']}, SHA-256 {str(build.part['sha256'])[:SHORT_HASH]}"),
                ("layers", f"{len(build.certificates)} published, {grown.size} measured"),
                (
                    "growth",
                    f"{percent(float(np.mean(share)))} over the height that was planned, give or take {percent(float(np.std(share)))}",
                ),
                ("greatest deviation of a layer", shown(_most(build, "deviation_mm"), "mm")),
                ("greatest cusp", shown(_most(build, "cusp_mm"), "mm")),
                (
                    "time of the layers",
                    duration(
                        sum(float(c["layer_s"]) + float(c["wait_s"]) for c in build.certificates.values())
                    ),
                ),
                ("feed", _feeds(build)),
                (
                    "refused",
                    ", ".join(f"{count} {code}" for code, count in sorted(tries.items())) or "nothing",
                ),
            ]
        ),
    )


def _names(build: _Build) -> set[str]:
    return {str(found["name"]) for found in build.certificates.values()}


def _most(build: _Build, column: str) -> float:
    values = np.abs(build.heights.get(column, np.zeros(1)))
    return float(np.nanmax(values)) if values.size else 0.0


def _feeds(build: _Build) -> str:
    usual = Counter(
        float(c.get("travel_speed_mm_s", build.config.process.travel_speed_mm_s))
        for c in build.certificates.values()
    )
    told = [f"{speed:g} mm/s in {counted(count, 'layer')}" for speed, count in usual.most_common(3)]
    return ", ".join(told) + (f", {len(usual) - 3} others" if len(usual) > 3 else "")


# -- heights and layers ------------------------------------------------------------------------------


def _heights(build: _Build) -> Markup:
    if not build.heights:
        return section("heights", "Heights", WHAT_HEIGHTS, paragraph("No layer was measured yet."))
    svg = Markup(heights_plot(build.heights))
    return section(
        "heights", "Heights", WHAT_HEIGHTS,
        picture(svg, "Heights over the layers: planned at the beginning, corrected when the layer was published, and measured; height, cusp and deviation."),
        collapsed(f"Table of {counted(len(build.heights['layer']), 'layer')}", _table(build)),
    )  # fmt: skip


def _table(build: _Build) -> Markup:
    names = (
        "layer",
        "base",
        "planned top",
        "corrected top",
        "measured top",
        "deviation",
        "height",
        "as grown",
        "cusp",
    )
    columns = (
        "base_mm",
        "planned_top_mm",
        "corrected_top_mm",
        "measured_top_mm",
        "deviation_mm",
        "thickness_mm",
        "grown_mm",
        "cusp_mm",
    )
    rows = [
        (
            figure(int(build.heights["layer"][k])),
            *(_mm(float(build.heights[name][k])) for name in columns),
        )
        for k in range(len(build.heights["layer"]))
    ]
    return table(
        tuple(n if n == "layer" else f"{n}, mm" for n in names),
        rows,
        numbers=tuple(n if n == "layer" else f"{n}, mm" for n in names),
    )


def _mm(value: float) -> Any:
    return figure(value, text=f"{value:.3f}") if np.isfinite(value) else "not planned"


def _layers(build: _Build) -> Markup:
    head = (
        "layer",
        "program",
        "SHA-256",
        "islands",
        "gates open",
        "feed, mm/s",
        "wait, s",
        "time, s",
        "from its text",
    )
    rows = []
    for layer, found in sorted(build.certificates.items()):
        seen = build.verified.get(str(found["name"]))
        text = (
            "not verified yet"
            if seen is None
            else f"{seen.checks} checks passed"
            if seen.passed
            else seen.why
        )
        called = str(found["called"])
        gates = found["gates"]
        rows.append(
            (
                figure(layer), element("code", called), element("code", str(found["files"][called])[:SHORT_HASH]), figure(found["islands"]),
                f"{sum(bool(g['passed']) for g in gates)} of {len(gates)}",
                figure(found.get("travel_speed_mm_s", build.config.process.travel_speed_mm_s)),
                figure(found["wait_s"]), figure(found["layer_s"]), text,
            )
        )  # fmt: skip
    numbers = ("layer", "islands", "feed, mm/s", "wait, s", "time, s")
    return section(
        "layers",
        "Layers",
        WHAT_LAYERS,
        collapsed(f"Table of {counted(len(rows), 'layer')}", table(head, rows, numbers=numbers)),
    )


def _refused(build: _Build) -> Markup:
    rows = [
        (str(entry.get("kind")), str(entry.get("code", "")), str(entry.get("reason", "")))
        for entry in build.entries
        if entry.get("kind") in ("refused", "kept")
    ]
    body = (
        table(("answer", "code", "reason"), rows) if rows else paragraph("Nothing was refused or kept back.")
    )
    return section("refused", "Refused", WHAT_REFUSED, body)

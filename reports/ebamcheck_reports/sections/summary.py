"""Summary: what the run came to, on one page for whoever decides; the sections after it are for whoever asks why."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.errors import InputError
from ebamcheck.record.certificate import CERTIFICATE, RELEASE, read_certificate
from ebamcheck_reports import part_picture, words
from ebamcheck_reports.figures import counted, duration, number, percent, shown
from ebamcheck_reports.markup import Markup, element, facts, figure, join, mark, paragraph, picture, table
from ebamcheck_reports.run_data import RunData

MOST_FINDINGS = 6
"""More would not leave the summary on one page."""

EVENTS = "events.parquet"
"""Every motion of the program with its time and power, as read back."""

JOULES_IN_KWH = 3.6e6
FRACTION = "of the area"

WHAT = (
    "The whole run on one page; what stands behind each line follows below. Good is every gate passed and nothing left to do but "
    "what a person has to."
)
CHECK_WHAT = (
    "The whole check on one page; what stands behind each line follows below. Good is every gate passed."
)


def render(run: RunData) -> Markup:
    """Verdict, picture, figures, gates, findings, and who approves."""
    return element(
        "section",
        element("h2", "Summary"),
        paragraph(CHECK_WHAT if run.is_check else WHAT, class_="what"),
        _verdict(run),
        element("div", _picture(run), _figures(run), class_="halves"),
        _gates(run),
        *_findings(run),
        *([] if run.is_check else _approval(run)),
        id="summary",
    )


def _verdict(run: RunData) -> Markup:
    word = "AGREED" if run.is_check else "VALIDATED"
    shut = [str(gate["name"]) for gate in run.gates if not gate["passed"]] + run.missing_gates
    failed = [str(check["name"]) for check in run.checks if not check["passed"]]
    said = [f"✔ {word}" if run.passed else f"✘ NOT {word}"]
    if shut:
        said.append(f"not passed: {', '.join(shut)}")
    if failed:
        said.append(f"{counted(len(failed), 'check')} failed: {', '.join(failed)}")
    parts = [element("strong", said[0]), *(element("span", text) for text in said[1:])]
    return element("div", *parts, class_=f"banner short {'good' if run.passed else 'bad'}")


def _picture(run: RunData) -> Markup:
    if run.part_of("slabs"):
        return paragraph(
            "The part was checked in slabs: its layers were dropped, and there is no picture of it."
        )
    try:
        layers = run.primary
    except InputError as error:
        return paragraph(f"The part cannot be drawn: {error}", class_="note bad")
    drawn = None if layers is None else part_picture.draw(layers, f"the part {run.part_of('part')['name']}")
    if drawn is None:
        return paragraph("There is no contour to draw the part from.", class_="note bad")
    return picture(drawn, "The part as its layers make it.", name="part")


def _figures(run: RunData) -> Markup:
    """Size, layers, mass, time, energy and wire; a cross-check has the first two."""
    part, heights = run.part_of("part"), run.part_of("heights")
    found = part["inspection"]
    done = [name for name, record in run.backends.items() if record["status"] == "done"]
    rows: list[tuple[str, Any]] = [
        ("part", str(part["source"])),
        ("size", join([" × ".join(shown(v) for v in found["size_mm"]), " mm"])),
        ("layers", f"{heights['count']} of {shown(heights['layer_height_mm'])} mm"),
        ("slicers", f"{len(done)}: {', '.join(done)}"),
        ("layers on which they agree", _agreement(run)),
    ]
    totals = run.part_of("program").get("totals")
    return facts([*rows, *(_of_the_build(run, totals) if totals else [])])


def _agreement(run: RunData) -> str:
    verdicts = run.part_of("comparison").get("verdicts", {})
    return f"{int(verdicts.get('agree', 0))} of {sum(int(n) for n in verdicts.values())}"


def _of_the_build(run: RunData, totals: Mapping[str, Any]) -> list[tuple[str, Any]]:
    pause_s = number(totals.get("pause_s", 0.0))
    time_s = number(totals["deposit_s"]) + number(totals["travel_s"]) + pause_s
    rows: list[tuple[str, Any]] = [
        ("mass of the metal laid", figure(totals["wire_kg"], "kg")),
        ("time", figure(time_s, text=duration(time_s))),
        ("of that with beam on", figure(totals["deposit_s"], text=duration(totals["deposit_s"]))),
        ("of that waiting", figure(pause_s, text=duration(pause_s))),
    ]
    energy_j = beam_energy_j(run.folder.path / EVENTS)
    if energy_j is not None:
        rows.append(("energy of the beam", figure(energy_j, text=f"{energy_j / JOULES_IN_KWH:.4g} kWh")))
    return [*rows, ("wire", figure(totals["wire_mm"], text=f"{number(totals['wire_mm']) / 1000.0:.4g} m"))]


def beam_energy_j(path: Path) -> float | None:
    """Energy that the beam brings: power times time of every motion of the text; None in a run that has no such table."""
    try:
        events = pd.read_parquet(path, columns=["power_w", "time_s"])
    except (OSError, ValueError, KeyError):
        return None
    return float(np.nansum(events["power_w"].to_numpy() * events["time_s"].to_numpy()))


def _gates(run: RunData) -> Markup:
    rows = []
    for gate in run.gates:
        share = gate["unit"] == FRACTION
        told = [percent(gate[k]) if share else shown(gate[k], gate["unit"]) for k in ("figure", "limit")]
        cells = (
            element("b", gate["name"]),
            mark(gate["passed"]),
            figure(gate["figure"], text=told[0]),
            figure(gate["limit"], text=f"{'at least' if share else 'at most'} {told[1]}"),
        )
        rows.append(
            element("tr", *(element("td", c) for c in cells), class_=None if gate["passed"] else "bad")
        )
    for name in run.missing_gates:
        cells_ = (name, "– not reached", "", "")
        rows.append(element("tr", *(element("td", c) for c in cells_), class_="missing"))
    return table(("gate", "result", "measured", "limit"), rows, class_="short")


def _findings(run: RunData) -> list[Markup]:
    """The gravest findings in a line each."""
    listed = [
        element("li", element("b", found["severity"]), ": ", found["text"], *_place(found), *_remedy(found))
        for found in run.findings[:MOST_FINDINGS]
    ]
    if not listed:
        return [paragraph(element("b", "Findings: "), "none.")]
    more = len(run.findings) - len(listed)
    if more:
        listed.append(element("li", f"… and {counted(more, 'finding')} more, under Verdict."))
    return [element("h3", "Findings"), element("ul", *listed, class_="short")]


def _place(found: Mapping[str, Any]) -> list[Markup]:
    return [join([" (", found["place"], ")"])] if found["place"] else []


def _remedy(found: Mapping[str, Any]) -> list[Markup]:
    return [join([" – ", element("i", found["remedy"])])] if found["remedy"] else []


def _approval(run: RunData) -> list[Markup]:
    """Who approves: as the certificate says, or room to write."""
    path = run.folder.path / CERTIFICATE
    release: Mapping[str, Any] = RELEASE
    with suppress(InputError):  # the section of the certificate says what is wrong with it
        release = read_certificate(path)["release"] if path.is_file() else RELEASE
    names = ("part_number", "machine_serial", "approver", "date")
    cells = [_line(name.replace("_", " "), str(release.get(name) or "")) for name in names]
    left = run.statement.left
    todo = [paragraph(element("b", "Left to you: "), "; ".join(left), ".")] if left else []
    return [element("h3", "Approval"), *todo, element("div", *cells, _line("signature", ""), class_="sign")]


def _line(name: str, value: str) -> Markup:
    return element("div", element("span", value or words.BLANK_LINE), element("small", name))

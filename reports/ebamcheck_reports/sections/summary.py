"""Summary and verdict: what the run came to on one page for whoever decides, and if a gate is shut, why."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck.errors import InputError
from ebamcheck.record.certificate import CERTIFICATE, RELEASE, read_certificate
from ebamcheck.record.certificate import counted as counted_by_severity
from ebamcheck.result import in_words
from ebamcheck_reports import part_picture, words
from ebamcheck_reports.markup import (
    Markup,
    counted,
    element,
    facts,
    figure,
    figure_duration,
    mark,
    number,
    paragraph,
    percent,
    picture,
    row,
    shown,
    table,
)
from ebamcheck_reports.run_data import RunData

MOST_FINDINGS = 6  # More would not leave the summary on one page
EVENTS = "events.parquet"  # Every motion of the program with its time and power, as read back

WHAT = (
    "The whole run on one page; what stands behind each line follows below. Good is every gate passed and nothing left to do but "
    "what a person has to."
)
CHECK_WHAT = "The whole check on one page; what stands behind each line follows below. Good is every gate passed."
GATES_WHAT = (
    "Gates stand between the part and the machine. Every one must pass; a gate compares one figure with one limit."
)
CHECK_GATES_WHAT = "Gates stand before the contours; a gate compares one figure with one limit."


def summary(run: RunData) -> Markup:
    """Verdict, picture, figures, gates, findings, and who approves."""
    return element(
        "section",
        element("h2", "Summary"),
        paragraph(CHECK_WHAT if run.is_check else WHAT, class_="what"),
        _short_banner(run),
        element("div", _picture(run), _figures(run), class_="halves"),
        _short_gates(run),
        *_short_findings(run),
        *([] if run.is_check else _approval(run)),
        id="summary",
    )


def _verdict(run: RunData) -> str:
    word = "AGREED" if run.is_check else "VALIDATED"
    return f"✔ {word}" if run.passed else f"✘ NOT {word}"


def _short_banner(run: RunData) -> Markup:
    shut = [str(gate["name"]) for gate in run.gates if not gate["passed"]] + run.missing_gates
    failed = [str(check["name"]) for check in run.checks if not check["passed"]]
    parts = [element("strong", _verdict(run))]
    if shut:
        parts.append(element("span", f"not passed: {', '.join(shut)}"))
    if failed:
        parts.append(element("span", f"{counted(len(failed), 'check')} failed: {', '.join(failed)}"))
    return element("div", *parts, class_=f"banner short {'good' if run.passed else 'bad'}")


def _picture(run: RunData) -> Markup:
    if run.part_of("slabs"):
        return paragraph("The part was checked in slabs: its layers were dropped, and there is no picture of it.")
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
    done = [name for name, record in run.backends.items() if record["status"] == "done"]
    verdicts = run.part_of("comparison").get("verdicts", {})
    rows: list[tuple[str, Any]] = [
        ("part", str(part["source"])),
        ("size", f"{' × '.join(shown(v) for v in part['inspection']['size_mm'])} mm"),
        ("layers", f"{heights['count']} of {shown(heights['layer_height_mm'])} mm"),
        ("slicers", f"{len(done)}: {', '.join(done)}"),
        (
            "layers on which they agree",
            f"{int(verdicts.get('agree', 0))} of {sum(map(int, verdicts.values()))}",
        ),
    ]
    totals = run.part_of("program").get("totals")
    return facts([*rows, *(_of_the_build(run, totals) if totals else [])])


def _of_the_build(run: RunData, totals: Mapping[str, Any]) -> list[tuple[str, Any]]:
    pause_s = number(totals.get("pause_s", 0.0))
    rows: list[tuple[str, Any]] = [
        ("mass of the metal laid", figure(totals["wire_kg"], "kg")),
        ("time", figure_duration(number(totals["deposit_s"]) + number(totals["travel_s"]) + pause_s)),
        ("of that with beam on", figure_duration(totals["deposit_s"])),
        ("of that waiting", figure_duration(pause_s)),
    ]
    energy_j = beam_energy_j(run.folder.path / EVENTS)
    if energy_j is not None:
        rows.append(("energy of the beam", figure(energy_j, text=f"{energy_j / 3.6e6:.4g} kWh")))
    return [*rows, ("wire", figure(totals["wire_mm"], text=f"{number(totals['wire_mm']) / 1000.0:.4g} m"))]


def beam_energy_j(path: Path) -> float | None:
    """Energy that the beam brings: power times time of every motion of the text; None in a run that has no such table."""
    try:
        events = pd.read_parquet(path, columns=["power_w", "time_s"])
    except (OSError, ValueError, KeyError):
        return None
    return float(np.nansum(events["power_w"].to_numpy() * events["time_s"].to_numpy()))


def _measured(gate: Mapping[str, Any]) -> tuple[Markup, Markup]:
    """Figure and limit of a gate; a share of the area must be reached, all others are kept under."""
    share = gate["unit"] == "of the area"
    told = [percent(gate[k]) if share else shown(gate[k], gate["unit"]) for k in ("figure", "limit")]
    limit = f"{'at least' if share else 'at most'} {told[1]}"
    return figure(gate["figure"], text=told[0]), figure(gate["limit"], text=limit)


def _short_gates(run: RunData) -> Markup:
    rows = []
    for gate in run.gates:
        cells = (element("b", gate["name"]), mark(gate["passed"]), *_measured(gate))
        plain = (element("td", cell) for cell in cells)
        rows.append(element("tr", *plain, class_=None if gate["passed"] else "bad"))
    rows += [row((name, "– not reached", "", ""), class_="missing") for name in run.missing_gates]
    return table(("gate", "result", "measured", "limit"), rows, class_="short")


def _short_findings(run: RunData) -> list[Markup]:
    """The gravest findings in a line each."""
    listed = []
    for found in run.findings[:MOST_FINDINGS]:
        place = f" ({found['place']})" if found["place"] else ""
        remedy = (" – ", element("i", found["remedy"])) if found["remedy"] else ()
        listed.append(element("li", element("b", found["severity"]), ": ", found["text"], place, *remedy))
    if not listed:
        return [paragraph(element("b", "Findings: "), "none.")]
    more = len(run.findings) - len(listed)
    if more:
        listed.append(element("li", f"… and {counted(more, 'finding')} more, under Verdict."))
    return [element("h3", "Findings"), element("ul", *listed, class_="short")]


def _approval(run: RunData) -> list[Markup]:
    """Who approves: as the certificate says, or room to write."""
    path = run.folder.path / CERTIFICATE
    release: Mapping[str, Any] = RELEASE
    with suppress(InputError):  # the section of the certificate says what is wrong with it
        release = read_certificate(path)["release"] if path.is_file() else RELEASE
    names = ("part_number", "machine_serial", "approver", "date")
    written = [(name.replace("_", " "), str(release.get(name) or "")) for name in names]
    lines = [  # a blank keeps the height of a line, for writing by hand
        element("div", element("span", value or "\u00a0"), element("small", name))
        for name, value in (*written, ("signature", ""))
    ]
    left = run.statement.left
    todo = [paragraph(element("b", "Left to you: "), "; ".join(left), ".")] if left else []
    return [element("h3", "Approval"), *todo, element("div", *lines, class_="sign")]


# -- the verdict, in full --------------------------------------------------------------------------


def verdict(run: RunData) -> Markup:
    """Draw the banner, the findings and the table of gates."""
    what = paragraph(CHECK_GATES_WHAT if run.is_check else GATES_WHAT, class_="what")
    return element("section", _banner(run), *_findings(run), what, _gates(run), id="verdict")


def _banner(run: RunData) -> Markup:
    code = int(run.manifest["exit_code"])
    # What is left to a person stands in the summary, where it is signed.
    said = [
        paragraph(element("b", f"{head}: "), "; ".join(clauses), ".")
        for head, clauses in run.statement.parts()
        if clauses and (run.is_check or clauses != run.statement.left)
    ]
    ended = f"Exit code {code}: {words.EXIT_CODES.get(code, 'see the documentation of exit codes')}."
    return element(
        "div",
        element("strong", _verdict(run)),
        paragraph(*_why(run)),
        *said,
        paragraph(ended, class_="small"),
        class_=f"banner {'good' if run.passed else 'bad'}",
        role="status",
    )


def _why(run: RunData) -> list[Any]:
    if run.is_check and run.passed:
        return ["The methods agree on every layer. No program was asked for."]
    if run.validated:
        return ["The program in the folder ", element("code", "program/"), " passed every gate."]
    reasons: list[tuple[Any, ...]] = [
        (element("b", gate["name"]), ": ", gate["text"]) for gate in run.gates if not gate["passed"]
    ]
    faults = [found for found in run.findings if found["severity"] == "fault"]
    reasons += [(element("b", found["code"]), ": ", in_words(found)) for found in faults]
    if run.missing_gates:
        reasons.append(("not reached: ", ", ".join(run.missing_gates)))
    if not reasons and not run.is_check:
        reasons.append(("nothing failed, but no program was marked as validated",))
    what = "Do not build from these contours. " if run.is_check else "Do not use this program on a machine. "
    return [what, element("ul", *(element("li", *reason) for reason in reasons))]


def _findings(run: RunData) -> list[Markup]:
    """Every finding, the gravest first."""
    if not run.findings:
        return []
    rows = []
    for found in run.findings:
        known = ["" if found[k] is None else figure(found[k], found["unit"]) for k in ("figure", "limit")]
        cells = (
            element("b", found["severity"]),
            element("code", found["code"]),
            found["text"],
            found["place"],
        )
        numbers = (element("td", value, class_="number") for value in known)
        grade = {"fault": "bad", "warning": "warned"}.get(found["severity"])
        rows.append(row((*cells, *numbers, found["remedy"]), class_=grade, data_finding=found["code"]))
    columns = ("severity", "finding", "what", "where", "figure", "limit", "what to do")
    return [
        element("h3", f"Findings: {counted_by_severity(run.findings)}"),
        table(columns, rows, class_="found", numbers=("figure", "limit")),
    ]


def _gates(run: RunData) -> Markup:
    rows = []
    for gate in run.gates:
        question = words.meaning(words.GATE_QUESTIONS, gate["name"])
        result = element("td", mark(gate["passed"]), class_="result")
        cells: tuple[Any, ...] = (
            element("b", gate["name"]),
            question,
            *_measured(gate),
            result,
            gate["text"],
        )
        rows.append(row(cells, class_=None if gate["passed"] else "bad", data_gate=gate["name"]))
    for name in run.missing_gates:
        cells = (
            name,
            words.GATE_QUESTIONS[name],
            "",
            "",
            "– not reached",
            "There was no contour to go on with.",
        )
        rows.append(row(cells, class_="missing"))
    columns = ("gate", "question", "measured", "limit", "result", "in words")
    return table(columns, rows, class_="gates", numbers=("measured", "limit"))

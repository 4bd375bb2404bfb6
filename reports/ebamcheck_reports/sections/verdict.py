"""Verdict: what is proved, what is left to a person, and if a gate is shut, why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck.record.certificate import counted
from ebamcheck.result import in_words
from ebamcheck_reports import words
from ebamcheck_reports.figures import percent, shown
from ebamcheck_reports.markup import Markup, element, figure, join, mark, paragraph, table
from ebamcheck_reports.run_data import RunData

FRACTION = "of the area"
"""Unit of a gate that is a share and must be reached, not kept under."""

WHAT = "Gates stand between the part and the machine. Every one must pass; a gate compares one figure with one limit."
CHECK_WHAT = "Gates stand before the contours; a gate compares one figure with one limit."


def render(run: RunData) -> Markup:
    """Draw the banner, the findings and the table of gates."""
    return element(
        "section",
        _banner(run),
        *_findings(run),
        paragraph(CHECK_WHAT if run.is_check else WHAT, class_="what"),
        _gates(run),
        id="verdict",
    )


def _banner(run: RunData) -> Markup:
    code = int(run.manifest["exit_code"])
    # What is left to a person stands in the summary, where it is signed.
    said = [
        part for part in run.statement.parts() if part[1] and (run.is_check or part[1] != run.statement.left)
    ]
    return element(
        "div",
        element("strong", _verdict(run)),
        paragraph(*_why(run)),
        *(_said(head, clauses) for head, clauses in said),
        paragraph(
            f"Exit code {code}: {words.EXIT_CODES.get(code, 'see the documentation of exit codes')}.",
            class_="small",
        ),
        class_=f"banner {'good' if run.passed else 'bad'}",
        role="status",
    )


def _verdict(run: RunData) -> str:
    word = "AGREED" if run.is_check else "VALIDATED"
    return f"✔ {word}" if run.passed else f"✘ NOT {word}"


def _why(run: RunData) -> list[Markup]:
    if run.is_check and run.passed:
        return [join(["The methods agree on every layer. No program was asked for."])]
    if run.validated:
        return [join(["The program in the folder ", element("code", "program/"), " passed every gate."])]
    shut = [gate for gate in run.gates if not gate["passed"]]
    reasons = [join([element("b", gate["name"]), ": ", gate["text"]]) for gate in shut]
    faults = [found for found in run.findings if found["severity"] == "fault"]
    reasons += [join([element("b", found["code"]), ": ", in_words(found)]) for found in faults]
    if run.missing_gates:
        reasons.append(join(["not reached: ", ", ".join(run.missing_gates)]))
    if not reasons and not run.is_check:
        reasons.append(join(["nothing failed, but no program was marked as validated"]))
    return [
        join(
            [
                "Do not build from these contours. "
                if run.is_check
                else "Do not use this program on a machine. "
            ]
        ),
        element("ul", *(element("li", r) for r in reasons)),
    ]


def _said(head: str, clauses: tuple[str, ...]) -> Markup:
    return paragraph(element("b", f"{head}: "), "; ".join(clauses), ".")


def _findings(run: RunData) -> list[Markup]:
    """Every finding, the gravest first."""
    if not run.findings:
        return []
    rows = [
        element(
            "tr",
            element("td", element("b", found["severity"])),
            element("td", element("code", found["code"])),
            element("td", found["text"]),
            element("td", found["place"]),
            *(element("td", _figure(found, name), class_="number") for name in ("figure", "limit")),
            element("td", found["remedy"]),
            class_={"fault": "bad", "warning": "warned"}.get(found["severity"]),
            data_finding=found["code"],
        )
        for found in run.findings
    ]
    columns = ("severity", "finding", "what", "where", "figure", "limit", "what to do")
    return [
        element("h3", f"Findings: {counted(run.findings)}"),
        table(columns, rows, class_="found", numbers=("figure", "limit")),
    ]


def _figure(found: Mapping[str, Any], name: str) -> Markup | str:
    value = found[name]
    return "" if value is None else figure(value, found["unit"])


def _gates(run: RunData) -> Markup:
    rows: list[Markup] = [_gate(gate) for gate in run.gates]
    for name in run.missing_gates:
        cells = (
            name,
            words.GATE_QUESTIONS[name],
            "",
            "",
            "– not reached",
            "There was no contour to go on with.",
        )
        rows.append(element("tr", *(element("td", c) for c in cells), class_="missing"))
    return table(
        ("gate", "question", "measured", "limit", "result", "in words"),
        rows,
        class_="gates",
        numbers=("measured", "limit"),
    )


def _gate(gate: Mapping[str, Any]) -> Markup:
    unit = gate["unit"]
    if unit == FRACTION:
        measured, limit = percent(gate["figure"]), f"at least {percent(gate['limit'])}"
    else:
        measured, limit = shown(gate["figure"], unit), f"at most {shown(gate['limit'], unit)}"
    return element(
        "tr",
        element("td", element("b", gate["name"])),
        element("td", words.meaning(words.GATE_QUESTIONS, gate["name"])),
        element("td", figure(gate["figure"], text=measured), class_="number"),
        element("td", figure(gate["limit"], text=limit), class_="number"),
        element("td", mark(gate["passed"]), class_="result"),
        element("td", gate["text"]),
        class_=None if gate["passed"] else "bad",
        data_gate=gate["name"],
    )

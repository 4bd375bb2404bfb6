"""Certificate: what a person signs, and the hashes by which a change after it is found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck.pipeline.certificate import CERTIFICATE, read_certificate
from ebamcheck_reports.markup import (
    Markup,
    collapsed,
    element,
    facts,
    figure,
    mark,
    paragraph,
    section,
    table,
)
from ebamcheck_reports.run_data import RunData

WHAT = (
    "The page to print and sign. It names part, settings, machine profile and every file of the program by its SHA-256, so that ebamcheck "
    "verify finds any byte that was changed since. Good is a certificate whose gates all passed and whose seal verifies. Name, date, "
    "signature and deviations are written by hand, or into certificate.json."
)

BLANK = "_" * 32
"""Room to write by hand."""


def render(run: RunData) -> Markup:
    """Hashes, gates, versions, and room for the approver."""
    path = run.folder.path / CERTIFICATE
    if not path.is_file():
        return section(
            "certificate", "Certificate", WHAT, paragraph("The run wrote no certificate.", class_="note bad")
        )
    found = read_certificate(path)
    return section(
        "certificate",
        "Certificate",
        WHAT,
        facts(
            [
                ("status", mark(bool(found["validated"]))),
                ("control", found["control"]),
                ("curves", f"{found['curve_form']}; {found['spline_convention']}"),
                ("smoothing", _smoothing(found["smoothing"])),
                ("contours by", found["primary"]),
                ("checked against", found["witness"]),
                *_hashes(found),
            ]
        ),
        table(
            ("gate", "result", "figure", "limit", "unit", "what"),
            [
                (g["name"], mark(g["passed"]), figure(g["figure"]), figure(g["limit"]), g["unit"], g["text"])
                for g in found["gates"]
            ],
            numbers=("figure", "limit"),
        ),
        *_findings(found),
        _software(found["software"]),
        collapsed(
            f"SHA-256 of {len(found['programs'])} program files",
            table(
                ("file", "SHA-256"), [(p["name"], element("code", p["sha256"])) for p in found["programs"]]
            ),
        ),
        element("h3", "Approval"),
        facts([(name, found["approver"].get(name) or BLANK) for name in ("name", "date", "signature")]),
        facts([("deviations", "; ".join(map(str, found["deviations"])) or BLANK)]),
    )


def _findings(found: Mapping[str, Any]) -> list[Markup]:
    """What is proved and left to do, and the findings; none in a certificate of an earlier version."""
    said = [
        (head, "; ".join(found[name]))
        for head, name in (("proved", "proved"), ("left to you", "left_to_do"))
        if found.get(name)
    ]
    rows = [
        (f["severity"], element("code", f["code"]), f["text"], f["place"], f["remedy"])
        for f in found.get("findings", [])
    ]
    columns = ("severity", "finding", "what", "where", "what to do")
    return [*([facts(said)] if said else []), *([table(columns, rows)] if rows else [])]


def _hashes(found: Mapping[str, Any]) -> list[tuple[str, Markup]]:
    names = (
        ("part's file", found["part"]["sha256"]),
        ("mesh as placed", found["part"]["mesh_sha256"]),
        ("settings", found["settings_sha256"]),
        ("machine profile", found["profile_sha256"]),
        ("record of the run", found["record_sha256"]),
        ("seal of this certificate", found["seal"]),
    )
    return [(name, element("code", value)) for name, value in names]


def _smoothing(found: Mapping[str, Any]) -> str:
    return f"{' '.join(found['words'])}, {found['tolerance_mm']:g} mm"


def _software(found: Mapping[str, Any]) -> Markup:
    versions = {"ebamcheck": found["ebamcheck"], "Python": found["python"], **found["dependencies"]}
    text = ", ".join(f"{name} {version}" for name, version in versions.items())
    return paragraph(f"Made by {text}" + (f"; commit {found['commit']}." if found.get("commit") else "."))

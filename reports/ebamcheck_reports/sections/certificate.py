"""Certificate: the statement that a person signs, and the hashes that reveal a later change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ebamcheck.record.certificate import CERTIFICATE, RELEASE, certificate, read_certificate
from ebamcheck_reports.markup import (
    Markup,
    collapsed,
    element,
    facts,
    figure,
    join,
    mark,
    paragraph,
    section,
    table,
)
from ebamcheck_reports.run_data import RunData

WHAT = (
    "What certificate.json holds. It names part, settings, machine profile and every file of the run by its SHA-256, so that ebamcheck "
    "verify finds any byte that was changed since. Good is a certificate whose gates all passed, whose seal verifies, and that "
    "somebody you trust has signed: ebamcheck sign adds approver, part number, lots and deviations and signs them, or they are "
    "written on this page by hand."
)

BLANK = "_" * 24
"""Blank line to fill in by hand."""


def render(run: RunData) -> Markup:
    """Hashes, gates, versions, and room for the approver."""
    path = run.folder.path / CERTIFICATE
    found = read_certificate(path) if path.is_file() else certificate(run.manifest)
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
            class_="onscreen",
        ),
        element("div", *_findings(found), class_="onscreen"),
        _software(found["software"]),
        collapsed(
            f"SHA-256 of {len(found['programs'])} program files",
            table(
                ("file", "SHA-256"), [(p["name"], element("code", p["sha256"])) for p in found["programs"]]
            ),
        ),
        element("h3", "Approval"),
        facts([(name.replace("_", " "), BLANK) for name in (*RELEASE, "signature")]),
    )


def _findings(found: Mapping[str, Any]) -> list[Markup]:
    """What is proved, and the findings; none in a certificate of an earlier version. What is left to do stands where it is signed."""
    said = [
        paragraph(element("b", f"{head}: "), "; ".join(found[name]), ".")
        for head, name in (("Proved", "proved"), ("Not proved", "not_proved"))
        if found.get(name)
    ]
    rows = [
        (f["severity"], element("code", f["code"]), f["text"], f["place"], f["remedy"])
        for f in found.get("findings", [])
    ]
    columns = ("severity", "finding", "what", "where", "what to do")
    return [*said, *([table(columns, rows)] if rows else [])]


def _hashes(found: Mapping[str, Any]) -> list[tuple[str, Markup]]:
    names = (
        ("part's file", found["part"]["sha256"]),
        ("mesh as placed", found["part"]["mesh_sha256"]),
        ("settings", found["settings_sha256"]),
        ("machine profile", found["profile_sha256"]),
        ("record of the run", found["record_sha256"]),
    )
    return [(name, element("code", value)) for name, value in names]


def _smoothing(found: Mapping[str, Any]) -> str:
    return f"{' '.join(found['words'])}, {found['tolerance_mm']:g} mm"


def _software(found: Mapping[str, Any]) -> Markup:
    source = found["source"]
    state = {"yes": "changed since", "no": "unchanged"}.get(source["dirty"], "state unknown")
    of_commit = f"commit {source['commit']} ({state})" if source["commit"] else "an installed package"
    text = ", ".join(f"{name} {version}" for name, version in found["dependencies"].items())
    return join(
        [
            paragraph(
                f"Made by ebamcheck {found['ebamcheck']} of {of_commit}, sources ",
                element("code", source["sha256"]),
                f", on {found['python']}, {found['system']}.",
            ),
            collapsed(f"{len(found['dependencies'])} packages", paragraph(text)),
        ]
    )

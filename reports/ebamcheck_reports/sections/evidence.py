"""Certificate and reproduction: the statement that a person signs, the hashes, and how the same run is made again."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import Any

from ebamcheck.record.certificate import CERTIFICATE, RELEASE, read_certificate
from ebamcheck.record.certificate import certificate as certified
from ebamcheck.settings.checking import as_toml
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


def certificate(run: RunData) -> Markup:
    """Hashes, gates, versions, and room for the approver."""
    path = run.folder.path / CERTIFICATE
    found = read_certificate(path) if path.is_file() else certified(run.manifest)
    smoothing, part = found["smoothing"], found["part"]
    hashes = {
        "part's file": part["sha256"],
        "mesh as placed": part["mesh_sha256"],
        "settings": found["settings_sha256"],
        "machine profile": found["profile_sha256"],
        "record of the run": found["record_sha256"],
    }
    gates = [
        (g["name"], mark(g["passed"]), figure(g["figure"]), figure(g["limit"]), g["unit"], g["text"])
        for g in found["gates"]
    ]
    programs = [(p["name"], element("code", p["sha256"])) for p in found["programs"]]
    columns = ("gate", "result", "figure", "limit", "unit", "what")
    return section(
        "certificate",
        "Certificate",
        WHAT,
        facts(
            [
                ("status", mark(bool(found["validated"]))),
                ("control", found["control"]),
                ("curves", f"{found['curve_form']}; {found['spline_convention']}"),
                ("smoothing", f"{' '.join(smoothing['words'])}, {smoothing['tolerance_mm']:g} mm"),
                ("contours by", found["primary"]),
                ("checked against", found["witness"]),
                *((name, element("code", value)) for name, value in hashes.items()),
            ]
        ),
        table(columns, gates, numbers=("figure", "limit"), class_="onscreen"),
        element("div", *_findings(found), class_="onscreen"),
        _software(found["software"]),
        collapsed(f"SHA-256 of {len(programs)} program files", table(("file", "SHA-256"), programs)),
        element("h3", "Approval"),
        facts([(name.replace("_", " "), "_" * 24) for name in (*RELEASE, "signature")]),
    )


def _findings(found: Mapping[str, Any]) -> list[Markup]:
    """What is proved, and the findings; none in a certificate of an earlier version. What is left to do stands where it is
    signed."""
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


def _software(found: Mapping[str, Any]) -> Markup:
    source, packages = found["source"], found["dependencies"]
    state = {"yes": "changed since", "no": "unchanged"}.get(source["dirty"], "state unknown")
    of_commit = f"commit {source['commit']} ({state})" if source["commit"] else "an installed package"
    made = paragraph(
        f"Made by ebamcheck {found['ebamcheck']} of {of_commit}, sources ",
        element("code", source["sha256"]),
        f", on {found['python']}, {found['system']}.",
    )
    text = ", ".join(f"{name} {version}" for name, version in packages.items())
    return join([made, collapsed(f"{len(packages)} packages", paragraph(text))])


def reproduce(run: RunData) -> Markup:
    """Everything needed to make the same run again: command line, settings, versions and hashes."""
    part, reference = run.part_of("part"), run.part_of("reference")
    command = f"ebamcheck run {shlex.quote(part['source'])} --config ebamcheck.toml"
    if reference:
        name = reference["part"]["source"].replace("\\", "/").rsplit("/", 1)[-1]
        command += f" --reference {shlex.quote(name)}"
    settings = json.dumps(run.manifest["settings"], indent=2, sort_keys=True)
    return section(
        "reproduce",
        "Reproduce",
        "The same part, settings and versions give the same files, byte for byte; when the run was made and how long each stage took stands in timings.json. Good is a run whose hashes match these.",
        paragraph("Save the settings below as ", element("code", "ebamcheck.toml"), " and run"),
        element("pre", command),
        facts(
            [
                ("ebamcheck", run.manifest["ebamcheck"]),
                ("Python", run.manifest["python"]),
                ("SHA-256 of the part's file", element("code", part["sha256"])),
                ("SHA-256 of the mesh as placed", element("code", part["mesh_sha256"])),
                ("SHA-256 of the settings", element("code", run.manifest["settings_sha256"])),
            ]
        ),
        collapsed("Settings as ebamcheck.toml", element("pre", as_toml(run.config))),
        collapsed("Settings as run.json holds them", element("pre", settings)),
    )

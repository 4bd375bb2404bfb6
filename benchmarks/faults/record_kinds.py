"""Faults of what a program and its run say of themselves: headers, record, certificate."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.faults.kinds import LINUXCNC, PLAIN, SINUMERIK, Ground, NotHereError, Place, kind

HEX = "0123456789abcdef"


def _header_line(ground: Ground, key: str) -> tuple[str, int]:
    lines = ground.text.files[ground.text.main]
    for i, line in enumerate(lines):
        if line.startswith(f"; {key}"):
            return ground.text.main, i
    raise NotHereError


def _status(ground: Ground, file: str) -> int:
    """Line of the status of a file that is validated."""
    lines = ground.text.files[file]
    if "; VALIDATED" not in lines:
        raise NotHereError
    return lines.index("; VALIDATED")


@kind(
    "header says not validated",
    "record",
    {SINUMERIK: ("every file", "one file"), LINUXCNC: ("every file",), PLAIN: ("every file",)},
    unseen="whether a program was validated is no property of its text: one from `post` says so rightly until a run proves it, and nobody runs it",
    unseen_variants=("every file",),
    in_comments=True,
)
def not_validated(ground: Ground) -> list[Place]:
    """Change the status of files."""
    text = ground.text
    files = list(text.files) if ground.variant == "every file" else [ground.pick(list(text.files))]
    places = []
    for file in files:
        i = _status(ground, file)
        text.files[file][i] = "; NOT VALIDATED"
        places += ground.line(file, i)
    ground.what = f"NOT VALIDATED in {ground.variant}"
    return places


@kind("header without a status", "record", in_comments=True)
def no_status(ground: Ground) -> list[Place]:
    """Take the status out."""
    text = ground.text
    file = ground.pick(list(text.files))
    i = _status(ground, file)
    text.files[file][i] = "; RELEASED"
    ground.what = "no status"
    return ground.line(file, i)


@kind(
    "header of another run",
    "record",
    ("PART SHA-256", "SETTINGS SHA-256", "LAYERS", "CONTROL", "BEAM", "WIRE", "COORDINATES", "CURVES", "SMOOTHING", "MACHINE"),
    in_comments=True,
    unseen="who verifies a text alone may give other settings than those that it was made with: the check tells it, and is no fault",
    unseen_variants=("SETTINGS SHA-256",),
)  # fmt: skip
def other_header(ground: Ground) -> list[Place]:
    """Change a line of the header."""
    if ground.variant == "SMOOTHING" and ground.text.control == PLAIN:
        raise NotHereError
    file, i = _header_line(ground, f"{ground.variant}:")
    lines = ground.text.files[file]
    if "SHA" in ground.variant:
        value = "".join(ground.pick(HEX) for _ in range(64))
    elif ground.variant == "LAYERS":
        value = "99"
    else:
        value = {
            "CONTROL": "FANUC 31i", "BEAM": "600 W (60 kV, 10 mA)", "WIRE": "Al, 3.2 mm, by hand", "CURVES": "lines, within 1 mm",
            "COORDINATES": "X Y of the machine, inches", "SMOOTHING": "G64, path may leave the program by 9 mm",
            "MACHINE": "another machine",
        }[ground.variant]  # fmt: skip
    lines[i] = f"; {ground.variant}: {value}"
    ground.what = f"{ground.variant}: {value[:24]}"
    return ground.line(file, i)


@kind("layer comment of another layer", "record", ("number", "Z", "cut"), in_comments=True)
def layer_comment(ground: Ground) -> list[Place]:
    """Say another layer in the comment at its head."""
    text = ground.text
    found = [
        (f, i)
        for f, lines in text.files.items()
        for i, line in enumerate(lines)
        if line.startswith("; LAYER: ")
    ]
    file, i = ground.pick(found[1:])
    line = text.files[file][i]
    edits = {
        "number": (r"LAYER: \d+", "LAYER: 1"),
        "Z": (r" Z [\d.]+", " Z 99.000000"),
        "cut": (r"CUT AT [-\d.]+", "CUT AT 77.000000"),
    }
    text.files[file][i] = re.sub(*edits[ground.variant], line)
    ground.what = f"{ground.variant} of a layer's comment"
    return ground.line(file, i)


@kind("$PATH", "record", ("another", "missing"), controls=(SINUMERIK,))
def other_path(ground: Ground) -> list[Place]:
    """Lead a file to another folder of the control."""
    file = ground.pick(list(ground.text.files))
    lines = ground.text.files[file]
    lines[1] = ";$PATH=/_N_WKS_DIR/_N_OTHER_WPD" if ground.variant == "another" else "; PATH"
    ground.what = f"$PATH {ground.variant}"
    return ground.line(file, 1)


# -- record and certificate ----------------------------------------------------------------------------


def _manifest(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def forge(run: Path) -> None:
        path = run / "run.json"
        found = json.loads(path.read_text(encoding="utf-8"))
        change(found)
        path.write_text(json.dumps(found, indent=2, sort_keys=True), encoding="utf-8")

    return forge


def _certificate(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def forge(run: Path) -> None:
        path = run / "certificate.json"
        found = json.loads(path.read_text(encoding="utf-8"))
        change(found)
        path.write_text(json.dumps(found, indent=2, sort_keys=True), encoding="utf-8")

    return forge


def _gate(name: str, **values: Any) -> Callable[[dict[str, Any]], None]:
    def change(record: dict[str, Any]) -> None:
        for gate in record["gates"]:
            if gate["name"] == name:
                gate.update(values)

    return change


def _setting(section: str, **values: Any) -> Callable[[dict[str, Any]], None]:
    return lambda record: record["settings"][section].update(values)


FORGED: dict[str, Callable[[dict[str, Any]], None]] = {
    "figure of the fit gate": _gate("fit", figure=0.0001, text="curves within 0.0001 mm of the contours"),
    "figure under its limit, still passed": _gate("coverage", figure=0.5),
    "limit of a gate": _gate("coverage", limit=0.1),
    "gate deleted": lambda record: record["gates"].pop(),
    "part's name": lambda record: record["part"].update(name="pressure-vessel", source="pressure-vessel.stl"),
    "primary slicer": lambda record: record.update(primary="stencil"),
    "witness is the primary": lambda record: record["program"].update(witness=record["primary"]),
    "checks of the program": lambda record: record["program"]["checks"].clear(),
    "limit of the coverage in the settings": _setting("scan", least_coverage=0.5),
    "travel in the settings": _setting("machine", travel_max_mm=[5000.0, 5000.0, 5000.0]),
    "keep-out in the settings": _setting("process", keep_out=[]),
    "agreement": lambda record: record["comparison"].update(passed=False),
    "findings": lambda record: record.update(findings=[]),
}
"""Changes of ``run.json``; hash of the settings and certificate are made anew."""

CONTROLS_IN_TURN = {SINUMERIK: 0, LINUXCNC: 1, PLAIN: 2}


@kind("forged record", "record", {c: tuple(FORGED)[k::3] for c, k in CONTROLS_IN_TURN.items()}, unseen="the record of the run is not part of the program")  # fmt: skip
def forged_record(ground: Ground) -> list[Place]:
    """Change the record of the run, and seal it again."""
    ground.forge = _manifest(FORGED[ground.variant])
    ground.what = f"run.json: {ground.variant}, sealed again"
    return [Place("run.json", 1, 1), Place("certificate.json", 1, 1)]


CERTIFIED: dict[str, Callable[[dict[str, Any]], None]] = {
    "approver": lambda paper: paper.update(
        approver={"name": "A. Forger", "date": "2026-01-01", "signature": "A.F."}
    ),
    "deviations": lambda paper: paper.update(deviations=["none"]),
    "software": lambda paper: paper["software"].update(commit="0" * 40),
    "part": lambda paper: paper["part"].update(name="pressure-vessel"),
    "gates": lambda paper: paper["gates"][0].update(text="everything is fine"),
    "validated": lambda paper: paper.update(proved=["everything"]),
}
"""Changes of ``certificate.json`` after it was written."""


@kind("forged certificate", "record", {c: tuple(CERTIFIED)[k::3] for c, k in CONTROLS_IN_TURN.items()}, unseen="the certificate is not part of the program")  # fmt: skip
def forged_certificate(ground: Ground) -> list[Place]:
    """Change the certificate, and seal it again by the hash that anyone can work out."""
    change = CERTIFIED[ground.variant]

    def sealed(paper: dict[str, Any]) -> None:
        from ebamcheck.record import certificate

        change(paper)
        if hasattr(certificate, "seal"):
            paper["seal"] = certificate.seal(paper)

    ground.forge = _certificate(sealed)
    ground.forge_last = True
    ground.what = f"certificate.json: {ground.variant}, sealed again"
    return [Place("certificate.json", 1, 1)]


@kind("layers of the run exchanged", "record", unseen="the record of the run is not part of the program")
def other_witness(ground: Ground) -> list[Place]:
    """Put the contours that made the program in the place of the witness's."""

    def forge(run: Path) -> None:
        found = json.loads((run / "run.json").read_text(encoding="utf-8"))
        primary, witness = found["primary"], found["program"]["witness"]
        shutil.copyfile(run / "layers" / f"{primary}.parquet", run / "layers" / f"{witness}.parquet")

    ground.forge = forge
    ground.what = "the witness's layers are those of the primary slicer"
    return [Place("run.json", 1, 1), Place("certificate.json", 1, 1)]


@kind("run relabelled as another part", "record", unseen="text and part are those that are named")
def relabelled(ground: Ground) -> list[Place]:
    """Name another part in the record of the run; verified against that part's file."""

    def change(record: dict[str, Any]) -> None:
        record["part"].update(name="other", source="other.stl")

    ground.forge = _manifest(change)
    ground.other_part = "cube" if ground.subject.name != "cube" else "prism"
    ground.what = f"the run is given out as one of the part {ground.other_part}"
    return [Place("run.json", 1, 1), Place("certificate.json", 1, 1), Place(f"{ground.other_part}.stl", 1, 1)]

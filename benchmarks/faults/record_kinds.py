"""Faults of what a program and its run say of themselves: headers, record, certificate."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.faults.kinds import PLAIN, RECORD, SINUMERIK, Ground, NotHereError, Place, kind
from benchmarks.faults.subjects import CONTROLS
from ebamcheck.record.certificate import seal

# -- comments at the head ------------------------------------------------------------------------------


def _status_line(ground: Ground, file: str, status: str) -> list[Place]:
    """Another status in the place of that of a file that is validated."""
    lines = ground.text.files[file]
    if "; VALIDATED" not in lines:
        raise NotHereError
    i = lines.index("; VALIDATED")
    lines[i] = f"; {status}"
    return ground.line(file, i)


def _not_validated(ground: Ground) -> list[Place]:
    files = list(ground.text.files)
    some = files if ground.variant == "every file" else [ground.pick(files)]
    return [place for file in some for place in _status_line(ground, file, "NOT VALIDATED")]


HEADERS = {
    "PART SHA-256": "", "SETTINGS SHA-256": "", "LAYERS": "99", "CONTROL": "FANUC 31i", "BEAM": "600 W (60 kV, 10 mA)",
    "WIRE": "Al, 3.2 mm, by hand", "COORDINATES": "X Y of the machine, inches", "CURVES": "lines, within 1 mm",
    "SMOOTHING": "G64, path may leave the program by 9 mm", "MACHINE": "another machine",
}  # fmt: skip
"""Lines of a header, and what they say wrongly; of a hash, other digits."""


def _header(ground: Ground) -> list[Place]:
    lines = ground.text.files[ground.text.main]
    key = f"; {ground.variant}:"
    i = next((i for i, line in enumerate(lines) if line.startswith(key)), None)
    if i is None or (ground.variant == "SMOOTHING" and ground.text.control == PLAIN):
        raise NotHereError
    value = HEADERS[ground.variant] or "".join(ground.pick("0123456789abcdef") for _ in range(64))
    lines[i] = f"{key} {value}"
    ground.what = f"{ground.variant}: {value[:24]}"
    return ground.line(ground.text.main, i)


LAYER_COMMENT = {
    "number": (r"LAYER: \d+", "LAYER: 1"),
    "Z": (r" Z [\d.]+", " Z 99.000000"),
    "cut": (r"CUT AT [-\d.]+", "CUT AT 77.000000"),
}


def _layer_comment(ground: Ground) -> list[Place]:
    every = [
        (f, i) for f, lines in ground.text.files.items() for i, line in enumerate(lines) if line.startswith("; LAYER: ")
    ]
    file, i = ground.pick(every[1:])
    ground.text.files[file][i] = re.sub(*LAYER_COMMENT[ground.variant], ground.text.files[file][i])
    return ground.line(file, i)


def _path(ground: Ground) -> list[Place]:
    file = ground.pick(list(ground.text.files))
    ground.text.files[file][1] = ";$PATH=/_N_WKS_DIR/_N_OTHER_WPD" if ground.variant == "another" else "; PATH"
    return ground.line(file, 1)


def _name(ground: Ground) -> list[Place]:
    layer = ground.layer()
    lines = ground.text.files[layer.file]
    lines[0] = lines[0].replace("_L", "_K")
    return ground.line(layer.file, 0)


# -- record and certificate ----------------------------------------------------------------------------

Change = Callable[[dict[str, Any]], object]
PAPERS = [Place("run.json", 1, 1), Place("certificate.json", 1, 1)]


def _changed(name: str, change: Change) -> Callable[[Path], None]:
    """Change a JSON file of a run."""

    def forge(run: Path) -> None:
        content = json.loads((run / name).read_text(encoding="utf-8"))
        change(content)
        (run / name).write_text(json.dumps(content, indent=2, sort_keys=True), encoding="utf-8")

    return forge


def _gate(name: str, **values: Any) -> Change:
    return lambda record: [gate.update(values) for gate in record["gates"] if gate["name"] == name]


def _setting(section: str, **values: Any) -> Change:
    return lambda record: record["settings"][section].update(values)


FORGED: dict[str, Change] = {
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

CERTIFIED: dict[str, Change] = {
    "approver": lambda paper: paper.update(approver={"name": "A. Forger", "date": "2026-01-01", "signature": "A.F."}),
    "deviations": lambda paper: paper.update(deviations=["none"]),
    "software": lambda paper: paper["software"].update(commit="0" * 40),
    "part": lambda paper: paper["part"].update(name="pressure-vessel"),
    "gates": lambda paper: paper["gates"][0].update(text="everything is fine"),
    "validated": lambda paper: paper.update(proved=["everything"]),
}  # fmt: skip
"""Changes of ``certificate.json`` after it was written; it is sealed again by the hash that anyone can work out."""


def _forged_record(ground: Ground) -> list[Place]:
    ground.forge = _changed("run.json", FORGED[ground.variant])
    return PAPERS


def _forged_certificate(ground: Ground) -> list[Place]:
    def forge(paper: dict[str, Any]) -> None:
        CERTIFIED[ground.variant](paper)
        paper["seal"] = seal(paper)

    ground.forge, ground.forge_last = _changed("certificate.json", forge), True
    return PAPERS[1:]


def _other_witness(ground: Ground) -> list[Place]:
    """The contours that made the program in the place of the witness's."""

    def forge(run: Path) -> None:
        record = json.loads((run / "run.json").read_text(encoding="utf-8"))
        primary, witness = record["primary"], record["program"]["witness"]
        shutil.copyfile(run / "layers" / f"{primary}.parquet", run / "layers" / f"{witness}.parquet")

    ground.forge = forge
    return PAPERS


def _relabelled(ground: Ground) -> list[Place]:
    """Another part in the record of the run, which is verified against that part's file."""
    ground.forge = _changed("run.json", lambda record: record["part"].update(name="other", source="other.stl"))
    ground.other_part = "cube" if ground.subject.name != "cube" else "prism"
    ground.facts["part"] = ground.other_part
    return [*PAPERS, Place(f"{ground.other_part}.stl", 1, 1)]


# -- the kinds -------------------------------------------------------------------------------------------

# fmt: off
kind("header says not validated", RECORD, _not_validated, in_comments=True, what="NOT VALIDATED in {v}",
     variants={c: ("every file", "one file") if c == SINUMERIK else ("every file",) for c in CONTROLS},
     unseen="whether a program was validated is no property of its text: one from `post` says so rightly until a run proves it, and nobody runs it",
     unseen_variants=("every file",))
kind("header without a status", RECORD, lambda g: _status_line(g, g.pick(list(g.text.files)), "RELEASED"), in_comments=True, what="no status")
kind("header of another run", RECORD, _header, tuple(HEADERS), in_comments=True,
     unseen="who verifies a text alone may give other settings than those that it was made with: the check tells it, and is no fault",
     unseen_variants=("SETTINGS SHA-256",))
kind("layer comment of another layer", RECORD, _layer_comment, tuple(LAYER_COMMENT), in_comments=True, what="{v} of a layer's comment")
kind("$PATH", RECORD, _path, ("another", "missing"), controls=(SINUMERIK,), what="$PATH {v}")
kind("name in the header", RECORD, _name, controls=(SINUMERIK,), what="the first line names another program")
kind("forged record", RECORD, _forged_record, {c: tuple(FORGED)[k::3] for k, c in enumerate(CONTROLS)},
     what="run.json: {v}, sealed again", unseen="the record of the run is not part of the program")
kind("forged certificate", RECORD, _forged_certificate, {c: tuple(CERTIFIED)[k::3] for k, c in enumerate(CONTROLS)},
     what="certificate.json: {v}, sealed again", unseen="the certificate is not part of the program")
kind("layers of the run exchanged", RECORD, _other_witness, what="the witness's layers are those of the primary slicer",
     unseen="the record of the run is not part of the program")
kind("run relabelled as another part", RECORD, _relabelled, what="the run is given out as one of the part {part}",
     unseen="text and part are those that are named")
# fmt: on

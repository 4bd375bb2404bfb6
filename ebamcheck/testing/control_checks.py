"""Checks of a control: what it writes is read back as it was meant, and planted faults are found."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.curves import Curves, fit
from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.control import Control, control
from ebamcheck.nc.files import ProgramFiles
from ebamcheck.nc.templates import process_values, usable_templates
from ebamcheck.pipeline.stages import bead_paths, plan_program, smooth_layers
from ebamcheck.program import mark_validated, verify_file
from ebamcheck.result import Check
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.settings.config import Config
from ebamcheck.testing.subject import Figure, truth

LAYERS = 3
FORMS = ("", "arcs", "lines")  # forms of curves: the control's own, arcs, lines
LONGEST_BLOCK = 255  # characters of a block; controls of this kind read at least so many

# Settings of the process that bring every kind of event into a program
PROCESSES: Mapping[str, Mapping[str, Any]] = {
    "defaults": {},
    "ramps": {"ramp_up_mm": 4.0, "crater_fill_mm": 3.0},
    "overlap": {"overlap_mm": 4.0, "seam_shift_mm": 9.0},
    "wire retract": {"wire_retract_mm": 3.0},
    "pauses": {"layer_pause_s": 12.5},
}


@dataclass(frozen=True)
class ControlSubject:
    """A control under test, with curves and plan of a small stack."""

    name: str
    machine: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.name

    @property
    def control(self) -> Control:
        """The plugin itself."""
        return control(self.name)

    def config(self, process: Mapping[str, Any], form: str = "") -> Config:
        """Settings for the control; ``machine.curve_form`` where one is given."""
        machine = {"control": self.name, **self.machine, **({"curve_form": form} if form else {})}
        return Config().changed(machine=machine, process=dict(process))

    @cached_property
    def stacks(self) -> dict[str, tuple[Curves, ScanPlan]]:
        """Curves of the contour beads and plan, for each of :data:`PROCESSES`."""
        return {name: _stack(self.config(process)) for name, process in PROCESSES.items()}

    def written(self, folder: Path, process: str = "defaults", form: str = "") -> tuple[ProgramFiles, Config]:
        """Write the program of the stack."""
        curves, plan = self.stacks[process]
        config = self.config(PROCESSES[process], form)
        files: ProgramFiles = self.control.load("writer")(curves, plan, config, folder)
        return files, config

    def checked(self, files: ProgramFiles, config: Config, process: str = "defaults") -> list[Check]:
        """Read a program back, and hold it against what it was made from."""
        curves, plan = self.stacks[process]
        return verify_file(files.main, config=config, curves=curves, plan=plan)


def _stack(config: Config) -> tuple[Curves, ScanPlan]:
    """A plate with round corners, an oval hole and a slot: lines, splines and arcs of both senses, several islands."""
    plate = shapely.box(0.0, 0.0, 62.0, 44.0).buffer(-8.0).buffer(8.0, quad_segs=32)
    oval = shapely.affinity.scale(shapely.Point(20.0, 22.0).buffer(8.0, quad_segs=48), 1.0, 0.7)
    section: BaseGeometry = plate.difference(shapely.union_all([oval, shapely.box(40.0, 18.0, 70.0, 26.0)]))
    layers = from_polygons(config.layer_height_mm * (np.arange(LAYERS) + 0.5), [[section]] * LAYERS)
    smooth = smooth_layers(fit(layers, "paper", config.curves))
    plan = plan_program(smooth, config)
    return bead_paths(smooth, plan, config), plan


# -- checks --------------------------------------------------------------------------------------------


def declaration(subject: ControlSubject) -> list[Figure]:
    """The plugin is a control of its name, its writer and reader load, and its templates and endings make sense."""
    found = subject.control
    parts = [f"{what} {getattr(found, what)!r}" for what in ("writer", "reader") if not _loads(found, what)]
    figures = [truth("declaration", found.name, not parts, f"cannot be loaded: {', '.join(parts)}")]
    if found.is_read:
        upper = bool(found.suffixes) and all(s.startswith(".") and s == s.upper() for s in found.suffixes)
        figures.append(truth("declaration", found.name, upper, "give suffixes in capitals, with their dot"))
        usable_templates(subject.config({}), subject.name)
    return figures


def _loads(found: Control, what: Any) -> bool:
    try:
        return not getattr(found, what) or callable(found.load(what))
    except SettingsError:
        return False


def read_back(subject: ControlSubject) -> list[Figure]:
    """Every motion and event of a program is read back as it was meant, in every form of curves."""
    figures = []
    for process in PROCESSES:
        for form in FORMS if process == "defaults" else FORMS[:1]:
            with tempfile.TemporaryDirectory() as folder:
                files, config = subject.written(Path(folder, "program"), process, form)
                checks = subject.checked(files, config, process)
            failed = [c for c in checks if not c.passed]
            text = "; ".join(f"{c.name}: {c.text} ({c.where})" for c in failed)
            figures.append(truth("read back", f"{process} {form}".strip(), not failed, text))
    return figures


def form_of_text(subject: ControlSubject) -> list[Figure]:
    """Files are ASCII with line feeds alone, blocks are no longer than a control reads, and the same twice."""
    with tempfile.TemporaryDirectory() as folder:
        files, _ = subject.written(Path(folder, "one"))
        again, _ = subject.written(Path(folder, "two"))
        data = b"".join((files.folder / name).read_bytes() for name in files.names)
        stamped = mark_validated(files)
        places = [(files.folder / name, again.folder / name) for name in files.names]
        changed = [one.read_bytes() != two.read_bytes() for one, two in places]
    longest, stamps = max(len(line) for line in data.split(b"\n")), stamped.validated and all(changed)
    return [
        truth("form of text", "encoding", data.isascii() and b"\r" not in data, "not ASCII with LF alone"),
        Figure("form of text", "longest block", -1, float(longest), float(LONGEST_BLOCK), "characters"),
        truth("form of text", "twice", files.sha256 == again.sha256, "two programs of the same differ"),
        truth("form of text", "status", stamps, "files do not carry their status"),
    ]


def planted_faults(subject: ControlSubject) -> list[Figure]:
    """Faults planted in the text are refused by the reader or found by a check."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        files, config = subject.written(Path(folder, "program"))
        texts = {name: (files.folder / name).read_text(encoding="ascii") for name in files.names}
        for fault, plant in _faults(config, subject.name).items():
            planted = ((n, new) for n, old in reversed(texts.items()) if (new := plant(old)) != old)
            name, text = next(planted, ("", ""))
            if not name:
                figures.append(truth("planted faults", fault, False, "there is no place to plant it"))
                continue
            (files.folder / name).write_text(text, encoding="ascii", newline="\n")
            try:
                found = any(not check.passed for check in subject.checked(files, config))
            except EbamcheckError:
                found = True
            (files.folder / name).write_text(texts[name], encoding="ascii", newline="\n")
            figures.append(truth("planted faults", fault, found, f"not found in {name}"))
    return figures


def _faults(config: Config, name: str) -> dict[str, Callable[[str], str]]:
    """Functions that plant one fault each into the text of a file; the text stays the same where there is no place."""
    templates = usable_templates(config, name)
    values = process_values(config, 1, 1.0, 1.0)

    def without(template: str) -> Callable[[str], str]:
        last = values.fill(template, templates[template])[-1].split(";")[0].strip()
        return lambda text: _without_second(text, last)

    move = r"X(-?[\d.]+) Y(-?[\d.]+)"
    return {
        "point moved by 2 mm": lambda t: _second(
            t, move, lambda m: f"X{float(m[1]) + 1.6:.6f} Y{float(m[2]) - 1.2:.6f}"
        ),
        "motion left out": _corner_left_out,
        "beam not switched off": without("beam_off"),
        "wire not started": without("wire_start"),
        "feed halved": lambda t: re.sub(r"\bF(\d+)", lambda m: f"F{int(m[1]) // 2}", t, count=1),
        "incremental positions": lambda t: t.replace("G90", "G91", 1),
        "inches": lambda t: re.sub(r"\bG(?:21|710|71)\b", "G20" if "G21" in t else "G70", t, count=1),
        "end cut off": lambda t: t[: t.rstrip("\n").rindex("\n", 0, 3 * len(t) // 4) + 1],
    }


def _without_second(text: str, words: str) -> str:
    """Leave out the second line that holds some words."""
    lines = text.split("\n")
    at = [i for i, line in enumerate(lines) if words in line]
    return "\n".join(line for i, line in enumerate(lines) if i not in at[1:2])


def _corner_left_out(text: str) -> str:
    """Leave out a straight motion to a corner; one to a place on the straight from the motion before to the next is no other
    path."""
    moves = list(re.finditer(r"^.*\bG1 X(-?[\d.]+) Y(-?[\d.]+).*\n", text, re.MULTILINE))
    for a, b, c in zip(moves[2:], moves[3:], moves[4:], strict=False):
        x, y, u, v = (float(b[k]) - float(other[k]) for other in (a, c) for k in (1, 2))
        between = text[a.end() : b.start()] + text[b.end() : c.start()]
        if abs(x * v - y * u) > math.hypot(x - u, y - v) and " X" not in between and "POLY" not in between:
            return text[: b.start()] + text[b.end() :]
    return text


def _second(text: str, pattern: str, change: Callable[[re.Match[str]], str]) -> str:
    found = list(re.finditer(rf"G[1-3]\b.*?{pattern}", text))
    if len(found) < 5:
        return text
    whole = found[4]
    return text[: whole.start()] + re.sub(pattern, change, whole[0], count=1) + text[whole.end() :]


CONTROL_CHECKS = (declaration, read_back, form_of_text, planted_faults)


def control_figures(subject: ControlSubject) -> Iterator[tuple[str, str, list[Figure]]]:
    """Name, summary and figures of every check; whatever a control raises is a violation; one that is not read back is held to its
    declaration alone."""
    for check in CONTROL_CHECKS if subject.control.is_read else CONTROL_CHECKS[:1]:
        name = check.__name__.replace("_", " ")
        try:
            figures = check(subject)
        except Exception as error:
            figures = [truth(name, "error", False, f"it raised {type(error).__name__}: {error}")]
        yield name, (check.__doc__ or "").strip().splitlines()[0], figures

"""The parts into whose programs faults are planted, small and each with something that the others lack, and their finished runs."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import ebamcheck
from benchmarks.faults.program_text import ProgramText
from ebamcheck.pipeline import run_job
from ebamcheck.settings.config import Config
from ebamcheck_models import Model, write_stl
from ebamcheck_models.outlines import circle, polygon, rounded_rectangle
from ebamcheck_models.prisms import prism
from ebamcheck_models.revolved import Torus
from ebamcheck_models.two_spheres import TwoSpheres

CONTROLS = ("sinumerik-840d-sl", "linuxcnc", "plain-gcode")

TESSELLATION_MM = 0.05
"""Chord error of the parts' meshes."""

TALL_MM = 5.0
"""Three layers of one bead each."""

CLAMP = {"name": "clamp", "outline_mm": ((50, -10), (70, -10), (70, 10), (50, 10)), "z_mm": (0, 15)}
"""A place to keep out of, beside every part."""

BACKENDS = ("planecut", "manifold")
"""Two exact slicers that start quickly."""

LAYER_MM = Config().layer_height_mm


@dataclass(frozen=True)
class Subject:
    """A part, and the settings of the run that makes its program."""

    name: str
    model: Model
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def config(self, control: str, **changes: Mapping[str, Any]) -> Config:
        """Settings of a run for a control; `changes` by section."""
        sections: dict[str, dict[str, Any]] = {
            "slicing": {"backends": BACKENDS},
            "process": {"keep_out": (CLAMP,)},
            "machine": {"control": control},
        }
        for some in (self.settings, changes):
            for section, values in some.items():
                sections[section] = {**sections.get(section, {}), **values}
        return Config().changed(**sections)


def _layers(lowest_mm: float, count: int) -> dict[str, dict[str, Any]]:
    """Settings that cut some layers alone: those of a round part that are wide enough for beads."""
    heights = tuple(round(lowest_mm + LAYER_MM * k, 6) for k in range(count))
    return {"layers": {"heights_mm": heights}}


SUBJECTS = {
    s.name: s
    for s in (
        Subject("cube", prism("cube", "cube", polygon([(0, 0), (24, 0), (24, 24), (0, 24)]), TALL_MM)),
        Subject(
            "prism",
            prism(
                "prism",
                "an L, which no mirror brings to itself",
                polygon([(0, 0), (38, 0), (38, 16), (18, 16), (18, 30), (0, 30)]),
                TALL_MM,
            ),
        ),
        Subject(
            "bored",
            prism(
                "bored",
                "rounded plate with two bores",
                rounded_rectangle(26, 18, 8),
                TALL_MM,
                (circle(-10, 0, 8.0), circle(14, 0, 5.0)),
            ),
        ),
        Subject("torus", Torus("torus", "torus, its lower half", 24.0, 11.0), _layers(0.5 * LAYER_MM, 4)),
        Subject(
            "two-spheres",
            TwoSpheres(
                "two-spheres",
                "two spheres that overlap, about their middle",
                np.array([[0, 0, 0], [16, 4, 3]]),
                (14.0, 12.0),
            ),
            _layers(-6.0, 4),
        ),
    )
}

ROUND_PARTS = ("bored", "torus", "two-spheres")
"""Parts with arcs; those after the first have splines, too."""

RADIUS_MM = 29.0
"""Twelve sides in a circle of this radius lie up to 0.988 mm inside of it."""

TWELVE = Subject(
    "twelve-sides",
    prism(
        "twelve-sides",
        "prism of twelve sides, which no circle is",
        polygon([(RADIUS_MM * math.cos(a), RADIUS_MM * math.sin(a)) for a in np.arange(12) * math.pi / 6]),
        TALL_MM,
    ),
    {"curves": {"crease_angle_deg": 20.0}},
)
"""Its edges are kept; with the default angle of a crease they are not."""

ROUND = Subject("round", prism("round", "the circle about the twelve sides", circle(0, 0, RADIUS_MM), TALL_MM))

RETRACTING = replace(SUBJECTS["cube"], name="cube-retracting", settings={"process": {"wire_retract_mm": 5.0}})
"""The cube, whose wire is drawn back after every bead."""

PREHEATED = replace(
    SUBJECTS["cube"],
    name="cube-preheated",
    settings={
        "machine": {"set_focus": ("H5={defocus} ; focus",)},
        "preheat": {"when": "plate", "defocus": 20.0},
    },
)
"""The cube on a plate that is preheated, which takes a control with subprograms."""

EVERY = {**SUBJECTS, **{s.name: s for s in (TWELVE, ROUND, RETRACTING, PREHEATED)}}
"""All parts; those of :data:`SUBJECTS` serve for every kind of fault."""

# -- finished runs -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Finished:
    """A run that is done, and what it was made from."""

    subject: Subject
    control: str
    config: Config
    run: Path
    part: Path

    def text(self) -> ProgramText:
        """The program, to be spoiled."""
        return ProgramText.read(self.run / "program", self.control)


class Workshop:
    """A folder of parts and finished runs, which serve until code or settings change."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.sound: dict[tuple[str, str, str], frozenset[str]] = {}
        """Names of the checks that fail for a sound program, by way of verification, part and control."""

    def part(self, subject: Subject) -> Path:
        """File of a part."""
        path = self.folder / f"{subject.name}.stl"
        if not path.is_file():
            write_stl(subject.model.tessellate(TESSELLATION_MM), path)
        return path

    def finished(self, subject: Subject, control: str, **changes: dict[str, Any]) -> Finished:
        """Return the run of a part for a control, made now if there is none."""
        config = subject.config(control, **changes)
        digest = _digest([config.model_dump(mode="json"), code_digest()])
        run = self.folder / f"{subject.name}-{control}-{digest}"
        part = self.part(subject)
        if not (run / "run.json").is_file():
            run_job(part, run, config)
        return Finished(subject, control, config, run, part)

    def forget_outdated(self) -> None:
        """Remove the runs of other code than that which is here now."""
        mark = self.folder / "code"
        if mark.is_file() and mark.read_text() != code_digest():
            for run in self.folder.glob("*/run.json"):
                shutil.rmtree(run.parent)
        mark.write_text(code_digest())


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()[:10]


@cache
def code_digest() -> str:
    """Hash of the product's sources: runs and verdicts are of this code."""
    root = Path(ebamcheck.__file__).parent
    return _digest_of([*sorted(root.rglob("*.py")), *sorted((root.parent / "backends").rglob("*.py"))])


@cache
def plant_digest() -> str:
    """Hash of the sources of this package: what is planted is by this code."""
    return _digest_of(sorted(Path(__file__).parent.glob("*.py")))


def _digest_of(sources: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:10]

"""Finished runs of the parts, made once for the code and the settings that are here now."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import ebamcheck
from benchmarks.faults.program_text import ProgramText
from benchmarks.faults.subjects import TESSELLATION_MM, Subject
from ebamcheck.pipeline import run_job
from ebamcheck.settings.config import Config
from ebamcheck_models import write_stl

DIGEST_LETTERS = 10


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
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()[
        :DIGEST_LETTERS
    ]


@cache
def code_digest() -> str:
    """Hash of the product's sources: runs and verdicts are of this code."""
    folder = Path(ebamcheck.__file__).parent
    digest = hashlib.sha256()
    for source in [*sorted(folder.rglob("*.py")), *sorted((folder.parent / "backends").rglob("*.py"))]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:DIGEST_LETTERS]


@cache
def plant_digest() -> str:
    """Hash of the sources of this package: what is planted is by this code."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:DIGEST_LETTERS]

"""What verification says of a program with a fault in it, by run and by text, that it does not say of the sound one."""

from __future__ import annotations

import re
import shutil
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.faults.kinds import Ground, Place
from benchmarks.faults.program_text import without_comments
from benchmarks.faults.subjects import Finished
from ebamcheck.errors import EbamcheckError
from ebamcheck.json_values import (
    sha256_of_file,
    sha256_of_json,
    write_json,
)
from ebamcheck.pipeline.reports import reports_again
from ebamcheck.program import Check
from ebamcheck.record.certificate import write_certificate
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.verification.verify import verify_against_part, verify_run

NEAR_LINES = 3
"""A fault is told at the right place within so many lines."""

REFUSED, CRASHED = "refused", "crashed"
"""Names in place of a check's: the verification ended with an error of its own, or with one that is a fault of the product."""

_PLACE = re.compile(r"(?:^|[\s/])([A-Za-z][\w.-]*):(\d+)")


@dataclass(frozen=True)
class Said:
    """A check that failed, or the error with which the verification ended."""

    check: str
    where: str
    text: str

    @property
    def place(self) -> tuple[str, int] | None:
        """File and line."""
        found = _PLACE.search(self.where)
        return (found[1], int(found[2])) if found else None


@dataclass(frozen=True)
class Verdict:
    """What one way of verification says of a fault."""

    said: tuple[Said, ...]
    by: tuple[str, ...] = ()
    """Names of the checks that name the right place."""

    @property
    def found(self) -> bool:
        """Whether the fault is found; a crash is no finding."""
        return any(said.check != CRASHED for said in self.said)


def verdict(said: Sequence[Said], sound: frozenset[str], places: Sequence[Place]) -> Verdict:
    """Leave out what is said of the sound program, too, and compare places."""
    new = tuple(s for s in said if s.check not in sound)
    return Verdict(new, tuple(dict.fromkeys(s.check for s in new if is_right(s, places))))


def is_right(said: Said, places: Sequence[Place]) -> bool:
    """Whether a place is one of those expected, within :data:`NEAR_LINES`; a record is one place."""
    at = said.place or (said.where.partition(":")[0], 1)
    return any(
        p.file == at[0] and (p.last == 1 or p.first - NEAR_LINES <= at[1] <= p.last + NEAR_LINES) for p in places
    )


def failures(check: Callable[[], list[Check]]) -> list[Said]:
    """What a verification says; an error is said, too."""
    try:
        return [Said(c.name, c.where, c.text) for c in check() if not c.passed]
    except EbamcheckError as error:
        text = str(error)
        found = _PLACE.search(text)
        return [Said(REFUSED, f"{found[1]}:{found[2]}" if found else text.partition(":")[0], text)]
    except Exception as error:
        # A crash is a finding about the product, and the other faults are still to be judged.
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        return [Said(CRASHED, "", f"{type(error).__name__}: {error} at {where}")]


def judged_run(ground: Ground, made: Finished, folder: Path, other_part: Path | None = None) -> list[Said]:
    """Put the text into a copy of the run, make its hashes anew as an attacker would, and verify the run."""
    copy = folder / "run"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(made.run, copy)
    ground.text.write(copy / "program")
    if ground.forge is not None and not ground.forge_last:
        ground.forge(copy)
        _write_reports(copy)

    def sealed_and_verified() -> list[Check]:
        # A record that cannot be read is refused before anybody can seal it.
        reseal(copy, ground.text.main, other_part)
        if ground.forge is not None and ground.forge_last:
            ground.forge(copy)
        return verify_run(copy, other_part or made.part)

    return failures(sealed_and_verified)


def judged_text(ground: Ground, made: Finished, folder: Path, keep_comments: bool) -> list[Said]:
    """Verify the text by itself against the part, all comments taken out."""
    alone = folder / "alone" / "program"
    shutil.rmtree(alone.parent, ignore_errors=True)
    alone.mkdir(parents=True)
    ground.text.write(alone)
    if not keep_comments:
        strip(alone)
    return failures(lambda: verify_against_part(alone / ground.text.main, made.part, made.config))


def strip(folder: Path) -> None:
    """Take the comments out of every file of a program."""
    for path in folder.iterdir():
        data = path.read_bytes()
        if b"\x00" not in data:
            path.write_bytes(without_comments(data.decode("latin-1")).encode("latin-1"))


def _write_reports(run: Path) -> None:
    """Make reports of a record anew, where they can be made of it."""
    with suppress(EbamcheckError):
        for name, text in reports_again(RunFolder(run)).items():
            (run / name).write_bytes(text)


def reseal(run: Path, main: str, other_part: Path | None = None) -> None:
    """Work out anew every hash that anyone can, and write a new certificate."""
    folder = RunFolder(run)
    record = folder.manifest()
    record["settings_sha256"] = sha256_of_json(record["settings"])
    if other_part is not None:
        record["part"]["sha256"] = sha256_of_file(other_part)
    names = [main, *sorted(p.name for p in (run / "program").iterdir() if p.name != main)]
    others = [name for name in record["files"] if not name.startswith("program/") and (run / name).is_file()]
    record["files"] = {name: sha256_of_file(run / name) for name in (*others, *(f"program/{n}" for n in names))}
    blocks = {file["name"]: file["blocks"] for file in record["program"]["files"]}
    record["program"]["files"] = [
        {"name": n, "sha256": sha256_of_file(run / "program" / n), "blocks": blocks.get(n, 1)} for n in names
    ]
    write_json(record, run / "run.json")
    write_certificate(folder)

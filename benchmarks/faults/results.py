"""What became of each fault: one record a fault, kept as it comes, so that a run that was ended goes on."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.faults.judging import Said

NOTES, NOTED = 6, 80
"""Checks that are noted of a fault, and letters of what each says."""


@dataclass(frozen=True)
class Result:
    """One fault: what was planted where, and what found it."""

    name: str
    kind: str
    changes: str
    control: str
    part: str
    variant: str
    what: str
    where: str
    """First place of the fault, ``FILE:line``."""
    unseen: str
    """Why text and part alone cannot show it."""
    run_checks: tuple[str, ...] = ()
    """Checks that failed in the verification of the run."""
    run_found: bool = False
    run_by: tuple[str, ...] = ()
    """Those of them that name the right line."""
    text_checks: tuple[str, ...] = ()
    text_found: bool = False
    text_by: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())
    """What the checks said."""

    @property
    def run_right(self) -> bool:
        """Whether a check of the run names the right line."""
        return bool(self.run_by)

    @property
    def text_right(self) -> bool:
        """Whether a check of the text names the right line."""
        return bool(self.text_by)

    @property
    def run_missed(self) -> bool:
        """Not found by the verification of the run."""
        return not self.run_found

    @property
    def text_missed(self) -> bool:
        """Not found by text and part, though it could be."""
        return not self.text_found and not self.unseen


class Ledger:
    """Results on disk, a line each, of one state of the code; of the last one where its digest is empty."""

    def __init__(self, path: Path, digest: str) -> None:
        self._path, self._digest = path, digest
        self._known: dict[str, dict[str, Any]] = {}
        if path.is_file():
            rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
            wanted = digest or (rows[-1]["digest"] if rows else "")
            self._known = {row["name"]: row for row in rows if row.pop("digest") == wanted}

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def __iter__(self) -> Iterator[Result]:
        return (self[name] for name in self._known)

    def __getitem__(self, name: str) -> Result:
        row: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in self._known[name].items()
        }
        return Result(**row)

    def add(self, result: Result) -> None:
        """Keep a result."""
        row = asdict(result)
        self._known[result.name] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({**row, "digest": self._digest}) + "\n")


def noted(said: Iterable[Said]) -> str:
    """What checks said, in short."""
    return " | ".join(f"{s.check} {s.where} {s.text[:NOTED]}" for s in list(said)[:NOTES])

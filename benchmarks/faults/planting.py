"""All faults in their order, each planted by random numbers of its own, and what verification finds of them."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.faults import (  # noqa: F401  (each puts its kinds on the list)
    bead_kinds,
    block_kinds,
    layer_kinds,
    path_kinds,
    process_kinds,
    record_kinds,
    settings_kinds,
)
from benchmarks.faults.judging import Said, Verdict, judged_run, judged_text, verdict
from benchmarks.faults.kinds import KINDS, Ground, Kind, NotHereError, Place
from benchmarks.faults.program_text import ProgramText
from benchmarks.faults.subjects import CONTROLS, EVERY, SUBJECTS, Finished, Workshop
from ebamcheck.atomic_file import replacing

PLAIN_PARTS = ("cube", "prism")
"""Parts for faults of state and record, which do not depend on the shape: they are verified soonest."""

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
    notes: tuple[str, ...] = ()
    """What the checks said."""

    @classmethod
    def of(cls, run: Verdict, text: Verdict, **about: str) -> Result:
        """What became of a fault, by both ways of verification."""
        return cls(
            **about,
            run_checks=tuple(s.check for s in run.said),
            run_found=run.found,
            run_by=run.by,
            text_checks=tuple(s.check for s in text.said),
            text_found=text.found,
            text_by=text.by,
            notes=(_noted(run.said), _noted(text.said)),
        )

    @property
    def run_missed(self) -> bool:
        """Not found by the verification of the run."""
        return not self.run_found

    @property
    def text_missed(self) -> bool:
        """Not found by text and part, though it could be."""
        return not self.text_found and not self.unseen


def _noted(said: Iterable[Said]) -> str:
    return " | ".join(f"{s.check} {s.where} {s.text[:NOTED]}" for s in list(said)[:NOTES])


@dataclass(frozen=True)
class Fault:
    """One fault to be planted: its kind, for which control, and which variant of it."""

    kind: Kind
    control: str
    variant: Any

    @property
    def name(self) -> str:
        """Name of the fault, the same in every run of the harness."""
        if self.variant is None:
            return f"{self.kind.name}/{self.control}"
        what = " -> ".join(map(str, self.variant)) if isinstance(self.variant, tuple) else self.variant
        return f"{self.kind.name}/{self.control}/{what}"


def faults(kinds: str = "", controls: Sequence[str] = CONTROLS) -> Iterator[Fault]:
    """All faults, or those whose kind's name contains a text."""
    found = []
    for kind in KINDS.values():
        for control in controls:
            some = [variant for c, variant in kind.variants if c == control and kinds in kind.name]
            found += [(n, Fault(kind, control, variant)) for n, variant in enumerate(some)]
    # The first of every kind first: a run that is cut short has seen all kinds.
    return (fault for _, fault in sorted(found, key=lambda entry: entry[0]))


class Planter:
    """Plants faults into the programs of finished runs, and has them judged."""

    def __init__(self, workshop: Workshop, seed: int, parts: Sequence[str] = tuple(SUBJECTS)) -> None:
        self._workshop, self._seed, self._parts = workshop, seed, parts

    def planted(self, fault: Fault) -> tuple[Ground, Finished, list[Place]]:
        """Plant a fault in the first of the parts, in random order, that has a place for it; NotHereError if none has."""
        random = np.random.default_rng([self._seed, zlib.crc32(fault.name.encode())])
        names = self._parts_for(fault.kind)
        for k in random.permutation(len(names)):
            made = self._workshop.finished(EVERY[names[k]], fault.control)

            def other(name: str, **changes: Any) -> ProgramText:
                return self._workshop.finished(EVERY[name], fault.control, **changes).text()

            ground = Ground(made.text(), made.subject, made.config, random, fault.variant, other)
            try:
                return ground, made, fault.kind.plant(ground)
            except NotHereError:
                continue
        raise NotHereError(f"{fault.name}: no part has a place for it")

    def _parts_for(self, kind: Kind) -> Sequence[str]:
        """Names of the parts that serve for a kind: the first that it wants, where the usual ones will not do."""
        usual = self._parts
        if kind.subjects:
            return [name for name in usual if name in kind.subjects] or kind.subjects[:1]
        plain = [name for name in usual if name in PLAIN_PARTS]
        return plain if plain and kind.changes in ("state", "record") else usual

    def judged(self, fault: Fault, folder: Path) -> Result:
        """Plant a fault, and verify run and text."""
        ground, made, places = self.planted(fault)
        where = "settings" if ground.settings else f"{places[0].file}:{places[0].first}"
        run, text = self._verdicts(fault.kind, ground, made, places, folder)
        return Result.of(
            run,
            text,
            name=fault.name,
            kind=fault.kind.name,
            changes=fault.kind.changes,
            control=fault.control,
            part=made.subject.name,
            variant="" if fault.variant is None else str(fault.variant),
            what=ground.what,
            where=where,
            unseen=fault.kind.unseen_of(fault.variant),
        )

    def _verdicts(
        self, kind: Kind, ground: Ground, made: Finished, places: list[Place], folder: Path
    ) -> tuple[Verdict, Verdict]:
        """What run and text say of a planted fault."""
        if ground.settings:
            return settings_kinds.judged_settings(ground, made, folder, places)
        part = self._workshop.part(EVERY[ground.other_part]) if ground.other_part else None
        run = verdict(judged_run(ground, made, folder, part), self._of_sound("run", made, folder), places)
        if ground.forge is not None:
            return run, Verdict(())
        said = judged_text(ground, made, folder, kind.in_comments)
        way = "commented" if kind.in_comments else "bare"
        return run, verdict(said, self._of_sound(way, made, folder), places)

    def _of_sound(self, way: str, made: Finished, folder: Path) -> frozenset[str]:
        """Names of the checks that fail for a sound program: false alarms, which find no fault."""
        known, key = self._workshop.sound, (way, made.subject.name, made.control)
        if key not in known:
            ground = Ground(made.text(), made.subject, made.config, np.random.default_rng(0))
            if way == "run":
                said = judged_run(ground, made, folder)
            else:
                said = judged_text(ground, made, folder, keep_comments=way == "commented")
            known[key] = frozenset(s.check for s in said)
        return known[key]


class Results:
    """Results of one state of the code on disk, a file each, so that a run that was ended goes on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def of(self, name: str, judge: Callable[[], Result]) -> Result | None:
        """What became of a fault, judged now if it was not; None where it has no place."""
        path = self._folder / f"{re.sub(r'[^A-Za-z0-9]+', '-', name)[:80]}-{zlib.crc32(name.encode()):08x}.json"
        if not path.is_file():
            try:
                known = asdict(judge())
            except NotHereError:
                known = None
            with replacing(path) as temporary:
                temporary.write_text(json.dumps(known), encoding="utf-8")
        row: dict[str, Any] | None = json.loads(path.read_text(encoding="utf-8"))
        if row is None:
            return None
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
        return Result(**values)

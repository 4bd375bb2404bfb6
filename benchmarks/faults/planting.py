"""All faults in their order, each planted by random numbers of its own, and judged both ways."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.faults import (  # noqa: F401  (each puts its kinds on the list)
    air_kinds,
    attack_kinds,
    layer_kinds,
    metal_kinds,
    motion_kinds,
    number_kinds,
    process_kinds,
    record_kinds,
    state_kinds,
    text_kinds,
)
from benchmarks.faults.finished import Finished, Workshop
from benchmarks.faults.judging import Verdict, judged_run, judged_text, verdict
from benchmarks.faults.kinds import KINDS, Ground, Kind, NotHereError, Place
from benchmarks.faults.program_text import ProgramText
from benchmarks.faults.results import Result, noted
from benchmarks.faults.subjects import CONTROLS, EVERY, SUBJECTS

PLAIN_PARTS = ("cube", "prism")
"""Parts for faults of state and record, which do not depend on the shape: they are verified soonest."""


@dataclass(frozen=True)
class Fault:
    """One fault to be planted: its kind, for which control, and which variant of it."""

    kind: Kind
    control: str
    variant: Any

    @property
    def name(self) -> str:
        """Name of the fault, the same in every run of the harness."""
        what = (
            ""
            if self.variant is None
            else f"/{self.variant if not isinstance(self.variant, tuple) else ' -> '.join(map(str, self.variant))}"
        )
        return f"{self.kind.name}/{self.control}{what}"


def faults(kinds: str = "", controls: tuple[str, ...] = CONTROLS) -> Iterator[Fault]:
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

    def __init__(self, workshop: Workshop, seed: int, parts: tuple[str, ...] = tuple(SUBJECTS)) -> None:
        self._workshop, self._seed, self._parts = workshop, seed, parts
        self._sound = workshop.sound

    def planted(self, fault: Fault) -> tuple[Ground, Finished, list[Place]]:
        """Plant a fault in the first of the parts, in random order, that has a place for it.

        Raises
        ------
        NotHereError
            If none has.
        """
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

    def _parts_for(self, kind: Kind) -> list[str]:
        """Names of the parts that serve for a kind: the first that it wants, where the usual ones will not do."""
        usual = self._parts
        if not kind.subjects and kind.changes in ("state", "record"):
            usual = tuple(name for name in usual if name in PLAIN_PARTS) or usual
        return [name for name in usual if name in kind.subjects or not kind.subjects] or list(
            kind.subjects[:1]
        )

    def judged(self, fault: Fault, folder: Path) -> Result:
        """Plant a fault, and verify run and text."""
        ground, made, places = self.planted(fault)
        part = self._workshop.part(EVERY[ground.other_part]) if ground.other_part else None
        run = verdict(judged_run(ground, made, folder, part), self._of_sound("run", made, folder), places)
        text = Verdict(())
        if ground.forge is None:
            way = "commented" if fault.kind.in_comments else "bare"
            said = judged_text(ground, made, folder, fault.kind.in_comments)
            text = verdict(said, self._of_sound(way, made, folder), places)
        return Result(
            name=fault.name,
            kind=fault.kind.name,
            changes=fault.kind.changes,
            control=fault.control,
            part=made.subject.name,
            variant="" if fault.variant is None else str(fault.variant),
            what=ground.what,
            where=f"{places[0].file}:{places[0].first}",
            unseen=fault.kind.unseen_of(fault.variant),
            run_checks=tuple(s.check for s in run.said),
            run_found=run.found,
            run_by=run.by,
            text_checks=tuple(s.check for s in text.said),
            text_found=text.found,
            text_by=text.by,
            notes=(noted(run.said), noted(text.said)),
        )

    def _of_sound(self, way: str, made: Finished, folder: Path) -> frozenset[str]:
        """Names of the checks that fail for a sound program: false alarms, which find no fault."""
        key = (way, made.subject.name, made.control)
        if key not in self._sound:
            ground = Ground(made.text(), made.subject, made.config, np.random.default_rng(0))
            if way == "run":
                said = judged_run(ground, made, folder)
            else:
                said = judged_text(ground, made, folder, keep_comments=way == "commented")
            self._sound[key] = frozenset(s.check for s in said)
        return self._sound[key]

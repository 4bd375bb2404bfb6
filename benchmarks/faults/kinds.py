"""What a kind of fault is: a name, an edit that plants it, and the variants in which it is planted for each control."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from benchmarks.faults.program_text import Bead, Layer, ProgramText
from benchmarks.faults.subjects import CONTROLS, Subject
from ebamcheck.settings.config import Config

Changes = Literal["metal", "motion", "state", "record"]
"""What a fault changes: the metal laid, other motions, the state or the values of the machine, what is said of the program."""

METAL: Changes = "metal"
MOTION: Changes = "motion"
STATE: Changes = "state"
RECORD: Changes = "record"
SINUMERIK, LINUXCNC, PLAIN = CONTROLS

T = TypeVar("T")


class NotHereError(Exception):
    """There is no place in this program for a fault of this kind."""


@dataclass(frozen=True)
class Place:
    """Lines of a file, counted from 1, at any of which a fault may be told."""

    file: str
    first: int
    last: int


@dataclass
class Ground:
    """What a fault is planted into, and the random numbers that say where."""

    text: ProgramText
    subject: Subject
    config: Config
    random: np.random.Generator
    variant: Any = None
    other: Callable[..., ProgramText] | None = None
    """Text of the program of another run for the same control: of another part, or by other settings."""
    what: str = ""
    """What was planted, in words."""
    facts: dict[str, Any] = field(default_factory=dict)
    """Figures of the place that the words of the kind name."""
    forge: Callable[[Path], None] | None = None
    """What is done to the run's folder beside the text, before its hashes are made anew."""
    forge_last: bool = False
    """`forge` comes after the hashes are made anew."""
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Settings by which the program is made anew: the fault is in them, and the names of its places are what a message names."""
    other_part: str = ""
    """Part whose file is handed to the verification of the run, and whose hash the record is given."""

    # -- where: random picks ---------------------------------------------------------------------------

    def pick(self, some: Sequence[T]) -> T:
        """One of several, at random."""
        if not len(some):
            raise NotHereError
        return some[int(self.random.integers(len(some)))]

    def pick_until(self, draw: Callable[[], T], fits: Callable[[T], bool], most: int = 100) -> T:
        """The first of at most so many draws that fits."""
        for _ in range(most):
            if fits(drawn := draw()):
                return drawn
        raise NotHereError

    def bead(self, contour: bool | None = None, least_layer: int = 0, motions: int = 1, most: int = 10**9) -> Bead:
        """A bead of `motions` to `most` motions, in one of the upper layers if so asked."""
        beads = self.text.beads(contour)
        return self.pick([b for b in beads if b.layer >= least_layer and motions <= len(b.motions) <= most])

    def motion(self, pattern: str, contour: bool | None = None, inner: bool = False) -> tuple[Bead, int]:
        """A motion of a bead whose block begins with a pattern; an inner one is neither the first nor the last."""
        beads = self.text.beads(contour)
        lines = [(b, i) for b in beads for i in (b.motions[1:-1] if inner else b.motions)]
        return self.pick([(b, i) for b, i in lines if re.match(pattern, self.text.code(b.file, i))])

    def layer(self, least: int = 0) -> Layer:
        """A layer from a least number on."""
        return self.pick(self.text.layers()[least:])

    def step(self, length_mm: float) -> np.ndarray:
        """A step of a length in a random direction."""
        angle = self.random.uniform(0.0, 2.0 * np.pi)
        return length_mm * np.array([np.cos(angle), np.sin(angle)])

    # -- edits -------------------------------------------------------------------------------------------

    def line(self, file: str, i: int, end: int | None = None) -> list[Place]:
        """The lines from `i` up to `end`, counted from 0, as a place."""
        return [Place(file, i + 1, i + 1 if end is None else end)]

    def insert(self, file: str, i: int, *blocks: str) -> list[Place]:
        """Put blocks before a line, and return their place."""
        self.text.insert(file, i, *blocks)
        return self.line(file, i, i + len(blocks))

    def replace(self, file: str, i: int, pattern: str, by: str, span: int = 1) -> list[Place]:
        """Put other words in the place of the first that match within a block; the block and `span - 1` behind it are its place."""
        self.text.set(file, i, re.sub(pattern, by, self.text.code(file, i), count=1))
        return self.line(file, i, i + span)

    def whole_program(self) -> list[Place]:
        """All lines of all files."""
        return [Place(file, 1, len(lines)) for file, lines in self.text.files.items()]


@dataclass(frozen=True)
class Kind:
    """A kind of fault."""

    name: str
    changes: Changes
    spoil: Callable[..., list[Place]]
    """Plants the fault in a :class:`Ground`, with `where` as keywords; the places at which it may be told."""
    variants: tuple[tuple[str, Any], ...]
    """Control and variant of each fault of this kind."""
    what: str
    """What is planted, in words, with the variant as ``{v}`` and the facts of the ground by their names."""
    unseen: str
    """Why text and part alone cannot show it; empty where they can."""
    unseen_variants: tuple[Any, ...] | None
    """Variants that `unseen` is about; None: all."""
    in_comments: bool
    """It stands in a comment: the text is judged with its comments."""
    subjects: tuple[str, ...]
    """Parts that it can be planted in; empty: all."""
    where: Mapping[str, Any]

    def unseen_of(self, variant: Any) -> str:
        """Why text and part alone cannot show a variant; empty where they can."""
        return self.unseen if self.unseen_variants is None or variant in self.unseen_variants else ""

    def plant(self, ground: Ground) -> list[Place]:
        """Plant the fault, and say what was planted."""
        places = self.spoil(ground, **self.where)
        ground.what = (
            f"settings {ground.settings}"
            if ground.settings
            else ground.what or self.what.format(v=ground.variant, **ground.facts)
        )
        return places


KINDS: dict[str, Kind] = {}


def kind(
    name: str,
    changes: Changes,
    spoil: Callable[..., list[Place]],
    variants: Sequence[Any] | Mapping[str, Sequence[Any]] = (None,),
    *,
    what: str = "{v}",
    controls: Sequence[str] = CONTROLS,
    unseen: str = "",
    unseen_variants: tuple[Any, ...] | None = None,
    in_comments: bool = False,
    subjects: tuple[str, ...] = (),
    **where: Any,
) -> None:
    """Put a kind on the list; `variants` for every control, or by control; `where` goes to `spoil`."""
    by_control = variants if isinstance(variants, Mapping) else dict.fromkeys(controls, variants)
    every = tuple((control, variant) for control, some in by_control.items() for variant in some)
    KINDS[name] = Kind(name, changes, spoil, every, what, unseen, unseen_variants, in_comments, subjects, where)

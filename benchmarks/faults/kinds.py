"""What a kind of fault is, and the list of all kinds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from benchmarks.faults.program_text import Bead, Layer, ProgramText
from benchmarks.faults.subjects import CONTROLS, Subject
from ebamcheck.settings.config import Config

Changes = Literal["metal", "motion", "state", "record"]
"""What a fault changes: the metal laid, other motions, the state or the values of the machine, what is said of the program."""

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
    forge: Callable[[Path], None] | None = None
    """What is done to the run's folder beside the text, before its hashes are made anew."""
    forge_last: bool = False
    """`forge` comes after the hashes are made anew."""
    other_part: str = ""
    """Part whose file is handed to the verification of the run, and whose hash the record is given."""

    def pick(self, some: Sequence[T]) -> T:
        """One of several, at random."""
        if not len(some):
            raise NotHereError
        return some[int(self.random.integers(len(some)))]

    def bead(self, contour: bool | None = None, least_layer: int = 0, motions: int = 1) -> Bead:
        """A bead of at least so many motions, in one of the upper layers if so asked."""
        return self.pick(
            [b for b in self.text.beads(contour) if b.layer >= least_layer and len(b.motions) >= motions]
        )

    def layer(self, least: int = 0) -> Layer:
        """A layer from a least number on."""
        return self.pick(self.text.layers()[least:])

    def line(self, file: str, i: int, end: int | None = None) -> list[Place]:
        """The lines from `i` up to `end`, counted from 0, as a place."""
        return [Place(file, i + 1, i + 1 if end is None else end)]


@dataclass(frozen=True)
class Kind:
    """A kind of fault."""

    name: str
    changes: Changes
    plant: Callable[[Ground], list[Place]]
    variants: tuple[tuple[str, Any], ...]
    """Control and variant of each fault of this kind."""
    unseen: str = ""
    """Why text and part alone cannot show it."""
    in_comments: bool = False
    """It stands in a comment: the text is judged with its comments."""
    subjects: tuple[str, ...] = ()
    """Parts that it can be planted in; empty: all."""
    unseen_variants: tuple[Any, ...] | None = None
    """Variants that `unseen` is about; None: all."""

    def unseen_of(self, variant: Any) -> str:
        """Why text and part alone cannot show a variant; empty where they can."""
        return self.unseen if self.unseen_variants is None or variant in self.unseen_variants else ""


KINDS: dict[str, Kind] = {}


def kind(
    name: str,
    changes: Changes,
    variants: Sequence[Any] | Mapping[str, Sequence[Any]] = (None,),
    *,
    controls: Sequence[str] = CONTROLS,
    unseen: str = "",
    in_comments: bool = False,
    subjects: tuple[str, ...] = (),
    unseen_variants: tuple[Any, ...] | None = None,
) -> Callable[[Callable[[Ground], list[Place]]], Callable[[Ground], list[Place]]]:
    """Put a function that plants a fault on the list of kinds; `variants` for every control, or by control."""

    def register(plant: Callable[[Ground], list[Place]]) -> Callable[[Ground], list[Place]]:
        by_control = variants if isinstance(variants, Mapping) else dict.fromkeys(controls, variants)
        every = tuple((control, variant) for control, some in by_control.items() for variant in some)
        KINDS[name] = Kind(name, changes, plant, every, unseen, in_comments, subjects, unseen_variants)
        return plant

    return register

"""Words of NC blocks, whatever their control: numbers, a block, and what is said of a word that makes no sense."""

from __future__ import annotations

import re
from dataclasses import dataclass

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"

SKIP = re.compile(r"\s*/\d?\s*")
"""Before a block that is skipped where the operator has chosen so at the panel."""

SKIPPED = "may be skipped"
"""Event of such a block, where it does anything."""


@dataclass(slots=True)
class Block:
    """One block: its values by address, and its words without value in order."""

    values: dict[str, float]
    lists: dict[str, tuple[float, ...]]
    codes: list[str]


class WordError(Exception):
    """A word that makes no sense where it stands; columns count from 0."""

    def __init__(self, what: str, column: int) -> None:
        super().__init__(what)
        self.what = what
        self.column = column


class UnknownWord(WordError):
    """A word outside the language; the interpreter may still know the block as a template or a call."""

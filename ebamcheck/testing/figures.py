"""What a check finds: one figure against one limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

NO_LAYER = -1
"""Layer of a figure that is about no layer in particular."""


@dataclass(frozen=True)
class Figure:
    """One figure of one check; it is a violation where the value is over the limit (or no number)."""

    check: str
    model: str
    """Solid or reference model that was cut, or what was looked at."""
    layer: int
    value: float
    limit: float
    text: str = ""

    @property
    def violated(self) -> bool:
        """Whether the value is over the limit."""
        return not self.value <= self.limit

    def __str__(self) -> str:
        where = f", layer {self.layer}" if self.layer != NO_LAYER else ""
        return f"{self.check}: {self.model}{where}: {self.value:.6g} over {self.limit:.6g}: {self.text}"


def truth(check: str, model: str, holds: bool, text: str, layer: int = NO_LAYER) -> Figure:
    """Figure of something that holds or does not: 0 or 1 against 0."""
    return Figure(check, model, layer, 0.0 if holds else 1.0, 0.0, text)


def violations(figures: Iterable[Figure]) -> list[Figure]:
    """Those that are over their limit."""
    return [figure for figure in figures if figure.violated]

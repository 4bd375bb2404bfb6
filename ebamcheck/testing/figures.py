"""What a check finds: one figure against one limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

NO_LAYER = -1
"""Layer of a figure that is about no layer in particular."""


@dataclass(frozen=True)
class Figure:
    """One figure of one check; it is a violation where the value is over the limit (or no number).

    Parameters
    ----------
    check
        Name of the check.
    model
        Solid or reference model that was cut, or what was looked at.
    layer
        Index of the layer, :data:`NO_LAYER` for none in particular.
    value, limit
        In the unit that the text names.
    text
        What the value is.

    Examples
    --------
    >>> print(Figure("bound", "cube", 3, 0.02, 0.01, "mm off the exact section"))
    bound: cube, layer 4: 0.02 over 0.01: mm off the exact section
    """

    check: str
    model: str
    layer: int
    value: float
    limit: float
    text: str = ""

    @property
    def violated(self) -> bool:
        """Whether the value is over the limit."""
        return not self.value <= self.limit

    def __str__(self) -> str:
        where = f", layer {self.layer + 1}" if self.layer != NO_LAYER else ""
        return f"{self.check}: {self.model}{where}: {self.value:.6g} over {self.limit:.6g}: {self.text}"


def truth(check: str, model: str, holds: bool, text: str, layer: int = NO_LAYER) -> Figure:
    """Figure of something that holds or does not: 0 or 1 against 0."""
    return Figure(check, model, layer, 0.0 if holds else 1.0, 0.0, text)


def violations(figures: Iterable[Figure]) -> list[Figure]:
    """Those that are over their limit.

    Parameters
    ----------
    figures
        What checks found.

    Returns
    -------
    list of Figure
        In the same order.

    Examples
    --------
    >>> found = [Figure("bound", "cube", 0, 0.5, 1.0), Figure("bound", "cube", 1, float("nan"), 1.0)]
    >>> [figure.layer for figure in violations(found)]
    [1]
    """
    return [figure for figure in figures if figure.violated]

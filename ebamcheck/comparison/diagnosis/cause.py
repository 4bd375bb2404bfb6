"""A systematic cause: its kind, its size, and the share of a difference that it explains."""

from __future__ import annotations

from dataclasses import dataclass, replace

OFFSET = "constant offset"
TRANSLATION = "translation"
HEIGHT = "wrong height"
SCALE = "scale"
UNIT = "wrong unit"
ROTATION = "rotation"
MIRROR = "mirrored"
MISSING_OUTER, MISSING_HOLE = "missing outer rings", "missing holes"
EXTRA_OUTER, EXTRA_HOLE = "extra outer rings", "extra holes"
NESTING = "wrong nesting"
ORIENTATION = "wrong ring direction"
WINDING_RULE = "other winding rule"
QUANTISATION = "quantised coordinates"
DROPPED = "dropped layers"
DUPLICATED = "duplicated layers"
SHIFTED = "shifted layers"

KINDS = (
    OFFSET, TRANSLATION, HEIGHT, SCALE, UNIT, ROTATION, MIRROR, MISSING_OUTER, MISSING_HOLE, EXTRA_OUTER, EXTRA_HOLE,
    NESTING, ORIENTATION, WINDING_RULE, QUANTISATION, DROPPED, DUPLICATED, SHIFTED,
)  # fmt: skip
"""Every kind, each of which has a remedy and a meaning."""


@dataclass(frozen=True)
class Cause:
    """One systematic cause of the difference between two slicers."""

    kind: str
    """One of :data:`KINDS`."""
    size: float
    """Fitted size: mm, a factor, degrees, or a number of rings or layers; of a translation its length."""
    unit: str
    text: str
    """Description with the size: ``translation by (0.120, -0.050) mm``."""
    share: float
    """Share of the difference that it explains, 0 .. 1."""
    layers: frozenset[int] | None = None
    """Layers that the cause affects; None: all on which the two differ."""
    also: tuple[str, ...] = ()
    """Descriptions of other causes that explain these layers as well: on a cylinder, scaling is the same as an offset."""
    vector_mm: tuple[float, float] | None = None
    """Translation along X and Y; None for other kinds."""

    def scaled(self, share: float) -> Cause:
        """Return the same cause with its share multiplied by `share`, as it was found in that part of a difference only."""
        return replace(self, share=self.share * share)

    def in_words(self) -> str:
        """Description of the cause, of what else it may be, and of how much it explains.

        Examples
        --------
        >>> Cause(HEIGHT, 0.05, "mm", "cut 0.05 mm too high", 0.981).in_words()
        'cut 0.05 mm too high (explains 98 % of the difference)'
        """
        other = f", or {', or '.join(self.also)}" if self.also else ""
        return f"{self.text}{other} (explains {100.0 * self.share:.0f} % of the difference)"

"""A systematic cause: what it is, how large, and how much of a difference it explains."""

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
    """One systematic cause of the difference of a slicer from another."""

    kind: str
    """One of :data:`KINDS`."""
    size: float
    """The fitted size: mm, a factor, degrees, or how many rings or layers; of a translation its length."""
    unit: str
    text: str
    """In words, with the size: ``translation by (0.120, -0.050) mm``."""
    share: float
    """Share of the difference that it explains, 0 .. 1."""
    layers: frozenset[int] | None = None
    """Layers that it is about; None: all on which the two differ."""
    also: tuple[str, ...] = ()
    """Other causes, in words, that explain these layers as well: of a cylinder a scale is an offset, too."""
    vector_mm: tuple[float, float] | None = None
    """Of a translation: along X and Y."""

    def scaled(self, share: float) -> Cause:
        """Return the same cause of a difference of which it was found in a share."""
        return replace(self, share=self.share * share)

    def in_words(self) -> str:
        """The cause, what else it may be, and how much it explains.

        Examples
        --------
        >>> Cause(HEIGHT, 0.05, "mm", "cut 0.05 mm too high", 0.981).in_words()
        'cut 0.05 mm too high (explains 98 % of the difference)'
        """
        other = f", or {', or '.join(self.also)}" if self.also else ""
        return f"{self.text}{other} (explains {100.0 * self.share:.0f} % of the difference)"

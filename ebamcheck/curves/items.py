"""Fitted contours, one layer and one piece at a time: small values to look at, iterate over and draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ebamcheck.layers.items import index_of
from ebamcheck.showing import short_text

if TYPE_CHECKING:
    from ebamcheck.curves.columns import Curves, Piece

SAMPLE_TOLERANCE_MM = 0.005
"""Chord error of the polylines as which curves are drawn: far below what a screen shows of a part."""


@dataclass(frozen=True, eq=False, repr=False)
class CurveLayer:
    """The fitted contours of one layer; iterating over it gives their pieces in the order of travel."""

    curves: Curves
    index: int

    @property
    def height_mm(self) -> float:
        """Absolute z."""
        return float(self.curves.heights[self.index])

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces of all rings, ring by ring."""
        found = self.curves
        return tuple(found.piece(p) for ring in found.rings_of(self.index) for p in found.pieces_of(ring))

    def __iter__(self) -> Iterator[Piece]:
        """Go through the pieces."""
        return iter(self.pieces)

    def __len__(self) -> int:
        """Return the number of pieces."""
        return sum(len(self.curves.pieces_of(ring)) for ring in self.curves.rings_of(self.index))

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the curves of the layer on matplotlib axes; `style` is of its lines."""
        block = self.curves.block(self.index, self.index + 1)
        ax = block.sample_tolerance(SAMPLE_TOLERANCE_MM)[0].plot(ax, **style)
        ax.set_title(f"curves of layer {self.index + 1}, z = {self.height_mm:.6g} mm")
        return ax

    def __repr__(self) -> str:
        return short_text.line(
            f"CurveLayer [{self.index}]",
            f"z = {self.height_mm:.6g} mm",
            short_text.counted(len(self.curves.rings_of(self.index)), "ring"),
            short_text.counted(len(self), "piece"),
            short_text.counted(self.curves.block(self.index, self.index + 1).block_count(), "NC block"),
        )


# -- methods of Curves -------------------------------------------------------------------------------


def curve_iterator(curves: Curves) -> Iterator[CurveLayer]:
    """Go through the layers, from the bottom up."""
    return (CurveLayer(curves, k) for k in range(len(curves)))


def curve_item(curves: Curves, which: int) -> CurveLayer:
    """One layer by its index; a negative one counts from the top."""
    return CurveLayer(curves, index_of(which, len(curves)))


def curves_line(curves: Curves) -> str:
    """Write the curves as one line."""
    return short_text.line(
        "Curves",
        short_text.counted(len(curves), "layer"),
        short_text.heights(curves.heights),
        short_text.counted(int(curves.closed.size), "ring"),
        short_text.counted(int(curves.kind.size), "piece"),
        curves.method,
    )


def curves_html(curves: Curves) -> str:
    """Show the curves in a notebook."""
    facts = {
        "layers": len(curves),
        "heights": short_text.heights(curves.heights),
        "rings": int(curves.closed.size),
        "pieces": int(curves.kind.size),
        "NC blocks": curves.block_count(),
        "method": curves.method or "not named",
    }
    return short_text.html("Curves", facts)


def curves_plot(curves: Curves, layer: int, ax: Any = None, **style: Any) -> Any:
    """Draw the curves of one layer on matplotlib axes."""
    return curve_item(curves, layer).plot(ax, **style)

"""Windows: the parts of a field of view that are drawn one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ebamcheck_stencil.field_of_view import FieldOfView


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels of the field of view, its low corner at (x, y)."""

    x: int
    y: int
    width: int
    height: int

    def halves(self) -> tuple[Window, Window] | None:
        """Halve the rows or, of a single row, the columns; None for a single pixel."""
        if self.height > 1:
            low = self.height // 2
            return (
                Window(self.x, self.y, self.width, low),
                Window(self.x, self.y + low, self.width, self.height - low),
            )
        if self.width > 1:
            low = self.width // 2
            return Window(self.x, self.y, low, 1), Window(self.x + low, self.y, self.width - low, 1)
        return None


def windows(view: FieldOfView, largest_px: int, bands: int = 1) -> Iterator[Window]:
    """Cover the field with windows of at most `largest_px` a side, in at least `bands` bands of rows."""
    rows = min(largest_px, max(1, -(-view.height_px // bands)))
    for y in range(0, view.height_px, rows):
        for x in range(0, view.width_px, largest_px):
            yield Window(x, y, min(largest_px, view.width_px - x), min(rows, view.height_px - y))

"""A stack of layers, one layer and one ring at a time: small values to look at, iterate over and draw.

Stages of a job work on the columns of :class:`~ebamcheck.layers.stack.Layers`; these objects are for people.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.showing import short_text
from ebamcheck.showing.outline_svg import outline_svg

if TYPE_CHECKING:
    import shapely

    from ebamcheck.layers.stack import Layers
    from ebamcheck.numeric.rings import Floats

KIND_COLOURS = {"outer": "#0072b2", "hole": "#d55e00", "open path": "#cc79a7"}
"""Okabe and Ito's colours, which colour-blind people can tell apart."""


@dataclass(frozen=True, eq=False, repr=False)
class Ring:
    """One contour of a layer: an outer ring, a hole, or an open path."""

    points: Floats
    """(n, 2) mm, without a repeated end point."""
    closed: bool
    area_mm2: float
    """Positive for an outer ring, negative for a hole, 0 for an open path."""
    length_mm: float

    @property
    def is_hole(self) -> bool:
        """Whether the ring bounds a hole."""
        return self.area_mm2 < 0.0

    @property
    def kind(self) -> str:
        """Name the ring: ``outer``, ``hole`` or ``open path``."""
        if not self.closed:
            return "open path"
        return "hole" if self.is_hole else "outer"

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def __repr__(self) -> str:
        return short_text.line(
            "Ring",
            self.kind,
            short_text.counted(len(self), "point"),
            f"{self.length_mm:.6g} mm long",
            f"{self.area_mm2:.6g} mm2" if self.closed else "",
        )


@dataclass(frozen=True, eq=False, repr=False)
class Layer:
    """One layer of a stack; iterating over it gives its rings."""

    stack: Layers
    index: int

    @property
    def height_mm(self) -> float:
        """Absolute z."""
        return float(self.stack.heights[self.index])

    @property
    def rings(self) -> tuple[Ring, ...]:
        """Contours in their order in the stack."""
        stack = self.stack
        return tuple(
            Ring(
                stack.ring(r),
                bool(stack.closed[r]),
                float(stack.ring_areas[r]),
                float(stack.ring_lengths[r]),
            )
            for r in stack.rings_of(self.index)
        )

    @property
    def area_mm2(self) -> float:
        """Area of the section: outer rings less holes."""
        of = self.stack.rings_of(self.index)
        return float(self.stack.ring_areas[of.start : of.stop].sum())

    @property
    def perimeter_mm(self) -> float:
        """Length of all closed rings."""
        of = slice(self.stack.rings_of(self.index).start, self.stack.rings_of(self.index).stop)
        return float(self.stack.ring_lengths[of][self.stack.closed[of]].sum())

    @property
    def polygons(self) -> list[shapely.Polygon]:
        """Solid regions as valid polygons, holes included."""
        return self.stack.polygons(self.index)

    def __iter__(self) -> Iterator[Ring]:
        """Go through the rings."""
        return iter(self.rings)

    def __len__(self) -> int:
        """Return the number of rings."""
        return len(self.stack.rings_of(self.index))

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the contours on matplotlib axes, each kind of ring in its colour; `style` is of its lines."""
        from ebamcheck.showing.plotting import Lines, plot_lines

        rings = self.rings
        groups = [
            Lines([_outline(ring) for ring in rings if ring.kind == kind], colour)
            for kind, colour in KIND_COLOURS.items()
        ]
        return plot_lines(groups, f"layer {self.index + 1}, z = {self.height_mm:.6g} mm", ax, **style)

    def __repr__(self) -> str:
        kinds = [ring.kind for ring in self.rings] if len(self) <= 1000 else []
        return short_text.line(
            f"Layer [{self.index}]",
            f"z = {self.height_mm:.6g} mm",
            *(f"{kinds.count(k)} {k}" for k in ("outer", "hole", "open path") if k in kinds),
            "" if kinds else short_text.counted(len(self), "ring"),
            f"{self.area_mm2:.6g} mm2",
        )

    def _repr_html_(self) -> str:
        """Show the layer in a notebook."""
        facts = {"z": f"{self.height_mm:.6g} mm", "rings": len(self), "area": f"{self.area_mm2:.6g} mm2"}
        return short_text.html(f"Layer [{self.index}]", facts, _picture(self))


def _picture(layer: Layer) -> str:
    rings = layer.rings
    return outline_svg([r.points for r in rings if r.closed], [r.points for r in rings if not r.closed])


def _outline(ring: Ring) -> Floats:
    """Points of a ring; a closed one repeats its first point at the end."""
    return np.vstack([ring.points, ring.points[:1]]) if ring.closed else ring.points


# -- methods of Layers -------------------------------------------------------------------------------


def layer_iterator(layers: Layers) -> Iterator[Layer]:
    """Go through the layers, from the bottom up."""
    return (Layer(layers, k) for k in range(len(layers)))


@overload
def layer_item(layers: Layers, which: int) -> Layer: ...
@overload
def layer_item(layers: Layers, which: slice) -> Layers: ...
def layer_item(layers: Layers, which: int | slice) -> Layer | Layers:
    """One layer by its index (a negative one counts from the top), or a part of the stack by a slice."""
    if isinstance(which, slice):
        start, stop, step = which.indices(len(layers))
        if step == 1:
            return layers.block(start, max(start, stop))
        return layers.take(np.arange(start, stop, step))
    return Layer(layers, index_of(which, len(layers)))


def index_of(which: int, count: int) -> int:
    """Index from 0 of one of `count` layers.

    Raises
    ------
    SettingsError
        If there is no such layer; it is also an IndexError, so that Python's own loops end there.
    """
    if not -count <= which < count:
        raise NoSuchLayer(f"no layer {which}: the stack has {short_text.counted(count, 'layer')}, from 0")
    return int(which) % count


class NoSuchLayer(SettingsError, IndexError):
    """A layer that a stack does not have."""


def layers_line(layers: Layers) -> str:
    """Write a stack as one line."""
    return short_text.line(
        "Layers",
        short_text.counted(len(layers), "layer"),
        short_text.heights(layers.heights),
        short_text.counted(int(layers.closed.size), "ring"),
        short_text.counted(len(layers.points), "point"),
        layers.backend,
    )


def layers_html(layers: Layers) -> str:
    """Show a stack in a notebook: its figures and its middle layer."""
    facts = {
        "layers": len(layers),
        "heights": short_text.heights(layers.heights),
        "rings": int(layers.closed.size),
        "points": len(layers.points),
        "slicer": layers.backend or "not named",
    }
    return short_text.html("Layers", facts, _picture(Layer(layers, len(layers) // 2)) if len(layers) else "")


def layers_plot(layers: Layers, ax: Any = None, **style: Any) -> Any:
    """Draw every contour at its height, on three-dimensional matplotlib axes; `style` is of its lines."""
    from ebamcheck.showing.plotting import Lines, plot_in_space

    lines = []
    for layer in layer_iterator(layers):
        for ring in layer:
            outline = _outline(ring)
            lines.append(np.column_stack([outline, np.full(len(outline), layer.height_mm)]))
    title = short_text.counted(len(layers), "layer")
    return plot_in_space(Lines(lines, KIND_COLOURS["outer"], 0.5), title, ax, **style)

"""Columns of many items, such as the layers of a stack: how these are counted, taken one by one, and shown at a prompt or in a
notebook."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.showing import short_text
from ebamcheck.showing.markup import NAMESPACE, Markup, element

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 360, 300, 8
MOST_POINTS = 20_000  # of more points every second, third … is drawn: a notebook keeps its pictures

FILL = {"fill": "#9fc3e8", "fill_opacity": 0.6, "fill_rule": "nonzero"}
STYLE = {**FILL, "stroke": "#2a78b8", "stroke_width": 1}
OPEN_STYLE = {"fill": "none", "stroke": "#d55e00", "stroke_width": 2}
Item = TypeVar("Item")
Facts = dict[str, int | str]  # facts about a value by name, counts by their plural


class NoSuchItem(SettingsError, IndexError):
    """An item that a value does not have; as an IndexError it ends Python's own loops."""


class Columns(Generic[Item]):
    """A value whose columns hold many items; a subclass has :meth:`__len__`, :meth:`_item` and :meth:`_facts`."""

    _item_in: ClassVar[tuple[str, str]]  # what an item is called, and what it is one of

    def __len__(self) -> int:
        raise NotImplementedError

    def _item(self, index: int) -> Item:
        raise NotImplementedError

    def _facts(self) -> Facts:
        """What tells the value from others."""
        raise NotImplementedError

    def _more(self) -> Facts:
        """What a notebook shows beside that; it may take time."""
        return {}

    def _picture(self) -> str:
        return ""

    def __iter__(self) -> Iterator[Item]:
        """Go through the items, from the first one on."""
        return map(self._item, range(len(self)))

    def __getitem__(self, which: int) -> Item:
        """One item by its index; a negative one counts from the end."""
        return self._item(index_of(which, len(self), *self._item_in))

    def __repr__(self) -> str:
        facts = ((name.removesuffix("s"), fact) for name, fact in self._facts().items())
        said = (short_text.counted(fact, one) if isinstance(fact, int) else fact for one, fact in facts)
        return short_text.line(type(self).__name__, *said)

    def _repr_html_(self) -> str:
        facts = {**self._facts(), **self._more()}
        named = {name: "not named" if fact == "" else fact for name, fact in facts.items()}
        return short_text.html(type(self).__name__, named, self._picture())


class LayerColumns(Columns[Item]):
    """A value whose columns hold a stack of layers, from the bottom up; a subclass has :meth:`_item` and :meth:`_facts`."""

    _item_in = ("layer", "stack")

    heights: Floats

    def __len__(self) -> int:
        """Return the number of layers."""
        return int(self.heights.size)

    def _heights(self) -> Facts:
        """How many layers there are, and from where to where they go."""
        return {"layers": len(self), **({"heights": short_text.heights(self.heights)} if len(self) else {})}


def index_of(which: int, count: int, one: str = "layer", of: str = "stack") -> int:
    """Index from 0 of one of `count` items, of which a negative one counts from the end; raises :class:`NoSuchItem`."""
    if not -count <= which < count:
        raise NoSuchItem(f"no {one} {which}: the {of} has {short_text.counted(count, one)}, from 0")
    return int(which) % count


def outline_svg(closed: Sequence[Floats], open_paths: Sequence[Floats] = ()) -> str:
    """Draw closed rings (n, 2), filled where they wind around, and open paths; nothing without points."""
    every = [ring for ring in (*closed, *open_paths) if len(ring)]
    if not every:
        return ""
    points = np.concatenate(every)
    low, wide = points.min(axis=0), np.ptp(points, axis=0)
    scale = min(
        (room - 2 * MARGIN_PX) / max(float(extent), 1e-9)
        for room, extent in zip((WIDTH_PX, HEIGHT_PX), np.maximum(wide, 1e-3 * max(wide.max(), 1e-9)), strict=True)
    )  # fmt: skip
    step = -(-len(points) // MOST_POINTS)

    def path(rings: Sequence[Floats], end: str, style: Mapping[str, Any]) -> Markup:
        data = ""
        for ring in rings:
            at = (ring[:: step if len(ring) > 4 * step else 1] - low) * (scale, -scale)
            at += (MARGIN_PX, MARGIN_PX + wide[1] * scale)
            data += "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in at.tolist()) + end
        return element("path", d=data, **style) if data else Markup("")

    width, height = (round(float(e) * scale) + 2 * MARGIN_PX for e in wide)
    drawn = (path(closed, "Z", STYLE), path(open_paths, "", OPEN_STYLE))
    return str(element("svg", *drawn, xmlns=NAMESPACE, width=width, height=height))

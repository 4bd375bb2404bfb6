"""Layers: the contours of a whole stack, in the form that every slicer returns and every later stage reads."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.geometry import rings
from ebamcheck.kernels import Bools, Floats, Ints, ShortInts
from ebamcheck.layers.canonical_form import ring_forms, ring_order, rows_in_form
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import LayerColumns, outline_svg
from ebamcheck.threads import run_blocks

if TYPE_CHECKING:
    import shapely
    from shapely.geometry.base import BaseGeometry

    from ebamcheck.mesh.part import Part

UP = (0.0, 0.0, 1.0)  # slicing direction of a part that is not rotated
RINGS_A_BLOCK = 256  # fewest rings worth a thread that brings them into canonical form

# Okabe and Ito's colours, which colour-blind people can tell apart
KIND_COLOURS = {"outer": "#0072b2", "hole": "#d55e00", "open path": "#cc79a7"}


@dataclass(frozen=True, eq=False, repr=False)
class Ring:
    """One contour of a layer: an outer ring, a hole, or an open path."""

    points: Floats  # (n, 2) mm, without a repeated end point
    closed: bool
    area_mm2: float  # positive for an outer ring, negative for a hole, 0 for an open path
    length_mm: float

    @property
    def kind(self) -> str:
        """Name the ring: ``outer``, ``hole`` or ``open path``."""
        if not self.closed:
            return "open path"
        return "hole" if self.area_mm2 < 0.0 else "outer"

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        area = f"{self.area_mm2:.6g} mm2" if self.closed else ""
        points, length = short_text.counted(len(self), "point"), f"{self.length_mm:.6g} mm long"
        return short_text.line("Ring", self.kind, points, length, area)


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
        stack, of = self.stack, self.stack.rings_of(self.index)
        columns = stack.closed, stack.ring_areas, stack.ring_lengths
        return tuple(map(Ring, map(stack.ring, of), *(c[of.start : of.stop].tolist() for c in columns)))

    @property
    def area_mm2(self) -> float:
        """Area of the section: outer rings less holes."""
        return self.stack[self.index : self.index + 1].areas().item()

    @property
    def perimeter_mm(self) -> float:
        """Length of all closed rings."""
        return self.stack[self.index : self.index + 1].perimeters().item()

    @property
    def polygons(self) -> list[shapely.Polygon]:
        """Solid regions as valid polygons, holes included."""
        return self.stack.polygons(self.index)

    def __iter__(self) -> Iterator[Ring]:
        return iter(self.rings)

    def __len__(self) -> int:
        return len(self.stack.rings_of(self.index))

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the contours on matplotlib axes, each kind of ring in its colour; `style` is of its lines."""
        from ebamcheck.showing.plotting import Lines, plot_lines

        of_kind = {kind: [_outline(r) for r in self.rings if r.kind == kind] for kind in KIND_COLOURS}
        groups = [Lines(lines, KIND_COLOURS[kind]) for kind, lines in of_kind.items()]
        return plot_lines(groups, f"layer {self.index + 1}, z = {self.height_mm:.6g} mm", ax, **style)

    def __repr__(self) -> str:
        kinds = [ring.kind for ring in self.rings] if len(self) <= 1000 else []
        counts = [f"{kinds.count(k)} {k}" for k in KIND_COLOURS if k in kinds]
        counts = counts or [short_text.counted(len(self), "ring")]
        name, z, area = f"Layer [{self.index}]", f"z = {self.height_mm:.6g} mm", f"{self.area_mm2:.6g} mm2"
        return short_text.line(name, z, *counts, area)

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


@dataclass(frozen=True, eq=False, repr=False)
class Layers(LayerColumns[Layer]):
    """The contours of a stack of layers, as columns.

    Outer rings run counter-clockwise, holes clockwise. No ring repeats its first point at its end or has
    consecutive equal points; each starts at its lexicographically least point, and the rings of a layer
    are sorted by that point. Empty layers are present; open paths are kept, with ``closed`` false.

    Parameters
    ----------
    heights
        (L,) absolute z of each layer, mm.
    points
        (N, 2) contour points, mm, in build coordinates.
    ring_starts
        (R + 1,) first row of each ring in `points`.
    layer_starts
        (L + 1,) first ring of each layer.
    closed
        (R,) false for an open path.
    edge
        (N, 2) lower and upper mesh vertex of the edge cut at each point, -1 for a point without one; None if unknown.
    edge_t
        (N,) parameter of the point on that edge, 0 at the lower vertex, 1 at the upper one; None if unknown.
    part
        Content hash of the part that was sliced.
    direction
        Slicing direction in the coordinates of the part's file.
    backend, settings
        Name and settings of the slicer.
    dropped
        (L,) number of rings without area that were left out of each layer.
    mesh
        The part itself, if the layers were cut from one in this process; files do not hold it.

    Examples
    --------
    >>> layers = from_rings([0.5, 1.5], [[[(0, 0), (2, 0), (2, 2), (0, 2)]], []])
    >>> len(layers), layers.areas().tolist(), layers.ring(0).shape
    (2, [4.0, 0.0], (4, 2))
    """

    heights: Floats
    points: Floats
    ring_starts: Ints
    layer_starts: Ints
    closed: Bools
    edge: ShortInts | None = None
    edge_t: Floats | None = None
    part: str = ""
    direction: tuple[float, float, float] = UP
    backend: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    dropped: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    mesh: Part | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.dropped.size != self.heights.size:
            object.__setattr__(self, "dropped", np.zeros(self.heights.size, np.int64))

    # -- item by item, and shown -------------------------------------------------------------------

    @overload
    def __getitem__(self, which: int) -> Layer: ...
    @overload
    def __getitem__(self, which: slice) -> Layers: ...
    def __getitem__(self, which: int | slice) -> Layer | Layers:
        """One layer by its index (a negative one counts from the top), or a part of the stack by a slice."""
        if not isinstance(which, slice):
            return super().__getitem__(which)
        start, stop, step = which.indices(len(self))
        if step == 1:
            return self.block(start, max(start, stop))
        return self.take(np.arange(start, stop, step))

    def _item(self, index: int) -> Layer:
        return Layer(self, index)

    def _facts(self) -> dict[str, int | str]:
        counts = {"rings": int(self.closed.size), "points": len(self.points)}
        return {**self._heights(), **counts, "slicer": self.backend}

    def _picture(self) -> str:
        return _picture(self[len(self) // 2]) if len(self) else ""

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw every contour at its height, on three-dimensional matplotlib axes; `style` is of its lines."""
        from ebamcheck.showing.plotting import Lines, plot_in_space

        outlines = [(layer.height_mm, _outline(ring)) for layer in self for ring in layer]
        lines = [np.column_stack([points, np.full(len(points), z_mm)]) for z_mm, points in outlines]
        title = short_text.counted(len(self), "layer")
        return plot_in_space(Lines(lines, KIND_COLOURS["outer"], 0.5), title, ax, **style)

    # -- counts and measures -----------------------------------------------------------------------

    @property
    def ring_layer(self) -> Ints:
        """Layer of each ring, (R,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.layer_starts))

    @cached_property
    def ring_areas(self) -> Floats:
        """Signed area of each ring, (R,) mm2; 0 for open paths."""
        return rings.signed_areas(self.points, self.ring_starts, self.closed)

    @cached_property
    def ring_lengths(self) -> Floats:
        """Length of each ring, (R,) mm."""
        return rings.lengths(self.points, self.ring_starts, self.closed)

    @cached_property
    def ring_bounds(self) -> Floats:
        """Bounding box of each ring, (R, 4) mm: xmin, ymin, xmax, ymax."""
        return rings.bounds(self.points, self.ring_starts)

    @cached_property
    def parents(self) -> Ints:
        """Smallest enclosing ring of each ring, (R,); -1 for none and for open paths."""
        of_rings = self.ring_areas, self.ring_bounds
        return rings.parents(self.points, self.ring_starts, self.layer_starts, *of_rings)

    def _per_layer(self, weights: NDArray[Any]) -> Floats:
        return np.bincount(self.ring_layer, weights, minlength=len(self)).astype(np.float64)

    def _count(self, which: Bools) -> Ints:
        return np.bincount(self.ring_layer[which], minlength=len(self)).astype(np.int64)

    def areas(self) -> Floats:
        """Area of each layer, (L,) mm2: outer rings less holes; open paths enclose none."""
        return self._per_layer(self.ring_areas)

    def perimeters(self) -> Floats:
        """Length of all closed rings of each layer, (L,) mm."""
        return self._per_layer(np.where(self.closed, self.ring_lengths, 0.0))

    def ring_counts(self) -> Ints:
        """Number of closed rings of each layer, outer and inner together, (L,)."""
        return self._count(self.closed)

    def outer_counts(self) -> Ints:
        """Number of outer rings of each layer, (L,)."""
        return self._count(self.closed & (self.ring_areas > 0))

    def hole_counts(self) -> Ints:
        """Number of holes of each layer, (L,)."""
        return self._count(self.closed & (self.ring_areas < 0))

    def open_counts(self) -> Ints:
        """Number of open paths of each layer, (L,)."""
        return self._count(~self.closed)

    def bounds(self) -> tuple[float, float, float, float]:
        """Box around all points, mm: xmin, ymin, xmax, ymax; NaN if there are no points."""
        if not len(self.points):
            return (np.nan, np.nan, np.nan, np.nan)
        return (*self.points.min(axis=0).tolist(), *self.points.max(axis=0).tolist())

    # -- parts of a stack --------------------------------------------------------------------------

    def ring(self, r: int) -> Floats:
        """Points of ring `r`, (n, 2), without a repeated end point."""
        return self.points[self.ring_starts[r] : self.ring_starts[r + 1]]

    def rings_of(self, layer: int) -> range:
        """Indices of the rings of a layer."""
        return range(int(self.layer_starts[layer]), int(self.layer_starts[layer + 1]))

    def polygons(self, layer: int) -> list[shapely.Polygon]:
        """Solid regions of a layer, where the winding number is over 0, as valid shapely polygons with holes."""
        import shapely

        from ebamcheck.geometry.regions import valid_polygons

        holes: dict[int, list[Floats]] = {}
        for r in self.rings_of(layer):
            if self.ring_areas[r] < 0 and self.parents[r] >= 0:
                holes.setdefault(int(self.parents[r]), []).append(self.ring(r))
        outer = [r for r in self.rings_of(layer) if self.ring_areas[r] > 0 and self._winding_inside(r) > 0]
        polygons = [shapely.Polygon(self.ring(r), holes.get(r, [])) for r in outer]
        return [part for polygon in polygons for part in valid_polygons(polygon)]

    def section(self, layer: int) -> BaseGeometry:
        """Solid region of a layer as one valid geometry, made anew each time: who prepares it shares it with nobody."""
        from ebamcheck.geometry.regions import layer_section

        return layer_section(self.polygons(layer))

    def _winding_inside(self, r: int) -> int:
        """Winding number just inside ring `r`, by the directions of the rings around it."""
        winding = 0
        while r >= 0:
            winding += 1 if self.ring_areas[r] > 0 else -1
            r = int(self.parents[r])
        return winding

    def take(self, layers: ArrayLike) -> Layers:
        """Select layers by index, in the order given (repeats allowed)."""
        wanted = np.asarray(layers, dtype=np.int64).reshape(-1)
        rings, layer_starts = _expand(self.layer_starts, wanted)
        rows, ring_starts = _expand(self.ring_starts, rings)
        # Many times faster than fancy indexing of rows.
        return self._chosen(wanted, rings, lambda c: c.take(rows, axis=0), ring_starts, layer_starts)

    def block(self, start: int, stop: int) -> Layers:
        """Layers ``start .. stop - 1``, as views where possible."""
        a, b = int(self.layer_starts[start]), int(self.layer_starts[stop])
        p, q = int(self.ring_starts[a]), int(self.ring_starts[b])
        ring_starts, layer_starts = self.ring_starts[a : b + 1] - p, self.layer_starts[start : stop + 1] - a
        return self._chosen(slice(start, stop), slice(a, b), lambda c: c[p:q], ring_starts, layer_starts)

    def _chosen(
        self, layers: Any, rings: Any, rows: Callable[[Any], Any], ring_starts: Ints, layer_starts: Ints
    ) -> Layers:
        """Some layers, rings and rows of points, under the starts that they then have."""
        return replace(
            self,
            heights=self.heights[layers],
            points=rows(self.points),
            ring_starts=ring_starts,
            layer_starts=layer_starts,
            closed=self.closed[rings],
            edge=None if self.edge is None else rows(self.edge),
            edge_t=None if self.edge_t is None else rows(self.edge_t),
            dropped=self.dropped[layers],
        )

    def labelled(self, **labels: Any) -> Layers:
        """Return the same contours with other labels (`part`, `direction`, `backend`, `settings`)."""
        return replace(self, **labels)

    def labels_json(self) -> str:
        """The labels as JSON with sorted keys, the form in slice files."""
        names = ("part", "direction", "backend", "settings")
        return json.dumps({name: getattr(self, name) for name in names}, sort_keys=True, default=dict)


def canonical(
    heights: ArrayLike, points: ArrayLike, ring_starts: ArrayLike, layer_starts: ArrayLike,
    closed: ArrayLike, *, edge: ShortInts | None = None, edge_t: Floats | None = None, **labels: Any,
) -> Layers:  # fmt: skip
    """Bring raw rings, in any order within a layer, into canonical form; rings without area are `dropped`."""
    heights = np.ascontiguousarray(heights, dtype=np.float64)
    points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 2)
    ring_starts = np.ascontiguousarray(ring_starts, dtype=np.int64)
    layer_starts = np.ascontiguousarray(layer_starts, dtype=np.int64)
    closed = np.ascontiguousarray(closed, dtype=np.bool_)
    forms = np.empty((closed.size, 3), np.int64)
    run_blocks(lambda a, b: ring_forms(points, ring_starts, closed, a, b, forms), closed.size, RINGS_A_BLOCK)
    order, new_layer_starts = ring_order(points, layer_starts, forms)
    new_ring_starts = np.concatenate([[0], np.cumsum(forms[order, 1])])
    rows = np.empty(int(new_ring_starts[-1]), np.int64)
    columns = points, ring_starts, forms, order, new_ring_starts
    run_blocks(lambda a, b: rows_in_form(*columns, a, b, rows), order.size, RINGS_A_BLOCK)
    return Layers(
        heights=heights,
        points=points[rows],
        ring_starts=new_ring_starts,
        layer_starts=new_layer_starts,
        closed=closed[order],
        edge=None if edge is None else edge[rows],
        edge_t=None if edge_t is None else edge_t[rows],
        dropped=np.diff(layer_starts) - np.diff(new_layer_starts),
        **labels,
    )


def from_rings(
    heights: ArrayLike,
    layers: Sequence[Iterable[ArrayLike]],
    open_paths: Sequence[Iterable[ArrayLike]] | None = None,
    **labels: Any,
) -> Layers:
    """Build layers from lists of rings, one list per layer; for small stacks and slice files.

    >>> square = [(0, 0), (2, 0), (2, 2), (0, 2)]
    >>> from_rings([0.5], [[square]]).areas().tolist()
    [4.0]
    """
    both = zip(layers, open_paths or [[]] * len(layers), strict=True)
    paths = [[(p, True) for p in closed] + [(p, False) for p in lines] for closed, lines in both]
    return from_paths(heights, paths, **labels)


def from_paths(heights: ArrayLike, layers: Sequence[list[tuple[Any, bool]]], **labels: Any) -> Layers:
    """Build layers from lists of paths (n, 2), each with whether it is closed: such a one may repeat its first point at the end."""
    every = [(np.asarray(p, np.float64).reshape(-1, 2), closed) for layer in layers for p, closed in layer]
    points = np.concatenate([np.zeros((0, 2)), *(p for p, _ in every)])
    ring_starts = np.cumsum([0, *(len(p) for p, _ in every)])
    layer_starts = np.cumsum([0, *map(len, layers)])
    flat, closed = np.asarray(heights, np.float64).reshape(-1), [is_closed for _, is_closed in every]
    return canonical(flat, points, ring_starts, layer_starts, closed, **labels)


def from_polygons(heights: ArrayLike, layers: Sequence[Iterable[BaseGeometry]], **labels: Any) -> Layers:
    """Build layers from shapely polygons (or multi-polygons), one collection per layer."""
    import shapely

    from ebamcheck.geometry.regions import valid_polygons

    stack = []
    for layer in layers:
        polygons = [polygon for geometry in layer for polygon in valid_polygons(geometry)]
        lines = shapely.get_rings(shapely.orient_polygons(np.array(polygons, object)))
        stack.append([shapely.get_coordinates(line)[:-1] for line in lines])
    return from_rings(heights, stack, **labels)


def concatenate(blocks: Sequence[Layers]) -> Layers:
    """Join consecutive blocks of one slicer into one stack; labels are those of the first block."""
    if not blocks:
        raise SettingsError("no layers to join: give at least one block")
    columns: dict[str, list[Any]] = {name: [getattr(b, name) for b in blocks] for name in ("edge", "edge_t")}
    whole = all(column is not None for values in columns.values() for column in values)
    edges: dict[str, Any] = {n: np.concatenate(values) if whole else None for n, values in columns.items()}
    rings = np.cumsum([0] + [b.closed.size for b in blocks])
    rows = np.cumsum([0] + [int(b.ring_starts[-1]) for b in blocks])
    ring_starts = [b.ring_starts[1:] + row for b, row in zip(blocks, rows[:-1], strict=True)]
    layer_starts = [b.layer_starts[1:] + ring for b, ring in zip(blocks, rings[:-1], strict=True)]
    return replace(
        blocks[0],
        heights=np.concatenate([b.heights for b in blocks]),
        points=np.concatenate([b.points for b in blocks]),
        ring_starts=np.concatenate([[0], *ring_starts]).astype(np.int64),
        layer_starts=np.concatenate([[0], *layer_starts]).astype(np.int64),
        closed=np.concatenate([b.closed for b in blocks]),
        dropped=np.concatenate([b.dropped for b in blocks]),
        **edges,
    )


def stacked(blocks: Iterable[Layers]) -> Layers:
    """Join consecutive blocks of layers, without their cut edges, as they come; each is released once its points are copied.

    The column of points grows in place: the points are never held twice, and no memory is touched for the first time twice.
    """
    points = np.empty((0, 2))
    kept: list[Layers] = []
    for block in blocks:
        size = len(points)
        # No view of it is taken before it is whole.
        points.resize((size + len(block.points), 2), refcheck=False)
        points[size:] = block.points
        kept.append(replace(block, points=np.empty((0, 2)), edge=None, edge_t=None))
    return replace(concatenate(kept), points=points)


def _expand(starts: Ints, wanted: Ints) -> tuple[Ints, Ints]:
    """Indices of the members of the `wanted` groups of a ragged column, and the starts of the new groups."""
    sizes = np.diff(starts)[wanted]
    new_starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    members = np.arange(new_starts[-1]) + np.repeat(starts[:-1][wanted] - new_starts[:-1], sizes)
    return members.astype(np.int64), new_starts

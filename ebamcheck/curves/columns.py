"""Curves: the fitted contours of a whole stack, as columns, and in Parquet files with one row a layer:

==================  ================  ==========================================================
column              type              meaning
==================  ================  ==========================================================
``height_mm``       double            absolute z of the layer
``ring_pieces``     list<int64>       pieces of each ring
``ring_closed``     list<bool>        false for an open path
``piece_kind``      list<uint8>       0 polyline, 1 cubic B-spline, 2 arc by three points
``piece_control``   list<int64>       control points of each piece
``x``, ``y``        list<double>      control points of all pieces, mm
``knot``            list<double>      knots of all splines, mm: four more than control points
==================  ================  ==========================================================

The schema's metadata hold ``ebamcheck.curves.version`` and ``ebamcheck.curves.labels`` (JSON: method,
settings, part, direction, backend). Every number comes back in the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from ebamcheck.columns_file import (
    Column,
    ReadTable,
    arrow_columns,
    labelled,
    labels_of,
    open_table,
    readable,
    starts_of,
    write_table,
)
from ebamcheck.curves import bezier
from ebamcheck.curves.bezier import BezierSpans, arcs_through
from ebamcheck.curves.runs import ARC, LINE, SPLINE
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers import stack as layer_columns
from ebamcheck.layers.stack import UP, Layers
from ebamcheck.showing import short_text
from ebamcheck.showing.columns import LayerColumns
from ebamcheck.threads import run_blocks

MOST_SAMPLES = 2**31  # Most points of a sampling: more come from a mistyped step
DRAWN_TOLERANCE_MM = 0.005
"""Chord error of the polylines as which curves are drawn: far below what a screen shows of a part."""

VERSION = "1"  # Version of the table in a file; a reader refuses any other
LABELS = ("method", "settings", "part", "direction", "backend")

_OF_RING = {"ring_pieces": pa.large_list(pa.int64()), "ring_closed": pa.large_list(pa.bool_())}
_OF_PIECE = {"piece_kind": pa.large_list(pa.uint8()), "piece_control": pa.large_list(pa.int64())}
_OF_CONTROL = {"x": pa.large_list(pa.float64()), "y": pa.large_list(pa.float64())}
_OF_KNOT = {"knot": pa.large_list(pa.float64())}
_KINDS = {"height_mm": pa.float64(), **_OF_RING, **_OF_PIECE, **_OF_CONTROL, **_OF_KNOT}
_UNLIKE = "its columns do not have the same rings and pieces in every layer"


class Piece(NamedTuple):
    """One piece of a contour."""

    kind: int  # LINE (the polyline of control), SPLINE (a cubic B-spline) or ARC (a circular arc)
    control: Floats  # (m, 2) control points, mm
    knots: Floats  # (m + 4,) clamped knot vector, mm; empty for a line or an arc
    ring: int
    layer: int

    def __repr__(self) -> str:
        kind = {LINE: "line", ARC: "arc"}.get(self.kind, "spline")
        points = short_text.counted(len(self.control), "control point")
        return short_text.line("Piece", kind, points, f"ring {self.ring}", f"layer [{self.layer}]")


class SampledRings(NamedTuple):
    """Points along curves, ring by ring in the order of the curves."""

    points: Floats  # (N, 2) mm
    ring_starts: Ints  # (R + 1,) into points


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence for the rings (R,) of curves, and the method to which each ring without it fell back."""

    cause: NDArray[np.uint8]  # why the ring by the requested method was not accepted, of gate.CAUSES
    method: NDArray[np.uint8]  # 0 the requested method, 1 the polyline of the contour
    accepted: Bools  # whether the ring by the method that it has now is accepted
    value_mm: Floats  # distance, by the requested method, where it exceeds its limit most or is nearest to it
    limit_mm: Floats  # the limit there
    at: Floats  # (R, 2) that place, mm; NaN where there is none
    mean_limit_mm: Floats  # mean limit along the ring
    points_mm: Floats  # greatest distance of the contour's points from the ring that was taken
    bulge_mm: Floats  # greatest distance of that ring from its contour
    known: bool = True  # whether the part was; if not, the settings alone limit the curves

    def of_rings(self, which: slice) -> Evidence:
        """Evidence of some of the rings."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        return Evidence(**{n: c if n == "known" else c[which] for n, c in columns.items()})


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
        a, b = self.curves.ring_starts[self.curves.layer_starts[self.index : self.index + 2]].tolist()
        return tuple(self.curves.piece(p) for p in range(a, b))

    def __iter__(self) -> Iterator[Piece]:
        """Go through the pieces."""
        return iter(self.pieces)

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.pieces)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the curves of the layer on matplotlib axes; `style` is of its lines."""
        block = self.curves.block(self.index, self.index + 1)
        ax = block.sample_tolerance(DRAWN_TOLERANCE_MM)[0].plot(ax, **style)
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


@dataclass(frozen=True, eq=False, repr=False)
class Curves(LayerColumns[CurveLayer]):
    """The fitted contours of a stack of layers.

    Rings are those of the layers that were fitted, in their order and direction. A ring is a chain of
    pieces; each ends, bit for bit, where the next one starts, and a closed ring ends where it starts.

    Parameters
    ----------
    heights
        (L,) absolute z of each layer, mm.
    layer_starts
        (L + 1,) first ring of each layer.
    ring_starts
        (R + 1,) first piece of each ring.
    closed
        (R,) false for an open path.
    kind
        (P,) :data:`LINE` = 0, the polyline of the control points, :data:`SPLINE` = 1, a cubic B-spline, or
        :data:`ARC` = 2, the circular arc from the first to the third of three control points through the second.
    control_starts, control
        (P + 1,) into the (M, 2) control points, mm.
    knot_starts, knots
        (P + 1,) into the (K,) knots: clamped (first and last four equal), from 0 to about the length
        of the piece in mm. Dividing by the last knot gives the parameters 0 .. 1 of the paper.
    method, settings
        How the curves were fitted.
    part, direction, backend
        Labels of the layers that were fitted.
    evidence
        Evidence for each ring, if the curves were fitted in this process; files do not hold it.

    Examples
    --------
    >>> from ebamcheck.curves import fit
    >>> from ebamcheck.slicers.slicing import slice_part
    >>> from ebamcheck_models import MODELS
    >>> cube = MODELS["cube"].tessellate(0.1)
    >>> curves = fit(slice_part(cube, [3.0, 6.0]), part=cube)
    >>> len(curves), curves.block_count()
    (2, 8)
    """

    heights: Floats
    layer_starts: Ints
    ring_starts: Ints
    closed: Bools
    kind: NDArray[np.uint8]
    control_starts: Ints
    control: Floats
    knot_starts: Ints
    knots: Floats
    method: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    part: str = ""
    direction: tuple[float, float, float] = UP
    backend: str = ""
    evidence: Evidence | None = field(default=None, repr=False)

    # -- layer by layer, and shown -----------------------------------------------------------------

    def _item(self, index: int) -> CurveLayer:
        return CurveLayer(self, index)

    def _facts(self) -> dict[str, int | str]:
        counts = {"rings": int(self.closed.size), "pieces": int(self.kind.size)}
        return {**self._heights(), **counts, "method": self.method}

    def _more(self) -> dict[str, int | str]:
        return {"NC blocks": self.block_count()}

    def plot(self, layer: int, ax: Any = None, **style: Any) -> Any:
        """Draw the curves of one layer on matplotlib axes."""
        return self[layer].plot(ax, **style)

    # -- parts of a stack --------------------------------------------------------------------------

    @property
    def ring_layer(self) -> Ints:
        """Layer of each ring, (R,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.layer_starts))

    @property
    def piece_ring(self) -> Ints:
        """Ring of each piece, (P,)."""
        return np.repeat(np.arange(self.closed.size), np.diff(self.ring_starts))

    def rings_of(self, layer: int) -> range:
        """Indices of the rings of a layer."""
        return range(int(self.layer_starts[layer]), int(self.layer_starts[layer + 1]))

    def pieces_of(self, ring: int) -> range:
        """Indices of the pieces of a ring."""
        return range(int(self.ring_starts[ring]), int(self.ring_starts[ring + 1]))

    def piece(self, i: int) -> Piece:
        """One piece by its index."""
        ring = int(np.searchsorted(self.ring_starts, i, side="right")) - 1
        return Piece(
            int(self.kind[i]),
            self.control[self.control_starts[i] : self.control_starts[i + 1]],
            self.knots[self.knot_starts[i] : self.knot_starts[i + 1]],
            ring,
            int(np.searchsorted(self.layer_starts, ring, side="right")) - 1,
        )

    def evaluate(self, i: int, parameters: ArrayLike) -> Floats:
        """Points (n, 2) of piece `i` at parameters from 0 to its last knot (a line or arc: to its length), mm."""
        piece = self.piece(i)
        at = np.ascontiguousarray(parameters, dtype=np.float64).reshape(-1)
        if piece.kind == LINE:
            travelled = np.cumsum(np.hypot(*np.diff(piece.control, axis=0, prepend=piece.control[:1]).T))
            return np.column_stack([np.interp(at, travelled, column) for column in piece.control.T])
        if piece.kind == ARC:
            arcs = arcs_through(np.repeat(piece.control[None], at.size, axis=0))
            return arcs.at(at / (np.abs(arcs.sweep) * arcs.radius))
        return np.asarray(BSpline(piece.knots, piece.control, 3)(at))

    def block(self, start: int, stop: int) -> Curves:
        """Layers ``start .. stop - 1``, as views where possible."""
        a, b = int(self.layer_starts[start]), int(self.layer_starts[stop])
        p, q = int(self.ring_starts[a]), int(self.ring_starts[b])
        c, d = int(self.control_starts[p]), int(self.control_starts[q])
        k, m = int(self.knot_starts[p]), int(self.knot_starts[q])
        return replace(
            self,
            heights=self.heights[start:stop],
            layer_starts=self.layer_starts[start : stop + 1] - a,
            ring_starts=self.ring_starts[a : b + 1] - p,
            closed=self.closed[a:b],
            kind=self.kind[p:q],
            control_starts=self.control_starts[p : q + 1] - c,
            control=self.control[c:d],
            knot_starts=self.knot_starts[p : q + 1] - k,
            knots=self.knots[k:m],
            evidence=None if self.evidence is None else self.evidence.of_rings(slice(a, b)),
        )

    # -- measures ----------------------------------------------------------------------------------

    def block_counts(self) -> Ints:
        """Number of NC blocks of each piece, (P,): knot spans of a spline, segments of a line, one for an arc."""
        return bezier.span_counts(self.kind, self.control_starts, self.knots, self.knot_starts)

    def block_count(self) -> int:
        """Number of NC blocks of all pieces together."""
        return int(self.block_counts().sum())

    def lengths(self) -> Floats:
        """Arc length of each piece, (P,) mm."""
        spans = self.bezier_spans()
        along = np.where(spans.kind == LINE, spans.interval_mm, bezier.arc_lengths(spans.points))
        return np.bincount(spans.piece, along, minlength=self.kind.size).astype(np.float64)

    # -- other forms -------------------------------------------------------------------------------

    def bezier_spans(self) -> BezierSpans:
        """Bezier form of every knot span, line segment and arc, in the order of travel; arcs in short spans."""
        columns = self.kind, self.control, self.control_starts, self.knots, self.knot_starts
        points, intervals, piece = bezier.span_points(*columns)
        ring = self.piece_ring[piece]
        return BezierSpans(points, intervals, self.kind[piece], piece, ring, self.ring_layer[ring])

    def sample(self, step_mm: float) -> Layers:
        """Points on the curves whose neighbours are at most `step_mm` apart, as layers.

        Ends of pieces and of knot spans are always among the points.

        Raises
        ------
        SettingsError
            If the step is not positive, or would give more than :data:`MOST_SAMPLES` points.
        """
        return self._as_layers(self._sampled(_positive(step_mm, "step_mm"), math.inf))

    def sample_tolerance(self, tolerance_mm: float) -> Layers:
        """Polylines that leave the curves by at most `tolerance_mm`, as layers; lines stay as they are.

        Raises
        ------
        SettingsError
            If the tolerance is not positive, or would give more than :data:`MOST_SAMPLES` points.
        """
        return self._as_layers(self.sampled_rings(tolerance_mm))

    def sampled_rings(self, tolerance_mm: float) -> SampledRings:
        """Polylines within `tolerance_mm` of the curves, one per ring, in the order of the rings."""
        return self._sampled(math.inf, _positive(tolerance_mm, "tolerance_mm"))

    def _sampled(self, step_mm: float, tolerance_mm: float) -> SampledRings:
        def work(start: int, stop: int) -> SampledRings:
            block = self.block(start, stop)
            return sampled_along(block.bezier_spans(), block.closed, step_mm, tolerance_mm)

        parts = run_blocks(work, len(self))
        starts = starts_of(np.concatenate([np.diff(part.ring_starts) for part in parts]))
        return SampledRings(np.concatenate([part.points for part in parts]), starts)

    def _as_layers(self, sampled: SampledRings) -> Layers:
        return layer_columns.canonical(
            self.heights,
            sampled.points,
            sampled.ring_starts,
            self.layer_starts,
            self.closed,
            part=self.part,
            direction=self.direction,
            backend=self.backend,
            settings={"curves": self.method, **self.settings},
        )

    # -- files -------------------------------------------------------------------------------------

    def to_parquet(self, path: str | Path) -> None:
        """Write the curves, one row a layer; the file appears whole or not at all.

        Raises
        ------
        SettingsError
            If the file cannot be written.
        """
        write_table(table_of(self), Path(path), row_group_size=1024)

    @classmethod
    def from_parquet(cls, path: str | Path) -> Curves:
        """Read curves that :meth:`to_parquet` wrote, every number in the bits it was written with.

        Raises
        ------
        InputError
            If the file is missing, damaged, not Parquet, of another version, or its columns do not match.
        """
        path = Path(path)
        with readable(path), open_table(path) as file:
            table = ReadTable(file.read(), path)
        labels = labels_of(table.table.schema, "curves", VERSION, LABELS, str(path))
        heights = table.plain("height_mm", _KINDS["height_mm"])
        ring, (layer_starts,) = table.alike(_OF_RING, _UNLIKE)
        piece, (pieces,) = table.alike(_OF_PIECE, _UNLIKE)
        control, (controls,) = table.alike(_OF_CONTROL, _UNLIKE)
        knot, (knots,) = table.alike(_OF_KNOT)
        curves = cls(
            heights=heights,
            layer_starts=layer_starts,
            ring_starts=starts_of(ring["ring_pieces"]),
            closed=ring["ring_closed"],
            kind=piece["piece_kind"].copy(),
            control_starts=starts_of(piece["piece_control"]),
            control=np.column_stack([control["x"], control["y"]]),
            knot_starts=starts_of(np.where(piece["piece_kind"] == SPLINE, piece["piece_control"] + 4, 0)),
            knots=knot["knot"].copy(),
            **labels,
        )
        _check(curves, pieces, controls, knots, path)
        return curves


def _positive(value: float, name: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise SettingsError(f"{name} {value}: give a positive number of millimetres")
    return float(value)


def sampled_along(spans: BezierSpans, closed: Bools, step_mm: float, tolerance_mm: float) -> SampledRings:
    """Sample the rings of curves, closed or not (R,); an infinite step or tolerance sets no limit."""
    if math.isfinite(step_mm):
        chords = bezier.chords_for_step(spans.points, spans.kind, step_mm)
    else:
        chords = bezier.chords_for_tolerance(spans.points, spans.kind, tolerance_mm)
    total = int(chords.sum())
    if total > MOST_SAMPLES:
        points_of = f"sampling would give {total} points (limit {MOST_SAMPLES})"
        raise SettingsError(f"{points_of}: give a larger step or tolerance")
    last = np.flatnonzero(np.diff(spans.ring, append=-1) != 0)
    ends = last[~closed[spans.ring[last]]]  # an open path needs its end point too
    sizes = chords.copy()
    sizes[ends] += 1
    places = starts_of(sizes)
    points = np.empty((int(places[-1]), 2))
    starts = np.ones(len(points), np.bool_)
    starts[places[ends + 1] - 1] = False
    points[starts] = bezier.sample_spans(spans.points, spans.kind == LINE, chords)
    points[~starts] = spans.points[ends, 3]
    return SampledRings(points, starts_of(np.bincount(spans.ring, sizes, minlength=closed.size)))


# -- other stacks of the same pieces -----------------------------------------------------------------


def of_layers(
    layers: Layers,
    ring_starts: Ints,
    kind: NDArray[np.uint8],
    control: tuple[Ints, Floats],
    knots: tuple[Ints, Floats],
) -> Curves:
    """Curves of the rings of layers, from the columns of their pieces."""
    stack = layers.heights, layers.layer_starts, ring_starts, layers.closed
    return Curves(*stack, kind, *control, *knots)


def joined(blocks: Sequence[Curves]) -> Curves:
    """Consecutive blocks of one stack as one."""
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in ("heights", "closed", "kind", "control", "knots")
    }
    for name in ("layer_starts", "ring_starts", "control_starts", "knot_starts"):
        columns[name] = starts_of(np.concatenate([np.diff(getattr(block, name)) for block in blocks]))
    evidence = [block.evidence for block in blocks if block.evidence is not None]
    if evidence:
        of_rings = (f.name for f in fields(Evidence) if f.name != "known")
        every: dict[str, Any] = {n: np.concatenate([getattr(e, n) for e in evidence]) for n in of_rings}
        columns["evidence"] = replace(evidence[0], **every)
    return replace(blocks[0], **columns)


def with_rings(curves: Curves, others: Curves, which: Bools) -> Curves:
    """Curves in which the rings marked by `which` (R,) are replaced, in order, by those of `others`."""
    both = joined([replace(curves, evidence=None), replace(others, evidence=None)])
    source = np.arange(which.size)
    source[which] = which.size + np.arange(others.closed.size)
    pieces, ring_starts = _rows_of(both.ring_starts, source)
    return replace(curves, ring_starts=ring_starts, **_piece_columns(both, pieces))


def turned_over(curves: Curves, rings: Bools) -> Curves:
    """Turn the direction of some rings (R,); each starts where it did, and every curve stays the same.

    Examples
    --------
    >>> from ebamcheck.curves import fit
    >>> from ebamcheck.slicers.slicing import slice_part
    >>> from ebamcheck_models import MODELS
    >>> curves = fit(slice_part(MODELS["cube"].tessellate(0.1), [3.0]))
    >>> turned = turned_over(curves, np.array([True]))
    >>> bool((turned.control[0] == curves.control[0]).all()), bool((turned.control[1] == curves.control[-2]).all())
    (True, True)
    """
    pieces, _ = _rows_of(curves.ring_starts, np.arange(rings.size), rings)
    return replace(curves, **_piece_columns(curves, pieces, rings[curves.piece_ring]))


def _piece_columns(curves: Curves, pieces: Ints, turned: Bools | None = None) -> dict[str, Any]:
    """Columns of some pieces, in their order; those that are `turned` run the other way."""
    rows, control_starts = _rows_of(curves.control_starts, pieces, turned)
    knot_rows, knot_starts = _rows_of(curves.knot_starts, pieces, turned)
    knots = curves.knots[knot_rows]
    if turned is not None:
        sizes = np.diff(knot_starts)
        some = sizes > 0
        # Knots count from the other end; what was the last one is the first now.
        last = np.repeat(knots[knot_starts[:-1][some]], sizes[some])
        knots = np.where(np.repeat(turned, sizes), last - knots, knots)
    return {
        "kind": curves.kind[pieces],
        "control": curves.control[rows],
        "control_starts": control_starts,
        "knots": knots,
        "knot_starts": knot_starts,
    }


def _rows_of(starts: Ints, groups: Ints, turned: Bools | None = None) -> tuple[Ints, Ints]:
    """Rows of some groups that begin at `starts`, backwards in those that are `turned`, and where each of them begins now."""
    sizes = np.diff(starts)[groups]
    group, place = each_of(sizes)
    if turned is not None:
        place = np.where(turned[group], sizes[group] - 1 - place, place)
    return starts[:-1][groups][group] + place, starts_of(sizes)


# -- files -------------------------------------------------------------------------------------------


def table_of(curves: Curves) -> pa.Table:
    """Table of curves, one row a layer, as it is written."""
    rings = curves.layer_starts
    pieces = curves.ring_starts[rings]
    control, knots = curves.control_starts[pieces], curves.knot_starts[pieces]
    columns: dict[str, Column] = {
        "height_mm": (curves.heights,),
        "ring_pieces": (np.diff(curves.ring_starts), rings),
        "ring_closed": (curves.closed, rings),
        "piece_kind": (curves.kind, pieces),
        "piece_control": (np.diff(curves.control_starts), pieces),
        "x": (curves.control[:, 0], control),
        "y": (curves.control[:, 1], control),
        "knot": (curves.knots, knots),
    }
    table = pa.table(arrow_columns(columns, _KINDS))
    return table.replace_schema_metadata(labelled(curves, "curves", VERSION, LABELS))


def _check(curves: Curves, pieces: Ints, controls: Ints, knots: Ints, path: Path) -> None:
    """Refuse columns that contradict each other, before they are used as indices; (L + 1,) starts of each layer in each level."""
    known = np.isin(curves.kind, (LINE, SPLINE, ARC))
    if not known.all():
        raise InputError(f"{path}: piece kind {int(curves.kind[~known][0])} is unknown: 0, 1 and 2 are")
    sizes = np.diff(curves.control_starts)
    if (np.diff(curves.ring_starts) < 0).any() or (sizes < np.array([2, 4, 3])[curves.kind]).any():
        raise InputError(f"{path}: a piece has too few control points: 2 for a line, 4 for a spline")
    levels = (
        (curves.ring_starts, curves.layer_starts, pieces, curves.kind),
        (curves.control_starts, pieces, controls, curves.control),
        (curves.knot_starts, pieces, knots, curves.knots),
    )
    whole = all(starts[-1] == len(column) for starts, _, _, column in levels)
    if not whole or not all(np.array_equal(starts[of], own) for starts, of, own, _ in levels):
        raise InputError(f"{path}: {_UNLIKE}")
    if not all(np.isfinite(column).all() for column in (curves.control, curves.knots, curves.heights)):
        raise InputError(f"{path}: holds a number that is not finite")
    inner = np.ones(max(curves.knots.size - 1, 0), dtype=bool)
    borders = curves.knot_starts[1:-1]
    inner[borders[(borders > 0) & (borders < curves.knots.size)] - 1] = False
    if (np.diff(curves.knots)[inner] < 0).any():
        raise InputError(f"{path}: the knots of a spline decrease")

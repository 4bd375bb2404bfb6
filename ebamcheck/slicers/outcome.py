"""Outcome of a backend that slices: its file and figures, or its failure; checks of a worker's events and layers."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from ebamcheck.backend import Probe
from ebamcheck.errors import BackendFailed, BackendMissing, InputError
from ebamcheck.layers.files import LayerFile
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.plugins.processes import one_line
from ebamcheck.plugins.trial import ProbeTold, Told

# What can become of a backend but success
Failure = Literal["", "unavailable", "refused", "crashed", "timed out", "out of memory", "killed"]


@dataclass(frozen=True)
class Limits:
    """What a backend's process may use, and how many there are at a time."""

    time_s: float = 600.0
    memory_mb: float = 8192.0
    processes: int | None = None  # processes side by side; None: as many as there are cores


@dataclass(frozen=True)
class Outcome:
    """What became of one backend."""

    name: str
    failure: Failure = ""
    why: str = ""
    file: Path | None = None  # where its layers lie; None where it failed
    probe: Probe = field(default_factory=lambda: Probe(False))
    error_bound_mm: float = 0.0
    height_bound_mm: float = 0.0
    rings: int = 0
    open_paths: int = 0
    points: int = 0
    prepare_s: float = 0.0
    slice_s: float = 0.0
    peak_mb: float = 0.0

    def made(self) -> Path:
        """File of its layers; raises what it failed of."""
        if self.file is None:
            kind = BackendMissing if self.failure == "unavailable" else BackendFailed
            raise kind(f"backend {self.name!r} {self.failure}: {self.why}")
        return self.file

    def read(self) -> Layers:
        """Read all its layers; raises what it failed of."""
        from ebamcheck.layers.files import read_parquet

        return read_parquet(self.made())


LONGEST_TEXT = 4000

_Count = Annotated[int, Field(ge=0, lt=2**53)]
_Amount = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class NoEvent(Exception):
    """A worker told something that is none of its words."""


class _Event(Told):
    """Every word of an event, and what may stand behind it; of what is seen from outside a worker says no failure."""

    done: _Count = 0
    probe: ProbeTold = ProbeTold(available=False, why="", hint="", versions={}, device="")
    error_bound_mm: float = 0.0
    height_bound_mm: float = 0.0
    prepare_s: _Amount = 0.0
    slice_s: _Amount = 0.0
    peak_mb: _Amount = 0.0
    rings: _Count = 0
    open_paths: _Count = 0
    points: _Count = 0
    written: Literal[True] = True
    failure: Literal["unavailable", "refused", "crashed", "out of memory"] = "crashed"
    why: str = ""
    unwritable: str = ""


def event_of(line: bytes) -> dict[str, Any]:
    """One event from one line; raises :class:`NoEvent` with what was found."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        event = None
    if not isinstance(event, dict) or not event:
        shown = repr(one_line(line[:200].decode("utf-8", "replace"), 60))
        raise NoEvent(f"told what is no event: {shown}")
    try:
        _Event.model_validate(event)
    except ValidationError as error:
        word = str(error.errors()[0]["loc"][0])
        told = f"told {one_line(word, 40)} = {one_line(repr(event[word]), 60)}"
        raise NoEvent(f"{told}, which is no word of a worker") from None
    for word in ("why", "unwritable"):
        if word in event:
            event[word] = one_line(event[word], LONGEST_TEXT)
    if "failure" in event and "why" not in event:
        event["why"] = "it did not say why"
    return event


def bounds_fault(told: Mapping[str, Any], extent_mm: float) -> str:
    """Fault of declared bounds, in one line; empty if there is none: a bound like the part's extent promises nothing."""
    for word, what in (("error_bound_mm", "error bound"), ("height_bound_mm", "height bound")):
        value = float(told.get(word, math.nan))
        said = f"it declares {'an' if what[0] == 'e' else 'a'} {what} of {value:g} mm"
        if not 0.0 <= value < math.inf:
            return f"{said}: a bound is a number from 0 up"
        if value >= extent_mm > 0.0:
            return f"{said} on a part of {extent_mm:g} mm: that promises nothing"
    return ""


def probe_of(told: Mapping[str, Any]) -> Probe:
    """The probe that a worker told of; one of no word where it came to none."""
    return Probe(**told["probe"]) if "probe" in told else Probe(False)


# -- form of layers --------------------------------------------------------------------------------

# Coordinates so many times farther off than the largest extent or coordinate of the part are no section of it: no mistake of units is
# that large, and squares of such numbers overflow
ABSURD = 1e6


def form_fault(layers: object, part: Part, heights: NDArray[np.float64]) -> str:
    """What is wrong with the layers that a slicer returned for a part at heights (L,), mm, in one line; empty if nothing."""
    if not isinstance(layers, Layers):
        return f"it returned {type(layers).__name__}, not Layers"
    of_form = (_column_faults(layers), _height_faults(layers, heights), _ring_faults(layers))
    of_part = (found(layers, part) for found in (_value_faults, _edge_faults, _label_faults))
    for fault in chain.from_iterable((*of_form, *of_part)):
        return f"it returned layers that are not valid: {fault}"
    return ""


def file_fault(file: Path, part: Part, heights: NDArray[np.float64], whole: bool) -> str:
    """Fault of a worker's file of layers, in one line; empty if there is none. Of a stranger the `whole` file is read."""
    try:
        with LayerFile(file) as stack:
            if stack.part != part.sha256:
                return f"its file holds layers of part {stack.part[:12] or 'unknown'}, given was {part.sha256[:12]}"
            if not np.array_equal(stack.heights, heights):
                return f"its file holds {len(stack)} layers, not those of the {heights.size} heights given"
            for fault in doubt_faults(stack.settings):
                return fault
            borders = stack.borders if whole else np.zeros(1, np.int64)
            for start, stop in pairwise(borders.tolist()):
                if fault := form_fault(stack.block(start, stop), part, heights[start:stop]):
                    return fault
    except InputError as error:
        return f"its file is not one of layers: {error}"
    return ""


def _column_faults(layers: Layers) -> Iterable[str]:
    integers = dict.fromkeys(("ring_starts", "layer_starts", "dropped"), "int64")
    for name, kind in {"heights": "float64", "points": "float64", "closed": "bool", **integers}.items():
        column: Any = getattr(layers, name)
        if not isinstance(column, np.ndarray):
            yield f"{name} is {type(column).__name__}, not an array"
            return
        if column.dtype != kind:
            yield f"{name} is of {column.dtype}, not of {kind}"
        if column.shape[1:] != ((2,) if name == "points" else ()) or not column.ndim:
            yield f"{name} has the shape {column.shape}"


def _height_faults(layers: Layers, heights: NDArray[np.float64]) -> Iterable[str]:
    if layers.heights.size != heights.size:
        yield f"{layers.heights.size} for {heights.size} heights"
    elif not np.array_equal(layers.heights, heights):
        k = int(np.flatnonzero(layers.heights != heights)[0])
        yield f"layer {k + 1} of the block is at z = {layers.heights[k]} mm, asked for was {heights[k]} mm"


def _ring_faults(layers: Layers) -> Iterable[str]:
    for name, past in (("ring_starts", len(layers.points)), ("layer_starts", layers.closed.size)):
        starts = getattr(layers, name)
        if not starts.size or starts[0] != 0 or starts[-1] != past or (np.diff(starts) < 0).any():
            yield f"{name} does not rise from 0 to {past}"
            return
    if layers.ring_starts.size != layers.closed.size + 1:
        yield f"{layers.ring_starts.size - 1} rings, of which {layers.closed.size} are told whether they are closed"
    elif layers.layer_starts.size != layers.heights.size + 1:
        yield f"{layers.layer_starts.size - 1} layers of rings at {layers.heights.size} heights"
    elif layers.dropped.size != layers.heights.size:
        yield f"{layers.dropped.size} counts of dropped rings for {layers.heights.size} layers"
    else:
        sizes = np.diff(layers.ring_starts)
        short = np.flatnonzero(sizes < np.where(layers.closed, 3, 1))
        if short.size:
            yield f"ring {short[0]} has {sizes[short[0]]} points"


def _value_faults(layers: Layers, part: Part) -> Iterable[str]:
    """Coordinates that are no numbers, or are nowhere near the part."""
    largest = ABSURD * float(max(np.abs(part.bounds).max(), part.size.max()))
    wrong = np.argwhere(~(np.abs(layers.points) <= largest))  # NaN among them
    if len(wrong):
        row, axis = wrong[0]
        low, high = part.bounds[:, axis]
        where = f"point {row}, {'xy'[axis]} is {layers.points[row, axis]}"
        yield f"{where}; the part lies from {low:g} to {high:g} mm"


def _edge_faults(layers: Layers, part: Part) -> Iterable[str]:
    if (layers.edge is None) != (layers.edge_t is None):
        yield "edge and edge_t go together, and one of them is missing"
    elif layers.edge is not None and layers.edge_t is not None:
        count = len(layers.points)
        if not isinstance(layers.edge, np.ndarray) or layers.edge.dtype != np.int32:
            yield "edge is no array of int32"
        elif not isinstance(layers.edge_t, np.ndarray) or layers.edge_t.dtype != np.float64:
            yield "edge_t is no array of float64"
        elif layers.edge.shape != (count, 2) or layers.edge_t.shape != (count,):
            yield f"edge and edge_t have shapes {layers.edge.shape}, {layers.edge_t.shape} for {count} points"
        elif count and not (layers.edge.min() >= -1 and layers.edge.max() < len(part.vertices)):
            yield f"edge names a vertex that the part, of {len(part.vertices)}, does not have"


def _label_faults(layers: Layers, part: Part) -> Iterable[str]:
    if layers.part != part.sha256:
        yield f"they are of part {str(layers.part)[:12] or 'unknown'}, given was {part.sha256[:12]}"
    try:
        layers.labels_json()
        settings = dict(layers.settings)
    except (TypeError, ValueError, RecursionError) as error:
        yield f"their labels cannot be written: {error}"
        return
    yield from doubt_faults(settings)


def doubt_faults(settings: Mapping[str, Any]) -> Iterable[str]:
    """Declared ``doubtful_regions`` of another form (see :meth:`ebamcheck.backend.Prepared.slice`)."""
    regions = settings.get("doubtful_regions", ())
    if not isinstance(regions, list | tuple):
        yield "doubtful_regions is no list"
        return
    for region in regions:
        box = region.get("box_mm") if isinstance(region, Mapping) else None
        numbers = list(box) if isinstance(box, list | tuple) else []
        sound = len(numbers) == 6 and all(isinstance(n, int | float) and np.isfinite(n) for n in numbers)
        if not (sound and isinstance(region.get("why"), str)):
            yield "doubtful_regions has an entry that is not {'box_mm': six numbers, 'why': a line}"
            return

"""A part in slabs of z, for a mesh that does not fit into memory: a binary STL file is read once, then slab by slab.
Cones close each slab's mesh beyond its heights. The file is not memory-mapped: mapped pages count as the process's memory.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.mesh.bodies import ASIDE, NO_VOLUME, boxes_meeting, outermost
from ebamcheck.mesh.files import extent_notes, told_if_unreadable
from ebamcheck.mesh.inspection import Inspection, defects, inspection_of
from ebamcheck.mesh.part import FROM_DEFAULT, FROM_SETTINGS, Part
from ebamcheck.mesh.stl import (
    FACET_BYTES,
    HEADER_BYTES,
    binary_count,
    checked_count,
    facet_corners,
    looks_like_ascii,
    refuse_foreign,
)
from ebamcheck.mesh.topology import body_labels, components, direction_balance, edge_groups, weld
from ebamcheck.settings.base import UNITS_MM, unit_named

BLOCK = 1 << 18  # facets read at once: 13 MB
COLUMN_BLOCK = 1 << 22  # facets of which the heights are looked at together, to bound the working memory

Singles = NDArray[np.float32]
Index = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class FacetFile:
    """A binary STL file, after a first pass over all of it."""

    path: Path
    low: Singles
    high: Singles  # (F,) least and greatest z of each facet, in the file's unit
    millimetres: float
    outline: Part  # the part without its mesh: the corners of its box as vertices, its names, and the hash of the file
    stamp: tuple[int, int]  # size and modification time of the file when it was read

    def __len__(self) -> int:
        return len(self.low)

    def corners(self, numbers: Index) -> Singles:
        """Corner points (N, 3, 3) of facets by their ascending numbers, in the file's unit; refuses a file that has changed."""
        result = np.empty((len(numbers), 3, 3), np.float32)
        with told_if_unreadable(self.path), self.path.open("rb") as file:
            if _stamp(file) != self.stamp:
                raise InputError(f"{self.path}: was changed while it was read: start again")
            at = 0
            while at < len(numbers):
                first = int(numbers[at])
                past = int(np.searchsorted(numbers, first + BLOCK))
                block = _read_facets(file, self.path, first, int(numbers[past - 1]) + 1 - first)
                chosen = np.ascontiguousarray(block[numbers[at:past] - first])
                chosen.flags.writeable = False
                result[at:past] = facet_corners(chosen, self.path.name, first)
                at = past
        return result

    def _in_mm(self, z: Singles) -> Iterator[tuple[int, Floats]]:
        """One of both columns in mm, in blocks, each with the number of its first facet."""
        for start in range(0, len(self), COLUMN_BLOCK):
            yield start, z[start : start + COLUMN_BLOCK].astype(np.float64) * self.millimetres

    def reaching(self, lower_mm: float, upper_mm: float) -> Index:
        """Ascending numbers of the facets between two heights, these included."""
        blocks = zip(self._in_mm(self.low), self._in_mm(self.high), strict=True)
        inside = ((start, (low <= upper_mm) & (high >= lower_mm)) for (start, low), (_, high) in blocks)
        return np.concatenate([(np.flatnonzero(here) + start).astype(np.int32) for start, here in inside])

    def counted(self, z: Singles, heights: Floats, side: Literal["left", "right"]) -> Ints:
        """Facets whose `low` or `high` is at most at each of rising heights (``left``), or under it (``right``), (L,)."""
        counts = np.zeros(heights.size + 1, np.int64)
        for _, z_mm in self._in_mm(z):
            counts += np.bincount(np.searchsorted(heights, z_mm, side=side), minlength=counts.size)
        return np.cumsum(counts)[:-1]


def is_binary_stl(path: Path) -> bool:
    """Whether a file is a binary STL, by its name and its size."""
    try:
        named = path.suffix.lower() in (".stl", "") and path.is_file()
        return named and path.stat().st_size == HEADER_BYTES + FACET_BYTES * facet_count(path)
    except (InputError, OSError):
        return False


def facet_count(path: Path) -> int:
    """Number of facets by the header of a binary STL file."""
    with told_if_unreadable(path), path.open("rb") as file:
        return binary_count(file.read(HEADER_BYTES))


def read_once(path: str | Path, units: str = "", progress: Callable[[int], None] | None = None) -> FacetFile:
    """Read a binary STL file from end to end: its box, its hash, and the heights of its facets; `progress` takes facets read."""
    path = Path(path)
    if path.suffix.lower() not in (".stl", ""):
        raise InputError(
            f"{path.name}: only a binary STL file is read in slabs: write it as binary STL, or check it whole (--slabs 1)"
        )
    unit = unit_named(units or "mm")
    millimetres = UNITS_MM[unit]
    with told_if_unreadable(path), path.open("rb") as file, ThreadPoolExecutor(1) as aside:
        stamp = _stamp(file)
        head = file.read(HEADER_BYTES)
        if len(head) < HEADER_BYTES or stamp[0] != HEADER_BYTES + FACET_BYTES * binary_count(head):
            start = head + file.read(4096)
            if looks_like_ascii(start):
                raise InputError(
                    f"{path.name}: is an ASCII STL: only a binary one is read in slabs: write it as binary STL, or check it whole (--slabs 1)"
                )
            refuse_foreign(start, path.name)
        count, notes = checked_count(head, stamp[0], path.name)
        if count > 2**31 - 1:  # facets are numbered in 32 bits
            raise InputError(
                f"{path.name}: {count} facets are over the {2**31 - 1} that slabs can number: split the part"
            )
        digest = hashlib.sha256(head)
        low, high = np.empty(count, np.float32), np.empty(count, np.float32)
        least, greatest = np.full(3, np.inf), np.full(3, -np.inf)
        for first in range(0, count, BLOCK):
            block = _read_facets(file, path, first, min(BLOCK, count - first))
            # Hashing takes as long as everything else, and is independent of it.
            hashing = aside.submit(digest.update, block.data)
            corners = facet_corners(block, path.name, first)
            past = first + len(block)
            # Corner by corner and column by column: many times faster than numpy along an axis of three.
            for c in range(3):
                columns = [corners[:, c, axis] for axis in range(3)]
                least = np.minimum(least, [column.min() for column in columns])
                greatest = np.maximum(greatest, [column.max() for column in columns])
            z = [corners[:, c, 2] for c in range(3)]
            np.minimum(np.minimum(z[0], z[1]), z[2], out=low[first:past])
            np.maximum(np.maximum(z[0], z[1]), z[2], out=high[first:past])
            hashing.result()
            if progress is not None:
                progress(len(block))
        digest.update(file.read())
    box = (np.stack([least, greatest]) + 0.0) * millimetres
    notes += extent_notes(float((box[1] - box[0]).max()), unit)
    outline = Part(
        box,
        np.array([[0, 1, 1]], np.int32),
        name=path.stem,
        source=str(path),
        source_sha256=digest.hexdigest(),
        units=unit,
        units_from=FROM_SETTINGS if units else FROM_DEFAULT,
        notes=tuple(notes),
    )
    return FacetFile(path, low, high, millimetres, outline, stamp)


def _read_facets(file: BinaryIO, path: Path, first: int, count: int) -> NDArray[np.uint16]:
    """Consecutive facets as 16-bit words, (F, 25); raises :class:`InputError` if the file ends too early."""
    file.seek(HEADER_BYTES + FACET_BYTES * first)
    data = file.read(FACET_BYTES * count)
    if len(data) < FACET_BYTES * count:
        raise InputError(f"{path}: was cut while it was read: start again")
    return np.frombuffer(data, np.uint16).reshape(count, -1)


def _stamp(file: BinaryIO) -> tuple[int, int]:
    found = os.fstat(file.fileno())
    return found.st_size, found.st_mtime_ns


@dataclass(frozen=True, eq=False)
class Slab:
    """One slab of a mesh: a closed part with the sections of the whole one at the slab's heights, and with its box."""

    part: Part
    own: Part  # open mesh of the facets from the file; the others are cones
    numbers: Index  # numbers of these facets in the file, ascending
    # An item with its lowest point at `lower_mm <= z < upper_mm` is counted in this slab only
    lower_mm: float
    upper_mm: float
    next_from_mm: float  # facets that reach up to this height are also in the next slab


@dataclass(frozen=True, eq=False)
class Division:
    """Facets of a file by the slabs that they reach into."""

    file: FacetFile
    layers: Ints  # (S + 1,) first layer of each slab, and the number of layers
    borders_mm: Floats  # (S + 1,) z between the slabs; the outermost are infinite
    reach_mm: float  # distance beyond its borders to which a slab has all facets
    most_facets: int  # facets of the largest slab
    crossings: int  # facets cut, summed over all layers: the number of points of their exact contours

    def __len__(self) -> int:
        return len(self.layers) - 1

    def slab(self, k: int) -> Slab:
        """Read one slab of the file, weld it and close it."""
        lower, upper = self.borders_mm[k : k + 2].tolist()
        numbers = self.file.reaching(lower - self.reach_mm, upper + self.reach_mm)
        vertices, faces = weld(self.file.corners(numbers))
        if self.file.millimetres != 1.0:
            vertices *= self.file.millimetres
        box = self.file.outline.vertices
        cones = closing_cones(vertices, faces, lower - self.reach_mm, upper + self.reach_mm)
        joined = np.ascontiguousarray(np.concatenate([faces, cones]))
        part = replace(self.file.outline, vertices=np.concatenate([vertices, box]), faces=joined)
        own = replace(part, vertices=part.vertices[: len(vertices)], faces=part.faces[: len(faces)])
        return Slab(part, own, numbers, lower, upper, upper - self.reach_mm)


def closing_cones(vertices: Floats, faces: Index, lower_mm: float, upper_mm: float) -> Index:
    """Facets (C, 3) that close open edges below `lower_mm` or above `upper_mm`, to vertices V and V + 1 beyond all others."""
    groups = edge_groups(faces, len(vertices))
    balance = direction_balance(faces, groups)
    odd = np.flatnonzero(balance)
    half_edge = groups.half_edges[groups.starts[odd]]
    ends = np.stack([faces[half_edge // 3, half_edge % 3], faces[half_edge // 3, (half_edge % 3 + 1) % 3]])
    lesser, greater = ends.min(axis=0), ends.max(axis=0)
    z = vertices[ends, 2]
    below, above = z.max(axis=0) < lower_mm, z.min(axis=0) > upper_mm
    beyond = below | above
    apex = np.where(below, len(vertices), len(vertices) + 1)
    # As many facets in the opposite direction as one direction has in excess.
    times = np.where(beyond, np.abs(balance[odd]), 0)
    rising = balance[odd] > 0
    cones = np.stack([np.where(rising, greater, lesser), np.where(rising, lesser, greater), apex], axis=1)
    return np.repeat(cones, times, axis=0).astype(np.int32)


def divided(file: FacetFile, heights: Floats, slabs: int, reach_mm: float) -> Division:
    """Divide layers at ascending heights into slabs of about equal work, each with all facets within a reach."""
    begun = file.counted(file.low, heights, "left")
    # Facets that begin at each height, and those cut there (at z = h + 0).
    begins, crossing = np.diff(begun, prepend=0), begun - file.counted(file.high, heights, "left")
    layers = slab_layers(begins, crossing, min(slabs, heights.size))
    _, sizes = _reaching(file, heights, layers, reach_mm)
    # Layers between two bodies are joined to those below: a slab without facets would be no mesh.
    layers = np.concatenate([layers[:-1][sizes > 0], layers[-1:]])
    borders, sizes = _reaching(file, heights, layers, reach_mm)
    return Division(file, layers, borders, reach_mm, int(sizes.max()), int(crossing.sum()))


def _reaching(file: FacetFile, heights: Floats, layers: Ints, reach_mm: float) -> tuple[Floats, Ints]:
    """Borders of slabs (S + 1,), and the number of facets within the reach of each (S,)."""
    between = 0.5 * (heights[layers[1:-1] - 1] + heights[layers[1:-1]])
    borders = np.concatenate([[-np.inf], between, [np.inf]])
    begun = file.counted(file.low, borders[1:] + reach_mm, "left")
    return borders, begun - file.counted(file.high, borders[:-1] - reach_mm, "right")


def slab_layers(begins: Ints, crossing: Ints, slabs: int) -> Ints:
    """First layer of each slab, and the number of layers (S + 1,); work is half the facets that begin, half those cut.

    >>> slab_layers(np.array([6, 0, 0, 6]), np.array([4, 4, 4, 4]), 2).tolist()
    [0, 2, 4]
    """
    layers = begins.size
    weight = begins / max(int(begins.sum()), 1) + crossing / max(int(crossing.sum()), 1) + 1e-9
    shares = np.cumsum(weight) / weight.sum()
    wanted = np.searchsorted(shares, np.arange(1, slabs) / slabs) + 1
    # Every slab has at least one layer.
    rising = np.maximum.accumulate(wanted - np.arange(1, slabs)) + np.arange(1, slabs)
    inner = np.minimum(rising, layers - slabs + np.arange(1, slabs))
    return np.concatenate([[0], inner, [layers]]).astype(np.int64)


class SlabInspection:
    """Inspection of a part slab by slab, from the lowest on; bodies are joined by facets that lie in two slabs."""

    def __init__(self, outline: Part, facets: int) -> None:
        self._outline = outline
        self._facets = facets
        self._counts = Counter[str]()
        # Of each slab: volumes (P,) of pieces of bodies, about the middle of the part's box, corners of their boxes (P, 3) twice, whether
        # they are open (P,), and pieces of the slab below and of this one that share a facet (N, 2)
        self._pieces: list[tuple[Floats, Floats, Floats, Bools, Ints]] = []
        self._known = 0
        # Facets that may reach into the next slab, and the piece of each.
        self._carried = np.zeros(0, np.int32), np.zeros(0, np.int64)

    def add(self, slab: Slab) -> None:
        """Add the next slab, from the bottom up."""
        part = slab.own
        groups = edge_groups(part.faces, len(part.vertices))
        counts, open_facets = defects(part, groups, slab.lower_mm, slab.upper_mm)
        self._counts.update(counts)
        body = body_labels(part.faces, groups)
        used = body >= 0
        volumes, lower, upper = _measured(slab, body, self._outline.bounds.mean(axis=0))
        is_open = np.zeros(volumes.size, np.bool_)
        is_open[body[open_facets]] = True
        numbers, pieces = slab.numbers[used], body[used].astype(np.int64) + self._known
        _, below, here = np.intersect1d(self._carried[0], numbers, assume_unique=True, return_indices=True)
        links = np.unique(np.stack([self._carried[1][below], pieces[here]], axis=1), axis=0)
        self._pieces.append((volumes, lower, upper, is_open, links))
        self._known += is_open.size
        carried = part.vertices[part.faces[used], 2].max(axis=1) >= slab.next_from_mm
        self._carried = numbers[carried], pieces[carried]

    def found(self) -> Inspection:
        """Result for the slabs added so far."""
        volumes, lower, upper, is_open = self._bodies()
        size = self._outline.size
        negative = volumes < -NO_VOLUME * float(size.max(initial=0.0)) ** 3
        return inspection_of(
            self._outline,
            self._counts,
            volumes,
            volume_mm3=float(volumes.sum()),
            facets=self._facets,
            inside_out_bodies=int((outermost(negative, volumes, lower, upper) & ~is_open).sum()),
            open_bodies=int(is_open.sum()),
            union_known=not len(boxes_meeting(lower, upper, ASIDE * float(np.linalg.norm(size)))),
        )

    def _bodies(self) -> tuple[Floats, Floats, Floats, Bools]:
        """Volumes (B,), lower and upper corners of the boxes (B, 3), and whether open (B,), of the bodies."""
        if not self._known:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.bool_)
        pieces, least, greatest, opened, links = map(np.concatenate, zip(*self._pieces, strict=True))
        body = components(self._known, *links.T)
        count = int(body.max()) + 1
        volumes, is_open = np.zeros(count), np.zeros(count, np.bool_)
        lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        np.add.at(volumes, body, pieces)
        np.minimum.at(lower, body, least)
        np.maximum.at(upper, body, greatest)
        np.logical_or.at(is_open, body, opened)
        return volumes, lower, upper, is_open


def _measured(slab: Slab, body: Index, middle: Floats) -> tuple[Floats, Floats, Floats]:
    """Volumes (B,) of the facets counted in a slab, about the middle of the part's box, and corners (B, 3) of the boxes of all."""
    count = int(body.max(initial=-1)) + 1
    volumes, lower, upper = np.zeros(count), np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    part = slab.own
    for start in range(0, len(body), BLOCK):
        rows = start + np.flatnonzero(body[start : start + BLOCK] >= 0)
        of, (a, b, c) = body[rows], np.moveaxis(part.vertices[part.faces[rows]], 1, 0)
        least = np.minimum(np.minimum(a, b), c)
        np.minimum.at(lower, of, least)
        np.maximum.at(upper, of, np.maximum(np.maximum(a, b), c))
        told = (least[:, 2] >= slab.lower_mm) & (least[:, 2] < slab.upper_mm)
        a, b, c = a[told], b[told], c[told]
        sixfold = np.einsum("ij,ij->i", a - middle, np.cross(b - a, c - a))
        volumes += np.bincount(of[told], sixfold, minlength=count) / 6.0
    return volumes, lower, upper

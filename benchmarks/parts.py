"""The parts that are measured: two series of eleven meshes of one solid, kept as STL files between runs.

``ladder``
    The reference model of that name at the paper's eleven tolerances. A tolerance alone makes tall and thin facets: 31.1 million
    points at the top.
``even``
    The same solid with facets as near to equilateral as its surfaces allow, as many as the paper's eleven file sizes hold: 9.0
    million points at the top. Rows are staggered by half a column and lie a half of root three of an edge apart; channels have at
    least :data:`LEAST_COLUMNS` columns, so the coarsest meshes have long facets there.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

import ebamcheck_models
from ebamcheck.atomic_file import replacing
from ebamcheck.mesh.stl import FACET, HEADER_BYTES
from ebamcheck_models import LADDER, MODELS, write_stl
from ebamcheck_models.model import Floats, single
from ebamcheck_models.ring_wall import LAYER_MM, Channel, RingWall, Rounding, levels
from ebamcheck_reports.paper import published

Series = Literal["ladder", "even"]
SERIES: tuple[Series, ...] = ("ladder", "even")

FOLDER = Path(__file__).parent / ".parts"
FACET_BYTES = 50
TOP = len(published.SIZES_MB)
BASE_SIZE = 6
"""The size of some 38,000 facets, to which growth is related."""

DEMO_TOLERANCE_MM, DEMO_REFERENCE_MM = 0.1, 0.005
"""Of the demo part and its reference, as in the Makefile's target `demo`."""

SHUFFLE_SEED = 4
DIGEST_LETTERS = 8


@dataclass(frozen=True)
class BenchmarkPart:
    """A file to be sliced."""

    series: str
    size: int
    path: Path
    facets: int
    layer_mm: float

    @property
    def key(self) -> str:
        """Name in tables of raw figures."""
        return f"{self.series}-{self.size}"

    @property
    def bytes(self) -> int:
        """Size of the file."""
        return self.path.stat().st_size


def benchmark_part(series: Series, size: int, layer_mm: float = LAYER_MM) -> BenchmarkPart:
    """Return the part of a series of that size, 1 .. 11; it is made on the first call."""

    def make(path: Path) -> None:
        if series == "ladder":
            write_stl(LADDER.tessellate(published.tolerances_by_size()[size - 1]), path)
        else:
            write_even_mesh(LADDER, round((published.SIZES_MB[size - 1] * 2**20 - HEADER_BYTES) / FACET_BYTES), path)

    path = _kept(f"{series}-{size:02}", make)
    return BenchmarkPart(series, size, path, facets_in(path), layer_mm)


def shuffled(part: BenchmarkPart) -> BenchmarkPart:
    """Return the same part with its facets in random order."""

    def make(path: Path) -> None:
        data = part.path.read_bytes()
        facets = np.frombuffer(data, f"V{FACET_BYTES}", offset=HEADER_BYTES)
        order = np.random.default_rng(SHUFFLE_SEED).permutation(len(facets))
        with replacing(path) as temporary:
            temporary.write_bytes(data[:HEADER_BYTES] + facets[order].tobytes())

    path = _kept(f"{part.series}-{part.size:02}-shuffled", make)
    return BenchmarkPart(f"{part.series}-shuffled", part.size, path, part.facets, part.layer_mm)


def model_file(name: str, tolerance_mm: float) -> Path:
    """Return the file of a reference model."""
    return _kept(f"{name}-{tolerance_mm:g}", lambda path: write_stl(MODELS[name].tessellate(tolerance_mm), path))


def facets_in(path: Path) -> int:
    """Facets of a binary STL file."""
    with path.open("rb") as file:
        return int.from_bytes(file.read(HEADER_BYTES)[80:], "little")


def sizes_of(text: str) -> tuple[int, ...]:
    """Read sizes as the command line gives them: numbers and ranges, 1 .. 11.

    >>> sizes_of("1,6,9-11")
    (1, 6, 9, 10, 11)
    """
    found: set[int] = set()
    for item in text.split(","):
        first, _, last = item.partition("-")
        found.update(range(int(first), int(last or first) + 1))
    if not found or min(found) < 1 or max(found) > TOP:
        raise ValueError(f"sizes {text!r}: give numbers and ranges from 1 to {TOP}, such as 1,6,9-11")
    return tuple(sorted(found))


def _kept(name: str, make: Callable[[Path], object]) -> Path:
    """Return the file of that name, made where there is none by the code that is here now."""
    path = FOLDER / f"{name}-{_code_digest()}.stl"
    if not path.is_file():
        FOLDER.mkdir(exist_ok=True)
        for outdated in FOLDER.glob(f"{name}-{'?' * DIGEST_LETTERS}.stl"):
            outdated.unlink()
        make(path)
    return path


@cache
def _code_digest() -> str:
    """Hash of the code that makes parts, so that no file outlives it."""
    digest = hashlib.sha256()
    for source in (*sorted(Path(ebamcheck_models.__file__).parent.glob("*.py")), Path(__file__)):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:DIGEST_LETTERS]


# -- near-equilateral facets --------------------------------------------------------------------------------

LEAST_COLUMNS = 6
LEAST_ROWS = 2
"""Rows of cells on a rounded end: with one, both ends of it would be a single fan."""

TRIALS = np.linspace(0.9, 1.3, 801)
"""Edges that are tried, over the edge that the area asks for: counts of rows and columns are whole numbers."""


class Grid(NamedTuple):
    """Columns around a surface and rows of cells on its lower end, between the ends, and on its upper end."""

    columns: int
    rows: tuple[int, int, int]

    @property
    def cells(self) -> int:
        """Cells of one side."""
        return self.columns * sum(self.rows)


class Grids(NamedTuple):
    """The grid of either side of the wall, and those of its channels."""

    wall: Grid
    channels: tuple[Grid, ...]

    @property
    def facets(self) -> int:
        """Two a cell, on both sides of the wall; a channel's end rows are fans of one a column."""
        return 4 * self.wall.cells + sum(2 * (g.cells - g.columns) for g in self.channels)


def grids_of(wall: RingWall, facets: int) -> Grids:
    """Grids whose count of facets comes nearest."""
    area = 2.0 * _circumference(wall) * wall.height_mm
    area += sum(_girth(c) * (c.ends.high_mm - c.ends.low_mm) for c in wall.channels)
    edge = math.sqrt(4.0 * area / (math.sqrt(3.0) * facets))
    tried = (_grids(wall, float(share) * edge) for share in TRIALS)
    return min(tried, key=lambda grids: abs(grids.facets - facets))


def _grids(wall: RingWall, edge_mm: float) -> Grids:
    end_mm = _quarter_mm(wall.half_mm, wall.lip_mm)
    return Grids(
        _grid(_circumference(wall), end_mm, wall.ends, edge_mm),
        tuple(_grid(_girth(c), _quarter_mm(c.through_mm, c.ends.cap_mm), c.ends, edge_mm) for c in wall.channels),
    )  # fmt: skip


def _grid(around_mm: float, end_mm: float, ends: Rounding, edge_mm: float) -> Grid:
    step_mm = 0.5 * math.sqrt(3.0) * edge_mm
    straight_mm = ends.high_mm - ends.low_mm - 2.0 * ends.cap_mm
    end = max(LEAST_ROWS, round(end_mm / step_mm))
    return Grid(
        max(LEAST_COLUMNS, round(around_mm / edge_mm)), (end, max(LEAST_ROWS, round(straight_mm / step_mm)), end)
    )  # fmt: skip


def _circumference(wall: RingWall) -> float:
    """Length of the wall's middle at half its height, mm."""
    u, middle = np.arange(721) / 720.0, np.array(0.5 * wall.height_mm)
    return float(np.linalg.norm(np.diff(wall.wall_point(u, middle, np.zeros(()), 1.0)), axis=0).sum())


def _girth(channel: Channel) -> float:
    """Length around a channel, mm."""
    return 2.0 * (_quarter_mm(channel.along_mm, channel.through_mm) + _quarter_mm(channel.through_mm, channel.along_mm))


def _quarter_mm(a_mm: float, b_mm: float) -> float:
    """Length of a quarter of an ellipse, mm."""
    angle = np.linspace(0.0, 0.5 * np.pi, 181)
    return float(np.hypot(np.diff(a_mm * np.cos(angle)), np.diff(b_mm * np.sin(angle))).sum())


def channel_mesh(wall: RingWall, channel: Channel, grid: Grid) -> tuple[Floats, NDArray[np.int64]]:
    """A closed tube between two poles, looking into it."""
    z, cap = levels(channel.ends, list(grid.rows))
    u = _staggered(len(z) - 2, grid.columns)
    rings = wall.tube_point(channel, u, z[1:-1, None], cap[1:-1, None]).reshape(3, -1).T
    poles = wall.tube_point(channel, np.zeros(2), z[[0, -1]], np.zeros(2)).T
    points = single(np.concatenate([poles, rings]))
    ring = np.arange(grid.columns)
    bottom, top = 2 + ring, len(points) - grid.columns + ring
    faces = [
        np.column_stack([np.zeros_like(ring), np.roll(bottom, -1), bottom]),
        2 + staggered_faces(len(z) - 2, grid.columns),
        np.column_stack([np.ones_like(ring), top, np.roll(top, -1)]),
    ]
    return points, np.concatenate(faces)[:, ::-1]


def _staggered(rows: int, columns: int) -> Floats:
    """Parameters (rows, columns) around, every other row moved by half a column."""
    result: Floats = (np.arange(columns)[None, :] + 0.5 * (np.arange(rows)[:, None] % 2)) / columns
    return result


def staggered_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Two facets a cell, (2 (rows - 1) columns, 3), along the short diagonal of each."""
    k, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = k * columns + j, k * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    moved = (k % 2 == 1)[..., None]
    lower = np.where(moved, np.stack([a, b, d], axis=-1), np.stack([a, b, c], axis=-1))
    upper = np.where(moved, np.stack([a, d, c], axis=-1), np.stack([b, d, c], axis=-1))
    return np.stack([lower, upper], axis=2).reshape(-1, 3).astype(np.int64)


FACETS_A_BAND = 1 << 20
"""Facets that are made at once, about: the mesh may be larger than memory."""


def write_even_mesh(wall: RingWall, facets: int, path: Path) -> int:
    """Write a closed, outward mesh of about that many facets, its vertices on the surface, as binary STL; how many there are."""
    grids = grids_of(wall, facets)
    count = 0
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(bytes(HEADER_BYTES))
        tubes = (channel_mesh(wall, *one) for one in zip(wall.channels, grids.channels, strict=True))
        for corners in (*_bands(wall, grids.wall), *(points[faces] for points, faces in tubes)):
            rows = np.zeros(len(corners), FACET)
            rows["corners"] = corners
            rows.tofile(file)
            count += len(rows)
        file.seek(HEADER_BYTES - 4)
        file.write(count.to_bytes(4, "little"))
    return count


def _bands(wall: RingWall, grid: Grid) -> Iterator[Floats]:
    """Corners (F, 3, 3) of the wall's facets, some rows of cells at a time: up outside, over the lip, down inside."""
    z, lip = levels(wall.ends, list(grid.rows))
    up = np.arange(len(z))
    row = np.concatenate([up, up[-2:0:-1], up[:1]])
    side = np.where(np.arange(len(row)) < len(up), 1.0, -1.0)
    side[-1] = 1.0  # the last row is the first again

    def points(first: int, stop: int) -> Floats:
        """Points (rows x columns, 3) of consecutive rows on one side."""
        k = np.arange(first, stop) % (len(row) - 1)
        u = (np.arange(grid.columns) + 0.5 * (k[:, None] % 2)) / grid.columns
        at = wall.wall_point(u, z[row[first:stop]][:, None], lip[row[first:stop]][:, None], float(side[first]))
        return single(at.reshape(3, -1).T)

    rows_a_band = max(1, FACETS_A_BAND // (2 * grid.columns)) // 2 * 2 or 2
    last = points(0, 1)
    for start in range(0, len(row) - 1, rows_a_band):
        # Every row is worked out once, so that bands meet in the same bits: its last one is the next band's first.
        stop = min(start + rows_a_band + 1, len(row))
        cuts = [start + 1, *(k for k in (len(up), len(row) - 1) if start + 1 < k < stop), stop]
        made = np.concatenate([last, *(points(a, b) for a, b in pairwise(cuts))])
        last = made[-grid.columns :]
        yield made[staggered_faces(len(made) // grid.columns, grid.columns)]

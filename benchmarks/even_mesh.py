"""The ladder's solid with facets as near to equilateral as its surfaces allow.

Rows are staggered by half a column and lie a half of root three of an edge apart. Channels have at least
:data:`LEAST_COLUMNS` columns, so the coarsest meshes have long facets there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.mesh.stl import FACET, HEADER_BYTES
from ebamcheck_models.model import Floats, single
from ebamcheck_models.ring_wall import Channel, RingWall, Rounding, levels

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


def even_mesh(wall: RingWall, facets: int) -> Part:
    """Return a closed, outward mesh of about that many facets, its vertices on the surface and 32-bit floats."""
    grids = grids_of(wall, facets)
    points, faces = _wall_mesh(wall, grids.wall)
    vertices, triangles, first = [points], [faces], len(points)
    for channel, grid in zip(wall.channels, grids.channels, strict=True):
        points, faces = channel_mesh(wall, channel, grid)
        vertices.append(points)
        triangles.append(faces + first)
        first += len(points)
    return from_arrays(np.concatenate(vertices), np.concatenate(triangles), f"{wall.name}-even")


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
    return 2.0 * (
        _quarter_mm(channel.along_mm, channel.through_mm) + _quarter_mm(channel.through_mm, channel.along_mm)
    )


def _quarter_mm(a_mm: float, b_mm: float) -> float:
    """Length of a quarter of an ellipse, mm."""
    angle = np.linspace(0.0, 0.5 * np.pi, 181)
    return float(np.hypot(np.diff(a_mm * np.cos(angle)), np.diff(b_mm * np.sin(angle))).sum())


def _wall_mesh(wall: RingWall, grid: Grid) -> tuple[Floats, NDArray[np.int64]]:
    """A torus of level rows: up outside, over the lip, down inside. It has an even number of rows."""
    z, lip = levels(wall.ends, list(grid.rows))
    up = np.arange(len(z))
    down = up[-2:0:-1]
    row, side = np.concatenate([up, down]), np.concatenate([np.ones(len(up)), -np.ones(len(down))])
    u = _staggered(len(row), grid.columns)
    points = _rows(wall.wall_point(u, z[row][:, None], lip[row][:, None], 1.0), side > 0.0)
    points += _rows(wall.wall_point(u, z[row][:, None], lip[row][:, None], -1.0), side < 0.0)
    return single(points), staggered_faces(len(row) + 1, grid.columns) % len(points)


def _rows(points: Floats, kept: NDArray[np.bool_]) -> Floats:
    """Points (rows x columns, 3) of a grid (3, rows, columns), 0 in the rows that are not kept."""
    return np.where(kept[None, :, None], points, 0.0).reshape(3, -1).T


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


# -- the same mesh in a file, band by band: it may be larger than memory ------------------------------------------


FACETS_A_BAND = 1 << 20
"""Facets that are made at once, about."""


def write_even_mesh(wall: RingWall, facets: int, path: Path) -> int:
    """Write the mesh that :func:`even_mesh` makes, facet by facet; returns how many there are.

    Parameters
    ----------
    wall
        The solid.
    facets
        How many, about.
    path
        Binary STL file; it appears when it is whole.
    """
    grids = grids_of(wall, facets)
    count = 0
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(bytes(HEADER_BYTES))
        for corners in _bands(wall, grids.wall):
            count += _append(file, corners)
        for channel, grid in zip(wall.channels, grids.channels, strict=True):
            points, faces = channel_mesh(wall, channel, grid)
            for first in range(0, len(faces), FACETS_A_BAND):
                count += _append(file, points[faces[first : first + FACETS_A_BAND]])
        file.seek(HEADER_BYTES - 4)
        file.write(count.to_bytes(4, "little"))
    return count


def _append(file: BinaryIO, corners: Floats) -> int:
    facets = np.zeros(len(corners), FACET)
    facets["corners"] = corners
    facets.tofile(file)
    return len(facets)


def _bands(wall: RingWall, grid: Grid) -> Iterator[NDArray[np.float64]]:
    """Corners (F, 3, 3) of the wall's facets, some rows of cells at a time, up outside and down inside."""
    z, lip = levels(wall.ends, list(grid.rows))
    up = np.arange(len(z))
    row = np.concatenate([up, up[-2:0:-1]])
    side = np.concatenate([np.ones(len(up)), -np.ones(len(up) - 2)])
    rows_a_band = max(1, FACETS_A_BAND // (2 * grid.columns)) // 2 * 2 or 2
    first_row = last_row = _points(wall, grid, row[:1], side[0], z, lip, 0)
    for start in range(0, len(row), rows_a_band):
        # Every row is worked out once, so that bands meet in the same bits: its last one is the next band's first.
        stop = min(start + rows_a_band, len(row) - 1)
        made = [last_row]
        made += [
            _points(wall, grid, row[chosen], side[chosen[0]], z, lip, int(chosen[0]))
            for chosen in _by_side(np.arange(start + 1, stop + 1), side)
        ]
        if stop == len(row) - 1:
            made.append(first_row)
        points = np.concatenate(made)
        last_row = points[-grid.columns :]
        faces = staggered_faces(len(points) // grid.columns, grid.columns)
        yield points[faces]
        if stop == len(row) - 1:
            return


def _by_side(rows: NDArray[np.int64], side: Floats) -> list[NDArray[np.int64]]:
    """Rows of a band, those outside and those inside of the wall."""
    return [chosen for chosen in (rows[side[rows] > 0.0], rows[side[rows] < 0.0]) if chosen.size]


def _points(
    wall: RingWall,
    grid: Grid,
    rows: NDArray[np.int64],
    side: float,
    z: Floats,
    lip: Floats,
    first: int,
) -> Floats:
    """Points (rows x columns, 3) of consecutive rows, of which the first is the `first` of all."""
    u = (
        np.arange(grid.columns)[None, :] + 0.5 * ((first + np.arange(len(rows)))[:, None] % 2)
    ) / grid.columns
    return single(wall.wall_point(u, z[rows][:, None], lip[rows][:, None], side).reshape(3, -1).T)

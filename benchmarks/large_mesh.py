"""The even mesh of a solid, written to a binary STL file band by band: it may be larger than memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from benchmarks import even_mesh
from ebamcheck.atomic_file import replacing
from ebamcheck.mesh.stl import FACET, HEADER_BYTES
from ebamcheck_models.model import Floats, single
from ebamcheck_models.ring_wall import RingWall, levels

FACETS_A_BAND = 1 << 20
"""Facets that are made at once, about."""


def write_even_mesh(wall: RingWall, facets: int, path: Path) -> int:
    """Write the mesh that :func:`benchmarks.even_mesh.even_mesh` makes, facet by facet; returns how many there are.

    Parameters
    ----------
    wall
        The solid.
    facets
        How many, about.
    path
        Binary STL file; it appears when it is whole.
    """
    grids = even_mesh.grids_of(wall, facets)
    count = 0
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(bytes(HEADER_BYTES))
        for corners in _bands(wall, grids.wall):
            count += _append(file, corners)
        for channel, grid in zip(wall.channels, grids.channels, strict=True):
            points, faces = even_mesh.channel_mesh(wall, channel, grid)
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


def _bands(wall: RingWall, grid: even_mesh.Grid) -> Iterator[NDArray[np.float64]]:
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
        faces = even_mesh.staggered_faces(len(points) // grid.columns, grid.columns)
        yield points[faces]
        if stop == len(row) - 1:
            return


def _by_side(rows: NDArray[np.int64], side: Floats) -> list[NDArray[np.int64]]:
    """Rows of a band, those outside and those inside of the wall."""
    return [chosen for chosen in (rows[side[rows] > 0.0], rows[side[rows] < 0.0]) if chosen.size]


def _points(
    wall: RingWall,
    grid: even_mesh.Grid,
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

"""The facets that a few planes cross, for a part that is cut in few layers only.

Sorting a whole part by height pays off over many layers. A single layer, as when slicing directions are tried, needs only
the facets that it crosses. All facets around a cut edge are among these, in the same order as in the whole mesh, so the traced
contours are the same bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck_planecut.sorted_mesh import Floats, Index, SortedMesh, sorted_mesh

Levels = NDArray[np.uint8]

MOST_PLANES = 255
"""Most planes at a time, so that a level fits into a byte: the levels of a million facets then stay in a core's cache."""

SMALLEST_BLOCK = 65536
"""Fewest vertices or facets worth a thread."""


def crossed_mesh(part: Part, heights: Floats) -> SortedMesh:
    """Sort only the facets that some planes cross; at these heights the result is cut like the whole mesh.

    Parameters
    ----------
    part
        The part as placed.
    heights
        (L,) mm, increasing, :data:`MOST_PLANES` at most.
    """
    level = np.empty(len(part.vertices), np.uint8)
    run_blocks(lambda a, b: _levels(part.vertices, heights, level, a, b), level.size, SMALLEST_BLOCK)
    crossed = np.concatenate(
        run_blocks(lambda a, b: _across(part.faces, level, a, b), len(part.faces), SMALLEST_BLOCK)
    )
    corners, faces = np.unique(part.faces[crossed], return_inverse=True)
    mesh = sorted_mesh(Part(part.vertices[corners], faces.reshape(-1, 3).astype(np.int32)))
    mesh.vertices[:, 3] = corners[mesh.vertices[:, 3].astype(np.int64)]
    return mesh._replace(numbers=crossed[mesh.numbers])


@kernel
def _levels(vertices: Floats, heights: Floats, level: Levels, start: int, stop: int) -> None:
    """Count the planes that each of the vertices ``[start, stop)`` lies above."""
    for v in range(start, stop):
        below = 0
        for n in range(heights.size):
            below += vertices[v, 2] > heights[n]
        level[v] = below


@kernel
def _across(faces: Index, level: Levels, start: int, stop: int) -> Index:
    """List the facets of ``[start, stop)`` whose corners do not lie above the same planes."""
    found = np.empty(stop - start, np.int32)
    count = 0
    for f in range(start, stop):
        a, b, c = level[faces[f, 0]], level[faces[f, 1]], level[faces[f, 2]]
        # Written always and kept where it counts: no branch that a processor could foretell wrongly.
        found[count] = f
        count += (a != b) | (b != c)
    return found[:count].copy()

"""Neighbours of facets found at lower vertices are those of half-edges grouped by edge."""

from __future__ import annotations

import numpy as np
import pytest
from test_planecut_speed_laws import LONE_PARTS, soup

from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, edge_groups, twins
from ebamcheck_planecut.sorted_mesh import sorted_mesh

CROWDED = soup(9, facets=400, points=400)
CROWDED.faces[:200, 0] = 7
# Two tetrahedra on one edge, whose ends lie at one place, as after a turn that rounds.
ENDS_TOGETHER = Part(
    np.array([(100, 0, 0), (100, 0, 0), (101, 1, 2), (101, -1, 2.5), (99, 1, 2), (99, -1, 2.5)], np.float64),
    np.array(
        [(0, 1, 2), (1, 0, 3), (0, 2, 3), (1, 3, 2), (0, 1, 4), (1, 0, 5), (0, 4, 5), (1, 5, 4)], np.int32
    ),
)
FOUND = {
    **LONE_PARTS,
    "a crowd at a vertex": CROWDED,
    "an edge of no length": ENDS_TOGETHER,
    "nothing": Part(np.zeros((0, 3)), np.zeros((0, 3), np.int32)),
}


@pytest.mark.parametrize("name", FOUND)
@pytest.mark.parametrize("threads", ["1", "3"])
def test_neighbours_are_those_of_half_edges_grouped_by_edge(name, threads, monkeypatch):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    mesh = sorted_mesh(FOUND[name])
    groups = edge_groups(mesh.faces, len(mesh.vertices))
    expected = twins(np.ascontiguousarray(mesh.vertices[:, :3]), mesh.faces, groups.half_edges, groups.starts)
    twin, is_open, mixed, fans = mesh.around
    assert twin.tolist() == expected.tolist()
    tails = mesh.faces.ravel()
    assert is_open == (twin == NO_TWIN).any()
    assert mixed == ((twin != NO_TWIN) & (tails == tails[twin])).any()
    assert fans == (np.diff(groups.starts) > 2).any()

"""Inspection: defects counted, verdicts given, orientation mended."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from parts import box, join, sphere, tilted, torus, welded

import ebamcheck
from ebamcheck.mesh.inspection import fix_orientation, inspect
from ebamcheck.mesh.part import Part, from_arrays


@pytest.mark.parametrize("part", [box(), sphere(), torus(), tilted(box())], ids=lambda p: p.name)
def test_sound_parts_pass(part):
    found = inspect(part)
    assert found.passed
    assert (found.open_edges, found.nonmanifold_edges, found.inconsistent_edges, found.bodies) == (0, 0, 0, 1)
    assert found.volume_mm3 == pytest.approx(part.volume)
    # Euler: V - E + F is 2 for a sphere, 0 for a torus.
    edges = 3 * found.facets // 2
    assert found.vertices - edges + found.facets == (0 if part.name == "torus" else 2)


def test_each_defect_is_named_with_its_count():
    part = tilted(box())
    without_lid = Part(part.vertices, np.delete(part.faces, [2, 3], axis=0))
    assert inspect(without_lid).verdict == "open"
    assert inspect(without_lid).open_edges == 4
    flipped = part.faces.copy()
    flipped[5] = flipped[5, ::-1]
    found = inspect(Part(part.vertices, flipped))
    assert (found.verdict, found.inconsistent_edges) == ("inconsistent", 3)
    found = inspect(part.reversed())
    assert (found.verdict, found.inside_out_bodies) == ("inside-out", 1)
    assert "fix-orientation" in found.why
    assert not found.passed
    doubled = Part(part.vertices, np.vstack([part.faces, part.faces[:2], [[1, 1, 2]]]).astype(np.int32))
    found = inspect(doubled)
    assert (found.duplicate_facets, found.degenerate_facets) == (2, 1)
    sheet = from_arrays([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 1)])
    assert inspect(sheet).verdict == "flat"


def test_an_open_inside_out_part_is_named_as_both():
    lidless = Part(box().vertices, np.delete(box().faces, [2, 3], axis=0)).reversed()
    found = inspect(lidless)
    assert found.verdict == "open"
    assert "inside-out" in found.why


def test_a_cavity_is_no_inside_out_body_but_a_second_inside_out_body_is():
    hollow = join(box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (3, 3, 3)).reversed())
    assert inspect(hollow).verdict == "sound"
    assert inspect(hollow).volume_mm3 == pytest.approx(56)
    apart = join(box((0, 0, 0), (4, 4, 4)), box((11, 1, 1), (13, 3, 3)).reversed())
    assert inspect(apart).verdict == "inside-out"
    assert inspect(hollow.reversed()).verdict == "inside-out"


def test_bodies_touching_along_an_edge_are_sound():
    found = inspect(welded(join(box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1)))))
    assert found.verdict == "sound"
    assert found.nonmanifold_edges == 1
    assert found.bodies == 1


@pytest.mark.parametrize("seed", range(4))
def test_orientation_is_mended_whatever_is_flipped(seed):
    part = tilted(torus())
    rng = np.random.default_rng(seed)
    flip = rng.random(len(part.faces)) < 0.4
    broken = Part(part.vertices, np.where(flip[:, None], part.faces[:, ::-1], part.faces).astype(np.int32))
    mended, turned = fix_orientation(broken)
    assert turned == flip.sum()
    assert inspect(mended).passed
    assert mended.volume == pytest.approx(part.volume)


def test_mending_keeps_cavities_turns_whole_parts_and_leaves_open_ones():
    hollow = join(box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (3, 3, 3)).reversed())
    assert fix_orientation(hollow) == (hollow, 0)
    mended, turned = fix_orientation(box().reversed())
    assert turned == 12
    assert mended.volume == pytest.approx(8)
    open_part = Part(box().vertices, np.delete(box().faces, [2, 3], axis=0)).reversed()
    assert fix_orientation(open_part)[1] == 0


@pytest.mark.corpus
def test_counts_of_the_corpus(corpus: Path):
    with (corpus / "MANIFEST.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["class"] != "malformed"]
    assert len(rows) > 50
    for row in rows:
        part = ebamcheck.load(corpus / row["file"])
        found = inspect(part)
        counted = (found.facets, found.open_edges, found.nonmanifold_edges, found.degenerate_facets)
        expected = tuple(int(row[k]) for k in ("facets", "open_edges", "nonmanifold_edges", "degenerate_facets"))
        assert counted == expected, row["file"]
        if row["winding_consistent_trimesh"] == "True" and not found.open_edges:
            assert part.signed_volume == pytest.approx(float(row["signed_volume"]), rel=1e-5, abs=1e-6), row["file"]
        if row["class"] == "good":
            assert found.passed, row["file"]
        if found.open_edges:
            assert found.verdict == "open", row["file"]

"""The error bound of the ray-casting backend: kept by shapes that hide between rays, and not idle."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from corpus_sections import simple_sections
from embree_parts import PARTS, SLICER, cut, heights_in, random_solid, region
from parts import box, join, moved
from section_oracle import depth_beyond, exact_section, prism, winding

import ebamcheck


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("seed", range(40))
def test_bound_is_kept_by_random_solids(seed, caplog):
    rng = np.random.default_rng(seed)
    part = random_solid(rng)
    heights = np.sort(rng.uniform(*part.bounds[:, 2], 2))
    settings = {"grid_mm": float(rng.choice([0.1, 0.2, 0.5, 1.5]))}
    bound = SLICER.error_bound_mm(part, SLICER.Settings(**settings))
    layers = cut(part, heights, **settings)
    for k, z in enumerate(heights):
        assert depth_beyond(region(layers, k), exact_section(part, z), bound * 1.0005) < 1e-9
    assert "do not pair" not in caplog.text


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("cell_mm", [0.1, 0.37, 1.3])
@pytest.mark.parametrize("name", PARTS)
def test_bound_is_kept(name, cell_mm):
    part = PARTS[name]
    settings = SLICER.Settings(grid_mm=cell_mm)
    bound = SLICER.error_bound_mm(part, settings)
    layers = cut(part, heights_in(part), grid_mm=cell_mm)
    for k, z in enumerate(layers.heights):
        assert depth_beyond(region(layers, k), exact_section(part, z), bound * 1.0005) == 0.0


def test_bound_is_not_idle():
    """Thin walls do vanish between rays: the promise says how thick they may be, not that they stay."""
    walls = [box((x, 0, 0), (x + 0.4, 20, 2)) for x in (0.0, 3.3, 6.7, 9.9, 13.2)]
    part = join(*walls, box((20, 0, 0), (24, 20, 2)))
    layers = cut(part, [1.0], grid_mm=1.0)
    assert 1 <= layers.ring_counts()[0] < len(walls) + 1


def test_corners_of_the_section_are_not_cut():
    """In-plane contours turn where the mesh's section turns, where that is in a cell the contour passes."""
    outline = shapely.Point(0.3, 0.4).buffer(8, quad_segs=6)
    part = prism(outline, 0.0, 2.0)
    cell_mm = 0.3
    layers = cut(part, [1.0], grid_mm=cell_mm)
    difference = region(layers).symmetric_difference(outline).area
    assert difference < 0.01 * outline.length * cell_mm / 8  # chords of cells take an eighth of a cell
    corners = shapely.get_coordinates(outline.exterior)[:-1]
    gaps = np.linalg.norm(corners[:, None] - layers.points[None], axis=2).min(axis=1)
    assert (gaps < 1e-9).mean() > 0.8


def test_far_from_the_origin():
    part = PARTS["tilted torus"]
    far = moved(part, shift=(1e6, -1e6, 1e6))
    near, off = cut(part, heights_in(part)), cut(far, heights_in(part) + 1e6)
    assert off.areas() == pytest.approx(near.areas(), rel=1e-4)
    assert off.ring_counts().tolist() == near.ring_counts().tolist()
    for k, z in enumerate(heights_in(part)):
        bound = SLICER.error_bound_mm(far, SLICER.Settings())
        shifted = shapely.transform(region(off, k), lambda p: p - (1e6, -1e6))
        assert depth_beyond(shifted, exact_section(part, z), bound * 1.0005) == 0.0


def test_mirrored_part_gives_mirrored_area():
    part = PARTS["star"]
    mirrored = moved(part, np.diag([-1, 1, 1]))
    heights = heights_in(part)
    assert cut(mirrored, heights).areas() == pytest.approx(cut(part, heights).areas(), rel=2e-3)


def test_winding_oracle_on_a_square():
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    cut_of_square = np.stack([square, np.roll(square, -1, axis=0)], axis=1)
    assert winding(cut_of_square, 0.5, 0.5) == 1
    assert winding(cut_of_square[:, ::-1], 0.5, 0.5) == -1
    assert winding(cut_of_square, 1.5, 0.5) == 0


@pytest.mark.corpus
@pytest.mark.slow
def test_reference_areas_of_the_corpus(corpus):
    compared = 0
    for file, rows in simple_sections(corpus).items():
        part = ebamcheck.load(corpus / file)
        layers = cut(part, [float(row["z"]) for row in rows])
        bound = SLICER.error_bound_mm(part, SLICER.Settings())
        for k, row in enumerate(rows):
            allowed = 0.05 * bound * float(row["perimeter"])
            assert layers.areas()[k] == pytest.approx(float(row["signed_area"]), abs=allowed), (
                file,
                row["z"],
            )
        compared += len(rows)
    assert compared > 100

"""The backend ``stencil``: what it says about itself, and contours of bitmaps."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import hypothesis.extra.numpy as hnp
import moderngl
import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from skimage.measure import find_contours
from stencil_cuts import as_image, cut, same
from stencil_parts import box, joined, torus, turned

from ebamcheck.backend import Slicer
from ebamcheck.errors import BackendMissing
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import from_arrays
from ebamcheck_stencil import Stencil
from ebamcheck_stencil.crossings import Crossings, Flips, empty_bitmap, flip, flips_by_layer
from ebamcheck_stencil.drawn_facets import _is_near_a_centre
from ebamcheck_stencil.field_of_view import MARGIN_PX, SUBPIXELS, FieldOfView, field_of_view
from ebamcheck_stencil.marching_squares import contours_of_layers, layers_of
from ebamcheck_stencil.slicer import border, capped, inside_rule

# -- what it says about itself -------------------------------------------------------------------------


def test_it_keeps_the_protocol():
    assert isinstance(Stencil(), Slicer)
    assert not Stencil.exact
    assert inside_rule(Stencil.Settings()) == Stencil.inside_rule == "winding > 0"
    assert inside_rule(Stencil.Settings(mode="literal")) == "1..2"


def test_importing_it_loads_no_graphics():
    code = "import sys, ebamcheck_stencil; print([m for m in ('moderngl', 'OpenGL', 'skimage') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_without_opengl_the_probe_says_why_and_what_to_install(monkeypatch):
    def refuse(**options):
        raise OSError(f"no such library for {options.get('backend')}")

    monkeypatch.setattr(moderngl, "create_context", refuse)
    probe = Stencil().probe()
    assert not probe.available
    assert "for egl" in probe.why
    assert "for None" in probe.why
    assert "libegl1" in probe.hint
    with pytest.raises(BackendMissing, match="no such library"):
        cut(box(), [0.5])


def test_the_driver_s_own_fault_does_not_come_out_of_the_probe(monkeypatch):
    class Broken:
        info: dict = {}  # noqa: RUF012

        def release(self):
            raise RuntimeError("cannot be released")

    monkeypatch.setattr(moderngl, "create_context", lambda **_: Broken())
    assert not Stencil().probe().available


@pytest.mark.parametrize("wrong", [{"pixel_mm": 0}, {"buffer_mb": -1}, {"mode": "fast"}, {"pixels": 3}])
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Stencil.Settings(**wrong)


@pytest.mark.parametrize(
    ("extent", "pixel"), [(10.0, 10 / 1024), (200.0, 0.1), (900.0, 900 / 4096), (0.0, 0.1)]
)
def test_the_automatic_pixel(extent, pixel):
    flat = from_arrays([(5, 5, 0), (5 + extent, 5, 0), (5, 5, 1)], [(0, 1, 2)])
    assert field_of_view(flat, None).pixel_mm == pytest.approx(pixel, rel=1e-14)


# -- facets that the literal mode sends -----------------------------------------------------------------


@settings(deadline=None)  # the first example compiles
@given(
    corners=hnp.arrays(np.int32, (3, 2), elements=st.integers(0, 6 * SUBPIXELS)),
    slack=st.integers(0, 40),
)
@example(corners=np.full((3, 2), SUBPIXELS // 2, np.int32), slack=0)
@example(corners=np.array([(0, 0), (1100, 1100), (550, 551)], np.int32), slack=1)
def test_facets_near_a_pixel_centre_are_told(corners, slack):
    """Against shapely: the facet grown by a square, and every centre."""
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * slack
    grown = shapely.convex_hull(shapely.MultiPoint((corners[:, None] + square).reshape(-1, 2)))
    across = np.arange(-1, 8) * SUBPIXELS + SUBPIXELS // 2
    centres = shapely.points(*map(np.ravel, np.meshgrid(across, across)))
    assert _is_near_a_centre(corners, 0, 1, 2, slack) == bool(shapely.intersects(grown, centres).any())


def test_room_for_points_is_not_that_of_the_densest_layer_for_all():
    """A checkered layer below 254 empty ones, in a process that may take one more gigabyte."""
    code = """
import resource
import numpy as np
from ebamcheck_stencil.crossings import Flips
from ebamcheck_stencil.field_of_view import FieldOfView
from ebamcheck_stencil.marching_squares import contours_of_layers

def contours(side, layers):
    view = FieldOfView(1.0, (0.0, 0.0), side, side)
    x, y = np.meshgrid(np.arange(2, side - 2), np.arange(2, side - 2))
    pixels = (y * view.stride_px + x)[(x + y) % 2 == 0].astype(np.uint32)
    flips = Flips(np.array([0, pixels.size] + [2 * pixels.size] * (layers - 1)), np.tile(pixels, 2))
    none = np.empty((0, side * view.stride_px // 64), np.uint64)
    return contours_of_layers(flips, none, 0, layers, view.stride_px // 64)

contours(8, 2)
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + 2**30, taken + 2**30))
points, _, _, counts = contours(1200, 255)
assert len(points) == 4 * counts[0] and not counts[1:].any()
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("low_mm", [0.0, -3e5, 1e13])
def test_layers_are_canonical_wherever_the_part_lies(low_mm):
    """At the farthest place half a pixel is less than the rounding, so that points fall together."""
    rng = np.random.default_rng(9)
    image = np.pad(rng.random((40, 50)) < 0.55, MARGIN_PX)
    view = FieldOfView(1e-3, (low_mm, low_mm), image.shape[1], image.shape[0])
    pixels = np.flatnonzero(np.pad(image, ((0, 0), (0, view.stride_px - view.width_px)))).astype(np.uint32)
    flips = Flips(np.array([0, pixels.size]), pixels)
    found = contours_of_layers(flips, empty_bitmap(view)[None, :][:0], 0, 1, view.stride_px // 64)
    rings = [view.to_mm(found.points[a:b]) for a, b in pairwise(found.starts)]
    assert same(layers_of(np.zeros(1), [found], view, {}), from_rings([0.0], [rings]))


# -- contours of bitmaps, against scikit-image ---------------------------------------------------------


def rings_of_image(image) -> Layers:
    """Our contours of one image, in pixels."""
    view = FieldOfView(1.0, (0.0, 0.0), image.shape[1], image.shape[0])
    pixels = np.flatnonzero(np.pad(image, ((0, 0), (0, view.stride_px - view.width_px)))).astype(np.uint32)
    bitmap = empty_bitmap(view)
    flip(bitmap, pixels)
    assert np.array_equal(as_image(bitmap, view), image)
    flips = Flips(np.array([0, pixels.size]), pixels)
    points, starts, least, _ = contours_of_layers(flips, bitmap[None, :][:0], 0, 1, view.stride_px // 64)
    rings = [points[a:b].tolist() for a, b in pairwise(starts)]
    assert [points[row].tolist() for row in least] == [min(ring) for ring in rings]
    return from_rings([0.0], [[points[a:b] / 2.0 for a, b in pairwise(starts)]])


@pytest.mark.parametrize("density", [0.02, 0.3, 0.5, 0.7, 0.98])
@pytest.mark.parametrize("shape", [(9, 9), (40, 150)])
def test_contours_are_those_of_scikit_image(density, shape):
    rng = np.random.default_rng(int(density * 100) + shape[0])
    for _ in range(5):
        image = np.pad(rng.random(shape) < density, MARGIN_PX)
        ours = rings_of_image(image)
        raw = find_contours(image.astype(float), 0.5, fully_connected="low", positive_orientation="low")
        theirs = from_rings([0.0], [[ring[:-1, ::-1] for ring in raw]])
        assert ours.areas() == pytest.approx(theirs.areas(), abs=1e-9)
        assert sorted(ours.ring_areas) == pytest.approx(sorted(theirs.ring_areas), abs=1e-9)
        assert sorted(ours.ring_lengths) == pytest.approx(sorted(theirs.ring_lengths), abs=1e-9)
        assert {tuple(p) for p in ours.points} <= {tuple(p) for p in theirs.points}


def test_no_point_lies_within_a_straight_run():
    rng = np.random.default_rng(3)
    layers = rings_of_image(np.pad(rng.random((60, 60)) < 0.6, MARGIN_PX))
    for r in range(layers.closed.size):
        ahead = np.roll(layers.ring(r), -1, axis=0) - layers.ring(r)
        behind = np.roll(ahead, 1, axis=0)
        assert (ahead[:, 0] * behind[:, 1] != ahead[:, 1] * behind[:, 0]).all()


def test_a_crossing_belongs_to_the_first_layer_at_or_above_it():
    rng = np.random.default_rng(5)
    heights = np.unique(np.concatenate([rng.normal(size=50), 1e-9 * rng.normal(size=50), [1e6]]))
    crossing_heights = np.concatenate([heights, heights - 1e-12, 2 * rng.normal(size=2000), [-1e9, 1e9]])
    pixels = np.arange(crossing_heights.size, dtype=np.uint32)
    flips = flips_by_layer(Crossings(pixels, crossing_heights, 0), heights)
    layer = np.full(pixels.size, heights.size)
    layer[flips.pixels] = np.repeat(np.arange(heights.size), np.diff(flips.starts))
    assert np.array_equal(layer, np.searchsorted(heights, crossing_heights, side="left"))


def test_the_border_of_an_opening():
    vertices, faces = box()
    assert len(border(faces)) == 0
    missing = faces[0]
    edges = {tuple(e) for e in border(np.delete(faces, 0, axis=0)).tolist()}
    assert edges == {tuple(e) for e in zip(np.roll(missing, -1).tolist(), missing.tolist(), strict=True)}
    whole = capped(from_arrays(vertices, np.delete(faces, 0, axis=0)))
    assert len(border(whole.faces)) == 0
    assert whole.volume == pytest.approx(1.0)
    assert np.array_equal(whole.bounds, from_arrays(vertices, faces).bounds)


def test_a_surface_is_closed_where_it_has_no_border():
    rng = np.random.default_rng(3)
    _, faces = joined(box(), turned(torus(9, 3), (1, 2, 3), 0.9))
    assert not len(border(faces))
    assert not len(border(faces[:0]))
    assert not len(border(np.vstack([faces, [(0, 1, 1)]])))  # a facet without area
    for facet in rng.choice(len(faces), 20, replace=False):
        assert len(border(np.delete(faces, facet, axis=0))) == 3
        flipped = faces.copy()
        flipped[facet] = flipped[facet, ::-1]
        assert len(border(flipped)) == 6
        doubled = np.vstack([faces, faces[[facet]]])
        assert len(border(doubled)) == 3

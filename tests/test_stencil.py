"""The backend ``stencil``: what it says about itself, and contours of bitmaps."""

from __future__ import annotations

from itertools import pairwise

import moderngl
import numpy as np
import pytest
from skimage.measure import find_contours
from stencil_cuts import UNIT, as_image, cut, same

from ebamcheck.backend import Slicer
from ebamcheck.errors import BackendMissing
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import from_arrays
from ebamcheck_stencil import Stencil
from ebamcheck_stencil.crossings import Flips, empty_bitmap, flip
from ebamcheck_stencil.field_of_view import MARGIN_PX, FieldOfView, field_of_view
from ebamcheck_stencil.marching_squares import contours_of_layers, layers_of
from ebamcheck_stencil.slicer import inside_rule

# -- what it says about itself -------------------------------------------------------------------------


def test_it_keeps_the_protocol():
    assert isinstance(Stencil(), Slicer)
    assert not Stencil.exact
    assert inside_rule(Stencil.Settings()) == Stencil.inside_rule == "winding > 0"
    assert inside_rule(Stencil.Settings(mode="literal")) == "1..2"


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
        cut(UNIT, [0.5])


@pytest.mark.parametrize("wrong", [{"pixel_mm": 0}, {"buffer_mb": -1}, {"mode": "fast"}, {"pixels": 3}])
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Stencil.Settings(**wrong)


@pytest.mark.parametrize(("extent", "pixel"), [(10.0, 10 / 1024), (200.0, 0.1), (900.0, 900 / 4096), (0.0, 0.1)])
def test_the_automatic_pixel(extent, pixel):
    flat = from_arrays([(5, 5, 0), (5 + extent, 5, 0), (5, 5, 1)], [(0, 1, 2)])
    assert field_of_view(flat, None).pixel_mm == pytest.approx(pixel, rel=1e-14)


# -- facets that the literal mode sends -----------------------------------------------------------------


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

"""A part held ready: the same layers as ever, from any thread, along any direction."""

from __future__ import annotations

import gc
import threading

import numpy as np
import pytest
from parts import box, sphere, tilted, torus

import ebamcheck
from ebamcheck import Slicing
from ebamcheck.errors import BackendFailed, BackendMissing, SettingsError
from ebamcheck.plugins import registry

BACKENDS = ["planecut", "manifold", "embree", "stencil"]
COLUMNS = ("heights", "points", "ring_starts", "layer_starts", "closed", "edge", "edge_t", "dropped")


@pytest.fixture(params=BACKENDS)
def backend(request):
    if not registry.probe(request.param).available:
        pytest.skip(registry.probe(request.param).why)
    return request.param


def assert_same(a, b):
    for name in COLUMNS:
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert a.labels_json() == b.labels_json()


def test_a_layer_is_the_same_alone_as_in_the_stack(backend):
    part = tilted(torus())
    heights = ebamcheck.layer_heights(part, part.size[2] / 12)
    stack = ebamcheck.slice(part, heights, backend=backend)
    with Slicing(part, backend) as slicing:
        for k in (5, 0, 11, 5):
            assert_same(slicing.at(heights[k]), stack.block(k, k + 1))
        assert_same(slicing.layers(heights[::-1]), stack.take(np.arange(12)[::-1]))


def test_another_direction_is_that_of_a_part_turned_before(backend):
    part, direction = sphere(10.0, 16), (1.0, -2.0, 0.5)
    turned = part.along(direction)
    with Slicing(part, backend) as slicing, slicing.along(direction) as other:
        assert_same(other.at(1.3), ebamcheck.slice(turned, [1.3], backend=backend))
        # From the turned one, too, directions are those of the file; and the first stays as it was.
        with other.along((0.0, 0.0, 1.0)) as back:
            assert_same(back.at(1.3), ebamcheck.slice(part, [1.3], backend=backend))
        assert_same(slicing.at(1.3), ebamcheck.slice(part, [1.3], backend=backend))


def test_settings_reach_the_slicer_and_go_along():
    with Slicing(box(), "embree", grid_mm=0.25) as slicing, slicing.along((1, 0, 0)) as other:
        assert slicing.at(0.7).settings["grid_mm"] == 0.25
        assert other.at(0.7).settings["grid_mm"] == 0.25


def test_a_closed_one_says_so():
    slicing = Slicing(box())
    slicing.close()
    slicing.close()
    with pytest.raises(SettingsError, match="closed"):
        slicing.at(1.0)


def test_errors_reach_the_caller_and_the_next_call_works():
    with Slicing(box()) as slicing:
        with pytest.raises(SettingsError, match="finite"):
            slicing.at(float("nan"))
        with pytest.raises(SettingsError, match="not a direction"):
            slicing.along((0, 0, 0))
        assert slicing.at(1.0).areas().tolist() == [4.0]
    with pytest.raises(BackendMissing, match="nosuch"):
        Slicing(box(), "nosuch")
    with pytest.raises(SettingsError, match="pixel"):
        Slicing(box(), "planecut", pixel=3)


def test_nothing_is_left_behind():
    """Neither a refused part nor a forgotten object keeps its thread."""
    before = threading.active_count()
    open_part = ebamcheck.mesh.part.from_arrays([(0, 0, 0), (1, 0, 0), (0, 1, 1)], [(0, 1, 2)])
    with pytest.raises(BackendFailed):
        Slicing(open_part, "manifold")
    forgotten = Slicing(box())
    forgotten.at(1.0)
    del forgotten
    gc.collect()
    assert threading.active_count() == before

"""The backend ``stencil`` at work: sections, tiles, modes, and bitmaps pixel by pixel."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np
import pytest
import shapely
from parts import box, join, moved, torus
from section_oracle import depth_beyond
from stencil_cuts import BOTH_MODES, PROBE, UNIT, cut, gl, image_at, same, turned

from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.layers.stack import concatenate
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models import LADDER
from ebamcheck_stencil import Stencil, opengl
from ebamcheck_stencil.field_of_view import SUBPIXELS, FieldOfView, field_of_view
from ebamcheck_stencil.slicer import CLIP_MOVE_PX, FLOAT32_STEP

pytestmark = gl

TORUS = turned(torus(9, 3, 96, 48), (1, 2, 3), 0.9)


def test_overlapping_bodies_unite_and_the_paper_s_rule_loses_the_third():
    boxes = [box((i, i, 0), (i + 6, i + 6, 4)) for i in range(3)]
    union = shapely.union_all([shapely.box(i, i, i + 6, i + 6) for i in range(3)])
    layers = cut(join(*boxes), [2.0], pixel_mm=0.1)
    assert layers.ring_counts().tolist() == [1]
    bound_mm = Stencil().error_bound_mm(join(*boxes), Stencil.Settings(pixel_mm=0.1))
    assert depth_beyond(shapely.union_all(layers.polygons(0)), union, 1.001 * bound_mm) == 0.0
    literal = cut(join(*boxes), [2.0], pixel_mm=0.1, mode="literal")
    assert literal.hole_counts().tolist() == [1]
    assert literal.areas()[0] == pytest.approx(union.area - 16.0, abs=2.5)
    assert cut(join(*boxes[:2]), [2.0], pixel_mm=0.1, mode="literal").ring_counts().tolist() == [1]


def test_bodies_that_share_a_face_leave_no_slit():
    mesh = turned(join(box((0, 0, 0), (9, 9, 5)), box((0, 0, 5), (9, 9, 9))), (3, 1, 2), 1.1)
    assert set(cut(mesh, np.linspace(0.5, 12, 60), pixel_mm=0.03).ring_counts()) == {1}


def test_many_shells_do_not_overflow_the_count():
    shells = join(*[box((0, 0, 0.001 * i), (3, 3, 5)) for i in range(300)])
    assert cut(shells, [2.0], pixel_mm=0.1).areas()[0] == pytest.approx(9.0, abs=1.2)


@BOTH_MODES
def test_a_part_without_facets_and_a_stack_without_layers(mode):
    nothing = from_arrays(np.zeros((0, 3)), np.zeros((0, 3)))
    assert cut(nothing, [0.0, 1.0], mode=mode).ring_counts().tolist() == [0, 0]
    assert len(cut(UNIT, [], mode=mode)) == 0


def test_vertical_and_degenerate_facets_change_nothing():
    part = box(upper=(3, 3, 3))
    more = from_arrays(part.vertices, np.vstack([part.faces, [(0, 0, 1), (2, 2, 2), (0, 1, 0)]]))
    assert same(cut(more, [1.5], pixel_mm=0.1), cut(part, [1.5], pixel_mm=0.1))


# -- the stack, the tiles and the threads change nothing -------------------------------------------


@BOTH_MODES
def test_tiles_give_the_same_bytes(mode):
    heights = np.linspace(-6, 6, 9)
    whole = cut(TORUS, heights, pixel_mm=0.1, mode=mode)
    for tiling in (
        {"max_texture_px": 37},
        {"max_texture_px": 5},
        {"max_texture_px": 1000, "buffer_mb": 0.02},
    ):
        assert same(cut(TORUS, heights, pixel_mm=0.1, mode=mode, **tiling), whole)


def test_a_crowded_window_is_drawn_in_parts():
    """Two hundred plates over one corner of the field: no estimate foresees them in one band."""
    plates = join(box(upper=(0.1, 30, 0.1)), *[moved(box(upper=(3, 1, 0.5)), shift=(0, 0, i)) for i in range(200)])
    few = cut(plates, [0.05, 7.25, 100.75], pixel_mm=0.1, buffer_mb=0.05)
    assert same(few, cut(plates, [0.05, 7.25, 100.75], pixel_mm=0.1))
    with pytest.raises(BackendFailed, match="buffer_mb"):
        cut(plates, [0.05], pixel_mm=0.1, buffer_mb=0.001)


@BOTH_MODES
def test_a_layer_does_not_depend_on_the_others(mode):
    rng = np.random.default_rng(2)
    count = 700 if mode == "draw-once" else 50
    heights = np.sort(np.concatenate([rng.uniform(-8, 8, count), 1e-7 * rng.random(5)]))
    done = []
    with Stencil().prepare(TORUS, Stencil.Settings(pixel_mm=0.2, mode=mode)) as prepared:
        whole = prepared.slice(heights, done.append)
        for start, stop in ((0, 1), (3, 8), (len(heights) - 1, len(heights))):
            assert same(prepared.slice(heights[start:stop]), whole.block(start, stop))
        blocks = [prepared.slice(heights[a : a + 90]) for a in range(0, len(heights), 90)]
    assert same(concatenate(blocks), whole)
    assert sum(done) == len(heights)


def test_settings_and_renderer_are_recorded():
    layers = cut(UNIT, [0.5], mode="literal")
    assert layers.backend == "stencil"
    assert layers.settings["mode"] == "literal"
    assert layers.settings["inside_rule"] == "1..2"
    assert layers.settings["pixel_mm"] == 1 / 1024
    assert layers.settings["GL_RENDERER"] == PROBE.device
    assert layers.settings["GL_VERSION"] == PROBE.versions["GL_VERSION"]
    assert layers.labels_json()


def test_a_field_over_the_driver_s_limit_is_refused():
    with pytest.raises(SettingsError, match="pixel_mm 1e-06"):
        cut(UNIT, [0.5], pixel_mm=1e-6)


@BOTH_MODES
def test_every_context_is_released(mode, monkeypatch):
    opened = []

    def recorded(open_context=opengl.open_context):
        opened.append(open_context())
        return opened[-1]

    monkeypatch.setattr(opengl, "open_context", recorded)
    cut(UNIT, [0.5], mode=mode, pixel_mm=0.1)
    Stencil().probe()
    with pytest.raises(SettingsError):
        cut(UNIT, [0.5], mode=mode, pixel_mm=1e-6)
    assert len(opened) == 3
    assert all(isinstance(c.mglo, moderngl.InvalidObject) for c in opened)


def test_a_bitmap_that_no_buffer_of_the_driver_holds_is_refused(monkeypatch):
    device = opengl.device
    monkeypatch.setattr(opengl, "device", lambda context: replace(device(context), buffer_bytes=1000))
    with pytest.raises(SettingsError, match="largest buffer"):
        cut(UNIT, [0.5], mode="literal", pixel_mm=0.01)
    assert cut(UNIT, [0.5], mode="literal", pixel_mm=0.1).areas()[0] == pytest.approx(1.0, abs=0.2)


# -- open surfaces -----------------------------------------------------------------------------------


def test_an_opening_is_reported_and_spoils_no_layer_that_does_not_cut_it():
    vertices, faces = TORUS.vertices, TORUS.faces
    heights = np.linspace(-8, 8, 60)
    closed = cut(TORUS, heights, pixel_mm=0.1)
    hole = np.arange(2000, 2030)
    opened = cut(Part(vertices, np.delete(faces, hole, axis=0)), heights, pixel_mm=0.1)
    assert closed.settings["unbalanced_pixels"] == 0
    assert opened.settings["unbalanced_pixels"] > 0
    z = vertices[faces[hole].ravel(), 2]
    clear = (heights < z.min()) | (heights > z.max())
    assert 0 < clear.sum() < heights.size
    assert same(opened.take(np.flatnonzero(clear)), closed.take(np.flatnonzero(clear)))


# -- bitmaps, pixel by pixel ----------------------------------------------------------------------------------


SIDE_PX = 1024
MOST_DIFFERING = 8
"""Pixels of 1024 x 1024 whose centres may lie within a lattice step of a contour, and so on either side."""

PARTS = {
    "turned torus": turned(torus(90, 31, 200, 120), (1, 2, 3), 0.9),
    "boxes that overlap": turned(
        join(box(upper=(40, 30, 20)), moved(box(upper=(9, 50, 60)), shift=(7, -8, -9))), (3, 1, 2), 0.4
    ),
    "ladder": LADDER.tessellate(0.06),
}


def fine_pixel(part: Part) -> float:
    return float(part.size[:2].max()) / (SIDE_PX - 6)


def section(part: Part, height: float):
    """Directed segments (S, 4) in which a generic plane cuts the facets, material on their left."""
    corners = part.vertices[part.faces]
    above = corners[:, :, 2] > height
    ends = np.full((len(corners), 4), np.nan)
    for k in range(3):
        a, b, rises = corners[:, k], corners[:, (k + 1) % 3], above[:, (k + 1) % 3]
        for crossed, place in ((rises & ~above[:, k], slice(2, 4)), (above[:, k] & ~rises, slice(0, 2))):
            p, q = a[crossed], b[crossed]
            t = (height - p[:, 2]) / (q[:, 2] - p[:, 2])
            ends[crossed, place] = p[:, :2] + t[:, None] * (q[:, :2] - p[:, :2])
    return ends[~np.isnan(ends).any(axis=1)]


def exact_image(segments, view: FieldOfView):
    """Pixels whose centres have a winding number over 0, by the crossings of each row's line with the segments."""
    step = view.to_mm(np.array([[0, 0], [2, 2]]))
    low, pixel = step[0], step[1] - step[0]
    x0, y0, x1, y1 = segments.T
    first, past = np.ceil((np.sort([y0, y1], axis=0) - low[1]) / pixel[1]).astype(int).clip(0, view.height_px)
    counts = past - first
    which = np.repeat(np.arange(len(segments)), counts)
    row = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
    t = (low[1] + pixel[1] * row - y0[which]) / (y1 - y0)[which]
    x = x0[which] + t * (x1 - x0)[which]
    changes = np.zeros((view.height_px, view.width_px), int)
    np.add.at(changes, (row, np.ceil((x - low[0]) / pixel[0]).astype(int)), np.where(y1 > y0, -1, 1)[which])
    return changes.cumsum(axis=1) > 0


def farthest_px(wrong, contour, view: FieldOfView) -> float:
    """Greatest distance of the centre of a wrong pixel from the contour, in pixels."""
    centres = shapely.points(view.to_mm(2 * np.argwhere(wrong)[:, ::-1]))
    return float(shapely.distance(centres, contour).max(initial=0.0)) / view.pixel_mm


def heights(part: Part, count: int):
    low, high = part.bounds[:, 2]
    return low + (high - low) * (np.arange(count) + 0.371) / count


@pytest.mark.parametrize("name", PARTS)
def test_few_pixels_differ_and_only_within_a_lattice_step_of_the_contour(name):
    part = PARTS[name]
    pixel = fine_pixel(part)
    view = field_of_view(part, pixel)
    assert max(view.width_px, view.height_px) in range(SIDE_PX - 4, SIDE_PX + 1)
    with (
        Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel)) as once,
        Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel, mode="literal")) as literal,
    ):
        for height in heights(part, 6):
            segments = section(part, height)
            exact, drawn = exact_image(segments, view), image_at(once, height)
            assert exact.any()
            contour = shapely.MultiLineString(segments.reshape(-1, 2, 2).tolist())
            assert np.count_nonzero(drawn != exact) <= MOST_DIFFERING
            assert farthest_px(drawn != exact, contour, view) <= 1.0 / SUBPIXELS
            # Clipping rounds once more, and how it does is the driver's.
            clipped = image_at(literal, height)
            assert np.count_nonzero(drawn != clipped) <= 2 * MOST_DIFFERING
            clipped_px = CLIP_MOVE_PX + 4.0 * FLOAT32_STEP * view.viewport_px
            assert farthest_px(clipped != exact, contour, view) <= clipped_px


def test_the_bitmap_is_what_the_contours_are_drawn_around():
    part = PARTS["turned torus"]
    pixel = 0.7
    view = field_of_view(part, pixel)
    with Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel)) as once:
        for height in heights(part, 3):
            region = shapely.union_all(once.slice(np.array([height])).polygons(0))
            x, y = view.to_mm(2 * np.indices((view.width_px, view.height_px)).reshape(2, -1).T).T
            inside = shapely.contains_xy(region, x, y).reshape(view.width_px, view.height_px).T
            assert np.array_equal(inside, image_at(once, height))

"""The backend ``stencil`` at work: laws of its sections, its error bound under attack, tiling, and its modes."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np
import pytest
import shapely
from corpus_sections import simple_sections
from stencil_cuts import (
    BOTH_MODES,
    PROBE,
    _fine_points,
    bound,
    breach,
    cut,
    exact_section,
    gl,
    image_at,
    region_of,
    same,
)
from stencil_parts import box, cylinder, joined, moved, prism, reversed_mesh, torus, turned

import ebamcheck
import ebamcheck_stencil.literal as literal_mode
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.layers.stack import concatenate
from ebamcheck.mesh.part import from_arrays
from ebamcheck_stencil import Stencil, opengl
from ebamcheck_stencil.drawn_facets import Bands, DrawnFacets
from ebamcheck_stencil.field_of_view import field_of_view
from ebamcheck_stencil.literal import LiteralSlices


def all_facets(part, lattice, heights, view):
    """Every facet of a part, to be drawn for every layer."""
    whole = Bands(np.array([np.inf]), np.array([-np.inf]), np.array([0, len(part.faces)]))
    return DrawnFacets(part.faces, whole, Bands(np.empty(0), np.empty(0), np.zeros(1, np.int64)))


class TestWithOpenGL:
    pytestmark = gl

    @BOTH_MODES
    @pytest.mark.parametrize(
        ("mesh", "height", "area"),
        [
            (box((0, 0, 0), (20, 20, 20)), 7.0, 400.0),
            (cylinder(8.0, 5.0, 96), 2.0, 0.5 * 96 * 64 * np.sin(2 * np.pi / 96)),
            (prism([(0, 0), (9, 1), (5, 8)], -1, 1), 0.3, 0.5 * (9 * 8 - 5 * 1)),
        ],
    )
    def test_area_of_closed_forms(self, mesh, height, area, mode):
        layers = cut(mesh, [height], pixel_mm=0.05, mode=mode)
        assert abs(layers.areas()[0] - area) <= layers.perimeters()[0] * bound(mesh, pixel_mm=0.05) / 4
        assert layers.ring_counts().tolist() == [1]
        assert layers.open_counts().tolist() == [0]

    @BOTH_MODES
    @pytest.mark.parametrize("seed", range(4))
    def test_the_bound_holds_on_turned_parts(self, seed, mode):
        rng = np.random.default_rng(seed)
        mesh = [
            torus(9, 3, 40, 20), box((-4, -5, -6), (5, 6, 7)), cylinder(6, 9, 31),
            prism([(0, 0), (14, 0.4), (14, 0.9)], -3, 3),
        ][seed]  # fmt: skip
        mesh = turned(mesh, rng.normal(size=3), rng.uniform(0.2, 1.5))
        low, high = mesh[0][:, 2].min(), mesh[0][:, 2].max()
        heights = np.sort(rng.uniform(low, high, 6))
        pixel = rng.uniform(0.07, 0.4)
        layers = cut(mesh, heights, pixel_mm=pixel, mode=mode)
        for k, height in enumerate(heights):
            assert (
                breach(
                    region_of(layers, k), exact_section(mesh, height), bound(mesh, pixel_mm=pixel, mode=mode)
                )
                < 1e-9
            )

    def test_the_bound_is_nearly_reached(self):
        """Needles through three of four neighbouring pixel centres fill a cell that holds nothing else."""
        pixel = 0.5
        corner = from_arrays(*box((0, 0, 0), (10, 10, 1)))
        view = field_of_view(corner, pixel)
        centres = view.to_mm(np.array([(20, 20), (22, 20), (20, 22)]))
        needles = [box((x - 0.01, y - 0.01, 0.1), (x + 0.01, y + 0.01, 0.9)) for x, y in centres]
        anchors = [moved(box(high=(0.01, 0.01, 0.05)), at) for at in ((0, 0, 0), (9.99, 9.99, 0.9))]
        mesh = joined(*needles, *anchors)
        layers = cut(mesh, [0.5], pixel_mm=pixel)
        exact = shapely.union_all([shapely.box(x - 0.01, y - 0.01, x + 0.01, y + 0.01) for x, y in centres])
        reach = max(exact.distance(shapely.Point(p)) for p in _fine_points(region_of(layers, 0)))
        r = bound(mesh, pixel_mm=pixel)
        assert 0.9 * r < reach <= r

    def test_overlapping_bodies_unite_and_the_paper_s_rule_loses_the_third(self):
        boxes = [box((i, i, 0), (i + 6, i + 6, 4)) for i in range(3)]
        union = shapely.union_all([shapely.box(i, i, i + 6, i + 6) for i in range(3)])
        layers = cut(joined(*boxes), [2.0], pixel_mm=0.1)
        assert layers.ring_counts().tolist() == [1]
        assert breach(region_of(layers, 0), union, bound(joined(*boxes), pixel_mm=0.1)) == 0.0
        literal = cut(joined(*boxes), [2.0], pixel_mm=0.1, mode="literal")
        assert literal.hole_counts().tolist() == [1]
        assert literal.areas()[0] == pytest.approx(union.area - 16.0, abs=2.5)
        assert cut(joined(*boxes[:2]), [2.0], pixel_mm=0.1, mode="literal").ring_counts().tolist() == [1]

    def test_bodies_that_share_a_face_leave_no_slit(self):
        low, high = (
            prism([(0, 0), (9, 0), (9, 9), (0, 9)], 0, 5),
            prism([(0, 0), (9, 0), (9, 9), (0, 9)], 5, 9),
        )
        mesh = turned(joined(low, high), (3, 1, 2), 1.1)
        assert set(cut(mesh, np.linspace(0.5, 12, 60), pixel_mm=0.03).ring_counts()) == {1}

    def test_many_shells_do_not_overflow_the_count(self):
        shells = joined(*[box((0, 0, 0.001 * i), (3, 3, 5)) for i in range(300)])
        assert cut(shells, [2.0], pixel_mm=0.1).areas()[0] == pytest.approx(9.0, abs=1.2)

    @BOTH_MODES
    def test_an_inside_out_part_is_empty(self, mode):
        layers = cut(reversed_mesh(torus(9, 3)), [-1.0, 0.5], mode=mode, pixel_mm=0.1)
        assert layers.ring_counts().tolist() == [0, 0]

    def test_a_cavity_is_a_hole(self):
        layers = cut(
            joined(box(high=(9, 9, 9)), reversed_mesh(box((3, 3, 3), (6, 6, 6)))), [1, 4], pixel_mm=0.1
        )
        assert layers.hole_counts().tolist() == [0, 1]
        assert layers.ring_areas[layers.ring_areas < 0][0] == pytest.approx(-9.0, abs=1.2)

    @BOTH_MODES
    def test_a_part_far_from_the_origin_is_cut_the_same(self, mode):
        mesh = turned(torus(9, 3, 40, 20), (1, 2, 3), 0.7)
        mesh = (np.round(mesh[0] * 2**20) / 2**20, mesh[1])  # exact under the shift
        shift = np.array([2.0**20, -(2.0**20), 2.0**20])
        heights = np.array([-3.0, 0.25, 2.0])
        here, there = (
            cut(m, h, pixel_mm=0.125, mode=mode)
            for m, h in ((mesh, heights), (moved(mesh, shift), heights + shift[2]))
        )
        assert np.array_equal(here.ring_starts, there.ring_starts)
        assert np.abs(here.points + shift[:2] - there.points).max() < 1e-9

    def test_a_vertical_mirror_turns_the_stack_over(self):
        vertices, faces = turned(torus(9, 3, 40, 20), (1, 2, 3), 0.7)
        heights = np.array([-4.0, -1.0, 0.3, 3.0])
        up = cut((vertices, faces), heights, pixel_mm=0.1)
        down = cut((vertices * (1, 1, -1), faces[:, ::-1]), -heights[::-1], pixel_mm=0.1)
        assert down.areas()[::-1].tolist() == up.areas().tolist()

    def test_layers_outside_of_the_part_are_empty(self):
        layers = cut(box(), [-5, -1e-9, 0.5, 1 + 1e-9, 7], pixel_mm=0.1)
        assert layers.ring_counts().tolist() == [0, 0, 1, 0, 0]

    @BOTH_MODES
    def test_a_part_without_facets_and_a_stack_without_layers(self, mode):
        nothing = from_arrays(np.zeros((0, 3)), np.zeros((0, 3)))
        assert cut(nothing, [0.0, 1.0], mode=mode).ring_counts().tolist() == [0, 0]
        assert len(cut(box(), [], mode=mode)) == 0

    def test_vertical_and_degenerate_facets_change_nothing(self):
        vertices, faces = box(high=(3, 3, 3))
        extra = np.array([(0, 0, 1), (2, 2, 2), (0, 1, 0)])
        more = cut((vertices, np.vstack([faces, extra])), [1.5], pixel_mm=0.1)
        assert same(more, cut((vertices, faces), [1.5], pixel_mm=0.1))

    # -- the stack, the tiles and the threads change nothing -------------------------------------------

    @BOTH_MODES
    def test_tiles_give_the_same_bytes(self, mode):
        mesh = turned(torus(9, 3), (1, 2, 3), 0.9)
        heights = np.linspace(-6, 6, 9)
        whole = cut(mesh, heights, pixel_mm=0.1, mode=mode)
        for tiling in (
            {"max_texture_px": 37},
            {"max_texture_px": 5},
            {"max_texture_px": 1000, "buffer_mb": 0.02},
        ):
            assert same(cut(mesh, heights, pixel_mm=0.1, mode=mode, **tiling), whole)

    @pytest.mark.parametrize("pixel_mm", [0.1, 0.7])
    def test_facets_that_are_not_sent_add_nothing(self, pixel_mm, monkeypatch):
        """Neither those below the plane nor those that no ray meets; what is level with the plane is sent."""
        stairs = joined(*[box(high=(4 - i, 4 - i, 1 + i)) for i in range(3)])
        fine = turned(torus(9, 3, 150, 90), (3, 1, 2), 1.9)
        needles = turned((fine[0] * [1, 1, 40], fine[1]), (1, -1, 0.1), 0.02)
        for mesh in (turned(torus(9, 3), (1, 2, 3), 0.9), stairs, fine, needles):
            part = from_arrays(*mesh)
            bottom, top = part.bounds[:, 2]
            levels = np.unique(np.concatenate([part.vertices[::97, 2], np.linspace(bottom - 1, top + 1, 9)]))
            few, sent = self.images(part, levels, pixel_mm)
            monkeypatch.setattr(literal_mode, "drawn_facets", all_facets)
            every, _ = self.images(part, levels, pixel_mm)
            monkeypatch.undo()
            assert all(map(np.array_equal, few, every))
            assert any(image.any() for image in few)
            assert sent.holding.size + sent.near.size <= len(part.faces)

    @staticmethod
    def images(part, levels, pixel_mm):
        """Bitmaps at the levels, and the facets of which they were drawn."""
        with Stencil().prepare(part, Stencil.Settings(pixel_mm=pixel_mm, mode="literal")) as prepared:
            return [image_at(prepared, level) for level in levels], prepared._drawn

    def test_half_a_fine_mesh_need_not_be_sent(self):
        part = from_arrays(*turned(torus(9, 3, 300, 200), (3, 1, 2), 1.9))
        _, sent = self.images(part, [0.0], 0.3)
        assert sent.holding.size < 0.35 * len(part.faces)
        assert sent.near.size < 0.35 * len(part.faces)
        ((_, first), *_), ((_, last), *_) = sent.ranges(part.bounds[::-1, 2] - part.bounds[:, 2].mean(), 0.0)
        assert first < 0.02 * sent.holding.size < last

    def test_a_crowded_window_is_drawn_in_parts(self):
        """Two hundred plates over one corner of the field: no estimate foresees them in one band."""
        plates = joined(
            box(high=(0.1, 30, 0.1)), *[moved(box(high=(3, 1, 0.5)), (0, 0, i)) for i in range(200)]
        )
        few = cut(plates, [0.05, 7.25, 100.75], pixel_mm=0.1, buffer_mb=0.05)
        assert same(few, cut(plates, [0.05, 7.25, 100.75], pixel_mm=0.1))
        with pytest.raises(BackendFailed, match="buffer_mb"):
            cut(plates, [0.05], pixel_mm=0.1, buffer_mb=0.001)

    @BOTH_MODES
    def test_a_layer_does_not_depend_on_the_others(self, mode):
        part = from_arrays(*turned(torus(9, 3), (1, 2, 3), 0.9))
        rng = np.random.default_rng(2)
        count = 700 if mode == "draw-once" else 50
        heights = np.sort(np.concatenate([rng.uniform(-8, 8, count), 1e-7 * rng.random(5)]))
        done = []
        with Stencil().prepare(part, Stencil.Settings(pixel_mm=0.2, mode=mode)) as prepared:
            whole = prepared.slice(heights, done.append)
            for start, stop in ((0, 1), (3, 8), (len(heights) - 1, len(heights))):
                assert same(prepared.slice(heights[start:stop]), whole.block(start, stop))
            blocks = [prepared.slice(heights[a : a + 90]) for a in range(0, len(heights), 90)]
        assert same(concatenate(blocks), whole)
        assert sum(done) == len(heights)

    def test_threads_do_not_change_a_byte(self, monkeypatch):
        mesh = turned(torus(9, 3), (1, 2, 3), 0.9)
        results = []
        for threads in ("1", "3"):
            monkeypatch.setenv("EBAMCHECK_THREADS", threads)
            results.append(cut(mesh, np.linspace(-6, 6, 40), pixel_mm=0.02))
        assert same(*results)

    def test_a_bitmap_after_other_drawing_is_the_same(self):
        part, settings = from_arrays(*box()), Stencil.Settings(pixel_mm=0.05, mode="literal")
        with Stencil().prepare(part, settings) as first, Stencil().prepare(part, settings) as second:
            before = image_at(first, 0.5)
            second.slice(np.array([0.25]))
            first.slice(np.array([0.75]))
            assert before.any()
            assert np.array_equal(image_at(first, 0.5), before)

    def test_the_two_modes_agree_but_for_the_lattice(self):
        mesh = turned(torus(9, 3), (1, 2, 3), 0.9)
        heights = np.linspace(-7, 7, 12)
        pixel = 0.05
        once, literal = (cut(mesh, heights, pixel_mm=pixel, mode=m) for m in ("draw-once", "literal"))
        for k in range(heights.size):
            differing = region_of(once, k).symmetric_difference(region_of(literal, k)).area / pixel**2
            # A contour of n pixels passes n / 256 centres within a lattice step.
            assert differing <= 3 + literal.perimeters()[k] / pixel / 64

    def test_settings_and_renderer_are_recorded(self):
        layers = cut(box(), [0.5], mode="literal")
        assert layers.backend == "stencil"
        assert layers.settings["mode"] == "literal"
        assert layers.settings["inside_rule"] == "1..2"
        assert layers.settings["pixel_mm"] == 1 / 1024
        assert layers.settings["GL_RENDERER"] == PROBE.device
        assert layers.settings["GL_VERSION"] == PROBE.versions["GL_VERSION"]
        assert layers.labels_json()

    def test_a_field_over_the_driver_s_limit_is_refused(self):
        with pytest.raises(SettingsError, match="pixel_mm 1e-06"):
            cut(box(), [0.5], pixel_mm=1e-6)

    @BOTH_MODES
    def test_every_context_is_released(self, mode, monkeypatch):
        opened = []

        def recorded(open_context=opengl.open_context):
            opened.append(open_context())
            return opened[-1]

        monkeypatch.setattr(opengl, "open_context", recorded)
        cut(box(), [0.5], mode=mode, pixel_mm=0.1)
        Stencil().probe()
        with pytest.raises(SettingsError):
            cut(box(), [0.5], mode=mode, pixel_mm=1e-6)
        assert len(opened) == 3
        assert all(isinstance(c.mglo, moderngl.InvalidObject) for c in opened)

    def test_a_bitmap_that_no_buffer_of_the_driver_holds_is_refused(self, monkeypatch):
        device = opengl.device
        monkeypatch.setattr(opengl, "device", lambda context: replace(device(context), buffer_bytes=1000))
        with pytest.raises(SettingsError, match="largest buffer"):
            cut(box(), [0.5], mode="literal", pixel_mm=0.01)
        assert cut(box(), [0.5], mode="literal", pixel_mm=0.1).areas()[0] == pytest.approx(1.0, abs=0.2)

    def test_two_prepared_parts_live_side_by_side(self):
        settings = Stencil.Settings(pixel_mm=0.1, mode="literal")
        small, large = (from_arrays(*box(high=(s, s, s))) for s in (2, 4))
        with Stencil().prepare(small, settings) as a, Stencil().prepare(large, settings) as b:
            assert isinstance(a, LiteralSlices)
            areas = [p.slice(np.array([1.0])).areas()[0] for p in (a, b, a)]
        assert areas == pytest.approx([4, 16, 4], abs=1.0)

    # -- open surfaces -----------------------------------------------------------------------------------

    def test_an_opening_is_reported_and_spoils_no_layer_that_does_not_cut_it(self):
        vertices, faces = turned(torus(9, 3), (1, 2, 3), 0.9)
        heights = np.linspace(-8, 8, 60)
        closed = cut((vertices, faces), heights, pixel_mm=0.1)
        hole = np.arange(2000, 2030)
        opened = cut((vertices, np.delete(faces, hole, axis=0)), heights, pixel_mm=0.1)
        assert closed.settings["unbalanced_pixels"] == 0
        assert opened.settings["unbalanced_pixels"] > 0
        z = vertices[faces[hole].ravel(), 2]
        clear = (heights < z.min()) | (heights > z.max())
        assert 0 < clear.sum() < heights.size
        assert same(opened.take(np.flatnonzero(clear)), closed.take(np.flatnonzero(clear)))

    def test_a_facet_turned_over_is_outweighed(self):
        vertices, faces = box(high=(5, 5, 5))
        flipped = faces.copy()
        flipped[8] = flipped[8, ::-1]
        assert same(
            cut((vertices, flipped), [1, 3], pixel_mm=0.1), cut((vertices, faces), [1, 3], pixel_mm=0.1)
        )

    @pytest.mark.corpus
    @pytest.mark.slow
    def test_areas_of_real_meshes(self, corpus):
        rows = simple_sections(corpus)
        assert len(rows) > 20
        for name, planes in rows.items():
            part = ebamcheck.load(corpus / name)
            layers = cut(part, [float(row["z"]) for row in planes])
            r = Stencil().error_bound_mm(part, Stencil.Settings())
            for k, row in enumerate(planes):
                error = abs(layers.areas()[k] - float(row["signed_area"]))
                assert error <= r * float(row["perimeter"]), (name, row["z"])

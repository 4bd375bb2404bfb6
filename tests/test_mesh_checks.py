"""Planted mistakes before the slicers and in what all of them share: sections, heights, the part of the file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh
from parts import box, join

from ebamcheck import save
from ebamcheck.checks import part_file
from ebamcheck.checks.mesh_checks import heights_check, sections_check
from ebamcheck.checks.part_file import file_check
from ebamcheck.layers import heights as layer_heights_of
from ebamcheck.layers.heights import cut_heights
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.mesh import part as mesh_part
from ebamcheck.mesh.part_source import Placing, read_part
from ebamcheck.plugins.registry import models
from ebamcheck.settings.base import UNITS_MM
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

FRAME = shapely.box(0, 0, 60, 40).difference(shapely.box(24, 14, 38, 26))


# -- sections ----------------------------------------------------------------------------------------


def cut(part, config=None):
    return slice_part(part, cut_heights(part, config or Config()))


@pytest.mark.in_turn(3)
@pytest.mark.parametrize(
    "name",
    ["blade", "helical-channel", "torus", "two-spheres", "menger-1", "case-touching-board", "case-prusa-4245", "tilted-plate"],
)  # fmt: skip
@pytest.mark.parametrize("height_mm", [0.9, 1.6755])
def test_sections_of_sound_slicers_are_those_of_the_mesh(name, height_mm):
    config = Config().changed(layers={"layer_height_mm": height_mm})
    part = models()[name].tessellate(0.1)
    layers = cut(part, config)
    assert sections_check(part, layers, config).passed
    assert heights_check(part, layers.heights, config).passed


def test_holes_that_polygons_forget_are_found(monkeypatch):
    part = models()["prism"].tessellate(0.1)
    layers, right = cut(part), Layers.polygons
    monkeypatch.setattr(Layers, "polygons", lambda self, k: [shapely.Polygon(p.exterior) for p in right(self, k)])
    check = sections_check(part, layers, Config())
    assert not check.passed
    assert check.value > Config().process.bead_width_mm / 4


@pytest.mark.parametrize(
    "change",
    [
        lambda p: shapely.affinity.translate(p, 0.4, 0.0),
        lambda p: shapely.affinity.translate(p, 0.0, -0.4),
        lambda p: shapely.affinity.scale(p, -1.0, 1.0),
        lambda p: shapely.affinity.rotate(p, 90.0),
        lambda p: p.buffer(0.4),
        lambda p: p.buffer(-0.4),
        lambda p: shapely.Polygon(p.exterior, list(p.interiors)[:-1]),
        lambda _: shapely.Polygon(),
    ],
)
def test_other_sections_are_found(change):
    part = models()["prism"].tessellate(0.1)
    layers = cut(part)
    polygons = [[change(p) if k == 7 else p for p in layers.polygons(k)] for k in range(len(layers))]
    check = sections_check(part, from_polygons(layers.heights, polygons), Config())
    assert not check.passed
    assert check.layer == 7


def test_a_body_that_is_lost_is_found_among_those_that_overlap():
    part = join(box((0, 0, 0), (30, 30, 10)), box((20, 20, 0), (50, 50, 10)), box((70, 0, 0), (80, 9, 10)))
    layers = cut(part)
    assert sections_check(part, layers, Config()).passed
    fewer = [sorted(layers.polygons(k), key=lambda p: p.area)[1:] for k in range(len(layers))]
    assert not sections_check(part, from_polygons(layers.heights, fewer), Config()).passed


# -- heights -----------------------------------------------------------------------------------------

TOWER = box((0, 0, 3), (20, 12, 3 + 70 * 1.6))
SIXTEENTHS = Config().changed(layers={"layer_height_mm": 1.6})


def test_layers_that_are_left_out_are_found():
    cuts = cut_heights(TOWER, SIXTEENTHS)
    assert heights_check(TOWER, cuts, SIXTEENTHS).passed
    for wrong in (cuts[:-1], cuts[1:], np.delete(cuts, 30), cuts[::2], cuts + 0.4, 1.1 * (cuts - 3) + 3):
        assert not heights_check(TOWER, wrong, SIXTEENTHS).passed


@pytest.mark.parametrize("top_mm", [0.3, 1.0, 1.6, 2.3, 2.5, 4.0, 47.21])
def test_any_height_of_a_part_has_its_layers(top_mm):
    part = box((0, 0, 0), (20, 20, top_mm))
    assert heights_check(part, cut_heights(part, SIXTEENTHS), SIXTEENTHS).passed


def test_heights_that_the_user_lists_are_his():
    config = SIXTEENTHS.changed(layers={"heights_mm": [5.0, 7.0, 8.0]})
    assert heights_check(TOWER, cut_heights(TOWER, config), config).passed


def test_a_mistake_in_the_heights_of_cuts_shuts_the_gate(monkeypatch):
    monkeypatch.setattr(layer_heights_of.math, "ceil", lambda number: int(np.ceil(number)) - 1)
    cuts = layer_heights_of.layer_heights(TOWER, 1.6)
    monkeypatch.undo()
    assert not heights_check(TOWER, cuts, SIXTEENTHS).passed
    assert replace(heights_check(TOWER, cuts, SIXTEENTHS), passed=True).value == pytest.approx(0.8)


# -- the part of the file ----------------------------------------------------------------------------


CORNERED = join(box((0, 0, 0), (30, 20, 10)), box((0, 0, 10), (8, 6, 25)))
"""A part that is alike in no two directions."""


def read(folder, settings, form="binary"):
    config = Config().changed(part=settings)
    part, path = CORNERED, folder / "prism.stl"
    if form != "ascii":
        save(part, path)
        path.write_bytes(path.read_bytes() + {"trailing": b"?", "padded": bytes(512)}.get(form, b""))
    else:
        lines = [
            "facet normal 0 0 0",
            "outer loop",
            *["vertex {:.9g} {:.9g} {:.9g}"] * 3,
            "endloop",
            "endfacet",
        ]
        every = (chr(10).join(lines).format(*facet.ravel()) for facet in part.triangles)
        # A name that ends in a word of the format.
        path.write_text(chr(10).join(["solid one_vertex", *every, "endsolid one_vertex", ""]))
    return read_part(path, config.part)[0], config


@pytest.mark.parametrize("form", ["binary", "trailing", "padded", "ascii"])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"units": "in"},
        {"units": "cm", "direction": [0.0, -1.0, 0.0]},
        {"direction": [0.6, 0.0, 0.8], "rotate_deg": 30.0, "place_at_mm": [100.0, 50.0, 3.0]},
        {"direction": [0.0, 0.0, -1.0]},
    ],
)
def test_a_part_is_the_one_in_its_file(settings, form, tmp_path):
    assert file_check(*read(tmp_path, settings, form)).passed


def test_a_text_file_has_the_numbers_of_a_binary_one(tmp_path):
    """A small part far from the origin: its file prints more digits than a part has."""
    config, path = Config(), tmp_path / "far.stl"
    corners = (0.513 * CORNERED.triangles + 123456.789).tolist()
    text = "facet normal 0 0 0 outer loop vertex {} {} {} vertex {} {} {} vertex {} {} {} endloop endfacet"
    every = (text.format(*(x for corner in facet for x in corner)) for facet in corners)
    path.write_text("\n".join(["solid far", *every, "endsolid far", ""]))
    assert file_check(read_part(path, config.part)[0], config).passed


def test_a_wrong_unit_is_found(monkeypatch, tmp_path):
    monkeypatch.setitem(UNITS_MM, "in", 25.0)
    check = file_check(*read(tmp_path, {"units": "in"}))
    assert not check.passed
    assert check.value > 0.01


@pytest.mark.parametrize("direction", [[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.0, -1.0]])
def test_a_part_that_is_turned_the_wrong_way_is_found(direction, monkeypatch, tmp_path):
    right = mesh_part.rotation_to_z
    wrong = (lambda _: np.eye(3)) if direction[2] < 0 else (lambda way: right(way).T)
    monkeypatch.setattr(mesh_part, "rotation_to_z", wrong)
    part, config = read(tmp_path, {"direction": direction})
    assert not file_check(part, config).passed


def test_a_part_that_shrinks_as_it_is_placed_is_found(monkeypatch, tmp_path):
    right = Placing.moved
    monkeypatch.setattr(Placing, "moved", lambda self, part: replace(right(self, part), vertices=0.98 * part.vertices))
    assert not file_check(*read(tmp_path, {"rotate_deg": 30.0})).passed


def turned_back(self, part, right=Placing.moved):
    return right(replace(self, turn_deg=-self.turn_deg), part)


def turned_about_the_origin(self, part, right=Placing.moved):
    return right(replace(self, about_mm=(0.0, 0.0)), part)


def placed_with_x_and_y_swapped(self, part, right=Placing.moved):
    x, y, z = self.shift_mm
    return right(replace(self, shift_mm=(y, x, z)), part)


def mirrored(self, part, right=Placing.moved):
    return replace(right(self, part), vertices=right(self, part).vertices * [-1.0, 1.0, 1.0]).reversed()


WRONG = [turned_back, turned_about_the_origin, placed_with_x_and_y_swapped, mirrored]
PLACED = {"rotate_deg": 30.0, "place_at_mm": [100.0, 50.0, 3.0]}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_part_that_is_placed_wrongly_is_found(wrong, monkeypatch, tmp_path):
    settings = PLACED if wrong is not turned_about_the_origin else {"rotate_deg": 30.0}
    assert file_check(*read(tmp_path, settings)).passed
    monkeypatch.setattr(Placing, "moved", wrong)
    check = file_check(*read(tmp_path, settings))
    assert not check.passed
    assert "direction, turn and place" in check.text


def test_a_part_that_is_turned_by_more_than_the_shortest_turn_is_found(monkeypatch, tmp_path):
    right, more = mesh_part.rotation_to_z, np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for direction in ([0.6, 0.0, 0.8], [0.0, 0.0, -1.0]):
        monkeypatch.setattr(mesh_part, "rotation_to_z", lambda way: more @ right(way))
        assert not file_check(*read(tmp_path, {"direction": direction})).passed
        monkeypatch.undo()


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 2e-7, 1e-6, 1e-4, 0.1, 1.0])
def test_a_turn_near_upside_down_keeps_the_size_of_a_part(tilt):
    """1 + z loses its digits there: a part turned along (0, 1e-6, -1) was a ten-thousandth too large."""
    way = mesh_part.unit_vector([0.6 * tilt, -0.8 * tilt, -1.0])
    turn = mesh_part.rotation_to_z(way)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
    assert turn @ way == pytest.approx([0.0, 0.0, 1.0], abs=2e-9)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_a_part_of_another_format_stands_where_the_settings_say(suffix, monkeypatch, tmp_path):
    path = tmp_path / f"part{suffix}"
    if suffix == ".ply":
        trimesh.Trimesh(CORNERED.vertices, CORNERED.faces, process=False).export(path)
    else:
        lines = [f"v {x} {y} {z}" for x, y, z in CORNERED.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (CORNERED.faces + 1).tolist()]
        path.write_text("\n".join(lines) + "\n")
    config = Config().changed(part={"units": "cm", "direction": [0.0, -1.0, 0.0], **PLACED})
    assert file_check(read_part(path, config.part)[0], config).passed
    monkeypatch.setattr(Placing, "moved", turned_back)
    assert not file_check(read_part(path, config.part)[0], config).passed


def test_facets_that_are_turned_over_as_the_settings_ask_stand_where_they_stood(tmp_path):
    path = tmp_path / "inside_out.stl"
    save(CORNERED.reversed(), path)
    config = Config().changed(part={"fix_orientation": True, **PLACED})
    part, turned = read_part(path, config.part)
    assert turned
    assert file_check(part, config).passed
    assert not file_check(part, config.changed(part={"fix_orientation": False})).passed


PLATE = """clearance_mm = 1
[[parts]]
file = "a.stl"
units = "inches"
direction = [1, 0, 0]
rotate_deg = 30
place_mm = [0, 0]
[[parts]]
file = "a.stl"
place_mm = [4000, 0]
copies = 3
step_mm = [500, 70]
"""


@pytest.mark.parametrize("wrong", [None, turned_back, placed_with_x_and_y_swapped, mirrored])
def test_every_part_of_a_plate_stands_where_the_plate_says(wrong, monkeypatch, tmp_path):
    save(CORNERED, tmp_path / "a.stl")
    (tmp_path / "plate.toml").write_text(PLATE)
    config = Config().changed(part={"units": "cm"})
    if wrong is not None:
        monkeypatch.setattr(Placing, "moved", wrong)
    assert file_check(read_part(tmp_path / "plate.toml", config.part)[0], config).passed is (wrong is None)


def test_a_plate_along_a_direction_of_the_settings_can_be_made_layer_by_layer(tmp_path):
    """The mesh of a plate is not turned: its layers have the direction of the settings, which parts without their own are turned by."""
    save(CORNERED, tmp_path / "a.stl")
    (tmp_path / "plate.toml").write_text('[[parts]]\nfile = "a.stl"\nplace_mm = [0, 0]\n')
    config = Config().changed(part={"direction": [1.0, 0.0, 0.0]})
    with LayerMaker(read_part(tmp_path / "plate.toml", config.part)[0], config) as maker:
        own = maker.config_of(Wanted(0, 0.0, 1.6, "MAIN_K0001R1"))
    part = read_part(tmp_path / "plate.toml", own.part)[0]
    assert file_check(part, own).passed
    assert (part.vertices == maker.part.vertices).all()


def test_copies_on_a_plate_are_read_once(tmp_path, monkeypatch):
    save(CORNERED, tmp_path / "a.stl")
    (tmp_path / "plate.toml").write_text(PLATE)
    config = Config().changed(part={"units": "cm"})
    part, read, right = read_part(tmp_path / "plate.toml", config.part)[0], [], part_file._facets_of
    monkeypatch.setattr(part_file, "_facets_of", lambda path: (read.append(path), right(path))[1])
    assert file_check(part, config).passed
    assert len(read) == 2  # in inches, and in centimetres

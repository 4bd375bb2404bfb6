"""Placed parts and plates: turns and shifts against rational ones, parts kept apart, each part with its own entry."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from command_line import FAST, WIDE, frame, write_stl
from parts import box, sphere
from slicers_here import slicers_here

from ebamcheck.checks.consumables import member_of, plate_checks, plate_record
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.mesh.part_source import (
    PlatePart,
    cosine_and_sine,
    load_plate,
    placing_of,
    read_part,
    read_reference,
    source_sha256,
)
from ebamcheck.pipeline import run_job
from ebamcheck.program import read_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import PartSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.verification.verify import verify

SETTINGS = Config().changed(layers={"layer_height_mm": 6.0}, process=WIDE, slicing={"backends": tuple(FAST.split(","))})


def block():
    """A part that no turn but a whole one brings onto itself."""
    return box((1.0, 2.0, 3.0), (31.0, 14.0, 15.0))


# -- one part ----------------------------------------------------------------------------------------


def test_a_part_that_nothing_moves_is_the_same_to_the_bit():
    part = block()
    assert placing_of(part).moved(part) is part
    assert placing_of(part, None, 360.0).moved(part) is part
    before = part.bounds.mean(axis=0)
    same = placing_of(part, (float(before[0]), float(before[1]))).moved(part)
    assert same.sha256 == part.sha256


@pytest.mark.parametrize("quarters", range(-4, 5))
def test_quarter_turns_are_exact(quarters):
    part = block()
    turned = placing_of(part, None, 90.0 * quarters).moved(part)
    size = part.size if quarters % 2 == 0 else part.size[[1, 0, 2]]
    assert np.array_equal(turned.size, size)
    assert np.array_equal(turned.bounds.mean(axis=0), part.bounds.mean(axis=0))
    assert turned.volume == pytest.approx(part.volume, rel=1e-12)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, -77.5, 90.0, 123.0])
@pytest.mark.parametrize("place", [(100.0, -50.0), (0.0, 0.0, 7.5)])
def test_the_middle_of_the_turned_box_comes_to_the_place(turn_deg, place):
    part = frame()
    placed = placing_of(part, place, turn_deg).moved(part)
    assert placed.bounds.mean(axis=0)[:2] == pytest.approx(place[:2], abs=1e-12)
    low = place[2] if len(place) == 3 else part.bounds[0, 2]
    assert placed.bounds[0, 2] == pytest.approx(low, abs=1e-12)
    # A motion: every distance stays, and so does the side that is inside.
    pairs = np.random.default_rng(4).integers(0, len(part.vertices), (200, 2))
    before = np.linalg.norm(np.diff(part.vertices[pairs], axis=1), axis=2)
    assert np.linalg.norm(np.diff(placed.vertices[pairs], axis=1), axis=2) == pytest.approx(before, abs=1e-9)
    assert placed.volume == pytest.approx(part.volume, rel=1e-12)


def test_a_positive_turn_is_counter_clockwise_seen_from_above():
    assert cosine_and_sine(90.0) == (0.0, 1.0)
    assert cosine_and_sine(30.0) == (math.cos(math.pi / 6), math.sin(math.pi / 6))
    part = box((-1, -1, 0), (3, 1, 2))
    turned = placing_of(part, (0.0, 0.0), 90.0).moved(part)
    corner = np.flatnonzero((part.vertices == (3, -1, 0)).all(axis=1))[0]
    assert turned.vertices[corner].tolist() == [1.0, 2.0, 0.0]


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 33.0])
def test_sections_move_with_the_part(turn_deg):
    part = frame()
    placed = placing_of(part, (200.0, 10.0), turn_deg).moved(part)
    (plain,), (moved,) = (slice_part(p, [4.0]).polygons(0) for p in (part, placed))
    about = shapely.affinity.rotate(plain, turn_deg, origin=(20.0, 20.0))
    there = shapely.affinity.translate(about, 180.0, -10.0)
    assert moved.symmetric_difference(there).area < 1e-6


def test_a_reference_moves_as_its_part_does(tmp_path):
    # The boxes of the two meshes are not the same: placed each by its own, they would be apart.
    coarse, fine = sphere(20.0, 7, 9), sphere(20.0, 30, 60)
    settings = PartSettings.model_validate({"place_at_mm": (100.0, 0.0), "rotate_deg": 20.0})
    file, finer = write_stl(coarse, tmp_path / "a.stl"), write_stl(fine, tmp_path / "b.stl")
    part, _ = read_part(file, settings)
    reference = read_reference(finer, file, settings)
    shift = placing_of(*(read_part(file, PartSettings())[0],), (100.0, 0.0), 20.0)
    assert np.array_equal(reference.vertices, shift.moved(read_part(finer, PartSettings())[0]).vertices)
    assert abs(part.bounds.mean(axis=0)[0] - 100.0) < 1e-9 < abs(reference.bounds.mean(axis=0)[0] - 100.0)


def test_direction_first_then_turn_then_place(tmp_path):
    file = write_stl(box((0, 0, 0), (30, 12, 8)), tmp_path / "a.stl")
    settings = PartSettings.model_validate(
        {"direction": (1, 0, 0), "rotate_deg": 90, "place_at_mm": (5, 6, 0), "units": "cm"}
    )
    part, _ = read_part(file, settings)
    assert part.size == pytest.approx([120.0, 80.0, 300.0])
    assert part.bounds[0] == pytest.approx([-55.0, -34.0, 0.0])


# -- plates ------------------------------------------------------------------------------------------


def plate_file(folder: Path, text: str, name: str = "plate.toml") -> Path:
    write_stl(block(), folder / "block.stl")
    write_stl(frame(), folder / "frame.stl")
    path = folder / name
    path.write_text(text)
    return path


PLATE = """
clearance_mm = 12.0
[[parts]]
file = "frame.stl"
place_mm = [0, 0]
rotate_deg = 45
[[parts]]
file = "block.stl"
name = "rail"
place_mm = [60, 0]
rotate_deg = 90
copies = 2
step_mm = [30, 0]
"""


def test_parts_and_copies_stand_where_the_plate_says(tmp_path):
    part = load_plate(plate_file(tmp_path, PLATE))
    assert [m.name for m in part.members] == ["frame", "rail 1", "rail 2"]
    assert [m.place_at_mm for m in part.members] == [(0, 0), (60, 0), (90, 0)]
    for member in part.members:
        mesh = part.member(member)
        assert mesh.bounds.mean(axis=0)[:2] == pytest.approx(member.place_at_mm, abs=1e-9)
        assert mesh.bounds[0, 2] == 0.0
    assert part.member(part.members[2]).size == pytest.approx([12.0, 30.0, 12.0])
    assert part.volume == pytest.approx(frame().volume + 2 * block().volume)
    assert sum(len(part.member(m).faces) for m in part.members) == len(part.faces)


def test_a_plate_cut_is_the_cut_of_each_part(tmp_path):
    part = load_plate(plate_file(tmp_path, PLATE))
    whole = shapely.union_all(slice_part(part, [5.0]).polygons(0))
    single = [slice_part(part.member(m), [5.0]).polygons(0) for m in part.members]
    assert whole.symmetric_difference(shapely.union_all([p for ps in single for p in ps])).area < 1e-9
    assert len(whole.geoms) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            PLATE.replace("[60, 0]", "[45, 0]"),
            r"'frame' and 'rail 1' are .* mm apart, and clearance_mm asks for 12 mm",
        ),
        (PLATE.replace("[30, 0]", "[0, 0]"), r"'rail 1' and 'rail 2' are in each other's way"),
        (PLATE.replace("step_mm = [30, 0]", ""), r"2 copies need step_mm"),
        (PLATE.replace("frame.stl", "gone.stl"), r"gone\.stl: there is no such file"),
        (PLATE.replace("frame.stl", "plate.toml"), r"is a plate itself"),
        (
            PLATE.replace('name = "rail"', 'name = "frame 2"\ncopies = 0').replace("copies = 2", ""),
            r"from 1 to 10000",
        ),
        (
            PLATE.replace("rotate_deg = 45", "turn = 45"),
            r"parts 1\.turn: unknown key; known keys: file, name",
        ),
        (
            PLATE.replace("place_mm = [0, 0]", ""),
            r"parts 1\.place_mm: is missing: it takes a list of 2 numbers",
        ),
        (
            PLATE.replace("[60, 0]", "[60, nan]"),
            r"parts 2\.place_mm\.1: it takes a list of 2 numbers .*, and a finite one",
        ),
        ("clearance_mm = 3", r"parts: is missing"),
        ("parts = 3", r"parts: "),
        ("parts = [", r"is not TOML"),
        (PLATE + '[[parts]]\nfile = "frame.stl"\nplace_mm = [0, 500]', r"two parts are called 'frame'"),
    ],
)
def test_plates_that_make_no_sense_are_refused_in_one_line(tmp_path, text, message):
    with pytest.raises((SettingsError, InputError), match=message) as told:
        load_plate(plate_file(tmp_path, text))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("gap_mm", [11.999, 12.001])
def test_the_clearance_is_that_of_the_outlines(tmp_path, gap_mm):
    # Two boxes of 30 x 12 mm side by side.
    text = PLATE[: PLATE.index("[[parts]]")] + (
        f'[[parts]]\nfile = "block.stl"\nplace_mm = [0, 0]\ncopies = 2\nstep_mm = [{30.0 + gap_mm}, 0]\n'
    )
    path = plate_file(tmp_path, text)
    if gap_mm < 12.0:
        with pytest.raises(SettingsError, match="apart, and clearance_mm"):
            load_plate(path)
    else:
        assert len(load_plate(path).members) == 2


def test_the_hash_of_a_plate_covers_its_parts(tmp_path):
    path = plate_file(tmp_path, PLATE)
    before = source_sha256(path)
    assert load_plate(path).source_sha256 == before == source_sha256(path)
    write_stl(box((1.0, 2.0, 3.0), (31.0, 14.0, 15.5)), tmp_path / "block.stl")
    assert source_sha256(path) != before


def test_settings_that_place_one_part_are_not_for_a_plate(tmp_path):
    path = plate_file(tmp_path, PLATE)
    for values in ({"place_at_mm": (0, 0)}, {"rotate_deg": 10}):
        with pytest.raises(SettingsError, match="a plate places each of its parts itself"):
            read_part(path, PartSettings.model_validate(values))
    with pytest.raises(SettingsError, match="measure the parts of a plate one by one"):
        read_reference(tmp_path / "frame.stl", path, PartSettings())


def test_every_point_belongs_to_the_part_whose_outline_is_nearest(tmp_path):
    part = load_plate(plate_file(tmp_path, PLATE))
    assert member_of(part, np.array([(0.0, 0.0), (60.0, 10.0), (92.0, -3.0), (200.0, 0.0)])).tolist() == [
        0,
        1,
        2,
        2,
    ]


# -- a job -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plate")
    path = plate_file(folder, PLATE)
    with slicers_here():
        return path, run_job(path, folder / "plate.run", SETTINGS)


def test_a_plate_is_validated_and_every_part_has_its_entry(built):
    path, result = built
    assert result.exit_code == 0, result.manifest["gates"]
    certificate = json.loads((result.folder.path / "certificate.json").read_text())
    entries = certificate["plate"]
    assert entries == json.loads((result.folder.path / "run.json").read_text())["plate"]
    assert [e["name"] for e in entries] == ["frame", "rail 1", "rail 2"]
    assert [e["place_at_mm"] for e in entries] == [[0, 0], [60, 0], [90, 0]]
    assert [e["rotate_deg"] for e in entries] == [45, 90, 90]
    assert [e["sha256"] for e in entries[1:]] == [source_sha256(path.parent / "block.stl")] * 2
    assert all(e["verdict"] == "sound" and e["layers"] == 2 for e in entries)
    total = sum(e["wire_kg"] for e in entries)
    assert total == pytest.approx(certificate_total(result), rel=1e-9)
    for entry in entries:
        assert entry["wire_kg"] == pytest.approx(entry["part_kg"], rel=0.03)
    assert entries[1]["part_kg"] == pytest.approx(block().volume * 4430e-9)


def certificate_total(result):
    return result.manifest["program"]["totals"]["wire_kg"]


def test_a_plate_is_laid_layer_by_layer(built):
    _, result = built
    part = load_plate(built[0])
    nc = read_program(RunFolder(result.folder.path).program_folder / "MAIN.MPF", SETTINGS)
    laid = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    owner = member_of(part, 0.5 * (nc.start[laid, :2] + nc.end[laid, :2]))
    assert (np.diff(nc.layer[laid]) >= 0).all()
    for layer in range(2):
        assert set(owner[nc.layer[laid] == layer].tolist()) == {0, 1, 2}


def test_a_run_of_a_plate_is_verified_whole_and_by_its_text(built):
    path, result = built
    for checks in (
        verify(result.folder.path),
        verify(result.folder.path / "program" / "MAIN.MPF", path),
    ):
        assert [c for c in checks if not c.passed] == []
        assert "plate" in {c.name for c in checks}


def test_a_changed_part_of_a_plate_is_seen(built, tmp_path):
    _, result = built
    other = plate_file(tmp_path, PLATE)
    write_stl(box((1.0, 2.0, 3.0), (31.0, 14.0, 15.5)), tmp_path / "block.stl")
    failed = [c.name for c in verify(result.folder.path, other) if not c.passed]
    assert failed == ["part unchanged"]


@pytest.mark.parametrize("key", ["wire_kg", "place_at_mm", "sha256", "rotate_deg", "name"])
def test_an_entry_that_is_not_so_is_seen(built, key):
    path, result = built
    part = load_plate(path)
    nc = read_program(result.folder.path / "program" / "MAIN.MPF", SETTINGS)
    recorded = result.manifest["plate"]
    (check,) = plate_checks(part, SETTINGS, nc, recorded, "run.json")
    assert check.passed
    wrong = {"wire_kg": 0.1, "place_at_mm": [0, 1], "sha256": "0", "rotate_deg": 1.0, "name": "x"}[key]
    (check,) = plate_checks(part, SETTINGS, nc, [{**recorded[0], key: wrong}, *recorded[1:]], "run.json")
    assert not check.passed
    assert key in check.text
    (check,) = plate_checks(part, SETTINGS, nc, recorded[:2], "run.json")
    assert not check.passed


def test_one_part_has_no_entries():
    assert plate_record(block(), SETTINGS) == []
    assert plate_checks(block(), SETTINGS, None, None, "") == []
    assert isinstance(replace(PlatePart(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), name="x"), PlatePart)


def test_a_placed_part_is_built_where_it_is_placed(tmp_path):
    file = write_stl(block(), tmp_path / "block.stl")
    placed = SETTINGS.changed(part={"place_at_mm": (300.0, -200.0), "rotate_deg": 90.0})
    result = run_job(file, tmp_path / "block.run", placed)
    assert result.exit_code == 0, result.manifest["gates"]
    nc = read_program(result.folder.path / "program" / "MAIN.MPF", placed)
    laid = nc.end[nc.deposit & (nc.ring >= 0)][:, :2]
    assert 0.5 * (laid.min(axis=0) + laid.max(axis=0)) == pytest.approx([300.0, -200.0], abs=1e-3)
    part = json.loads((result.folder.path / "certificate.json").read_text())["part"]
    assert (part["place_at_mm"], part["rotate_deg"]) == ([300.0, -200.0], 90.0)
    assert all(check.passed for check in verify(result.folder.path))

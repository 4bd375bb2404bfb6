"""Where hatch beads start and end, by text and sections alone: late starts, early ends, and what holds for one and for many."""

import numpy as np
import pytest
import shapely
from prism_program import CONFIG, Made

import ebamcheck
from ebamcheck.checks.bead_end_checks import end_gaps_check, most_on_average_mm
from ebamcheck.nc.roles import by_height, by_section
from ebamcheck.program import read_program
from ebamcheck_models import MODELS


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A plate whose hatch has many islands, and its program as it is planned."""
    return Made(tmp_path_factory.mktemp("plate"), shapely.box(0.0, 0.0, 80.0, 56.0), layers=3)


def read(made, main=None):
    nc = by_height(read_program(main or made.files.main, made.config), made.z)
    return by_section(nc, made.layers, made.z, made.config.contour_offset_mm, 0.75)


def moved(made, folder, late_mm=0.0, early_mm=0.0, only=None):
    """The check of the program whose hatch beads start or end later or earlier along their first or last line, in the text."""
    nc = read(made)
    texts = {file.name: file.data.split(b"\n") for file in nc.files}
    beads = nc.beads
    for a, b in zip(beads.first.tolist(), beads.last.tolist(), strict=True):
        if nc.ring[a] >= 0 or only not in (None, a):
            continue
        if late_mm and nc.lengths[a] > late_mm + 1.0:
            way = nc.end[a, :2] - nc.start[a, :2]
            set_place(texts, nc, a - 1, nc.start[a, :2], nc.start[a, :2] + late_mm * way / np.hypot(*way))
        if early_mm and nc.lengths[b] > early_mm + 1.0:
            way = nc.end[b, :2] - nc.start[b, :2]
            set_place(texts, nc, b, nc.end[b, :2], nc.end[b, :2] - early_mm * way / np.hypot(*way))
    for name, lines in texts.items():
        (folder / name).write_bytes(b"\n".join(lines))
    check = end_gaps_check(read(made, folder / made.files.main.name), made.config, made.layers)
    assert check.name == "ends of beads"
    return check


def set_place(texts, nc, row, before, after):
    """Change the block that leads to a place: that of a motion, or of the last one before it that names X and Y."""
    lines = texts[nc.files[int(nc.file[row])].name]
    old = f"X{before[0]:.6f} Y{before[1]:.6f}".encode()
    i = int(nc.line[row]) - 1
    while old not in lines[i]:
        i -= 1
    lines[i] = lines[i].replace(old, f"X{after[0]:.6f} Y{after[1]:.6f}".encode())


def test_beads_as_planned_stop_three_tenths_of_a_spacing_before_their_islands_border(plate, tmp_path):
    assert moved(plate, tmp_path).passed


@pytest.mark.parametrize("end", ["late_mm", "early_mm"])
def test_two_millimetres_at_every_bead_are_found_and_half_a_millimetre_is_not(plate, tmp_path, end):
    found = moved(plate, tmp_path, **{end: 2.0})
    assert not found.passed
    assert "on average" in found.text
    assert ("start" if end == "late_mm" else "end") in found.text
    assert moved(plate, tmp_path, **{end: 0.3}).passed


def test_an_end_beyond_the_border_of_the_part_faces_it(tmp_path):
    """The tips of an impeller's blades are narrower than a bead: no border lies ahead of what ends within them."""
    part = MODELS["impeller"].tessellate(0.05)
    tips = shapely.union_all(ebamcheck.slice(part, [9.215], backend="planecut").polygons(0))
    made = Made(tmp_path, tips, layers=1)
    found = end_gaps_check(read(made), made.config, made.layers)
    assert found.passed
    assert np.isfinite(found.value)


def test_the_mean_of_many_ends_is_held_to_less_than_one_end():
    """Three quarters of a spacing for very many, one and a half bead widths for one."""
    limits = most_on_average_mm(np.array([1.0, 10.0, 1e6]), CONFIG)
    assert limits == pytest.approx([9.0, 3.24 + 0.576, 3.24], abs=1e-3)

"""What no layer has: bores, cracks and rims that lie between two cuts are told with place and size, and refused where a setting says so."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from parts import box, join, sphere, tilted, torus

from ebamcheck.checks.mesh_checks import between_check
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.pipeline.findings import metal_findings
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

CUTS = (np.arange(4) + 0.5) * 1.5
BLOCK = box((0, 0, 0), (40, 30, 6))


def bored(radius_mm: float, z_mm: float, sides: int = 24) -> Part:
    """A block with a round bore along X through it."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([15.0 + radius_mm * np.cos(turn), z_mm + radius_mm * np.sin(turn)])
    outer = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 6.0], [0.0, 6.0]])
    points = np.vstack([outer, ring])
    quarter = sides // 4
    # Each corner of the block with the quarter of the ring next to it, then the four sides of the block.
    faces = []
    for corner, first in ((0, 2), (1, 3), (2, 0), (3, 1)):
        at = [4 + (first * quarter + k) % sides for k in range(quarter + 1)]
        faces += [(corner, b, a) for a, b in itertools.pairwise(at)]
        faces.append((corner, (corner + 1) % 4, at[-1]))
    ends = np.array(faces)
    count = len(points)
    walls = [(a, (a + 1) % 4) for a in range(4)] + [(4 + (k + 1) % sides, 4 + k) for k in range(sides)]
    tube = [t for a, b in walls for t in ((a, a + count, b), (b, a + count, b + count))]
    flat = np.vstack([np.column_stack([np.full(count, x), points]) for x in (0.0, 40.0)])
    return from_arrays(flat, np.vstack([ends[:, ::-1], ends + count, np.array(tube)[:, ::-1]]))


def found(part: Part, **process: float) -> tuple:
    config = Config().changed(layers={"layer_height_mm": 1.5}, process=process)
    cuts = np.arange(part.bounds[0, 2] + 0.75, part.bounds[1, 2], 1.5)
    check = between_check(part, slice_part(part, cuts), config)
    return check, list(metal_findings([check]))


def test_a_bore_that_lies_between_two_cuts_is_told_and_refused_where_holes_are_wider_by_the_settings():
    part = bored(0.6, 3.0)
    check, told = found(part)
    assert check.passed
    assert [(f.severity, f.code) for f in told] == [("warning", "lost-between-cuts")]
    assert "an opening 1.2 mm high and 1.2 mm wide at z = 3.000 mm, (20.0, 15.0)" in check.text
    check, told = found(part, least_hole_mm=20.0)
    assert not check.passed
    assert [f.severity for f in told] == ["fault"]
    assert "process.least_hole_mm allows none under 20 mm" in check.text
    assert (check.layer, round(check.x_mm), round(check.y_mm)) == (1, 20, 15)


def test_a_bore_that_a_cut_crosses_is_for_the_sections_to_tell():
    check, told = found(bored(0.6, 2.25))
    assert check.value == 0.0
    assert told == []


@pytest.mark.parametrize("gap", [0.1, 0.4, 1.2])
def test_a_gap_between_two_bodies_is_told(gap):
    part = join(box((0, 0, 0), (40, 30, 2.5)), box((0, 0, 2.5 + gap), (40, 30, 6)))
    check, _ = found(part)
    assert check.value == 1.0
    assert f"an opening {gap:.2g} mm high" in check.text


def test_a_rim_is_told_where_it_reaches_farther_than_sides_are_uneven():
    for reach, count in ((0.8, 0.0), (1.2, 1.0)):
        part = join(BLOCK, box((-reach, -reach, 2.6), (40 + reach, 30 + reach, 3.4)))
        check, told = found(part, least_wall_mm=1.0)
        assert check.value == count
        assert check.passed == (count == 0.0)
        assert [f.severity for f in told] == ["fault"] * int(count)


@pytest.mark.parametrize(
    "part",
    [BLOCK, sphere(10.0), torus(), tilted(BLOCK), join(BLOCK, box((10, 10, 5.5), (20, 20, 9.7)))],
    ids=["block", "sphere", "torus", "tilted", "step"],
)
def test_sound_parts_have_nothing_between_their_cuts(part):
    check, told = found(part)
    assert check.value == 0.0
    assert told == []


def test_listed_heights_say_which_layers_there_are():
    config = Config().changed(layers={"heights_mm": [0.75, 5.25]})
    check = between_check(bored(0.6, 3.0), slice_part(bored(0.6, 3.0), np.array([0.75, 5.25])), config)
    assert check.passed
    assert check.value == 0.0


def test_sections_that_meet_in_a_line_are_compared():
    """Two blocks beside each other, one on the lower and one on the upper layer, and a rim of a third between the cuts."""
    part = join(
        box((0, 0, 0), (20, 30, 1.5)), box((20, 0, 1.5), (40, 30, 3)), box((0, 0, 0.9), (40, 30, 2.1))
    )
    check, _ = found(part)
    assert check.passed
    assert check.value == 0.0

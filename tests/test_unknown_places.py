"""Beads of a text that never says where they begin: they cover nothing, and no check ends with an error."""

from __future__ import annotations

import re

import pytest
import shapely
from prism_program import Made

from ebamcheck.checks.bead_checks import coverage_check, gaps_check, line_checks
from ebamcheck.checks.process_checks import overhang_check
from ebamcheck.checks.subject import Subject
from ebamcheck.program import verify_program


@pytest.mark.parametrize("lines", [25, 10**6], ids=["the-first-beads", "all-beads"])
def test_beads_from_a_place_that_no_block_has_given_cover_nothing(lines, tmp_path):
    made = Made(tmp_path, shapely.box(0, 0, 36, 30), layers=2)

    def without_x(text):
        text[:lines] = [re.sub(r" X-?[\d.]+", "", line) for line in text[:lines]]

    made.edit("MAIN_L0001.SPF", without_x)
    if lines > 25:
        made.edit("MAIN_L0002.SPF", without_x)
        made.edit("MAIN.MPF", without_x)
    nc = made.read()
    subject = Subject(nc, made.config, layers=made.layers)
    checks = [*line_checks(subject), *coverage_check(subject), *gaps_check(subject)]
    found = {check.name: check for check in checks}
    assert not found["coverage"].passed
    assert not found["gaps"].passed
    assert "nan" not in found["coverage"].text
    overhang_check(nc, made.config)


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_a_text_without_x_fails_its_checks(tmp_path):
    made = Made(tmp_path, shapely.box(0, 0, 36, 30), layers=2)
    for name in ("MAIN.MPF", "MAIN_L0001.SPF", "MAIN_L0002.SPF"):
        made.edit(name, lambda text: text.__setitem__(slice(None), [re.sub(r" X-?[\d.]+", "", t) for t in text]))
    nc, heights = made.read(), made.layers.heights
    given = {"layers": made.layers, "heights": heights, "beads": True, "metal": True, "heat": True}
    failed = {check.name for check in verify_program(nc, config=made.config, **given) if not check.passed}
    assert {"start of path", "section", "coverage", "gaps", "metal"} <= failed

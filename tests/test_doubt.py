"""Declared doubt: it widens the limit in its own place, up to a cap, is counted, and changes nothing elsewhere."""

import numpy as np
import pytest
import shapely

from ebamcheck.comparison import compare_all
from ebamcheck.comparison.doubt import doubted_layers
from ebamcheck.layers.stack import from_polygons
from ebamcheck.pipeline.findings import doubt_findings
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import ComparisonSettings
from ebamcheck.testing.solids import box

PART = box((0, 0, 0), (20, 10, 6))
HEIGHTS = np.array([1.0, 3.0, 5.0])
SECTION = shapely.box(0, 0, 20, 10)
BUMP = shapely.box(5, 9, 7, 10.006)


def compared(bumps, bound_mm=0.007, box_mm=(4, 8, 2, 8, 11, 4), most_mm=0.01):
    doubt = {"box_mm": list(box_mm), "why": "an edge was turned"} | (
        {"bound_mm": bound_mm} if bound_mm else {}
    )
    stacks = {
        "exact": from_polygons(HEIGHTS, [[SECTION]] * 3),
        "doubts": from_polygons(
            HEIGHTS,
            [[shapely.union_all([SECTION, *b])] for b in bumps],
            settings={"doubtful_regions": [doubt]},
        ),
    }
    return compare_all(
        stacks, PART, dict.fromkeys(stacks, (0.0, 0.0)), dict.fromkeys(stacks, True), dict.fromkeys(stacks, "half-open"),
        ComparisonSettings(doubt_mm=most_mm),
    )  # fmt: skip


def test_a_declared_place_agrees_and_is_counted_and_told():
    found = compared([[], [BUMP], []])
    assert found.passed
    ((_, _, layers, depth_mm, added_mm),) = doubted_layers(found.pairs)
    assert (layers, added_mm) == ([1], 0.007)
    assert depth_mm == pytest.approx(0.006, rel=0.02)
    (told,) = doubt_findings(found.pairs, Config())
    assert told.severity == "warning"
    assert "0.006 mm apart" in told.text


@pytest.mark.parametrize(
    ("what", "bumps", "options"),
    [
        ("no bound is declared", [[], [BUMP], []], {"bound_mm": None}),
        ("the bound is too small", [[], [BUMP], []], {"bound_mm": 0.004}),
        ("the bound is over the cap", [[], [BUMP], []], {"bound_mm": 0.02}),
        ("a doubt is forbidden", [[], [BUMP], []], {"most_mm": 0.0}),
        ("it lies on another layer", [[BUMP], [], []], {}),
        ("it differs beside, too", [[], [BUMP, shapely.box(15, 9, 17, 10.006)], []], {}),
        ("a body is lost beside", [[], [BUMP, shapely.box(30, 0, 33, 3)], []], {}),
        ("the bound is no number", [[], [BUMP], []], {"bound_mm": float("inf")}),
    ],
)
def test_a_doubt_changes_nothing_where(what, bumps, options):
    found = compared(bumps, **options)
    assert not found.passed, what
    assert not list(doubted_layers(found.pairs))
    assert found.findings

"""A program whose layers end beside the top of the part: no gate sees it, since all hold the metal against its own layers."""

from __future__ import annotations

import numpy as np
import pytest

from ebamcheck.pipeline import findings
from ebamcheck.settings.config import Config

LAYER = Config().layer_height_mm


def told(part_mm, heights, config=None):
    return list(findings.height_findings(part_mm, np.array(heights), config or Config()))


def test_a_plate_thinner_than_its_only_layer_is_warned_of():
    (found,) = told(1.0, [0.5])
    assert (found.severity, found.code) == ("warning", "height-off-part")
    assert found.text == "the only layer ends at Z 1.676 mm, and the part is 1.000 mm high"
    assert found.figure == pytest.approx(0.6755, abs=1e-4)
    assert found.limit == pytest.approx(0.02)


@pytest.mark.parametrize(("off", "said"), [(0.0, 0), (0.019, 0), (-0.019, 0), (0.03, 1), (-0.03, 1)])
def test_within_the_tolerance_of_the_metal_nothing_is_said(off, said):
    cuts = (np.arange(12) + 0.5) * LAYER
    assert len(told(12 * LAYER / (1.0 + off), cuts)) == said


def test_layers_on_what_stands_are_not_the_whole_part():
    assert not told(20.0, [0.8], Config().changed(layers={"base_mm": 10.0}))


@pytest.mark.parametrize(
    ("part_mm", "severity"),
    [
        (22.0, "fault"),
        (21.2, "fault"),
        (20.9, "warning"),
        (19.2, "warning"),
        (18.8, "fault"),
        (18.0, "fault"),
    ],
)
def test_layers_that_are_missing_or_too_many_are_a_fault(part_mm, severity):
    """Ten layers of 2 mm: no heights but listed ones leave off half a layer, or go on as far above the part."""
    config = Config().changed(layers={"layer_height_mm": 2.0})
    assert [one.severity for one in told(part_mm, 1.0 + 2.0 * np.arange(10), config)] == [severity]


@pytest.mark.parametrize(("listed", "setting"), [([0.4], "heights_mm"), ([], "layer_height_mm")])
def test_a_thin_plate_gets_no_layer_of_twice_its_height(listed, setting):
    (found,) = told(0.8, [0.4], Config().changed(layers={"heights_mm": listed}))
    assert found.severity == "fault"
    assert found.place == f"layers.{setting}"
    assert setting in found.remedy

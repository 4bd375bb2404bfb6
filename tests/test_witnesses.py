"""Outside witnesses: programs of others and trimesh as slicers, and what they have in common."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from witness_programs import PROGRAMS, WITNESSES, available, named

from ebamcheck.comparison import compare
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.layers.even_odd import directed_by_nesting
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import Part
from ebamcheck.testing import SlicerSuite
from ebamcheck.testing.solids import box, house_rule, joined, mapped, sections, simple, turn
from ebamcheck_cura import Cura
from ebamcheck_planecut import PlaneCut
from ebamcheck_prusa import Prusa
from ebamcheck_slic3r import Slic3r
from ebamcheck_trimesh import TrimeshSections


def cut(witness: Any, part: Part, heights: Any, **settings: Any) -> Layers:
    with witness.prepare(part, witness.Settings(**settings)) as prepared:
        return prepared.slice(np.asarray(heights, np.float64))


def within_bounds(witness: Any, part: Part, heights: Any) -> None:
    """The layers of a witness agree with those of the exact slicer of this house within the declared bound."""
    exact, found = cut(PlaneCut(), part, heights), cut(witness, part, heights)
    slack_mm = 1e-6 * float(part.size.max())
    bound_mm = witness.error_bound_mm(part, witness.Settings()) + witness.height_bound_mm(
        part, witness.Settings()
    )
    table = compare(
        exact, found, tolerance_mm=slack_mm, bound_b_mm=bound_mm, exact_a=True, exact_b=witness.exact
    )
    assert table["agrees"].all(), table[~table["agrees"]].to_string()
    assert (found.areas() > 0.0).all()


def middles(part: Part, count: int) -> Any:
    low, high = part.bounds[:, 2]
    return low + (np.arange(count) + 0.5) * (high - low) / count


# -- rings without direction ---------------------------------------------------------------------------


def test_nested_rings_are_turned_by_their_depth() -> None:
    def square(low: float, high: float) -> list[tuple[float, float]]:
        return [(low, low), (low, high), (high, high), (high, low)]

    raw = from_rings(
        [1.0], [[square(0, 9), square(1, 8), square(2, 7)[::-1], square(20, 21)]], [[[(0, 0), (5, 5)]]]
    )
    found = directed_by_nesting(raw, 1e-9, "a slicer")
    assert sorted(found.ring_areas.tolist()) == [-49.0, 0.0, 1.0, 25.0, 81.0]
    assert found.open_counts().tolist() == [1]


def test_crossing_rings_are_refused_and_touching_ones_are_not() -> None:
    first, second = shapely.box(0, 0, 4, 4), shapely.box(3, 3, 8, 8)
    beside = shapely.box(4 - 1e-12, 0, 8, 3)

    def layers(*boxes: Any) -> Layers:
        return from_rings([0.0, 1.0], [[], [shapely.get_coordinates(b)[:-1] for b in boxes]])

    assert directed_by_nesting(layers(first, beside), 1e-9, "a slicer").outer_counts().tolist() == [0, 2]
    with pytest.raises(BackendFailed, match="rings cross at z = 1 mm"):
        directed_by_nesting(layers(first, second), 1e-9, "a slicer")


# -- the witnesses themselves --------------------------------------------------------------------------


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("witness", WITNESSES, ids=named)
@pytest.mark.parametrize("name", ["tilted plate", "upright torus", "cavity", "two bodies"])
def test_stacks_agree_with_the_exact_cut(witness: Any, name: str) -> None:
    available(witness)
    part = replace(simple(name), name=f'{name}; "odd" $name/..')
    within_bounds(witness, part, middles(part, 41))


@pytest.mark.parametrize("witness", WITNESSES, ids=named)
@pytest.mark.parametrize("size_mm", [1e-3, 4000.0])
def test_tiny_and_huge_parts_agree(witness: Any, size_mm: float) -> None:
    available(witness)
    part = mapped(simple("tilted plate"), np.eye(3) * size_mm / 27.0)
    within_bounds(witness, part, middles(part, 12))


@pytest.mark.parametrize("witness", WITNESSES, ids=named)
def test_parts_far_away_agree(witness: Any) -> None:
    available(witness)
    part = mapped(simple("tilted plate"), turn(20.0), shift=(2.0**17, -(2.0**18), -(2.0**16)))
    within_bounds(witness, part, middles(part, 12))


@pytest.mark.parametrize("witness", WITNESSES, ids=named)
def test_layers_of_other_heights_agree(witness: Any) -> None:
    """Single planes, runs of two steps, and heights a hair over the bottom and under the top."""
    available(witness)
    part = simple("tilted plate")
    low, high = part.bounds[:, 2].tolist()
    heights = [
        *(low + np.array([0.4, 1.1])),
        *(low + 2.0 + 0.25 * np.arange(8)),
        *(low + 6.0 + 0.7 * np.arange(9)),
        high - 0.4,
    ]
    within_bounds(witness, part, heights)


@pytest.mark.parametrize("witness", WITNESSES, ids=named)
def test_blocks_are_the_same_as_the_whole(witness: Any) -> None:
    available(witness)
    part = simple("upright torus")
    heights = middles(part, 30)
    with witness.prepare(part, witness.Settings()) as prepared:
        first = prepared.slice(heights[12:20])
        whole = prepared.slice(heights)
    assert np.array_equal(first.points, whole.block(12, 20).points)


@pytest.mark.parametrize("witness", [Slic3r(), Prusa()], ids=named)
def test_parts_that_a_program_would_mend_are_refused(witness: Any) -> None:
    available(witness)
    part = simple("box")
    with pytest.raises(BackendFailed, match="is open"):
        cut(witness, Part(part.vertices, part.faces[:-1]), [1.0])
    with pytest.raises(BackendFailed, match="negative volume"):
        cut(witness, part.reversed(), [1.0])


def test_curaengine_keeps_open_paths() -> None:
    witness = Cura()
    available(witness)
    part = simple("box")
    lidless = Part(part.vertices, part.faces[~(part.triangles[:, :, 0] == 20.0).all(axis=1)])
    layers = cut(witness, lidless, [2.0])
    assert layers.ring_counts().tolist() == [0]
    assert layers.ring_lengths.sum() == pytest.approx(20.0 + 14.0 + 20.0, abs=0.01)


@pytest.mark.parametrize("witness", [Cura(), TrimeshSections()], ids=named)
def test_crossing_shells_are_refused_where_rings_have_no_direction(witness: Any) -> None:
    available(witness)
    with pytest.raises(BackendFailed, match="rings cross"):
        cut(witness, joined(box((0, 0, 0), (9, 8, 5)), box((4, 3, 1), (14, 12, 6))), [2.0])


def test_slic3r_unites_crossing_shells() -> None:
    witness = Slic3r()
    available(witness)
    part = joined(box((0, 0, 0), (9, 8, 5)), box((4, 3, 1), (14, 12, 6)))
    found, wanted = cut(witness, part, [2.0]), sections(part, [2.0], house_rule)
    assert found.areas() == pytest.approx(wanted.areas(), abs=1e-3)
    assert found.ring_counts().tolist() == [1]


@pytest.mark.parametrize("witness", PROGRAMS, ids=named)
def test_a_time_limit_ends_a_run_and_leaves_nothing(
    witness: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    available(witness)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(BackendFailed, match=r"took over 0\.001 s"):
        cut(witness, simple("sphere"), middles(simple("sphere"), 20), time_limit_s=0.001)
    assert not list(tmp_path.iterdir())


def test_images_of_prusaslicer_have_a_limit() -> None:
    witness = Prusa()
    available(witness)
    with pytest.raises(SettingsError, match="give a larger one"):
        cut(witness, simple("sphere"), [1.0], pixel_mm=1e-6)


def test_definitions_of_cura_can_be_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    available(Cura())
    monkeypatch.setenv("EBAMCHECK_CURA_DEFINITIONS", str(tmp_path))
    probe = Cura().probe()
    assert not probe.available
    assert str(tmp_path) in probe.why
    assert "apt install cura" in probe.hint


class TestTrimesh(SlicerSuite):
    slicer = TrimeshSections
    models = ("cube", "torus")


@pytest.mark.slow
class TestSlic3r(SlicerSuite):
    slicer = Slic3r
    models = ("cube", "torus", "tilted-plate")


@pytest.mark.slow
class TestCura(SlicerSuite):
    slicer = Cura
    models = ("cube", "torus", "tilted-plate")


@pytest.mark.slow
class TestPrusa(SlicerSuite):
    slicer = Prusa
    models = ("cube", "torus", "tilted-plate")

"""The conformance kit: it passes honest slicers, finds every broken one, and serves a plugin from outside."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import oracle
import pytest
from broken_backends import FAULTS
from fake_distribution import environment

from ebamcheck.commands.accuracy import conform_command
from ebamcheck.errors import BackendMissing, SettingsError
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import models
from ebamcheck.testing import CHECKS, Figure, SlicerSuite, Subject, conform, examine, markdown_table, solids
from ebamcheck.testing.solids import house_rule, section
from ebamcheck.testing.subject import generic_heights
from ebamcheck_embree import Embree
from ebamcheck_manifold import ManifoldCut
from ebamcheck_planecut import PlaneCut
from ebamcheck_stencil import Stencil

CHECK = {check.name: check for check in CHECKS}
QUICK_MODELS = ("cube", "torus")


class TestPlaneCut(SlicerSuite):
    slicer = PlaneCut
    models = QUICK_MODELS


class TestManifold(SlicerSuite):
    slicer = ManifoldCut
    models = QUICK_MODELS


class TestEmbree(SlicerSuite):
    slicer = Embree
    models = QUICK_MODELS


@pytest.mark.gl
class TestStencil(SlicerSuite):
    slicer = Stencil
    settings = ({"pixel_mm": 0.13},)
    models = ("torus",)


@pytest.mark.slow
class TestEveryModelOfEmbree(SlicerSuite):
    """All installed models."""

    slicer = Embree
    settings = ({"grid_mm": 0.31}, {})


@pytest.mark.slow
@pytest.mark.gl
class TestEveryModelAndModeOfTheStencil(SlicerSuite):
    slicer = Stencil
    settings = ({"pixel_mm": 0.17}, {})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planecut", "manifold"])
def test_exact_slicers_cut_every_model(name):
    known = {"manifold": {"case-touching-board"}}  # tests/test_laws.py names what is wrong there
    chosen = sorted(set(models()) - known.get(name, set()))
    assert conform(name, chosen).violations == []


@pytest.mark.in_turn(4)
@pytest.mark.parametrize("name", FAULTS)
def test_every_broken_slicer_is_found(name):
    fault = FAULTS[name]
    base = fault.slicer.__mro__[1]()
    if not base.probe().available:
        pytest.skip(base.probe().why)
    found = examine(fault.slicer, [CHECK[fault.check]])
    assert not found.passed
    assert found.outcomes[0].verdict == "FAIL"
    assert all(figure.text for figure in found.violations)


LAW_BREAKERS = {
    "translation": "rounded-to-hundredths",
    "rotation": "mirrored-axis",
    "mirror": "shifted-by-a-pixel-and-a-half",
    "scale": "rounded-to-hundredths",
    "upside down": "off-by-one-layer",
    "large offset": "single-precision",
    "union of parts": "mirrored-axis",
    "volume": "lost-hole",
    "ring parity": "lost-hole",
    "reference models": "off-by-one-layer",
    "facet order": "trusts-the-facet-order",
    "vertex order": "trusts-the-vertex-order",
    "subdivision": "trusts-the-facet-order",
    "context": "enters-as-another",
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("law", LAW_BREAKERS)
def test_every_law_finds_a_broken_slicer(law):
    subject = Subject(FAULTS[LAW_BREAKERS[law]].slicer, models=models(["torus"]))
    if not subject.slicer.probe().available:
        pytest.skip(subject.slicer.probe().why)
    assert examine(subject, [CHECK[law]]).outcomes[0].verdict == "FAIL"


def test_no_check_is_idle():
    assert set(CHECK) == {fault.check for fault in FAULTS.values()} | set(LAW_BREAKERS)


def test_the_kits_own_sections_are_those_of_rational_arithmetic():
    for name in solids.SIMPLE:
        part = solids.simple(name)
        for z in generic_heights(part, 2).tolist():
            exact = oracle.section(part.vertices, part.faces, z)
            regions = section(part, z, house_rule)
            area = float(oracle.signed_area(exact))
            assert sum(r.area for r in regions) == pytest.approx(area, rel=1e-12)
            rings = sum(1 + len(r.interiors) for r in regions)
            assert rings == len(oracle.rings(exact))


def test_solids_of_the_kit_are_closed_and_outward():
    parts = [solids.simple(name) for name in solids.SIMPLE] + [*solids.attackers(0.05).values()]
    for part in parts:
        edges = part.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        assert len(np.unique(edges, axis=0)) == len(edges)
        assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
        assert part.volume > 0
    for part in solids.attackers(0.05).values():
        assert np.array_equal(part.bounds, solids.frame().bounds)


def test_a_figure_that_is_no_number_is_a_violation():
    assert Figure("a", "b", 0, float("nan"), 1.0).violated
    assert not Figure("a", "b", 0, 1.0, 1.0).violated
    assert "layer 4" in str(Figure("a", "b", 3, 2.0, 1.0, "c"))


def test_a_slicer_that_raises_is_told_and_stops_nothing():
    class Raises(PlaneCut):
        def prepare(self, part, settings):
            raise ZeroDivisionError("no\nluck")

    found = examine(Subject(Raises), [CHECK["labels"], CHECK["settings"]])
    assert [o.verdict for o in found.outcomes] == ["FAIL", "pass"]
    assert "ZeroDivisionError: no luck" in found.table()


# -- the command ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_a_table_json_and_markdown(capsys):
    assert conform_command(["planecut"], models="none") == 0
    table = capsys.readouterr().out
    assert table.startswith("planecut: conforms")
    assert all(check.name in table for check in CHECKS)
    assert conform_command(["planecut"], models="cube", as_json=True) == 0
    (record,) = json.loads(capsys.readouterr().out)
    assert record["passed"] is True
    assert [c["check"] for c in record["checks"]] == [check.name for check in CHECKS]
    assert conform_command(["manifold"], models="cube", markdown=True) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| check | manifold |"
    assert len(lines) == 2 + len(CHECKS)


def test_the_command_tells_violations_by_its_exit_code(capsys):
    assert conform_command(["planecut"], models="none", setting=["overlaps=keep"]) == 1
    assert "inside rule: two shells, layer" in capsys.readouterr().out


def test_the_command_refuses_what_it_does_not_know():
    with pytest.raises(BackendMissing, match="unknown backend 'teapot'"):
        conform_command(["teapot"])
    with pytest.raises(SettingsError, match="unknown model 'teapot'"):
        conform_command(["planecut"], models="teapot")
    with pytest.raises(SettingsError, match="pixel: unknown key"):
        conform_command(["planecut"], models="none", setting=["pixel=3"])
    with pytest.raises(SettingsError, match="write it as NAME=VALUE"):
        conform_command(["planecut"], models="none", setting=["pixel"])


def test_the_markdown_table_marks_faults_and_what_does_not_apply():
    good = examine(PlaneCut, [CHECK["orientation"], CHECK["bound not idle"]])
    bad = examine(FAULTS["reversed-orientation"].slicer, [CHECK["orientation"], CHECK["bound not idle"]])
    rows = markdown_table([good, bad]).splitlines()[2:]
    assert rows == ["| orientation | pass | FAIL (6 of 6) |", "| bound not idle | - | - |"]


# -- a plugin from outside -----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_plugin_is_installed_found_and_passes(tmp_path):
    source = shutil.copytree(Path(__file__).parent / "example_plugin", tmp_path / "source")
    target = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index",
         "--disable-pip-version-check", "--target", target, source],
        check=True, capture_output=True,
    )  # fmt: skip
    code = (
        "from ebamcheck.plugins import registry; from ebamcheck.testing import CHECKS, examine; "
        "found = examine(registry.loaded_slicer('rows'), CHECKS[:12]); "
        "print(found.table()); assert found.passed"
    )
    env = os.environ | environment(target)
    done = subprocess.run([sys.executable, "-c", code], env=env, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("rows: conforms")
    assert "rows" not in registry.slicers()

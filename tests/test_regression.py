"""Regression reports: every planted fault is found against an honest baseline, and nothing else is."""

from __future__ import annotations

import json
import os
import sqlite3
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fake_distribution import found_here, install
from regression_plugin import ALLOWED_MM, BOUND_MM, ROUGH_MM

from ebamcheck import installed
from ebamcheck.commands.regress import regress, summary
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.plugins import registry
from ebamcheck.regression import (
    Tolerances,
    job,
    run_regression,
)
from ebamcheck.regression.baselines import Entry, read_baselines, write_baselines
from ebamcheck.regression.difference import differences
from ebamcheck.regression.history import record, trends
from ebamcheck.regression.job import accepted, updated
from ebamcheck.slicers.cutting import cut_here
from ebamcheck.slicers.isolation import slice_all
from ebamcheck_embree import Embree
from ebamcheck_planecut import PlaneCut
from ebamcheck_stencil import Stencil


def _fault(name: str, base: type, metric: str):
    marks = [pytest.mark.gl] if base is Stencil else []
    return pytest.param(name, base.name, metric, marks=marks, id=name)


CAUGHT = [
    _fault("off-by-one-layer", PlaneCut, "depth_max_mm"),
    _fault("mirrored-axis", PlaneCut, "depth_max_mm"),
    _fault("lost-hole", PlaneCut, "hole_mismatch_layers"),
    _fault("dropped-tiny-loop", PlaneCut, "ring_mismatch_layers"),
    _fault("closed-plane-rule", PlaneCut, "depth_max_mm"),
    _fault("closed-gap", PlaneCut, "area_error_max_mm2"),
    _fault("half-cell-shift", Embree, "depth_mean_mm"),
    _fault("half-pixel-shift", Stencil, "depth_mean_mm"),
]
"""Broken slicer, the honest one that it is made from, and a metric that must tell."""

USED = [*(fault.values[0] for fault in CAUGHT), "rough", "rough-within", "rough-beyond", "aborting"]
"""Of the plugin's slicers: each is asked what it is in a process of its own."""


WRONG = {*(fault.values[0] for fault in CAUGHT), "rough-within", "rough-beyond"}


def sliced(part, heights, settings, folder, limits):
    """What :func:`slice_all` gives; only who may crash has a process of its own."""
    borders = np.array([0, heights.size])
    here = {
        n: cut_here(part, heights, n, settings[n], folder, limits, borders) for n in settings if n in WRONG
    }
    return here | slice_all(
        part, heights, {n: settings[n] for n in settings if n not in here}, folder, limits
    )


@pytest.fixture(scope="module")
def plugins(tmp_path_factory):
    """Install the block and the slicers that are used as a distribution that worker processes find, too.

    Those that cut wrongly and no more count as the house's, and cut here: that spares two processes each.
    """
    folder = tmp_path_factory.mktemp("plugins")
    backends = {name: f"regression_plugin:{name.replace('-', '_')}" for name in USED}
    models = {"trial-block": "regression_plugin:BLOCK"}
    install(folder, "regression-plugin", {registry.MODELS: models, registry.BACKENDS: backends})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "is_house", lambda point: point.name in WRONG or installed.is_house(point))
        patch.setattr(job, "slice_all", sliced)
        found_here(folder, patch, os.path.dirname(__file__))
        yield
    registry.forget()


@pytest.fixture(scope="module")
def honest_report(plugins, tmp_path_factory):
    """The honest slicers on the block, without baselines."""
    usable = [n for n in ("planecut", "embree", "stencil") if registry.probe(n).available]
    return run_regression(tmp_path_factory.mktemp("none"), ["trial-block"], [*usable, "rough"])


@pytest.fixture(scope="module")
def honest(honest_report):
    """What the honest slicers come to on the block, by backend."""
    return {key.backend: entry for key, entry in honest_report.entries.items()}


def as_baseline_of(backend: str, entry: Entry) -> Entry:
    return replace(entry, key=replace(entry.key, backend=backend))


@pytest.fixture(scope="module")
def report(honest, tmp_path_factory):
    """All broken slicers in one report, each against the baseline of the honest one it is made from."""
    folder = tmp_path_factory.mktemp("baselines")
    pairs = [(p.values[0], p.values[1]) for p in CAUGHT]
    pairs += [("rough-within", "rough"), ("rough-beyond", "rough")]
    pairs = [(name, base) for name, base in pairs if base in honest] + [("aborting", "planecut")]
    write_baselines(folder, [as_baseline_of(name, honest[base]) for name, base in pairs], ["trial-block"])
    return run_regression(folder, ["trial-block"], [name for name, _ in pairs])


def difference_of(report, backend):
    return next(d for d in report.differences if d.key.backend == backend)


# -- what is caught --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "base", "metric"), CAUGHT)
def test_a_broken_slicer_is_caught_against_the_honest_baseline(report, honest, name, base, metric):
    if base not in honest:
        pytest.skip(f"{base} is not available: {registry.probe(base).why}")
    found = difference_of(report, name)
    assert found.verdict == "worse"
    assert metric in {change.metric for change in found.changes if change.worse}
    assert report.exit_code is ExitCode.OUT_OF_TOLERANCE


def test_a_loss_of_a_hundredth_of_the_bound_over_the_tolerance_is_found_and_explained(report):
    found = difference_of(report, "rough-beyond")
    assert found.verdict == "worse"
    change = next(c for c in found.changes if c.metric == "depth_max_mm")
    assert change.old == pytest.approx(ROUGH_MM, abs=1e-6)
    assert change.new - change.old == pytest.approx(ALLOWED_MM + 0.01 * BOUND_MM, abs=2e-6)
    growth = change.growth
    solid = len(report.entries[found.key].measured.columns["layer"]) - 1  # the plane of the top face is empty
    assert (growth.column, growth.count) == ("depth_mm", solid)
    assert growth.largest == pytest.approx(change.new - change.old, abs=2e-6)
    first = growth.places[0]
    assert (first.layer, first.z_mm, first.old) == (0, 0.0, pytest.approx(ROUGH_MM, abs=1e-6))
    assert -0.1 <= first.x_mm <= 20.1
    assert -0.1 <= first.y_mm <= 12.1
    text = "\n".join(found.lines())
    for part in (
        "rough-beyond",
        "depth_max_mm 0.05 -> 0.05106",
        "layers worse, at most by 0.00106",
        "layer 1, z = 0 mm",
    ):
        assert part in text


def test_a_loss_within_the_tolerance_is_none(report):
    assert difference_of(report, "rough-within").verdict == "same"


def test_a_crash_is_a_finding_that_no_update_accepts(report, tmp_path):
    found = difference_of(report, "aborting")
    assert (found.verdict, found.fails) == ("failed", True)
    assert "SIGABRT" in found.why
    copied = replace(report, baselines=tmp_path)
    updated(copied, "all")
    assert "aborting" not in {key.backend for key in read_baselines(tmp_path, ["trial-block"])}
    assert accepted(report).exit_code is ExitCode.OUT_OF_TOLERANCE


def test_junit_names_the_backend_in_the_class_and_counts_what_failed(report, tmp_path):
    from ebamcheck.regression.junit import write_junit

    suite = ElementTree.parse(write_junit(report, tmp_path)).getroot()[0]
    cases = {case.get("classname"): case for case in suite}
    assert set(cases) == {f"ebamcheck.regress.{d.key.backend}" for d in report.differences}
    assert cases["ebamcheck.regress.mirrored-axis"].find("failure").get("type") == "worse"
    assert cases["ebamcheck.regress.aborting"].find("error") is not None
    assert len(cases["ebamcheck.regress.rough-within"]) == 0
    failed = sum(d.verdict == "worse" for d in report.differences)
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == (
        str(len(report.differences)),
        str(failed),
        "1",
    )


# -- the command -----------------------------------------------------------------------------------------


def _regress(baselines: Path, output: Path, **options):
    given = {"models": "trial-block", "backends": "planecut", **options}
    return regress(baselines=baselines, output=output, **given)


@pytest.fixture(scope="module")
def accepted_once(honest, tmp_path_factory):
    """Two reports of the command against the same baselines that share nothing but the history."""
    base = tmp_path_factory.mktemp("command")
    write_baselines(base / "baselines", [honest["planecut"]], ["trial-block"])
    history = base / "history.sqlite"
    codes = [_regress(base / "baselines", base / name, history=history) for name in ("one", "two")]
    return base, codes


def test_two_reports_on_an_unchanged_tree_are_the_same_bytes_but_for_timings(accepted_once):
    base, codes = accepted_once
    assert codes == [ExitCode.PASS] * 2
    for name in ("results.json", "junit.xml", "regress.html"):
        assert (base / "one" / name).read_bytes() == (base / "two" / name).read_bytes(), name
    timed = json.loads((base / "one" / "timings.json").read_text())
    assert all(set(seconds) == {"prepare_s", "slice_s", "measure_s"} for seconds in timed.values())


@pytest.mark.slow
def test_settings_of_slicers_are_honoured_and_held_against_the_same_baselines(honest, tmp_path, capsys):
    if "embree" not in honest:
        pytest.skip(f"embree is not available: {registry.probe('embree').why}")
    write_baselines(tmp_path / "baselines", [honest["embree"]], ["trial-block"])
    config = tmp_path / "ebamcheck.toml"
    config.write_text("[slicing.settings.embree]\ngrid_mm = 1.0\n")
    given = {"backends": "embree", "config_file": config}
    assert _regress(tmp_path / "baselines", tmp_path / "out", **given) is ExitCode.OUT_OF_TOLERANCE
    told = capsys.readouterr()
    assert "embree runs with grid_mm = 1.0" in told.err
    (found,) = json.loads((tmp_path / "out" / "results.json").read_text())["differences"]
    assert found["verdict"] == "worse"
    with pytest.raises(SettingsError, match=r"slicing\.settings\.embree"):
        _regress(tmp_path / "baselines", tmp_path / "out", update_baseline="all", **given)
    config.write_text("[slicing.settings.embree]\nnosuch = 1\n")
    with pytest.raises(SettingsError, match="nosuch"):
        _regress(tmp_path / "baselines", tmp_path / "out", **given)


def test_the_history_counts_a_result_that_is_seen_again(accepted_once):
    base, _ = accepted_once
    with sqlite3.connect(base / "history.sqlite") as database:
        assert database.execute("SELECT result, times_seen FROM results").fetchall() == [(1, 2)]
    database.close()
    (trend,) = trends(base / "history.sqlite", "depth_max_mm")
    assert (trend.key.backend, trend.results) == ("planecut", (1,))


def test_the_page_needs_no_network_and_no_script(accepted_once):
    page = (accepted_once[0] / "one" / "regress.html").read_text()
    assert "<script" not in page
    assert "http" not in page
    assert "<svg" in page


def test_an_update_shows_the_difference_first_and_rewrites_only_what_failed(accepted_once, tmp_path, capsys):
    source, _ = accepted_once
    folder = tmp_path / "baselines"
    key, entry = next(iter(read_baselines(source / "baselines", ["trial-block"]).items()))
    better = {**entry.measured.metrics, "volume_error_mm3": -1.0}  # no slicer is that good: now it is worse
    stale = replace(entry, key=replace(key, settings_hash="0" * 12))
    spoiled = replace(entry, measured=replace(entry.measured, metrics=better))
    write_baselines(folder, [spoiled, stale, as_baseline_of("absent", entry)], ["trial-block"])
    assert _regress(folder, tmp_path / "out", update_baseline="failed") is ExitCode.PASS
    text = capsys.readouterr().out
    assert text.index("volume_error_mm3 -1 ->") < text.index("baselines written")
    assert "with --update-baseline" not in text  # it is what is being done
    assert "VANISHED" in text
    held = read_baselines(folder, ["trial-block"])
    assert held[key] == entry
    assert {k.backend for k in held} == {"planecut", "absent"}  # what was not asked for is not touched
    assert stale.key not in held


def test_without_a_baseline_nothing_is_compared_and_it_says_how_to_make_one(honest_report):
    assert honest_report.exit_code is ExitCode.NOTHING_COMPARED
    assert {d.verdict for d in honest_report.differences} == {"new"}
    assert "make the baselines with --update-baseline=all" in summary(honest_report)[-1]


def held(new: Entry, old: Entry, **tolerances):
    (found,) = differences({new.key: new}, {old.key: old}, {}, Tolerances(**tolerances))
    return found


def test_a_file_that_is_no_history_is_said_to_be_none(tmp_path, report):
    path = tmp_path / "history.sqlite"
    path.write_text("certainly not a database " * 50)
    with pytest.raises(InputError, match="--history"):
        record(path, report)

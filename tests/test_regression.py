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
from hypothesis import given
from hypothesis import strategies as st
from regression_plugin import ALLOWED_MM, BLOCK, BOUND_MM, ROUGH_MM

from ebamcheck import installed
from ebamcheck.accuracy import regression as job
from ebamcheck.accuracy.baselines import Entry, Key, differences, read_baselines, write_baselines
from ebamcheck.accuracy.measurement import (
    LAYER_COLUMNS,
    LENGTH,
    REFUSED,
    TOLERANCE_NAMES,
    Measured,
    Tolerance,
    Tolerances,
    default_tolerance,
    measure_outcome,
    read_matrix,
    read_tolerances,
    rounded,
    rounds,
    summarised,
    truth_of,
)
from ebamcheck.accuracy.regression import accepted, run_regression, trends, updated
from ebamcheck.commands.accuracy import regress, summary
from ebamcheck.errors import BackendMissing, ExitCode, InputError, SettingsError
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import models
from ebamcheck.slicers.cutting import cut_here
from ebamcheck.slicers.isolation import slice_all
from ebamcheck_planecut import PlaneCut

CAUGHT = {
    "mirrored-axis": ("planecut", "depth_max_mm"),
    "lost-hole": ("planecut", "hole_mismatch_layers"),
    "dropped-tiny-loop": ("planecut", "ring_mismatch_layers"),
    "closed-gap": ("planecut", "area_error_max_mm2"),
    "half-cell-shift": ("embree", "depth_mean_mm"),
}
"""Broken slicer, the honest one that it is made from, and a metric that must tell."""

ROUGH = {"rough-within": "rough", "rough-beyond": "rough"}
USED = [*CAUGHT, "rough", *ROUGH, "aborting"]
"""Of the plugin's slicers: each is asked what it is in a process of its own."""

WRONG = {*CAUGHT, *ROUGH}


def sliced(part, heights, settings, folder, limits):
    """What :func:`slice_all` gives; only who may crash has a process of its own."""
    borders = np.array([0, heights.size])
    here = {n: cut_here(part, heights, n, settings[n], folder, limits, borders) for n in settings if n in WRONG}
    return here | slice_all(part, heights, {n: settings[n] for n in settings if n not in here}, folder, limits)


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
    usable = [n for n in ("planecut", "embree") if registry.probe(n).available]
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
    bases = {name: base for name, (base, _) in CAUGHT.items()} | ROUGH | {"aborting": "planecut"}
    pairs = {name: base for name, base in bases.items() if base in honest}
    entries = [as_baseline_of(name, honest[base]) for name, base in pairs.items()]
    write_baselines(folder, entries, ["trial-block"])
    return run_regression(folder, ["trial-block"], list(pairs))


def difference_of(report, backend):
    return next(d for d in report.differences if d.key.backend == backend)


# -- what is caught --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CAUGHT)
def test_a_broken_slicer_is_caught_against_the_honest_baseline(report, honest, name):
    base, metric = CAUGHT[name]
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
    assert (first.layer, first.z_mm, first.old) == (1, 0.0, pytest.approx(ROUGH_MM, abs=1e-6))
    assert -0.1 <= first.x_mm <= 20.1
    assert -0.1 <= first.y_mm <= 12.1
    text = "\n".join(found.lines())
    told = (
        "rough-beyond",
        "depth_max_mm 0.05 -> 0.05106",
        "layers worse, at most by 0.00106",
        "layer 1, z = 0 mm",
    )
    assert all(part in text for part in told)


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
    from ebamcheck.accuracy.regression import write_junit

    suite = ElementTree.parse(write_junit(report, tmp_path)).getroot()[0]
    cases = {case.get("classname"): case for case in suite}
    assert set(cases) == {f"ebamcheck.regress.{d.key.backend}" for d in report.differences}
    assert cases["ebamcheck.regress.mirrored-axis"].find("failure").get("type") == "worse"
    assert cases["ebamcheck.regress.aborting"].find("error") is not None
    assert len(cases["ebamcheck.regress.rough-within"]) == 0
    failed = sum(d.verdict == "worse" for d in report.differences)
    counts = [suite.get(name) for name in ("tests", "failures", "errors")]
    assert counts == [str(len(report.differences)), str(failed), "1"]


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


def test_the_history_counts_a_result_that_is_seen_again(accepted_once):
    base, _ = accepted_once
    with sqlite3.connect(base / "history.sqlite") as database:
        assert database.execute("SELECT result, times_seen FROM results").fetchall() == [(1, 2)]
    database.close()
    (trend,) = trends(base / "history.sqlite", "depth_max_mm")
    assert (trend.key.backend, trend.results) == ("planecut", (1,))


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


# -- rules without a slicer -----------------------------------------------------------------------------------


COLUMN = [0.01, 0.02, 0.03]


def entry_of(depths, backend="b", metadata=None, status="measured") -> Entry:
    columns = {name: [0] * len(depths) for name in LAYER_COLUMNS} | {
        "layer": list(range(len(depths))),
        "z_mm": [float(k) for k in range(len(depths))],
        "x_mm": [None] * len(depths),
        "y_mm": [None] * len(depths),
        "depth_mm": list(depths),
    }
    whole = {"volume_error_mm3": 0.0, "bound_mm": 0.1, "not_compared_layers": 0.0}
    measured = Measured(status, "", {**summarised(columns), **whole}, columns)
    return Entry(Key("m", backend, "h"), {}, measured, metadata or {})


def held_to(new: Entry, old: Entry, **tolerances):
    (found,) = differences({new.key: new}, {old.key: old}, {}, Tolerances(**tolerances))
    return found


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6), st.floats(0.0, 0.1), st.integers(0, 5))
def test_an_entry_is_worse_exactly_if_a_layer_grew_beyond_its_tolerance(depths, growth, at):
    old = [rounded(d) for d in depths]
    k = at % len(old)
    new = [rounded(d + growth) if i == k else d for i, d in enumerate(old)]
    grown = new[k] > old[k] + LENGTH.allowed(old[k])
    found = held_to(entry_of(new), entry_of(old))
    assert (found.verdict == "worse") == grown
    if grown:
        places = [p for c in found.changes if c.growth for p in c.growth.places]
        assert {p.layer for p in places} == {k + 1}
        assert {(p.old, p.new) for p in places} == {(old[k], new[k])}


def test_a_loss_on_one_layer_does_not_hide_behind_a_worse_one():
    found = held_to(entry_of([0.5, 0.2, 0.0]), entry_of([0.5, 0.1, 0.1]))
    assert found.verdict == "worse"
    (change,) = [c for c in found.changes if c.worse]
    assert (change.metric, change.growth.places[0].layer) == ("depth_mm", 2)


def test_machine_renderer_and_versions_are_told_and_never_compared():
    old = entry_of(COLUMN, metadata={"machine": "a", "renderer": "x", "versions": {"n": "1"}})
    new = entry_of(COLUMN, metadata={"machine": "b", "renderer": "y", "versions": {"n": "2"}})
    assert held_to(new, old).verdict == "same"
    worse = held_to(replace(entry_of([1.0, 1.0, 1.0]), metadata=new.metadata), old)
    assert "renderer x -> y" in worse.why


def test_a_tolerance_of_a_backend_goes_before_that_of_the_metric():
    wide = {name: Tolerance(absolute=9.0) for name in TOLERANCE_NAMES}
    new, old = entry_of([0.04, 0.02, 0.03]), entry_of(COLUMN)
    assert held_to(new, old).verdict == "worse"
    assert held_to(new, old, metrics=wide).verdict == "same"
    tight = {"b": {"depth_max_mm": Tolerance()}}
    assert held_to(new, old, metrics=wide, backends=tight).verdict == "worse"


def test_a_backend_that_cannot_run_here_is_neither_met_nor_missed():
    old = entry_of(COLUMN)
    (absent,) = differences({}, {old.key: old}, {"b": "no display"}, Tolerances())
    assert (absent.verdict, absent.fails, absent.why) == ("not run", False, "no display")
    (gone,) = differences({}, {old.key: old}, {}, Tolerances())
    assert (gone.verdict, gone.fails) == ("vanished", True)


def test_a_refusal_is_an_answer_that_is_held_too():
    refused = replace(entry_of(COLUMN), measured=Measured(REFUSED, "open edges"))
    assert held_to(refused, refused).verdict == "same"
    assert held_to(refused, entry_of(COLUMN)).verdict == "worse"
    assert held_to(entry_of(COLUMN), refused).verdict == "better"


def test_baselines_come_back_as_written_and_unchanged_ones_are_left_alone(tmp_path):
    entries = [entry_of(COLUMN), entry_of([0.1 + 0.2, 1e-7, 3.0], backend="c")]
    assert write_baselines(tmp_path, entries, ["m"]) == [tmp_path / "m.json"]
    assert read_baselines(tmp_path, ["m", "other"]) == {e.key: e for e in entries}
    assert write_baselines(tmp_path, entries, ["m"]) == []
    assert write_baselines(tmp_path, [], ["m"]) == [tmp_path / "m.json"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 99, "entries": {}}', '{"format": 1, "entries": {"a b": {}}}'])
def test_what_is_no_baseline_is_said_to_be_none(tmp_path, text):
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(InputError, match=r"m\.json"):
        read_baselines(tmp_path, ["m"])


def test_a_tolerance_file_is_read_and_unknown_metrics_are_refused(tmp_path):
    path = tmp_path / "tolerances.toml"
    path.write_text("[metrics.depth_max_mm]\nabsolute = 0.5\n[backends.b.bound_mm]\nrelative = 1.0\n")
    table = read_tolerances(path)
    assert table.of("b", "depth_max_mm").allowed(9.0) == 0.5
    assert table.of("b", "bound_mm").allowed(0.25) == 0.25
    assert table.of("c", "depth_mean_mm") == default_tolerance("depth_mean_mm")
    path.write_text("[metrics.depth_max]\nabsolute = 0.5\n")
    with pytest.raises(SettingsError, match="unknown metric 'depth_max'"):
        read_tolerances(path)


# -- the truth -------------------------------------------------------------------------------------------


def test_planes_through_level_faces_are_among_the_heights_and_are_cut_as_the_plane_just_above():
    truth = truth_of(BLOCK, 0.05, 24)
    assert {0.0, 5.0, 10.0} <= set(truth.heights.tolist())
    areas = dict(zip(truth.heights.tolist(), truth.layers.areas().tolist(), strict=True))
    assert areas[10.0] == 0.0
    assert areas[5.0] == pytest.approx(BLOCK.area(6.0))
    assert areas[0.0] == pytest.approx(BLOCK.area(1.0))
    assert truth.uniform.sum() == 24


def test_an_exact_cut_of_a_curved_model_stays_within_what_its_mesh_allows(tmp_path):
    from ebamcheck.layers.files import write_parquet
    from ebamcheck.slicers.isolation import Outcome

    def measured(layers):
        write_parquet(layers, tmp_path / "layers.parquet")
        return measure_outcome(truth, Outcome("planecut", file=tmp_path / "layers.parquet"))

    truth = truth_of(models(["torus"])["torus"], 0.2, 12)
    slicer = PlaneCut()
    with slicer.prepare(truth.part, slicer.Settings()) as prepared:
        layers = prepared.slice(truth.heights)
    found = measured(layers)
    assert found.metrics["beyond_bound_layers"] == 0
    assert 0.0 < found.metrics["depth_max_mm"] <= float(truth.allowance_mm.max())
    moved = layers.labelled()
    moved = replace(moved, points=moved.points + np.array([2.0 * float(truth.allowance_mm.max()), 0.0]))
    assert measured(moved).metrics["beyond_bound_layers"] > 0


# -- what is committed -----------------------------------------------------------------------------------

COMMITTED = Path(__file__).parents[1] / "reports" / "baselines"


def test_the_committed_baselines_are_those_of_the_matrix():
    matrix = read_matrix(COMMITTED)
    held = read_baselines(COMMITTED, matrix.every_day)
    backends = ["embree", "manifold", "planecut", "stencil"]
    expected = {
        (name, subject.backend, subject.settings_hash(matrix.case(name)))
        for name in matrix.every_day
        for round_ in rounds(matrix, name, backends)
        for subject in round_.values()
    }
    assert {(k.model, k.backend, k.settings_hash) for k in held} == expected
    assert all(e.measured.metrics["beyond_bound_layers"] == 0 for e in held.values() if e.measured.metrics)


# -- what is asked for -----------------------------------------------------------------------------------


def test_what_is_unknown_is_refused_with_the_right_code(tmp_path):
    def asked(**options):
        return regress(
            baselines=tmp_path,
            output=tmp_path / "out",
            **{"models": "cube", "backends": "planecut", **options},
        )

    with pytest.raises(BackendMissing, match="unknown backend 'nosuch'"):
        asked(backends="nosuch")
    with pytest.raises(SettingsError, match="unknown model 'nosuch'"):
        asked(models="nosuch")
    with pytest.raises(SettingsError, match="give failed or all"):
        asked(update_baseline="some")

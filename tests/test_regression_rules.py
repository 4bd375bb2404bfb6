"""Rules of regression without a slicer: what is worse, tolerances, baselines, and what is committed."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from regression_plugin import ALLOWED_MM, BLOCK, ROUGH_MM

from ebamcheck.accuracy.baselines import Entry, Key, differences, read_baselines, write_baselines
from ebamcheck.accuracy.matrix import (
    LENGTH,
    MATRIX,
    Matrix,
    Tolerance,
    Tolerances,
    default_tolerance,
    read_matrix,
    read_tolerances,
    rounds,
)
from ebamcheck.accuracy.measurement import (
    LAYER_COLUMNS,
    METRICS,
    NAMES,
    REFUSED,
    TOLERANCE_NAMES,
    Measured,
    measure_outcome,
    rounded,
    summarised,
    truth_of,
)
from ebamcheck.commands.accuracy import regress
from ebamcheck.errors import BackendMissing, InputError, SettingsError
from ebamcheck.plugins.model import models
from ebamcheck_planecut import PlaneCut

# -- rules, without a slicer -----------------------------------------------------------------------------

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


def held(new: Entry, old: Entry, **tolerances):
    (found,) = differences({new.key: new}, {old.key: old}, {}, Tolerances(**tolerances))
    return found


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6), st.floats(0.0, 0.1), st.integers(0, 5))
def test_an_entry_is_worse_exactly_if_a_layer_grew_beyond_its_tolerance(depths, growth, at):
    old = [rounded(d) for d in depths]
    k = at % len(old)
    new = [rounded(d + growth) if i == k else d for i, d in enumerate(old)]
    grown = new[k] > old[k] + LENGTH.allowed(old[k])
    found = held(entry_of(new), entry_of(old))
    assert (found.verdict == "worse") == grown
    if grown:
        places = [p for c in found.changes if c.growth for p in c.growth.places]
        assert {p.layer for p in places} == {k}
        assert {(p.old, p.new) for p in places} == {(old[k], new[k])}


def test_a_loss_on_one_layer_does_not_hide_behind_a_worse_one():
    found = held(entry_of([0.5, 0.2, 0.0]), entry_of([0.5, 0.1, 0.1]))
    assert found.verdict == "worse"
    (change,) = [c for c in found.changes if c.worse]
    assert (change.metric, change.growth.places[0].layer) == ("depth_mm", 1)


def test_a_gain_is_told_and_fails_nothing():
    found = held(entry_of([0.005, 0.01, 0.01]), entry_of(COLUMN))
    assert (found.verdict, found.fails) == ("better", False)
    assert any("depth_max_mm 0.03 -> 0.01" in line for line in found.lines())


def test_machine_renderer_and_versions_are_told_and_never_compared():
    old = entry_of(COLUMN, metadata={"machine": "a", "renderer": "x", "versions": {"n": "1"}})
    new = entry_of(COLUMN, metadata={"machine": "b", "renderer": "y", "versions": {"n": "2"}})
    assert held(new, old).verdict == "same"
    worse = held(replace(entry_of([1.0, 1.0, 1.0]), metadata=new.metadata), old)
    assert "renderer x -> y" in worse.why


def test_a_tolerance_of_a_backend_goes_before_that_of_the_metric():
    wide = {name: Tolerance(absolute=9.0) for name in TOLERANCE_NAMES}
    new, old = entry_of([0.04, 0.02, 0.03]), entry_of(COLUMN)
    assert held(new, old).verdict == "worse"
    assert held(new, old, metrics=wide).verdict == "same"
    tight = {"b": {"depth_max_mm": Tolerance()}}
    assert held(new, old, metrics=wide, backends=tight).verdict == "worse"


def test_a_backend_that_cannot_run_here_is_neither_met_nor_missed():
    old = entry_of(COLUMN)
    (absent,) = differences({}, {old.key: old}, {"b": "no display"}, Tolerances())
    assert (absent.verdict, absent.fails, absent.why) == ("not run", False, "no display")
    (gone,) = differences({}, {old.key: old}, {}, Tolerances())
    assert (gone.verdict, gone.fails) == ("vanished", True)


def test_a_refusal_is_an_answer_that_is_held_too():
    refused = replace(entry_of(COLUMN), measured=Measured(REFUSED, "open edges"))
    assert held(refused, refused).verdict == "same"
    assert held(refused, entry_of(COLUMN)).verdict == "worse"
    assert held(entry_of(COLUMN), refused).verdict == "better"


def test_baselines_come_back_as_written_and_unchanged_ones_are_left_alone(tmp_path):
    entries = [entry_of(COLUMN), entry_of([0.1 + 0.2, 1e-7, 3.0], backend="c")]
    assert write_baselines(tmp_path, entries, ["m"]) == [tmp_path / "m.json"]
    assert read_baselines(tmp_path, ["m", "other"]) == {e.key: e for e in entries}
    assert write_baselines(tmp_path, entries, ["m"]) == []
    assert write_baselines(tmp_path, [], ["m"]) == [tmp_path / "m.json"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"format": 99, "entries": {}}', '{"format": 1, "entries": {"a b": {}}}']
)
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


def test_the_loss_that_is_planted_is_that_which_the_tolerance_allows():
    assert LENGTH.allowed(ROUGH_MM) == pytest.approx(ALLOWED_MM, rel=1e-12)


def test_every_metric_has_a_tolerance_and_a_column_that_is_measured():
    assert len(set(NAMES)) == len(NAMES)
    assert {metric.column for metric in METRICS} == set(LAYER_COLUMNS)
    assert default_tolerance("ring_mismatch_layers").allowed(7.0) == 0.0
    assert default_tolerance("depth_max_mm") == LENGTH


# -- the truth -------------------------------------------------------------------------------------------


def test_planes_through_level_faces_are_among_the_heights_and_are_cut_as_the_plane_just_above():
    truth = truth_of(BLOCK, 0.05, 24)
    assert {0.0, 5.0, 10.0} <= set(truth.heights.tolist())
    areas = dict(zip(truth.heights.tolist(), truth.layers.areas().tolist(), strict=True))
    assert areas[10.0] == 0.0
    assert areas[5.0] == pytest.approx(BLOCK.area(6.0))
    assert areas[0.0] == pytest.approx(BLOCK.area(1.0))
    assert truth.uniform.sum() == 24


@pytest.mark.parametrize("name", ["sphere", "torus", "cylinder"])
def test_an_exact_cut_of_a_curved_model_stays_within_what_its_mesh_allows(tmp_path, name):
    from ebamcheck.layers.files import write_parquet
    from ebamcheck.slicers.isolation import Outcome

    def measured(layers):
        write_parquet(layers, tmp_path / "layers.parquet")
        return measure_outcome(truth, Outcome("planecut", file=tmp_path / "layers.parquet"))

    truth = truth_of(models([name])[name], 0.2, 12)
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


def test_the_committed_matrix_is_valid_for_the_installed_backends():
    matrix = read_matrix(COMMITTED)
    assert matrix == Matrix.model_validate(tomllib.loads((COMMITTED / MATRIX).read_text()))
    for name in matrix.every_day:
        subjects = [s for round_ in rounds(matrix, name, list(matrix.variants)) for s in round_.values()]
        assert len({(s.backend, s.settings_hash(matrix.case(name))) for s in subjects}) == len(subjects)


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

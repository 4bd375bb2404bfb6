"""Backends in processes of their own: what they return, and what becomes of those that fail."""

from __future__ import annotations

import os
import re
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from fake_distribution import found_here, install
from parts import box, tilted, torus

import ebamcheck
from ebamcheck.backend import Probe
from ebamcheck.errors import BackendMissing, SettingsError
from ebamcheck.plugins import registry
from ebamcheck.slicers.isolation import Limits, longest_first, slice_all

HEIGHTS = np.linspace(0.1, 1.9, 40)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A distribution of slicers that come to grief, which worker processes find, too."""
    points = {name.lower(): f"enemy_plugin:{name}" for name in ("Troubled", "Absent", "Raising")}
    folder = tmp_path_factory.mktemp("troubled")
    return install(folder, "troubled-plugin", {registry.BACKENDS: points})


@pytest.fixture
def plugins(installed, monkeypatch):
    found_here(installed, monkeypatch, os.path.dirname(__file__))
    yield
    registry.forget()


def test_slicers_that_are_not_exact_begin_first():
    names = ["embree", "manifold", "planecut", "stencil"]
    assert longest_first(names) == ["embree", "stencil", "manifold", "planecut"]


def test_one_that_ends_before_anybody_looks_is_held_to_its_memory_all_the_same(tmp_path):
    chosen = {"planecut": registry.slicer_settings("planecut", {})}
    few = Limits(time_s=120.0, memory_mb=1.0)
    outcome = slice_all(box(), HEIGHTS, chosen, tmp_path, few)["planecut"]
    assert outcome.failure == "out of memory"
    assert "over the limit of 1 MB (slicing.memory_limit_mb)" in outcome.why
    assert not list(tmp_path.glob("*.parquet"))


@pytest.mark.in_turn(2, 1)
@pytest.mark.parametrize(
    ("trouble", "failure", "why"),
    [
        ("abort", "crashed", "SIGABRT"),
        ("kill", "killed", "SIGKILL"),
        ("raise", "crashed", "RuntimeError: it broke|on two lines"),
        ("refuse", "refused", "3 open edges"),
        ("memory", "out of memory", "over the limit of 900 MB"),
    ],
)
def test_a_failing_backend_is_a_finding_and_the_others_go_on(plugins, trouble, failure, why, tmp_path):
    backends = {
        "troubled": registry.slicer_settings("troubled", {"trouble": trouble}),
        "planecut": registry.slicer_settings("planecut", {}),
    }
    limits = Limits(time_s=120.0, memory_mb=900.0)
    target = tmp_path / "layers"
    target.mkdir()
    outcomes = slice_all(box(), HEIGHTS, backends, target, limits)
    assert list(outcomes) == ["troubled", "planecut"]
    bad, good = outcomes["troubled"], outcomes["planecut"]
    assert bad.failure == failure
    assert bad.file is None
    assert re.search(why, bad.why), bad.why
    assert "\n" not in bad.why
    assert good.failure == ""
    assert good.read().areas().tolist() == [4.0] * 40
    assert good.peak_mb > 10
    assert [file.name for file in target.iterdir()] == ["planecut.parquet"]


def test_what_is_done_meanwhile_is_done_once_and_while_they_work(tmp_path):
    settings = {name: registry.slicer_settings(name, {}) for name in ("planecut", "manifold")}
    seen = []
    told = {"progress": lambda name, layers: seen.append(name), "meanwhile": lambda: seen.append("meanwhile")}
    outcomes = slice_all(box(), HEIGHTS, settings, tmp_path, Limits(processes=1), **told)
    assert seen[0] == "meanwhile"
    assert set(seen[1:]) == {"manifold", "planecut"}
    assert not any(outcome.failure for outcome in outcomes.values())


def test_layers_do_not_depend_on_the_blocks_they_are_cut_in(tmp_path):
    part = tilted(torus())
    heights = ebamcheck.layer_heights(part, part.size[2] / 40)
    settings = {"manifold": registry.slicer_settings("manifold", {})}
    here = ebamcheck.slice(part, heights, backend="manifold")
    for borders in ([0, 1, 17, 17, 39, 40], range(41)):
        there = slice_all(part, heights, settings, tmp_path, borders=np.array(borders))["manifold"].read()
        for column in ("heights", "points", "ring_starts", "layer_starts", "closed", "dropped"):
            assert np.array_equal(getattr(here, column), getattr(there, column)), column


def test_a_failing_backend_leaves_nothing_half_written(plugins, tmp_path):
    """Its time is over when the first of two blocks is written."""
    target = tmp_path / "layers"
    target.mkdir()
    settings = {"troubled": registry.slicer_settings("troubled", {"trouble": "stop"})}
    outcome = slice_all(box(), HEIGHTS, settings, target, Limits(time_s=4.0), borders=np.array([0, 20, 40]))["troubled"]
    assert (outcome.failure, outcome.file) == ("timed out", None)
    assert list(target.iterdir()) == []


def test_no_worker_outlives_its_parent_call(plugins, tmp_path):
    import psutil

    before = {p.pid for p in psutil.Process().children(recursive=True)}

    def interrupt(*_):
        raise KeyboardInterrupt

    backends = {
        "planecut": registry.slicer_settings("planecut", {}),
        "troubled": registry.slicer_settings("troubled", {"trouble": "hang"}),
    }
    with pytest.raises(KeyboardInterrupt):
        slice_all(box(), HEIGHTS, backends, tmp_path, progress=interrupt)
    assert {p.pid for p in psutil.Process().children(recursive=True)} <= before


def test_unavailable_unknown_and_broken_backends(plugins, monkeypatch):
    with pytest.raises(BackendMissing, match=r"unknown backend 'nosuch': installed are .*planecut"):
        ebamcheck.slice(box(), [1.0], backend="nosuch")
    with pytest.raises(BackendMissing, match="'absent' is not available: no such device; install one"):
        ebamcheck.slice(box(), [1.0], backend="absent")
    with pytest.raises(BackendMissing, match="no such device"):
        ebamcheck.slice(box(), [1.0], backend="absent", isolate=True)
    assert registry.probe("raising") == Probe(False, why="its probe raised OSError: driver not found")
    assert registry.default_backend() == "planecut"
    with pytest.raises(SettingsError, match=r"'planecut': pixel: unknown key; known keys: overlaps"):
        ebamcheck.slice(box(), [1.0], backend="planecut", pixel=3)


def test_a_broken_plugin_warns_and_is_left_out(monkeypatch):
    real = registry.entry_points
    broken = [
        EntryPoint("gone", "no_such_module:Slicer", registry.BACKENDS),
        EntryPoint("halfway", "ebamcheck.errors:InputError", registry.BACKENDS),
        EntryPoint("misnamed", "ebamcheck_planecut:PlaneCut", registry.BACKENDS),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: [*real(group=group), *broken])
    registry.forget()
    with pytest.warns(registry.BrokenPluginWarning) as told:
        found = registry.slicers()
    registry.forget()
    assert "planecut" in found
    assert not {"gone", "halfway", "misnamed"} & set(found)
    messages = "\n".join(str(w.message) for w in told)
    reasons = {"gone": "ModuleNotFoundError", "halfway": "lacks", "misnamed": "calls itself 'planecut'"}
    for name, why in reasons.items():
        assert f"plugin '{name}'" in messages
        assert why in messages

"""Slicers of strangers that lie, crash or leave children behind, each in a process of its own."""

from __future__ import annotations

import re

import numpy as np
import psutil
import pytest
from enemy_plugin import SLICERS
from enemy_text import TESTS
from fake_distribution import found_here, install
from parts import box

import ebamcheck as api
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.plugins import registry
from ebamcheck.slicers.isolation import Limits, slice_all
from ebamcheck.slicers.slicing import Slicing

HEIGHTS = np.linspace(0.1, 1.9, 40)


@pytest.fixture(scope="module")
def slicing_enemies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slicing")
    points = {name: f"enemy_plugin:{name.replace('-', '_')}" for name in SLICERS}
    points |= {"forks": "enemy_plugin:FORKS", "loose": "enemy_plugin:LOOSE"}
    return install(folder, "slicing-enemies", {registry.BACKENDS: points})


QUICK = [*SLICERS][::4]
"""Each of them takes two processes: quick tests have a few."""


@pytest.fixture(
    scope="module",
    params=[QUICK, pytest.param([n for n in SLICERS if n not in QUICK], marks=pytest.mark.slow)],
    ids=["some", "others"],
)
def sliced(request, slicing_enemies, tmp_path_factory):
    """What became of some of them and of honest slicers, run side by side."""
    with pytest.MonkeyPatch.context() as patch:
        found_here(slicing_enemies, patch, TESTS)
        target = tmp_path_factory.mktemp("layers")
        backends = {
            name: registry.slicer_settings(name, {}) for name in (*request.param, "planecut", "manifold")
        }
        steps = dict.fromkeys(backends, 0)

        def progress(name, done):
            steps[name] += done

        outcomes = slice_all(box(), HEIGHTS, backends, target, Limits(time_s=300.0, processes=3), progress)
        registry.forget()
    assert max(steps.values()) <= 40
    return outcomes, target


def test_slicers_that_lie_are_lost_and_reported(sliced):
    liars = {name: outcome for name, outcome in sliced[0].items() if name in SLICERS}
    assert len(liars) >= 4
    for name, outcome in liars.items():
        assert (outcome.failure, outcome.file) == ("crashed", None), name
        assert re.search(SLICERS[name][1], outcome.why), (name, outcome.why)
        assert "\n" not in outcome.why, name


def test_the_others_go_on(sliced):
    outcomes, target = sliced
    for name in ("planecut", "manifold"):
        assert outcomes[name].read().areas() == pytest.approx([4.0] * 40)
    assert sorted(file.name for file in target.iterdir()) == ["manifold.parquet", "planecut.parquet"]


def test_no_child_of_a_worker_outlives_it(slicing_enemies, tmp_path, monkeypatch):
    found_here(slicing_enemies, monkeypatch, TESTS)
    settings = {"forks": registry.slicer_settings("forks", {})}
    assert slice_all(box(), HEIGHTS, settings, tmp_path)["forks"].failure == ""
    sleeping = ["import time; time.sleep(600)"]
    left = []
    for process in psutil.process_iter():
        try:
            if process.cmdline()[2:] == sleeping and process.status() != psutil.STATUS_ZOMBIE:
                left.append(process)
        except psutil.Error:
            continue
    assert left == []
    registry.forget()


def test_a_stranger_slices_in_no_process_but_its_own(slicing_enemies, monkeypatch):
    found_here(slicing_enemies, monkeypatch, TESTS)
    assert api.slice(box(), [1.0], backend="loose").areas().tolist() == [4.0]
    with Slicing(box(), "loose") as slicing:
        assert slicing.at(1.0).areas().tolist() == [4.0]
    with pytest.raises(BackendFailed, match="'leaver' crashed: its process ended with code 0"):
        api.slice(box(), [1.0], backend="leaver")
    with pytest.raises(
        BackendFailed, match=r"'loose' of slicing-enemies 1 runs in a process of its own only"
    ):
        registry.slicer("loose").prepare(box(), registry.slicer_settings("loose", {}))
    assert registry.one_method("loose", "planecut")
    assert not registry.one_method("manifold", "planecut")
    with pytest.raises(BackendMissing, match="unknown backend 'nobody'"):
        registry.loaded_slicer("nobody")
    registry.forget()

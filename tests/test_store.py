"""The run folder: whole or not there, one run at a time, and JSON that every reader takes."""

from __future__ import annotations

import json
import math
import os

import numpy as np
import pytest

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.pipeline.run_folder import (
    MANIFEST,
    RunFolder,
    plain,
    sha256_of_json,
    start_run,
    write_json,
)


def finished(target, text="first"):
    run = start_run(target, "f", resume=False)
    write_json({"format": 1, "text": text}, run.path / MANIFEST)
    folder = run.finish()
    run.release()
    return folder


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_a_run_appears_when_it_is_whole(tmp_path):
    target = tmp_path / "a" / "b.run"
    run = start_run(target, "f", resume=False)
    assert not target.exists()
    write_json({"format": 1}, run.path / MANIFEST)
    assert run.finish().manifest() == {"format": 1}
    run.release()
    assert names(target.parent) == ["b.run"]


def test_a_former_run_is_replaced_whole(tmp_path):
    target = tmp_path / "b.run"
    (finished(target).path / "old.csv").write_text("of the first run")
    assert finished(target, "second").manifest()["text"] == "second"
    assert not (target / "old.csv").exists()
    assert names(tmp_path) == ["b.run"]


def test_a_link_to_a_run_stays_a_link(tmp_path):
    finished(tmp_path / "real.run")
    (tmp_path / "link").symlink_to("real.run")
    finished(tmp_path / "link", "second")
    assert (tmp_path / "link").is_symlink()
    assert RunFolder(tmp_path / "real.run").manifest()["text"] == "second"


def test_what_is_no_run_is_never_replaced(tmp_path):
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers" / "thesis.txt").write_text("ten years")
    (tmp_path / "file").write_text("x")
    for name in ("papers", "file"):
        with pytest.raises(SettingsError, match=f"{name}: is there and is no run folder"):
            start_run(tmp_path / name, "f", resume=False)
    (tmp_path / "empty").mkdir()
    finished(tmp_path / "empty")
    assert (tmp_path / "papers" / "thesis.txt").read_text() == "ten years"
    assert names(tmp_path) == ["empty", "file", "papers"]


def test_two_runs_to_one_place_do_not_mix(tmp_path):
    first = start_run(tmp_path / "b.run", "f", resume=False)
    (first.path / "half").write_text("x")
    with pytest.raises(SettingsError, match=r"another run to this place is under way"):
        start_run(tmp_path / "b.run", "f", resume=True)
    assert (first.path / "half").exists()
    first.release()
    start_run(tmp_path / "b.run", "f", resume=True).release()


@pytest.mark.parametrize(
    ("resume", "fingerprint", "kept"), [(True, "f", True), (True, "g", False), (False, "f", False)]
)
def test_only_the_same_run_goes_on(tmp_path, resume, fingerprint, kept):
    first = start_run(tmp_path / "b.run", "f", resume=False)
    (first.layers_folder / "planecut.parquet").write_text("x")
    first.release()
    second = start_run(tmp_path / "b.run", fingerprint, resume)
    assert (second.layers_folder / "planecut.parquet").exists() is kept
    second.release()


def test_places_that_cannot_be_written_are_told(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(SettingsError, match="cannot be written: Not a directory"):
        start_run(tmp_path / "file" / "b.run", "f", resume=False)
    with pytest.raises(SettingsError, match="cannot be written: File name too long"):
        start_run(tmp_path / ("x" * 300), "f", resume=False)


def test_manifests_that_are_none(tmp_path):
    with pytest.raises(InputError, match=r"is no run folder: it has no run\.json"):
        RunFolder(tmp_path).manifest()
    for text, message in (
        ("{", "cannot be read"),
        ("[]", "not a run of format 1"),
        ('{"format": 2}', "not a run"),
    ):
        (tmp_path / MANIFEST).write_text(text)
        with pytest.raises(InputError, match=message):
            RunFolder(tmp_path).manifest()


def test_plain_values_are_strict_json():
    value = {
        "array": np.arange(3), "number": np.float64(0.1), "tuple": (1, 2.5), "set": {"b", "a"},
        "nan": math.nan, "infinity": -math.inf, "name": os.fsdecode(b"gro\xdf.stl"), 3: None,
    }  # fmt: skip
    text = json.dumps(plain(value), allow_nan=False)
    assert json.loads(text) == {
        "array": [0, 1, 2], "number": 0.1, "tuple": [1, 2.5], "set": ["a", "b"],
        "nan": "NaN", "infinity": "-Infinity", "name": "gro\\udcdf.stl", "3": None,
    }  # fmt: skip


def test_the_hash_of_settings_ignores_their_order_alone():
    assert sha256_of_json({"a": 1, "b": [1, 2]}) == sha256_of_json({"b": (1, 2), "a": 1})
    assert sha256_of_json({"a": 1, "b": [1, 2]}) != sha256_of_json({"a": 1, "b": [2, 1]})

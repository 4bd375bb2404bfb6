"""The run folder: whole or not there, one run at a time, and JSON that every reader takes."""

from __future__ import annotations

import json
import math
import os

import numpy as np
import pytest

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import plain, sha256_of_json
from ebamcheck.record import run_folder as store
from ebamcheck.record.run_folder import MANIFEST, RunFolder, finished_run, start_run


def finished(target, text="first", finished="2026-11-22T14:15:00Z", force=False):
    run = start_run(target, "f", resume=False, force=force)
    run.write_manifest({"format": 1, "text": text, "timings": {"finished": finished}})
    (run.path / "fingerprint").unlink()
    folder = run.finish()
    run.release()
    return folder


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def text_of(folder):
    """The one word by which these records differ; no run writes so little, and none would be read."""
    return json.loads((folder / MANIFEST).read_text())["text"]


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_a_run_appears_when_it_is_whole(tmp_path):
    target = tmp_path / "a" / "b.run"
    run = start_run(target, "f", resume=False)
    assert not target.exists()
    run.write_manifest({"format": 1, "timings": {"finished": "now"}})
    folder = run.finish()
    assert json.loads((folder.path / "timings.json").read_text()) == {"finished": "now"}
    assert json.loads((folder.path / MANIFEST).read_text()) == {"format": 1}
    run.release()
    assert names(target.parent) == ["b.run"]


def test_a_finished_run_is_never_overwritten(tmp_path):
    target = tmp_path / "b.run"
    before = contents(finished(target).path)
    said = r"finished at 2026-11-22T14:15:00Z: .*-o, or --force.* b\.run\.2026-11-22T141500$"
    with pytest.raises(SettingsError, match=said):
        start_run(target, "f", resume=False)
    assert contents(target) == before
    assert names(tmp_path) == ["b.run"]


def test_with_force_every_former_run_is_kept_under_its_own_date(tmp_path):
    target = tmp_path / "b.run"
    (finished(target).path / "signatures").mkdir()
    (target / "signatures" / "jane.json").write_text("{}")
    before = contents(target)
    assert text_of(finished(target, "second", force=True).path) == "second"
    assert names(target) == ["layers", MANIFEST, "timings.json"]
    assert contents(tmp_path / "b.run.2026-11-22T141500") == before
    # Two that ended in the same second, and one whose times are gone.
    finished(target, "third", force=True)
    assert names(tmp_path) == ["b.run", "b.run.2026-11-22T141500", "b.run.2026-11-22T141500-2"]
    (target / "timings.json").unlink()
    os.utime(target / MANIFEST, (0, 0))
    finished(target, "fourth", force=True)
    assert text_of(tmp_path / "b.run.1970-01-01T000000") == "third"


def test_the_dated_name_never_leads_elsewhere_and_a_link_stays_a_link(tmp_path):
    """The time in a record is text like any other."""
    finished(tmp_path / "b.run", finished="../../2026-11-22T14:15:00Z")
    os.utime(tmp_path / "b.run" / MANIFEST, (0, 0))
    (tmp_path / "link").symlink_to("b.run")
    finished(tmp_path / "link", "second", force=True)
    assert names(tmp_path) == ["b.run", "b.run.1970-01-01T000000", "link"]
    assert (tmp_path / "link").is_symlink()
    assert text_of(tmp_path / "b.run") == "second"


@pytest.mark.parametrize("where", ["before the exchange", "after the exchange"])
def test_a_run_killed_on_the_way_to_its_place_loses_neither(tmp_path, where):
    target, unfinished = tmp_path / "b.run", tmp_path / ".b.run.unfinished"
    finished(target)
    run = start_run(target, "f", resume=False, force=True)
    run.write_manifest({"format": 1, "text": "second", "timings": {"finished": "2026-11-23T00:00:00Z"}})
    (run.path / "fingerprint").unlink()
    run.release()
    if where == "after the exchange":
        store._exchange(unfinished, target)
    with pytest.raises(SettingsError, match="holds a run that was finished"):
        start_run(target, "f", resume=False)
    texts = {text_of(path) for path in tmp_path.iterdir()}
    assert (texts, unfinished.exists()) == ({"first", "second"}, False)


def test_a_run_killed_before_its_last_step_is_finished_by_the_next(tmp_path):
    target = tmp_path / "b.run"
    run = start_run(target, "f", resume=False)
    run.write_manifest({"format": 1, "fingerprint": "f", "timings": {}})
    (run.path / "fingerprint").unlink()
    assert finished_run(tmp_path / "other.run", "f") is None
    with pytest.raises(SettingsError, match="under way"):
        finished_run(target, "f")
    run.release()
    assert finished_run(target, "g") is None
    assert finished_run(target, "f") == RunFolder(target)


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


@pytest.mark.parametrize(
    ("resume", "fingerprint", "kept"), [(True, "f", True), (True, "g", False), (False, "f", False)]
)
def test_only_the_same_run_goes_on_and_two_do_not_mix(tmp_path, resume, fingerprint, kept):
    first = start_run(tmp_path / "b.run", "f", resume=False)
    (first.layers_folder / "planecut.parquet").write_text("x")
    with pytest.raises(SettingsError, match=r"another run to this place is under way"):
        start_run(tmp_path / "b.run", "f", resume=True)
    assert (first.layers_folder / "planecut.parquet").exists()
    first.release()
    second = start_run(tmp_path / "b.run", fingerprint, resume)
    assert (second.layers_folder / "planecut.parquet").exists() is kept
    second.release()


def test_places_that_cannot_be_written_are_told(tmp_path):
    (tmp_path / "file").write_text("x")
    for place, said in (("file/b.run", "Not a directory"), ("x" * 300, "File name too long")):
        with pytest.raises(SettingsError, match=f"cannot be written: {said}"):
            start_run(tmp_path / place, "f", resume=False)


def test_manifests_that_are_none(tmp_path):
    with pytest.raises(InputError, match=r"is no run folder: it has no run\.json"):
        RunFolder(tmp_path).manifest()
    for text, message in (
        ("{", "cannot be read"),
        ("[]", "not a run of format 2"),
        ('{"format": 1}', "not a run of format 2: make it again"),
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

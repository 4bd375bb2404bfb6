"""The server of a build: its journal, what a kill leaves, what is published, and a machine that plays the other side."""

from __future__ import annotations

import hashlib
import json
import shutil
import tracemalloc
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import command, ebamcheck
from live_boxes import Server, failed_checks, play, third_layer

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.building import Building, answer_to
from ebamcheck.live.heights_table import PLOT, TABLE, HeightsTable, read_heights
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.publishing import (
    JOURNAL,
    LAYERS,
    Journal,
    certificate_of,
    publish,
    read_current,
    read_journal,
)
from ebamcheck.testing.played_control.program import Growth

SIZE = (30, 24, 12)


# -- the journal -------------------------------------------------------------------------------------


def test_a_changed_or_missing_line_shows(tmp_path):
    path = tmp_path / "j.jsonl"
    with Journal(path) as journal:
        for k in range(5):
            journal.append({"kind": "height", "done": k})
    lines = path.read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([*lines[:2], *lines[3:]]))
    with pytest.raises(InputError, match="does not follow"):
        list(read_journal(path))
    path.write_bytes(b"\n".join(lines).replace(b'"done":2', b'"done":7'))
    with pytest.raises(InputError, match="does not follow"):
        list(read_journal(path))


def test_a_line_that_was_cut_off_goes_and_the_rest_stays(tmp_path):
    path = tmp_path / "j.jsonl"
    with Journal(path) as journal:
        journal.append({"kind": "height", "done": 0})
        journal.append({"kind": "height", "done": 1})
    whole = path.read_bytes()
    first = whole.index(b"\n") + 1
    for cut in range(first, len(whole)):
        path.write_bytes(whole[:cut])
        assert len(list(read_journal(path))) == 1
        with Journal(path) as journal:
            assert journal.lines == 1
            with pytest.raises(SettingsError, match="another `ebamcheck live` writes to it"):
                Journal(path)
        assert path.read_bytes() == whole[:first]


def test_replay_gives_the_same_bytes_and_another_build_is_refused(place, maker, tmp_path):
    made = Building(maker, tmp_path / "b")
    made.start()
    made.height({"done": 1, "height_mm": 1.9})
    made.height({"done": 2, "height_mm": 3.3})
    made.close()
    files = {
        p.relative_to(tmp_path / "b"): p.read_bytes() for p in (tmp_path / "b").rglob("*") if p.is_file()
    }
    fresh = tmp_path / "c"
    fresh.mkdir()
    shutil.copy(tmp_path / "b" / JOURNAL, fresh / JOURNAL)
    again = Building(maker, fresh)
    again.close()
    assert {p.relative_to(fresh): p.read_bytes() for p in fresh.rglob("*") if p.is_file()} == files
    done = ebamcheck("live", place / "box.run", "--replay", fresh / JOURNAL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "3 layers made again" in done.stdout
    other = maker.config.changed(process={"wire_retract_mm": 1.5})
    with (
        LayerMaker(maker.part, other, maker.primary) as changed,
        pytest.raises(InputError, match="another build"),
    ):
        Building(changed, fresh)


def test_a_journal_whose_layer_is_not_what_comes_out_is_refused(place, maker, tmp_path):
    with Journal(tmp_path / "b" / JOURNAL) as journal:
        building = Building(maker, tmp_path / "x")
        journal.append({"kind": "begin", **building._of()})
        building.close()
        journal.append({"kind": "height", "done": 0, "height_mm": 0.0})
        journal.append({"kind": "layer", "name": "MAIN_K0001R1", "files": {"MAIN_K0001R1.MPF": "0" * 64}})
    with pytest.raises(InputError, match="other bytes"):
        Building(maker, tmp_path / "b")
    done = ebamcheck("live", place / "box.run", "--replay", tmp_path / "b" / JOURNAL, cwd=tmp_path)
    assert done.returncode == 1


def test_a_journal_with_another_wait_than_comes_out_is_refused(maker, tmp_path):
    made = Building(maker, tmp_path / "b")
    made.start()
    made.close()
    entries = list(read_journal(tmp_path / "b" / JOURNAL))
    assert [entry["kind"] for entry in entries] == ["begin", "height", "layer"]
    for name, more_s in (("same", 0.0), ("other", 1.0)):
        with Journal(tmp_path / name / JOURNAL) as journal:
            for entry in entries:
                waits = {"wait_s": entry["wait_s"] + more_s} if "wait_s" in entry else {}
                journal.append({key: value for key, value in {**entry, **waits}.items() if key != "after"})
    Building(maker, tmp_path / "same").close()
    with pytest.raises(InputError, match="another wait"):
        Building(maker, tmp_path / "other")


@pytest.mark.parametrize("place_of_kill", ["staged", "renamed", "journalled"])
def test_a_kill_at_any_moment_leaves_the_last_validated_layer(maker, tmp_path, monkeypatch, place_of_kill):
    from ebamcheck.live import publishing

    class Killed(BaseException):
        """What no handler catches, as a kill is not caught."""

    folder = tmp_path / "b"
    made = Building(maker, folder)
    made.start()
    told = read_current(folder)

    def kill(*_args, **_kwargs):
        raise Killed

    if place_of_kill == "staged":
        monkeypatch.setattr(publishing, "publish", kill)
    elif place_of_kill == "renamed":
        appended = made.journal.append
        monkeypatch.setattr(
            made.journal, "append", lambda entry: kill() if entry["kind"] == "layer" else appended(entry)
        )
    else:
        monkeypatch.setattr(publishing, "write_synced", kill)
    with pytest.raises(Killed):
        made.height({"done": 1, "height_mm": 1.9})
    made.close()
    monkeypatch.undo()
    assert read_current(folder) == told
    called = folder / told["program"]
    assert hashlib.sha256(called.read_bytes()).hexdigest() == told["sha256"]
    # What the kill left of a layer in the making goes when the build goes on.
    (folder / ".making.left" / "program").mkdir(parents=True)
    again = Building(maker, folder)
    assert not list(folder.glob(".making.*"))
    answer = again.height({"done": 1, "height_mm": 1.9})
    again.close()
    assert answer["answer"] == "published"
    assert answer["layer"] == 2
    untouched = Building(maker, tmp_path / "never")
    untouched.start()
    assert untouched.height({"done": 1, "height_mm": 1.9})["sha256"] == answer["sha256"]
    untouched.close()


def test_a_file_that_was_exchanged_before_publishing_is_not_published(maker, tmp_path):
    made = third_layer(maker, tmp_path / "s")
    certificate = certificate_of(made, maker)
    path = made.files.folder / made.files.names[1]
    path.write_text(path.read_text() + "\n")
    with pytest.raises(SettingsError, match="not the file that was verified"):
        publish(tmp_path / "b", made, certificate)
    assert read_current(tmp_path / "b") is None


def test_what_is_not_validated_is_never_published(maker, tmp_path):
    made = third_layer(maker, tmp_path / "s", 0.5)
    assert not made.passed
    assert "process window" in made.why
    with pytest.raises(InputError, match="not validated"):
        publish(tmp_path / "b", made, certificate_of(made, maker))
    assert not (tmp_path / "b").exists()


def test_memory_does_not_grow_over_thousands_of_lines(maker, tmp_path):
    building = Building(maker, tmp_path / "b")
    building.start()
    good = json.dumps({"event": "height", "done": 1, "height_mm": 1.8}).encode()
    bad = [
        b"\xff",
        b'{"event": "launch"}',
        good.replace(b"1.8", b"true"),
        good.replace(b'"done": 1', b'"done": 5'),
    ]
    answer_to(building, good)

    def round_of(count):
        for k in range(count):
            answer_to(building, bad[k % len(bad)])
            answer_to(building, good)

    round_of(200)
    tracemalloc.start()
    round_of(200)
    before = tracemalloc.get_traced_memory()[0]
    round_of(2000)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    building.close()
    assert grown < 100_000, grown


# -- the whole loop ----------------------------------------------------------------------------------


def test_the_server_outlives_bad_input_and_ends_with_its_input(place, tmp_path):
    server = Server(command("live", place / "box.run", "-o", tmp_path / "b"), cwd=tmp_path)
    try:
        assert server.tell(event="status")["published"] is None
        assert server.ask(b"x" * 1_000_000)["code"] == "unreadable"
        assert server.tell(event="start")["answer"] == "published"
        assert server.tell(event="reset")["published"]["layer"] == 1
        assert server.tell(event="stop") == {"answer": "stopped"}
    finally:
        server.close()


@pytest.mark.slow
def test_a_server_without_a_line_says_that_it_waits(place, tmp_path):
    server = Server(command("live", place / "box.run", "-o", tmp_path / "b", "--timeout", 0.2), cwd=tmp_path)
    try:
        answer = server.tell(event="start")
        while answer["answer"] == "late":
            answer = server.answer()
        late = server.answer()
        assert late["answer"] == "late"
        assert late["published"]["name"] == answer["name"]
        assert server.tell(event="height", done=1, height_mm=1.8)["answer"] == "published"
    finally:
        server.close()


@pytest.mark.parametrize(("drift", "seed"), [(0.1, 1), pytest.param(-0.1, 2, marks=pytest.mark.slow)])
def test_a_build_with_drift_and_noise_ends_at_the_top_and_every_layer_verifies(place, tmp_path, drift, seed):
    pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")
    out = tmp_path / "b"
    done = ebamcheck(
        "machine", place / "box.run", "-o", out, "--drift", drift, "--noise", 0.05, "--seed", seed, "--speed", 1e6,
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the top came out" in done.stdout
    again = ebamcheck("machine", place / "box.run", "-o", out, cwd=tmp_path)
    assert again.returncode == 2
    assert "holds a build that was begun" in again.stderr
    entries = list(read_journal(out / JOURNAL))
    layers = [entry["name"] for entry in entries if entry["kind"] == "layer"]
    assert sorted(layers) == sorted(p.name for p in (out / LAYERS).iterdir())
    last = next(entry for entry in entries if entry["kind"] == "done")
    assert abs(last["off_mm"]) < 0.42
    for name in layers:
        assert failed_checks(out / LAYERS / name, place / "box.stl") == []
    table = (out / "machine.csv").read_text().strip().split("\n")
    assert len(table) == len(layers) + 1


@pytest.mark.slow
def test_a_server_killed_in_the_middle_goes_on_where_it_was(place, tmp_path):
    out = tmp_path / "b"
    start = command("live", place / "box.run", "-o", out)
    server = Server(start, cwd=tmp_path)
    answer = play(server.tell, out, Growth(0.1), most_layers=2)[-1]
    assert answer["layer"] == 3
    server.kill()
    again = Server(start, cwd=tmp_path)
    try:
        assert again.tell(event="status")["published"]["name"] == answer["name"]
        assert again.tell(event="start")["sha256"] == answer["sha256"]
        last = play(again.tell, out, Growth(0.1))[-1]
    finally:
        again.close()
    whole = Server(command("live", place / "box.run", "-o", tmp_path / "w"), cwd=tmp_path)
    try:
        assert play(whole.tell, tmp_path / "w", Growth(0.1))[-1] == last
    finally:
        whole.close()
    names = sorted(p.name for p in (out / LAYERS).iterdir())
    assert names == sorted(p.name for p in (tmp_path / "w" / LAYERS).iterdir())
    for name in names:
        for file in sorted((out / LAYERS / name / "program").iterdir()):
            assert file.read_bytes() == (tmp_path / "w" / LAYERS / name / "program" / file.name).read_bytes()


def test_heights_of_a_build_are_tabled_and_drawn_and_come_out_the_same_again(maker, tmp_path):
    folder = tmp_path / "b"
    building = Building(maker, folder)
    answers = [building.start()]
    measured = []
    for k in range(3):
        last = answers[-1]
        measured.append(last["base_mm"] + 1.08 * last["thickness_mm"])
        answers.append(building.height({"done": k + 1, "height_mm": measured[-1]}))
        building.heights.write()
    building.close()
    table = read_heights(folder / TABLE)
    tops = [answer["base_mm"] + answer["thickness_mm"] for answer in answers[:3]]
    assert table["layer"].tolist() == [1, 2, 3]
    assert table["measured_top_mm"] == pytest.approx(measured, rel=1e-6)
    assert table["corrected_top_mm"] == pytest.approx(tops, rel=1e-6)
    assert table["deviation_mm"] == pytest.approx(np.subtract(measured, tops), rel=1e-5)
    assert table["planned_top_mm"] == pytest.approx(building.rule.plan(0.0).tops_mm[:3], rel=1e-6)
    assert table["grown_mm"] == pytest.approx(1.08 * table["thickness_mm"], rel=1e-5)
    drawn = ElementTree.fromstring((folder / PLOT).read_text())
    lines = [line for line in drawn.iter() if line.tag.endswith("polyline")]
    assert len(lines) == 6
    assert all(len(line.get("points").split()) == 3 for line in lines)
    HeightsTable(tmp_path / "nowhere").write(ended=True)  # costs the table alone
    before = {name: (folder / name).read_bytes() for name in (TABLE, PLOT)}
    Building(maker, folder).close()
    assert {name: (folder / name).read_bytes() for name in before} == before

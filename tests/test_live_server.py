"""The server of a build: its journal, what a kill leaves, what is published, and a machine that plays the other side."""

from __future__ import annotations

import json
import tracemalloc
from contextlib import closing
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import command, ebamcheck
from live_boxes import Server, failed_checks, made_again, play, third_layer

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.live import publishing
from ebamcheck.live.building import Building, answer_to
from ebamcheck.live.heights_table import PLOT, TABLE, HeightsTable, laid_height, read_heights
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.publishing import (
    CURRENT,
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
    with closing(Building(maker, tmp_path / "b")) as build:
        build.start()
        build.height({"done": 1, "height_mm": 1.9})
        build.height({"done": 2, "height_mm": 3.3})
    fresh = tmp_path / "c"
    assert made_again(maker, tmp_path / "b", fresh)
    for name in (CURRENT, TABLE):
        assert (fresh / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    done = ebamcheck("live", place / "box.run", "--replay", fresh / JOURNAL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "3 layers made again" in done.stdout
    other = maker.config.changed(process={"wire_retract_mm": 1.5})
    with (
        LayerMaker(maker.part, other, maker.primary) as changed,
        pytest.raises(InputError, match="another build"),
    ):
        Building(changed, fresh)


def test_a_journal_with_other_bytes_or_waits_than_come_out_is_refused(place, maker, tmp_path):
    with closing(Building(maker, tmp_path / "b")) as build:
        build.start()
    entries = list(read_journal(tmp_path / "b" / JOURNAL))
    assert [entry["kind"] for entry in entries] == ["begin", "height", "layer"]
    wait_s = entries[-1]["wait_s"]
    for name, changes in (
        ("same", {}),
        ("another wait", {"wait_s": wait_s + 1.0}),
        ("other bytes", {"files": {"MAIN_K0001R1.MPF": "0" * 64}}),
    ):
        with Journal(tmp_path / name / JOURNAL) as journal:
            for entry in [*entries[:-1], {**entries[-1], **changes}]:
                journal.append({key: value for key, value in entry.items() if key != "after"})
        if name == "same":
            Building(maker, tmp_path / name).close()
            continue
        with pytest.raises(InputError, match=name):
            Building(maker, tmp_path / name)
    done = ebamcheck("live", place / "box.run", "--replay", tmp_path / "other bytes" / JOURNAL, cwd=tmp_path)
    assert done.returncode == 1


class Killed(BaseException):
    """What no handler catches, as a kill is not caught."""


@pytest.mark.parametrize("step", ["publish", "journal", "write_synced"])
def test_a_kill_at_any_moment_leaves_the_last_validated_layer(maker, tmp_path, monkeypatch, step):
    folder, reading = tmp_path / "b", {"done": 1, "height_mm": 1.9}

    def kill(entry=None, *_args, **_kwargs):
        if step != "journal" or entry["kind"] == "layer":
            raise Killed
        return appended(entry)

    with closing(Building(maker, folder)) as build, monkeypatch.context() as patch:
        build.start()
        told, appended = read_current(folder), build.journal.append
        patch.setattr(*((build.journal, "append") if step == "journal" else (publishing, step)), kill)
        with pytest.raises(Killed):
            build.height(reading)
    assert read_current(folder) == told
    assert sha256_of_file(folder / told["program"]) == told["sha256"]
    # What the kill left of a layer in the making goes when the build goes on.
    (folder / ".making.left" / "program").mkdir(parents=True)
    with closing(Building(maker, folder)) as build:
        assert not list(folder.glob(".making.*"))
        answer = build.height(reading)
    assert (answer["answer"], answer["layer"]) == ("published", 2)
    with closing(Building(maker, tmp_path / "never")) as untouched:
        untouched.start()
        assert untouched.height(reading)["sha256"] == answer["sha256"]


def test_what_was_exchanged_or_is_not_validated_is_never_published(maker, tmp_path):
    made = third_layer(maker, tmp_path / "s")
    certificate = certificate_of(made, maker)
    path = made.files.folder / made.files.names[1]
    path.write_text(path.read_text() + "\n")
    with pytest.raises(SettingsError, match="not the file that was verified"):
        publish(tmp_path / "b", made, certificate)
    thin = third_layer(maker, tmp_path / "t", 0.5)
    assert not thin.passed
    assert "process window" in thin.why
    with pytest.raises(InputError, match="not validated"):
        publish(tmp_path / "b", thin, certificate_of(thin, maker))
    assert read_current(tmp_path / "b") is None


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
    with closing(Server(command("live", place / "box.run", "-o", "b"), cwd=tmp_path)) as server:
        assert server.tell(event="status")["published"] is None
        assert server.ask(b"x" * 1_000_000)["code"] == "unreadable"
        assert server.tell(event="start")["answer"] == "published"
        assert server.tell(event="reset")["published"]["layer"] == 1
        assert server.tell(event="stop") == {"answer": "stopped"}


@pytest.mark.slow
def test_a_server_without_a_line_says_that_it_waits(place, tmp_path):
    start = command("live", place / "box.run", "-o", "b", "--timeout", 0.2)
    with closing(Server(start, cwd=tmp_path)) as server:
        answer = server.tell(event="start")
        while answer["answer"] == "late":
            answer = server.answer()
        late = server.answer()
        assert late["answer"] == "late"
        assert late["published"]["name"] == answer["name"]
        assert server.tell(event="height", done=1, height_mm=1.8)["answer"] == "published"


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
    out, whole = tmp_path / "b", tmp_path / "w"
    start = command("live", place / "box.run", "-o", out)
    server = Server(start, cwd=tmp_path)
    answer = play(server.tell, out, Growth(0.1), most_layers=2)[-1]
    assert answer["layer"] == 3
    server.kill()
    with closing(Server(start, cwd=tmp_path)) as again:
        assert again.tell(event="status")["published"]["name"] == answer["name"]
        assert again.tell(event="start")["sha256"] == answer["sha256"]
        last = play(again.tell, out, Growth(0.1))[-1]
    with closing(Server(command("live", place / "box.run", "-o", whole), cwd=tmp_path)) as untouched:
        assert play(untouched.tell, whole, Growth(0.1))[-1] == last
    programs = [
        {path.relative_to(folder): path.read_bytes() for path in folder.glob(f"{LAYERS}/*/program/*")}
        for folder in (out, whole)
    ]
    assert programs[0] == programs[1] != {}


def test_heights_of_a_build_are_tabled_and_drawn_and_come_out_the_same_again(maker, tmp_path):
    folder, measured = tmp_path / "b", []
    with closing(Building(maker, folder)) as build:
        answers = [build.start()]
        for k in range(3):
            measured.append(answers[k]["base_mm"] + 1.08 * answers[k]["thickness_mm"])
            answers.append(build.height({"done": k + 1, "height_mm": measured[k]}))
            build.heights.write()
        planned = build.rule.plan(0.0).tops_mm[:3]
    table = read_heights(folder / TABLE)
    tops = [answer["base_mm"] + answer["thickness_mm"] for answer in answers[:3]]
    assert table["layer"].tolist() == [1, 2, 3]
    assert table["measured_top_mm"] == pytest.approx(measured, rel=1e-6)
    assert table["corrected_top_mm"] == pytest.approx(tops, rel=1e-6)
    assert table["deviation_mm"] == pytest.approx(np.subtract(measured, tops), rel=1e-5)
    assert table["planned_top_mm"] == pytest.approx(planned, rel=1e-6)
    assert table["grown_mm"] == pytest.approx(1.08 * table["thickness_mm"], rel=1e-5)
    drawn = ElementTree.fromstring((folder / PLOT).read_text())
    lines = [line for line in drawn.iter() if line.tag.endswith("polyline")]
    assert [len(line.get("points").split()) for line in lines] == [3] * 6
    before = {name: (folder / name).read_bytes() for name in (TABLE, PLOT)}
    Building(maker, folder).close()
    assert {name: (folder / name).read_bytes() for name in before} == before
    lost = HeightsTable(tmp_path / "nowhere")  # a table that cannot be written costs the table alone
    lost.add(laid_height(0, np.array([1.7]), 0.0, 1.7, 1.9, 0.0))
    lost.write(ended=True)
    assert not (tmp_path / "nowhere").exists()

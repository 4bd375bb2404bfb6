"""Every fault of the list of bad input, by name, at both doors: its stated answer, and nothing changed, released or lost."""

import asyncio
import errno
import json
import math
import os

import pytest

from ebamcheck.live import publishing
from ebamcheck.live.building import Building, answer_to
from ebamcheck.live.making import MadeLayer
from ebamcheck.live.publishing import read_current

SIZE = (30, 24, TOP_MM := 5.2)


@pytest.fixture
def building(maker, tmp_path):
    made = Building(maker, tmp_path / "b")
    yield made
    made.close()


def line(**values):
    return json.dumps({"event": "height", **values}).encode()


# Heights after the first layer, which was planned from 0 to about 1.73 mm.
HEIGHTS = {
    "missing": (None, "missing"),
    "absurd": (40.0, "absurd"),
    "absurd, endless": (1e300, "absurd"),
    "decreasing": (-3.0, "decreasing"),
    "nothing grown": (0.0, "decreasing"),
    "no number": (math.nan, "not-a-number"),
    "infinite": (math.inf, "not-a-number"),
    "in inches": (1.75 / 25.4, "unit"),
    "in metres": (1.75e-3, "unit"),
    "in micrometres": (1750.0, "unit"),
}


@pytest.mark.parametrize("name", HEIGHTS)
def test_a_bad_height_on_a_line_is_refused_and_the_next_good_one_counts(name, building):
    height, code = HEIGHTS[name]
    first = building.start()
    before = read_current(building.folder)
    answer = answer_to(building, line(done=1, height_mm=height))
    assert (answer["answer"], answer["code"]) == ("refused", code)
    assert len(answer["reason"]) < 120
    assert read_current(building.folder) == before
    good = answer_to(building, line(done=1, height_mm=1.8))
    assert good["answer"] == "published"
    assert good["layer"] == first["layer"] + 1


TEXTS = {
    "a text for a number": (line(done=1, height_mm="1.8"), "not-a-number"),
    "a truth for a number": (line(done=1, height_mm=True), "not-a-number"),
    "a list for a number": (line(done=1, height_mm=[1.8]), "not-a-number"),
    "a truth for a counter": (line(done=True, height_mm=1.8), "counter"),
    "bytes that are no text": (b"\xff\xfe height", "unreadable"),
    "a number of a thousand digits": (b'{"event":"height","done":1,"height_mm":1' + b"0" * 1000 + b"}", "not-a-number"),
    "another unit": (line(done=1, height_mm=1.8, unit="in"), "unit"),
    "no counter": (line(height_mm=1.8), "missing"),
    "a counter ahead": (line(done=3, height_mm=1.8), "counter-jump"),
    "a negative counter": (line(done=-1, height_mm=1.8), "counter"),
    "half a layer": (line(done=1.5, height_mm=1.8), "counter"),
    "a counter of a hundred digits": (line(done=10**100, height_mm=1.8), "counter-jump"),
    "no JSON": (b"height 1.8", "unreadable"),
    "half a line": (b'{"event": "height", "done": 1, "hei', "unreadable"),
    "a line without end": (b'{"event": "height"' + b" " * 5000 + b"}", "unreadable"),
    "nested without end": (b"[" * 4000, "unreadable"),
    "an empty line": (b"  ", "unreadable"),
    "a counter twice": (b'{"event": "height", "done": 7, "done": 1, "height_mm": 1.8}', "unreadable"),
    "an event that is not known": (b'{"event": "launch"}', "event"),
    "no event": (b"{}", "event"),
}  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_a_bad_line_is_refused_and_changes_nothing(name, building):
    text, code = TEXTS[name]
    building.start()
    before = read_current(building.folder)
    answer = answer_to(building, text)
    assert (answer["answer"], answer["code"]) == ("refused", code)
    assert "\n" not in answer["reason"]
    assert len(answer["reason"]) < 120
    assert read_current(building.folder) == before
    assert building.expected_done == 1


def test_a_counter_that_falls_back_is_refused(building):
    building.start()
    assert answer_to(building, line(done=1, height_mm=1.8))["answer"] == "published"
    assert answer_to(building, line(done=0, height_mm=1.8))["code"] == "counter-jump"
    assert building.expected_done == 2


def test_a_repeated_height_is_answered_and_another_one_for_the_same_layer_refused(building):
    building.start()
    first = answer_to(building, line(done=1, height_mm=1.8))
    again = answer_to(building, line(done=1, height_mm=1.8))
    assert again == {**first, "again": True}
    assert answer_to(building, line(done=1, height_mm=1.85))["code"] == "repeated"
    assert building.expected_done == 2


def until_the_last(building):
    """Lay all layers as planned but the last one; number of layers done when that is laid, and what it lies on."""
    answer = building.start()
    while answer["layers_left"] > 1:
        done, top_mm = answer["layer"], answer["base_mm"] + answer["thickness_mm"]
        answer = answer_to(building, line(done=done, height_mm=top_mm))
    return answer["layer"]


@pytest.mark.parametrize("short_mm", [0.45, 0.55, 0.7, 0.8])
def test_a_rest_under_the_least_layer_is_laid_by_the_least_and_the_build_ends(short_mm, building):
    done = until_the_last(building)
    least = answer_to(building, line(done=done, height_mm=TOP_MM - short_mm))
    assert least["answer"] == "published", least
    assert least["thickness_mm"] == pytest.approx(building.rule.limits.least_mm)
    end = answer_to(building, line(done=done + 1, height_mm=least["base_mm"] + least["thickness_mm"]))
    assert end["answer"] == "done"
    assert 0.0 < end["off_mm"] <= building.rule.met_mm


def test_a_rest_under_the_least_layer_that_no_gate_lets_through_ends_the_build_and_says_what_is_left(
    building, tmp_path, maker, monkeypatch
):
    done = until_the_last(building)
    with monkeypatch.context() as patch:
        patch.setattr(MadeLayer, "passed", False)
        patch.setattr(MadeLayer, "why", "gate deposit: too thin")
        # A whole layer is left: the build waits for somebody who helps.
        assert answer_to(building, line(done=done, height_mm=TOP_MM - 1.0))["answer"] == "kept"
        end = answer_to(building, line(done=done, height_mm=TOP_MM - 0.6))
    assert (end["answer"], end["off_mm"]) == ("done", pytest.approx(-0.6))
    assert "no layer fills the last 0.600 mm (gate deposit: too thin)" in end["said"][0]
    assert building.finished


@pytest.mark.parametrize("step", ["certificate", "current"])
def test_a_full_disk_keeps_the_layer_and_the_server_goes_on_when_there_is_room(step, building, monkeypatch):
    building.start()
    before = read_current(building.folder)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with monkeypatch.context() as patch:

        def no_room(*given):
            raise full

        patch.setattr(publishing, "values_as_toml" if step == "certificate" else "write_synced", no_room)
        kept = answer_to(building, line(done=1, height_mm=1.8))
        assert kept["answer"] == "kept"
        assert "No space left" in kept["reason"]
    assert read_current(building.folder) == before
    good = answer_to(building, line(done=1, height_mm=1.8))
    assert good["answer"] == "published"
    assert read_current(building.folder)["name"] == good["name"]


def test_a_disk_without_room_for_the_journal_is_told_and_nothing_is_published(building, monkeypatch):
    building.start()
    before = read_current(building.folder)
    with monkeypatch.context() as patch:

        def no_room(entry):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        patch.setattr(building.journal, "append", no_room)
        answer = answer_to(building, line(done=1, height_mm=1.8))
        assert answer["answer"] == "error"
        assert "No space left" in answer["reason"]
    assert read_current(building.folder) == before
    assert answer_to(building, line(done=1, height_mm=1.8))["answer"] == "published"


# -- the door of a control ---------------------------------------------------------------------------


@pytest.mark.slow
def test_every_bad_height_on_a_control_is_refused_and_releases_nothing(maker, tmp_path):
    pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")
    from opcua_controls import codes, control, door, on_a_desk, until

    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
            await until(lambda: at["released"] == 1.0)
            at["done"] = 1.0
            # What no variable holds, `missing`, is one that is no number there.
            heights = [
                (math.nan if h is None else h, code.replace("missing", "not-a-number")) for h, code in HEIGHTS.values()
            ]
            for height, code, measured in [*((*one, 1.0) for one in heights), (1.8, "counter-jump", 3.0)]:
                told.clear()
                at["height"], at["measured"] = height, measured
                await until(lambda code=code: code in codes(told))
                assert at["released"] == 1.0, height
                at["measured"] = 0.0
                await asyncio.sleep(0.3)
            at["height"], at["measured"] = 1.8, 1.0
            await until(lambda: at["released"] == 2.0)

    asyncio.run(play())

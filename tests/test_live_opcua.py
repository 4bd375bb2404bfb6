"""The door to a control by OPC UA, on loopback: whole builds with planted faults, and a control without a program."""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import stat

import numpy as np
import pytest
from live_boxes import made_again
from opcua_controls import built, codes, control, door, led, of_its_own_loop, on_a_desk, sound, until

from ebamcheck.controls.sinumerik.release_keys import key_below
from ebamcheck.errors import SettingsError
from ebamcheck.live.building import Building
from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.handshake import KEY_FILE
from ebamcheck.live.opcua.link import Link
from ebamcheck.live.publishing import read_journal
from ebamcheck.testing.played_control.program import FAULTS

SIZE = (30, 24, 5.2)


BUILDS = {
    "heights": (["missing@1", "absurd@1", "inches@1", "jump@1", "late@2", "repeated@2", "count@2", "stray@2"],
                {"not-a-number", "absurd", "unit", "counter-jump", "late", "two-servers"}),
    "connections": (["upload@2", "away@1", "sessions@2"], {"lost"}),
    "writes": (["refuse@1", "lost-writes@2", "other-file@3", "other-client@2"], {"rights", "write-lost", "other-file"}),
    "resets": (["reset@2", "reset-between@2"], {"counter-jump", "begins-again"}),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", ["heights", *(pytest.param(name, marks=pytest.mark.slow) for name in BUILDS if name != "heights")]
)
def test_a_build_goes_through_its_faults_and_lays_what_was_proved(name, maker, place, tmp_path):
    faults, wanted = BUILDS[name]
    answer, program, told = built(maker, tmp_path / "b", faults)
    sound(tmp_path / "b", place / "box.stl", program, answer)
    assert wanted <= {text.get("code", text["answer"]) for text in told}
    assert all(len(text.get("reason", "").splitlines()) <= 1 for text in told)
    if name == "resets":
        # What was done to the control stands in the journal, and changes no byte of what was made.
        assert made_again(maker, tmp_path / "b", tmp_path / "again")


def test_every_fault_is_in_a_build():
    assert {text.partition("@")[0] for faults, _ in BUILDS.values() for text in faults} == set(FAULTS)


# -- a control without a program ---------------------------------------------------------------------


@of_its_own_loop
async def test_nothing_is_released_before_a_program_waits(maker, tmp_path):
    async with led(maker, tmp_path / "b", waits=False) as (at, told):
        await until(lambda: "waiting" in codes(told))
        await asyncio.sleep(0.6)
        assert at["released"] == 0.0
        assert at.panel.files == {}
        task = asyncio.create_task(at.wait())
        await until(lambda: at["released"] == 1.0)
        task.cancel()
        current = json.loads((tmp_path / "b" / "current.json").read_text())
        name = f"{current['name']}_L0001.SPF"
        assert hashlib.sha256(at.panel.files[at.file(name)]).hexdigest() == current["sha256"]
        assert at["digest"] == int(current["sha256"][:12], 16)
        assert at["number"] == 1.0


@of_its_own_loop
async def test_texts_go_to_nodes_of_the_profile_and_a_map_stands_for_the_height(maker, tmp_path):
    nodes = {role: f"ns=2;s=/Plc/{role}" for role in ("name", "sha256", "map")}

    opcua = on_a_desk(nodes=nodes)
    async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
        await until(lambda: at["released"] == 1.0)
        current = json.loads((tmp_path / "b" / "current.json").read_text())
        assert at.panel.texts == {"name": current["name"], "sha256": current["sha256"]}
        top = current["thickness_mm"]
        x, y = np.meshgrid(np.arange(0.0, 31.0), np.arange(0.0, 25.0))
        rows = [f"{a},{b},{top + 0.01 * (a - 15.0)}" for a, b in zip(x.ravel(), y.ravel(), strict=True)]
        (tmp_path / "m.csv").write_text("\n".join(["x_mm,y_mm,height_mm", *rows]))
        await write_from_outside(maker, opcua, "map", str(tmp_path / "none.csv"))
        at["done"], at["measured"] = 1.0, 1.0
        await until(lambda: "map" in codes(told))
        assert at["released"] == 1.0
        await write_from_outside(maker, opcua, "map", str(tmp_path / "m.csv"))
        await until(lambda: at["released"] == 2.0)
        published = next(text for text in reversed(told) if text["answer"] == "published")
        assert published["height_map"]["slope_deg"] == pytest.approx(math.degrees(0.01), abs=0.02)
        assert published["base_mm"] == pytest.approx(top, abs=0.01)


async def write_from_outside(maker, opcua, role, text):
    """Another client, as who measures is one."""
    async with Link(maker.config.machine, opcua) as link:
        await link.write_all({role: text})


@of_its_own_loop
async def test_a_release_that_is_gone_waits_for_the_operator(maker, tmp_path):
    async with led(maker, tmp_path / "b") as (at, told):
        await until(lambda: at["released"] == 1.0)
        at["released"] = 0.0  # RESET in the first layer
        await until(lambda: "withdrawn" in codes(told))
        await asyncio.sleep(0.5)
        assert at["released"] == 0.0
        at["begin_at"] = 7.0
        await until(lambda: "begin-at" in codes(told))
        assert at["released"] == 0.0
        at["begin_at"] = 1.0
        await until(lambda: at["released"] == 1.0)
        assert at["begin_at"] == 0.0


@of_its_own_loop
async def test_a_door_that_comes_again_does_not_release_twice(maker, tmp_path):
    opcua = on_a_desk()
    async with control(maker, opcua) as at:
        async with door(maker, tmp_path / "b", opcua):
            await until(lambda: at["released"] == 1.0)
        at["released"] = 0.0
        async with door(maker, tmp_path / "b", opcua) as told:
            await until(lambda: "withdrawn" in codes(told))
            assert at["released"] == 0.0


@of_its_own_loop
async def test_a_count_of_the_height_that_is_one_behind_is_told_at_once(maker, tmp_path):
    async with led(maker, tmp_path / "b", late_s=1e5) as (at, told):
        await until(lambda: at["released"] == 1.0)
        at["done"], at["height"], at["measured"] = 1.0, 1.7, 1.0
        await until(lambda: at["released"] == 2.0)
        # The played control shows its values on a grid: the 0 of the release has to be on it before the same 1 comes again.
        await asyncio.sleep(0.4)
        at["done"], at["height"], at["measured"] = 2.0, 3.4, 1.0
        await until(lambda: "counter-jump" in codes(told))
        assert "said to be of layer 1, 2 layers are done" in told[-1]["reason"]


@of_its_own_loop
async def test_a_layer_that_is_kept_back_is_told_once_and_tried_less_and_less_often(maker, tmp_path, monkeypatch):
    tries = []

    opcua = on_a_desk(longest_retry_s=30.0)
    with monkeypatch.context() as patch:
        right = Building._made

        def kept(self, reading):
            tries.append(reading)
            return {
                "answer": "kept",
                "done": reading.done,
                "height_mm": reading.height_mm,
                "reason": "no",
            }, None

        patch.setattr(Building, "_made", kept)
        async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
            # After 0.1, 0.2, 0.4 and 0.8 s: looks come five times as often.
            await until(lambda: len(tries) >= 4)
            assert codes(told) == ["connected", "kept"]
            await asyncio.sleep(0.5)
            assert len(tries) <= 5
            # One that can release nothing leads nothing.
            assert at["owner"] == 0.0
            patch.setattr(Building, "_made", right)
            await until(lambda: at["released"] == 1.0)
    entries = [entry["kind"] for entry in read_journal(tmp_path / "b" / "journal.jsonl")]
    assert entries[:4] == ["begin", "height", "kept", "layer"]


@pytest.mark.slow
def test_a_file_of_another_build_is_not_written_over(maker, tmp_path):
    async def play(replaced):
        opcua = on_a_desk(replace=replaced)
        async with control(maker, opcua) as at:
            at.panel.files[at.file("MAIN_K0001R1_L0001.SPF")] = b"of another build"
            async with door(maker, tmp_path / f"{replaced}", opcua) as told:
                if replaced:
                    await until(lambda: at["released"] == 1.0)
                    return
                await until(lambda: "file-exists" in codes(told))
                assert at.panel.files == {at.file("MAIN_K0001R1_L0001.SPF"): b"of another build"}
                assert at["released"] == 0.0
                at.panel.files.clear()
                await until(lambda: at["released"] == 1.0)

    asyncio.run(play(False))
    asyncio.run(play(True))


@of_its_own_loop
async def test_a_layer_over_the_limit_of_the_control_is_not_sent(maker, tmp_path):
    opcua = on_a_desk(file_limit_mb=0.001)
    async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
        await until(lambda: "held" in codes(told))
        assert "opcua.file_limit_mb 0.001" in told[-1]["reason"]
        assert at.panel.files == {}


@of_its_own_loop
async def test_counts_that_are_none_release_nothing(maker, tmp_path):
    opcua = on_a_desk()
    async with control(maker, opcua) as at:
        at["done"] = -1.0
        async with door(maker, tmp_path / "b", opcua) as told:
            for value, code in (
                (-1.0, "counter"),
                (0.5, "counter"),
                (math.nan, "counter"),
                (1e300, "counter-jump"),
                (4.0, "counter-jump"),
            ):
                told.clear()
                at["done"] = value
                await until(lambda code=code: code in codes(told))
                assert at["released"] == 0.0
            assert at.panel.files == {}


@pytest.mark.slow
@of_its_own_loop
async def test_no_exception_ends_the_server(maker, tmp_path, monkeypatch):
    async with led(maker, tmp_path / "b") as (at, told):
        await until(lambda: at["released"] == 1.0)
        with monkeypatch.context() as patch:
            patch.setattr(Building, "height", lambda self, message: 1 // 0)
            at["done"], at["height"], at["measured"] = 1.0, 1.7, 1.0
            await until(lambda: "held" in codes(told))
            assert "ZeroDivisionError" in told[-1]["reason"]
            assert "\n" not in told[-1]["reason"]
        # The same height is taken when the fault is gone.
        await until(lambda: at["released"] == 2.0)


@of_its_own_loop
async def test_a_text_that_was_changed_on_disk_is_not_sent(maker, tmp_path):
    async with led(maker, tmp_path / "b", waits=False) as (at, told):
        await until(lambda: "waiting" in codes(told))
        current = json.loads((tmp_path / "b" / "current.json").read_text())
        path = tmp_path / "b" / current["program"]
        path.write_text(path.read_text().replace("M17", "M17 ; changed"))
        task = asyncio.create_task(at.wait())
        await until(lambda: "held" in codes(told))
        task.cancel()
        assert "is not the file that was verified" in told[-1]["reason"]
        assert at.panel.files == {}
        assert at["released"] == 0.0


@of_its_own_loop
async def test_a_node_that_is_not_there_is_a_matter_of_settings(maker, tmp_path):
    opcua = on_a_desk()
    wrong = opcua.model_copy(update={"nodes": {"height": "ns=2;s=/Nope"}})
    building = Building(maker, tmp_path / "b")
    try:
        async with control(maker, opcua):
            with pytest.raises(SettingsError, match=r"no node 'ns=2;s=/Nope' \(height\)"):
                await Door(building, maker.config.machine, wrong, lambda answer: None).run()
    finally:
        building.close()


@of_its_own_loop
async def test_a_build_that_can_release_nothing_does_not_take_the_control_over(maker, tmp_path):
    opcua = on_a_desk()
    async with control(maker, opcua) as at, door(maker, tmp_path / "a", opcua) as first:
        await until(lambda: at["released"] == 1.0)
        owner = at["owner"]
        async with door(maker, tmp_path / "b", opcua) as second:
            await until(lambda: "two-servers" in codes(second))
            assert "1 is released there, and not by this build" in second[-1]["reason"]
            at["done"] = 1.0
            await until(lambda: "1 layers are done there, 0 in this build" in second[-1].get("reason", ""))
            at["height"], at["measured"] = 1.7, 1.0
            await until(lambda: at["released"] == 2.0)
            assert at["owner"] == owner
            assert "two-servers" not in codes(first)


@pytest.mark.slow
@of_its_own_loop
async def test_of_two_builds_that_could_go_on_the_last_one_writes_and_the_other_says_so(maker, tmp_path):
    opcua = on_a_desk()
    async with control(maker, opcua, waits=False) as at, door(maker, tmp_path / "a", opcua) as first:
        await until(lambda: "waiting" in codes(first))
        async with door(maker, tmp_path / "b", opcua) as second:
            await until(lambda: "two-servers" in codes(first))
            task = asyncio.create_task(at.wait())
            await until(lambda: "released" in codes(second))
            assert "released" not in codes(first)
            task.cancel()


@pytest.mark.parametrize("when", ["while the layer is laid", "before its height has come"])
@of_its_own_loop
async def test_a_release_by_another_client_is_set_to_0_and_the_build_goes_on(when, maker, tmp_path):
    async with led(maker, tmp_path / "b", waits=False) as (at, told):
        task = asyncio.create_task(at.wait())
        await until(lambda: at["released"] == 1.0)
        task.cancel()
        first = (at["key"], at["seal"])
        if when == "before its height has come":
            at["done"] = 1.0
        at["released"] = 2.0
        await until(lambda: at["released"] == 0.0)
        await until(lambda: "two-servers" in codes(told))
        # Nobody can know the key of the layer that was written.
        assert (at["key"], at["seal"]) == first
        await asyncio.sleep(0.6)
        assert "withdrawn" not in codes(told)
        at["done"] = 1.0
        at["height"], at["measured"] = 1.7, 1.0
        task = asyncio.create_task(at.wait())
        await until(lambda: at["released"] == 2.0)
        task.cancel()
        assert key_below(int(at["key"]), 2) == first[0]


@of_its_own_loop
async def test_a_restarted_build_goes_on_with_its_keys_whatever_was_written_meanwhile(maker, tmp_path):
    opcua = on_a_desk()
    async with control(maker, opcua) as at:
        async with door(maker, tmp_path / "b", opcua):
            await until(lambda: at["released"] == 1.0)
        first, at["released"] = at["key"], 5.0
        assert stat.S_IMODE((tmp_path / "b" / KEY_FILE).stat().st_mode) == 0o600
        async with door(maker, tmp_path / "b", opcua):
            at["done"], at["height"], at["measured"] = 1.0, 1.7, 1.0
            await until(lambda: at["released"] == 2.0)
        assert key_below(int(at["key"]), 2) == first

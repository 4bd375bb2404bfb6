"""Who may release a layer on a control: the build that leads it, by keys that nobody else has."""

from __future__ import annotations

import asyncio
import stat

import pytest
from live_boxes import maker_of, run_of_box
from opcua_controls import codes, control, door, on_a_desk, until

from ebamcheck.controls.sinumerik.release_keys import key_below
from ebamcheck.live.opcua.handshake import KEY_FILE
from ebamcheck.live.opcua.link import installed


@pytest.fixture(scope="module", autouse=True)
def quiet():
    installed()


@pytest.fixture(scope="module")
def maker(tmp_path_factory):
    """Maker of the layers of a box of three."""
    with maker_of(run_of_box(tmp_path_factory, (30, 24, 5.2))) as made:
        yield made


def test_a_build_that_can_release_nothing_does_not_take_the_control_over(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua) as at, door(maker, tmp_path / "a", opcua) as first:
            await until(lambda: at["released"] == 1.0)
            owner = at["owner"]
            async with door(maker, tmp_path / "b", opcua) as second:
                await until(lambda: "two-servers" in codes(second))
                assert "1 is released there, and not by this build" in second[-1]["reason"]
                at["done"] = 1.0
                await until(
                    lambda: "1 layers are done there, 0 in this build" in second[-1].get("reason", "")
                )
                at["height"], at["measured"] = 1.7, 1.0
                await until(lambda: at["released"] == 2.0)
                assert at["owner"] == owner
                assert "two-servers" not in codes(first)

    asyncio.run(play())


@pytest.mark.slow
def test_of_two_builds_that_could_go_on_the_last_one_writes_and_the_other_says_so(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua, waits=False) as at, door(maker, tmp_path / "a", opcua) as first:
            await until(lambda: "waiting" in codes(first))
            async with door(maker, tmp_path / "b", opcua) as second:
                await until(lambda: "two-servers" in codes(first))
                task = asyncio.create_task(at.wait())
                await until(lambda: "released" in codes(second))
                assert "released" not in codes(first)
                task.cancel()

    asyncio.run(play())


@pytest.mark.parametrize("when", ["while the layer is laid", "before its height has come"])
def test_a_release_by_another_client_is_set_to_0_and_the_build_goes_on(when, maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua, waits=False) as at, door(maker, tmp_path / "b", opcua) as told:
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

    asyncio.run(play())


def test_a_restarted_build_goes_on_with_its_keys_whatever_was_written_meanwhile(maker, tmp_path):
    async def play():
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

    asyncio.run(play())

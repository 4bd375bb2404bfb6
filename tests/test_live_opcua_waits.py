"""Who waits for a control ends when told to, at whatever moment, and though the control answers no more."""

from __future__ import annotations

import asyncio
import contextlib
from contextlib import asynccontextmanager
from urllib.parse import urlsplit

import pytest

pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")

from opcua_controls import control, free_url, of_its_own_loop, on_a_desk, until

from ebamcheck.live.building import Building
from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.link import BrokenOff, within
from ebamcheck.testing.played_control.program import Panel
from ebamcheck.testing.played_control.server import PlayedServer

SIZE = (30, 24, 5.2)
# Turns of the event loop over which a cancellation is tried against an end that comes in the middle of them
STEPS = 8


async def turns(count):
    for _ in range(count):
        await asyncio.sleep(0)


@pytest.mark.parametrize("after", range(STEPS))
@of_its_own_loop
async def test_a_cancellation_is_never_lost_though_the_wait_ends_with_it(after):
    event, went_on = asyncio.Event(), []

    async def waits():
        await within(event.wait(), 5.0)
        went_on.append(True)
        # Whoever goes on comes to another wait, and is there when it is cancelled, or was told while it waited.
        await asyncio.sleep(5.0)

    task = asyncio.create_task(waits())
    await turns(4)
    asyncio.get_running_loop().call_soon(event.set)
    await turns(after)
    task.cancel()
    done, _ = await asyncio.wait([task], timeout=2.0)
    assert done == {task}
    assert task.cancelled()


@of_its_own_loop
async def test_a_wait_ends_in_time_and_tells_what_was_cancelled_from_within():
    with pytest.raises(TimeoutError):
        await within(asyncio.sleep(5.0), 0.05)
    broken = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_soon(broken.cancel)
    with pytest.raises(BrokenOff):
        await within(broken, 5.0)
    assert await within(asyncio.sleep(0.0, "here"), 5.0) == "here"
    with pytest.raises(ZeroDivisionError):
        await within(_fails(), 5.0)


async def _fails():
    return 1 // 0


class Line:
    """A line between a server and whoever connects: what it has taken up to a moment it passes on, and nothing after."""

    def __init__(self, url):
        self.to, self.mute = urlsplit(url), False
        self.tasks, self.writers = [], []

    @asynccontextmanager
    async def at(self, url):
        place = urlsplit(url)
        server = await asyncio.start_server(self._both, place.hostname, place.port)
        try:
            yield self
        finally:
            server.close()
            for task in self.tasks:
                task.cancel()
            for writer in self.writers:
                writer.close()
            await asyncio.gather(*self.tasks, return_exceptions=True)
            for writer in self.writers:
                with contextlib.suppress(OSError):
                    await writer.wait_closed()

    async def _both(self, reader, writer):
        far_reader, far_writer = await asyncio.open_connection(self.to.hostname, self.to.port)
        self.writers += [writer, far_writer]
        self.tasks += [
            asyncio.create_task(self._pass(reader, far_writer)),
            asyncio.create_task(self._pass(far_reader, writer)),
        ]

    async def _pass(self, reader, writer):
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                if not self.mute:
                    writer.write(data)


@pytest.mark.parametrize("after_s", [0.3, *(pytest.param(s, marks=pytest.mark.slow) for s in (1.9, 2.4))])
@of_its_own_loop
async def test_a_door_that_is_cancelled_once_ends_though_its_control_is_mute(maker, tmp_path, after_s):
    opcua = on_a_desk(request_s=0.5)
    line_url = free_url()
    told, building = [], Building(maker, tmp_path / "b")
    door = Door(building, maker.config.machine, opcua.model_copy(update={"url": line_url}), told.append)
    try:
        async with control(maker, opcua) as at, Line(opcua.url).at(line_url) as line:
            task = asyncio.create_task(door.run())
            await until(lambda: at["released"] == 1.0)
            line.mute = True
            await asyncio.sleep(after_s)
            task.cancel()
            await asyncio.wait([task], timeout=5.0)
            assert task.cancelled()
    finally:
        building.close()


@of_its_own_loop
async def test_a_played_control_ends_while_it_is_away(maker):
    """It goes away because an upload asks for it; the library loses a cancellation while it takes itself down."""

    server = PlayedServer(Panel(), maker.config.machine, on_a_desk(), None)
    serving = server.serving()
    await serving.__aenter__()
    cleaning = server._server.bserver.cleanup_task
    server.broke.set()
    while not cleaning.cancelling():
        await asyncio.sleep(0)
    # It waits for its own cleaning to end, and takes what comes now for that.
    ending = asyncio.create_task(serving.__aexit__(None, None, None))
    await asyncio.wait([ending], timeout=10.0)
    assert ending.done()
    ending.result()

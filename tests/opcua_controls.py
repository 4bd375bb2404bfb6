"""Controls that tests play behind an OPC UA server on loopback, and builds that go through them."""

from __future__ import annotations

import asyncio
import functools
import socket
from contextlib import asynccontextmanager

import numpy as np
import pytest
from live_boxes import failed_checks

from ebamcheck.live.building import Building
from ebamcheck.live.publishing import LAYERS, read_journal
from ebamcheck.settings.machine import OpcuaSettings
from ebamcheck.testing.played_control.program import Growth, Panel, PlayedProgram

pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")

from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.handshake import OFFSETS, file_path
from ebamcheck.live.opcua.link import installed
from ebamcheck.testing.played_control.server import PlayedServer, faults_of, played

installed()  # and asyncua is quiet

LONGEST_S = 90.0  # Time after which a build that does not end is taken for one that never does


def of_its_own_loop(test):
    """Let pytest run a test that is a coroutine."""

    @functools.wraps(test)
    def run(*given, **named):
        asyncio.run(test(*given, **named))

    return run


def free_url():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"opc.tcp://127.0.0.1:{found.getsockname()[1]}"


def on_a_desk(**changes):
    quick = {"look_s": 0.2, "retry_s": 0.1, "longest_retry_s": 0.4, "request_s": 2.0}
    return OpcuaSettings(**{"url": free_url(), "security": "none", "anonymous": True, **quick, **changes})


def built(maker, folder, faults=(), **changes):
    """Build the box on a played control; what was told, and what the control laid."""
    opcua, told = on_a_desk(late_s=0.4, **changes), []

    async def both():
        building = Building(maker, folder)
        try:
            door = Door(building, maker.config.machine, opcua, told.append)
            planted = faults_of(list(faults))
            program = PlayedProgram(maker.config, opcua, maker.height_mm, Growth(0.05), 2000.0, planted)
            side = asyncio.create_task(played(program, None))
            answer = await asyncio.wait_for(door.run(), LONGEST_S)
            await side
            return answer, program
        finally:
            building.close()

    return (*asyncio.run(both()), told)


def sound(folder, part, program, answer):
    """Every law of a build that went through: what was called was validated, and what was measured is true."""
    assert program.ended
    assert answer["answer"] == "built"
    entries = list(read_journal(folder / "journal.jsonl"))
    released = [entry for entry in entries if entry["kind"] == "released"]
    published = {entry["name"]: entry["files"] for entry in entries if entry["kind"] == "layer"}
    for row in program.laid:
        assert row.sha256 in published[row.name.removesuffix("_L0001")].values()
        assert row.sha256 in {entry["sha256"] for entry in released}
    assert [row.layer for row in program.laid] == list(range(1, len(published) + 1))
    tops = np.cumsum([row.grown_mm for row in program.laid])
    measured = [entry["height_mm"] for entry in entries if entry["kind"] == "height"]
    taken = [h for h in measured if h != 0.0]
    assert np.allclose(taken, tops, atol=1e-9)
    for name in published:
        assert failed_checks(folder / LAYERS / name, part) == []


class Control:
    """A panel behind a server, on which a test plays the program itself."""

    def __init__(self, config, opcua):
        self.panel, self.config, self.opcua = Panel(), config, opcua
        self._waiting = None

    def __getitem__(self, role):
        return self.panel.get(self.config.machine.live_r + OFFSETS[role])

    def __setitem__(self, role, value):
        self.panel.set(self.config.machine.live_r + OFFSETS[role], value)

    async def wait(self):
        """Be a program that waits: it counts the time."""
        while True:
            self["waited"] = self["waited"] + 0.5
            await asyncio.sleep(0.1)

    def file(self, name):
        return file_path(self.config.machine, self.opcua, name)


@asynccontextmanager
async def control(maker, opcua, waits=True, access=None):
    made = Control(maker.config, opcua)
    async with PlayedServer(made.panel, maker.config.machine, opcua, access).serving():
        task = asyncio.create_task(made.wait()) if waits else None
        try:
            yield made
        finally:
            if task:
                task.cancel()


@asynccontextmanager
async def door(maker, folder, opcua):
    told, building = [], Building(maker, folder)
    task = asyncio.create_task(Door(building, maker.config.machine, opcua, told.append).run())
    try:
        yield told
    finally:
        task.cancel()
        await asyncio.wait([task], timeout=LONGEST_S)
        building.close()
        assert task.done()


@asynccontextmanager
async def led(maker, folder, waits=True, **settings):
    """A control that a build leads, and what the build's door tells."""
    opcua = on_a_desk(**settings)
    async with control(maker, opcua, waits) as at, door(maker, folder, opcua) as told:
        yield at, told


async def until(condition, limit_s=20.0):
    for _ in range(int(limit_s / 0.05)):
        if condition():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("it does not come to it")


def codes(told):
    return [text.get("code", text["answer"]) for text in told]

"""The door to a control by OPC UA, on loopback: whole builds with planted faults, and a control without a program."""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import os
import re
import shutil
import socket
import subprocess
import sys
from contextlib import asynccontextmanager

import numpy as np
import pytest
from command_line import FAST, ebamcheck, write_stl
from parts import box

from ebamcheck.errors import SettingsError
from ebamcheck.live.bed import Growth
from ebamcheck.live.building import Building
from ebamcheck.live.journal import read_journal
from ebamcheck.live.loading import finished_run
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.publishing import LAYERS
from ebamcheck.pipeline.verify import verify
from ebamcheck.program.controls.sinumerik.handshake import run_text
from ebamcheck.program.controls.sinumerik.waiting import waiting_program
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.opcua import OpcuaSettings
from ebamcheck.showing.plotting import ExtraMissing

pytest.importorskip("asyncua", reason="needs the extra opcua: pip install 'ebamcheck[opcua]'")

from ebamcheck.live.opcua.desk import desk_profile, faults_of, played
from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.handshake import OFFSETS, file_path, node_ids
from ebamcheck.live.opcua.link import Link, LinkLost, LoginRefused, checked, installed
from ebamcheck.live.opcua.panel import FAULTS, Panel
from ebamcheck.live.opcua.playing import planned_s, top_of
from ebamcheck.live.opcua.server import PlayedServer

SIZE = (30, 24, 5.2)

LONGEST_S = 90.0
"""Time after which a build that does not end is taken for one that never does."""


@pytest.fixture(scope="module", autouse=True)
def quiet():
    installed()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box of three layers."""
    folder = tmp_path_factory.mktemp("opcua")
    write_stl(box(upper=SIZE), folder / "box.stl")
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def maker(place):
    found = finished_run(place / "box.run")
    with LayerMaker(found.part, found.config, found.primary) as made:
        yield made


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
            side = asyncio.create_task(
                played(
                    maker.config,
                    opcua,
                    None,
                    maker.height_mm,
                    Growth(0.05),
                    2000.0,
                    faults_of(list(faults)),
                    lambda row: None,
                )
            )
            answer = await asyncio.wait_for(door.run(), LONGEST_S)
            program, ended = await side
            return answer, program, ended
        finally:
            building.close()

    return (*asyncio.run(both()), told)


def sound(folder, part, program, answer, ended):
    """Every law of a build that went through: what was called was validated, and what was measured is true."""
    assert ended
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
        checks = verify(
            folder / LAYERS / name / "program", part, load_config(folder / LAYERS / name / "settings.toml")
        )
        assert len(checks) > 50
        assert [check for check in checks if not check.passed] == []


BUILDS = {
    "heights": (["missing@1", "absurd@1", "inches@1", "jump@1", "late@2", "repeated@2", "count@2"],
                {"missing", "absurd", "unit", "counter-jump", "late"}),
    "connections": (["upload@2", "away@1", "sessions@2"], {"lost"}),
    "writes": (["refuse@1", "lost-writes@2", "other-file@3", "other-client@2"], {"rights", "write-lost", "other-file"}),
    "resets": (["reset@2", "reset-between@2"], {"counter-jump", "begins-again"}),
}  # fmt: skip


@pytest.mark.parametrize("name", BUILDS)
def test_a_build_goes_through_its_faults_and_lays_what_was_proved(name, maker, place, tmp_path):
    faults, wanted = BUILDS[name]
    answer, program, ended, told = built(maker, tmp_path / "b", faults)
    sound(tmp_path / "b", place / "box.stl", program, answer, ended)
    assert wanted <= {text.get("code", text["answer"]) for text in told}
    assert all(len(text.get("reason", "").splitlines()) <= 1 for text in told)
    if name == "resets":
        # What was done to the control stands in the journal, and changes no byte of what was made.
        shutil.copytree(tmp_path / "b", tmp_path / "again")
        (tmp_path / "again" / "current.json").unlink()
        shutil.rmtree(tmp_path / "again" / LAYERS)
        Building(maker, tmp_path / "again").close()
        for path in (tmp_path / "b" / LAYERS).rglob("*"):
            if path.is_file():
                assert (
                    tmp_path / "again" / LAYERS / path.relative_to(tmp_path / "b" / LAYERS)
                ).read_bytes() == path.read_bytes()


def test_every_fault_is_in_a_build():
    assert {text.partition("@")[0] for faults, _ in BUILDS.values() for text in faults} == set(FAULTS)


# -- a control without a program ---------------------------------------------------------------------


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
        await asyncio.gather(task, return_exceptions=True)
        building.close()


async def until(condition, limit_s=20.0):
    for _ in range(int(limit_s / 0.05)):
        if condition():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("it does not come to it")


def codes(told):
    return [text.get("code", text["answer"]) for text in told]


def test_nothing_is_released_before_a_program_waits(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua, waits=False) as at, door(maker, tmp_path / "b", opcua) as told:
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

    asyncio.run(play())


def test_texts_go_to_nodes_of_the_profile_and_a_map_stands_for_the_height(maker, tmp_path):
    nodes = {role: f"ns=2;s=/Plc/{role}" for role in ("name", "sha256", "map")}

    async def play():
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

    asyncio.run(play())


async def write_from_outside(maker, opcua, role, text):
    """Another client, as who measures is one."""
    async with Link(maker.config.machine, opcua) as link:
        await link.write_text(role, text)


def test_a_release_that_is_gone_waits_for_the_operator(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
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

    asyncio.run(play())


def test_a_door_that_comes_again_does_not_release_twice(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua) as at:
            async with door(maker, tmp_path / "b", opcua):
                await until(lambda: at["released"] == 1.0)
            at["released"] = 0.0
            async with door(maker, tmp_path / "b", opcua) as told:
                await until(lambda: "withdrawn" in codes(told))
                assert at["released"] == 0.0

    asyncio.run(play())


def test_of_two_servers_the_last_one_writes_and_the_other_says_so(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua) as at, door(maker, tmp_path / "a", opcua) as first:
            await until(lambda: at["released"] == 1.0)
            async with door(maker, tmp_path / "b", opcua) as second:
                await until(lambda: "two-servers" in codes(first))
                # A release that it did not make is taken back, and then it makes its own: the file is the same.
                await until(lambda: "two-servers" in codes(second))
                await until(lambda: "released" in codes(second))
                owner = at["owner"]
                await asyncio.sleep(0.5)
                assert at["owner"] == owner

    asyncio.run(play())


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


def test_a_layer_over_the_limit_of_the_control_is_not_sent(maker, tmp_path):
    async def play():
        opcua = on_a_desk(file_limit_mb=0.001)
        async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
            await until(lambda: "held" in codes(told))
            assert "opcua.file_limit_mb 0.001" in told[-1]["reason"]
            assert at.panel.files == {}

    asyncio.run(play())


def test_counts_that_are_none_release_nothing(maker, tmp_path):
    async def play():
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

    asyncio.run(play())


def test_no_exception_ends_the_server(maker, tmp_path, monkeypatch):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua) as at, door(maker, tmp_path / "b", opcua) as told:
            await until(lambda: at["released"] == 1.0)
            with monkeypatch.context() as patch:
                patch.setattr(Building, "height", lambda self, message: 1 // 0)
                at["done"], at["height"], at["measured"] = 1.0, 1.7, 1.0
                await until(lambda: "held" in codes(told))
                assert "ZeroDivisionError" in told[-1]["reason"]
                assert "\n" not in told[-1]["reason"]
            # The same height is taken when the fault is gone.
            await until(lambda: at["released"] == 2.0)

    asyncio.run(play())


def test_a_text_that_was_changed_on_disk_is_not_sent(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        async with control(maker, opcua, waits=False) as at, door(maker, tmp_path / "b", opcua) as told:
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

    asyncio.run(play())


def test_a_node_that_is_not_there_is_a_matter_of_settings(maker, tmp_path):
    async def play():
        opcua = on_a_desk()
        wrong = opcua.model_copy(update={"nodes": {"height": "ns=2;s=/Nope"}})
        building = Building(maker, tmp_path / "b")
        try:
            async with control(maker, opcua):
                with pytest.raises(SettingsError, match=r"no node 'ns=2;s=/Nope' \(height\)"):
                    await Door(building, maker.config.machine, wrong, lambda answer: None).run()
        finally:
            building.close()

    asyncio.run(play())


# -- security ----------------------------------------------------------------------------------------


def test_nobody_writes_without_certificate_and_user(maker, tmp_path):
    opcua = on_a_desk()
    access = desk_profile(tmp_path / "desk", opcua)
    ours = load_config(tmp_path / "desk" / "opcua.toml").opcua
    checked(ours)
    other = desk_profile(tmp_path / "other", opcua)
    strange = ours.model_copy(
        update={
            "certificate": str(other.client_certificate),
            "private_key": str(tmp_path / "other" / "client-key.pem"),
        }
    )
    wrong = tmp_path / "wrong"
    wrong.write_text("guess")
    wrong.chmod(0o600)

    async def play():
        async with control(maker, opcua, access=access) as at:
            async with Link(maker.config.machine, ours) as link:
                await link.write("wait", 3.0)
            assert at["wait"] == 3.0
            not_it = ours.model_copy(update={"server_certificate": str(other.certificate)})
            for bad in (ours.model_copy(update={"password_file": str(wrong)}), strange, not_it, opcua):
                with pytest.raises((LoginRefused, LinkLost)):
                    async with Link(maker.config.machine, bad) as link:
                        await link.write("wait", 4.0)
            assert at["wait"] == 3.0

    asyncio.run(play())
    assert (tmp_path / "desk" / "password").stat().st_mode & 0o077 == 0
    assert (tmp_path / "desk" / "client-key.pem").stat().st_mode & 0o077 == 0
    (tmp_path / "desk" / "password").chmod(0o644)
    with pytest.raises(SettingsError, match="others may read it"):
        checked(ours)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "opcua.certificate is missing"),
        ({"security": "none"}, "no password goes over an open channel"),
        ({"certificate": "a", "private_key": "b", "server_certificate": "c"}, "opcua.user is missing"),
        ({"certificate": "/nowhere", "private_key": "b", "server_certificate": "c", "user": "u"}, "opcua.certificate '/nowhere': cannot be read"),
        ({"certificate": __file__, "private_key": "b", "server_certificate": "c", "user": "u"}, "is no certificate in PEM or DER"),
    ],
)  # fmt: skip
def test_what_is_missing_for_a_safe_connection_is_told_before_anything_begins(changes, said):
    with pytest.raises(SettingsError, match=said):
        checked(OpcuaSettings(**changes))


@pytest.mark.parametrize("url", ["http://a", "opc.tcp://", "opc.tcp://user:secret@host:4840"])
def test_addresses_that_are_none_or_hold_a_password_are_refused(url):
    with pytest.raises(SettingsError, match=r"opcua\.url"):
        Config().changed(opcua={"url": url})


# -- commands ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_commands_build_the_part_on_a_desk_though_one_is_killed(place, tmp_path):
    url = free_url()
    machine = subprocess.Popen(
        [sys.executable, "-m", "ebamcheck", "machine", str(place / "box.run"), "--opcua", "--url", url,
         "--drift", "0.1", "--speed", "2000", "-o", str(tmp_path / "desk"), "--fault", "away@2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ,
    )  # fmt: skip
    arguments = [
        "live", str(place / "box.run"), "--opcua", "-c", str(tmp_path / "desk" / "opcua.toml"), "-o", str(tmp_path / "b"),
    ]  # fmt: skip
    try:
        for line in machine.stdout:
            if line.startswith("layer"):
                break
        first = subprocess.Popen(
            [sys.executable, "-m", "ebamcheck", *arguments], stdout=subprocess.PIPE, text=True, env=os.environ
        )
        for line in first.stdout:
            if json.loads(line)["answer"] == "released":
                break
        first.kill()
        first.communicate()
        done = ebamcheck(*arguments, cwd=tmp_path)
        out, err = machine.communicate(timeout=LONGEST_S)
    finally:
        machine.kill()
        machine.wait()
    assert done.returncode == 0, done.stderr
    assert machine.returncode == 0, err
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert answers[-1]["answer"] == "built"
    assert "the top came out" in out
    assert err == ""
    entries = list(read_journal(tmp_path / "b" / "journal.jsonl"))
    released = [entry["sha256"] for entry in entries if entry["kind"] == "released"]
    rows = (tmp_path / "desk" / "machine.csv").read_text().splitlines()
    column = rows[0].split(",").index("sha256")
    assert [row.split(",")[column] for row in rows[1:]] == released


def test_an_address_in_use_is_told_in_one_line(place, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        url = f"opc.tcp://127.0.0.1:{taken.getsockname()[1]}"
        done = ebamcheck("machine", place / "box.run", "--opcua", "--url", url, "-o", "desk", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "cannot listen there" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("live", "--url", "opc.tcp://a"), "belong to --opcua"),
        (("live", "--opcua"), "opcua.certificate is missing"),
        (("machine", "--fault", "away@1"), "belong to --opcua"),
        (("machine", "--opcua", "--fault", "away"), "give NAME@LAYER"),
        (("machine", "--opcua", "--faults"), "give --fault NAME@LAYER"),
    ],
)
def test_options_that_do_not_go_together_are_told_in_one_line(arguments, said, place, tmp_path):
    name, *more = arguments
    done = ebamcheck(name, place / "box.run", *more, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert done.stderr.count("\n") == 1


def test_without_asyncua_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "asyncua", None)
    with pytest.raises(ExtraMissing, match=r"ebamcheck\[opcua\]"):
        installed()


# -- the text ----------------------------------------------------------------------------------------


def test_the_main_program_goes_on_at_the_layer_that_the_server_says():
    config = Config().changed(machine={"live_timeout_s": 60.0})

    def door(run):
        # After a RESET the program counts from 0: the server sets its count, and then releases.
        if run.time_s > 2.0 and run.values.get("R100") == 0.0:
            run.values |= {"R100": 5.0, "R102": 2.0, "R101": 6.0}
        elif run.calls:
            run.values["R101"] = -1.0

    run = run_text(waiting_program(config, 12.0)[1], door, config)
    assert [name for name, _ in run.calls] == ["MAIN_K0006R2_L0001"]
    assert run.stops[-1][0] == "M30"
    assert not run.faults


def test_nodes_are_those_of_the_profile():
    machine = replace_section(Config().machine, live_r=200)
    nodes = node_ids(machine, OpcuaSettings(nodes={"height": "ns=3;i=5"}))
    assert nodes["done"] == "ns=2;s=/Channel/Parameter/R[u1,200]"
    assert nodes["measured"] == "ns=2;s=/Channel/Parameter/R[u1,207]"
    assert nodes["height"] == "ns=3;i=5"
    with pytest.raises(SettingsError, match="'top' is none of done"):
        Config().changed(opcua={"nodes": {"top": "ns=3;i=5"}})


def replace_section(section, **changes):
    return section.model_copy(update=changes)


def test_the_played_control_reads_top_and_time_from_the_text_alone(maker, place):
    text = next((place / "box.run" / "program").glob("*_L0001.SPF")).read_text()
    assert top_of(text) == pytest.approx(finished_run(place / "box.run").tops_mm[0], abs=1e-6)
    table = (place / "box.run" / "process.csv").read_text().splitlines()
    row = dict(zip(table[0].split(","), table[1].split(","), strict=True))
    waits_s = sum(float(found) for found in re.findall(r" G4 F([\d.]+)", text))
    driven_s = float(row["deposit_s"]) + float(row["travel_s"])
    # Rapid moves up and down are left out.
    assert float(row["deposit_s"]) <= planned_s(text, 100.0) - waits_s <= driven_s

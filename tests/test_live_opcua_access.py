"""The door to a control by OPC UA: who may write, what its commands refuse, and the text that waits at its side."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys

import pytest
from command_line import ebamcheck
from live_boxes import puts
from opcua_controls import LONGEST_S, control, free_url, on_a_desk

from ebamcheck.controls.sinumerik.handshake import run_text
from ebamcheck.controls.sinumerik.release_keys import ReleaseKeys
from ebamcheck.controls.sinumerik.waiting import waiting_program
from ebamcheck.errors import SettingsError
from ebamcheck.live.opcua.handshake import node_ids
from ebamcheck.live.opcua.link import Link, LinkLost, LoginRefused, checked, installed
from ebamcheck.live.publishing import read_journal
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.machine import OpcuaSettings
from ebamcheck.showing.plotting import ExtraMissing
from ebamcheck.testing.played_control.server import desk_profile

SIZE = (30, 24, 5.2)


@pytest.mark.slow
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
            # Another server is known before anything is said to it, and at once: it is a matter of settings.
            with pytest.raises(LoginRefused, match=r"shows another certificate than opcua\.server_certificate"):
                async with Link(maker.config.machine, not_it):
                    pass
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


@pytest.mark.parametrize(
    "url",
    [
        "http://a",
        "opc.tcp://",
        "opc.tcp://user:secret@host:4840",
        "opc.tcp://host",
        "opc.tcp://host:0",
        "opc.tcp://host:70000",
    ],
)
def test_addresses_that_are_none_or_hold_a_password_are_refused(url):
    with pytest.raises(SettingsError, match=r"opcua\.url"):
        Config().changed(opcua={"url": url})


def test_certificate_key_and_uri_have_to_be_of_one_another(tmp_path):
    desk_profile(tmp_path / "a", OpcuaSettings())
    desk_profile(tmp_path / "b", OpcuaSettings())
    ours = load_config(tmp_path / "a" / "opcua.toml").opcua
    checked(ours)
    for changes, said in (
        ({"private_key": str(tmp_path / "b" / "client-key.pem")}, "is not the key of opcua.certificate"),
        ({"application_uri": "urn:other"}, "is for urn:ebamcheck:live, opcua.application_uri is 'urn:other'"),
    ):
        with pytest.raises(SettingsError, match=said) as told:
            checked(ours.model_copy(update=changes))
        assert "\n" not in str(told.value)


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
        (("machine", "--url", "opc.tcp://a"), "belongs to --opcua"),
        (("machine", "--opcua", "--fault", "away"), "give NAME@LAYER"),
        (("machine", "--fault", "away@0"), "give NAME@LAYER"),
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
    config, keys = Config().changed(machine={"live_timeout_s": 60.0}), ReleaseKeys(1_000_003)

    def door(run):
        # After a RESET the program counts from 0: the server sets its count, and then releases.
        if run.time_s > 2.0 and run.values.get("R100") == 0.0:
            run.values["R100"] = 5.0
            puts(run, keys.release(6, 2, 0.0))
        elif run.calls:
            puts(run, keys.built(6))

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

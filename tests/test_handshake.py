"""The main program that waits between layers: what it does with doors that answer, are silent, late or wrong, and planted faults."""

from __future__ import annotations

import json

import pytest
from command_line import FAST, ebamcheck, started, write_stl
from parts import box

from ebamcheck.errors import SettingsError
from ebamcheck.live.publishing import layer_name
from ebamcheck.pipeline.live_program import check_waits
from ebamcheck.program.controls.sinumerik.handshake import Expression, Run, handshake_check, run_text
from ebamcheck.program.controls.sinumerik.waiting import waiting_program
from ebamcheck.settings.config import Config

CONFIG = Config().changed(machine={"live_timeout_s": 60.0})


def text_of(config=CONFIG):
    return waiting_program(config, 12.0)[1]


def judged(text, config=CONFIG):
    return handshake_check(text, "MAIN_LIVE.MPF", config, 12.0)


@pytest.mark.parametrize("late", ["stop", "end"])
@pytest.mark.parametrize(("first", "poll_s"), [(0, 0.5), (100, 7.0), (900, 0.9)])
def test_what_is_written_does_what_it_should(late, first, poll_s):
    machine = {"live_late": late, "live_r": first, "live_poll_s": poll_s, "live_timeout_s": 60.0}
    config = Config().changed(machine=machine)
    check = judged(text_of(config), config)
    assert check.passed, check.text


def test_it_calls_the_names_that_layers_are_published_under():
    released = []

    def door(run):
        layer = int(run.values.get("R100", 0)) + 1
        run.values |= {"R102": 3.0, "R101": float(layer if layer <= 12 else -1)}
        released.append(layer)

    run = run_text(text_of(), door, CONFIG)
    assert [name for name, _ in run.calls] == [f"{layer_name('MAIN', k, 3)}_L0001" for k in range(12)]
    assert run.stops[-1][0] == "M30"
    assert not run.faults


def test_it_waits_at_least_as_long_as_the_server_says():
    def door(run):
        layer = int(run.values.get("R100", 0)) + 1
        run.values |= {"R102": 1.0, "R103": 42.0, "R101": float(layer if layer <= 3 else -1)}

    times = [at_s for _, at_s in run_text(text_of(), door, CONFIG).calls]
    assert all(b - a >= 42.0 for a, b in zip([0.0, *times], times, strict=False))


FAULTS = {
    "no STOPRE before the parameter is read": ("LIVE_WAIT: STOPRE", "LIVE_WAIT: R104=R104"),
    "any release will do": ("IF R101==R100+1 GOTOF", "IF R101>=1 GOTOF"),
    "calls without being asked": ("IF R101==R100+1 GOTOF LIVE_CALL", "IF R101==0 GOTOF LIVE_CALL"),
    "waits for ever": ("IF R104>=60 GOTOF LIVE_LATE", "IF R104>=600000 GOTOF LIVE_LATE"),
    "gives up too soon": ("IF R104>=60 GOTOF LIVE_LATE", "IF R104>=6 GOTOF LIVE_LATE"),
    "wire stays on when it gives up": ("LIVE_LATE: M63 ; wire off", "LIVE_LATE: R105=0"),
    "does not wait for the part to cool": ("G4 F=R105", "R105=0"),
    "another name": ('<<"_L0001"', '<<"_L0002"'),
    "does not count": ("R100=R100+1", "R100=R100"),
    "believes what was left of the build before": ("N170 R101=0", "N170 R105=0"),
    "never ends": ("IF R101==-1 GOTOF LIVE_END", "IF R101==-9 GOTOF LIVE_END"),
    "no message": ('MSG("LIVE: NO LAYER RELEASED WITHIN 60 S")', "MSG()"),
    "ends where it should stop": ("M0\n", "M30\n"),
    "a block that nobody knows": ("GOTOB LIVE_NEXT", "GOTOC LIVE_NEXT"),
    "a jump the other way": ("GOTOB LIVE_WAIT", "GOTOF LIVE_WAIT"),
    "the beam stands while it waits": ("LIVE_NEXT: R104=0", "LIVE_NEXT: R104=0\nN201 M60"),
    "the wire runs before a layer": ("N330 LIVE_N", "N321 M62\nN330 LIVE_N"),
    "the tool dives before a layer": ("N330 LIVE_N", "N321 G0 X0 Y0 Z-50\nN330 LIVE_N"),
    "the tool moves after a layer": ("N380 R100", "N371 G0 Z500\nN380 R100"),
    "another work offset": ("N80 G54", "N80 G55"),
    "a work offset that changes": ("N330 LIVE_N", "N321 G55\nN330 LIVE_N"),
    "no modes": ("N40 G17 G710 G90 G94\n", ""),
    "a frame of before": ("N70 TRANS\n", ""),
    "no smoothing": ("N100 SOFT FFWON G642\n", ""),
    "a wide tolerance": ("CTOL=0.05", "CTOL=5"),
    "no tolerance": ("N110 CTOL=0.05\n", ""),
    "the beam of before": ("N130 M61 ; beam off\n", ""),
    "ends under the part's top": ("G0 Z32.0", "G0 Z3.0"),
    "rises at feed": ("G0 Z32.0", "G1 F600 Z32.0"),
    "parks without a rise": ("N520 G0 Z32.000000\n", ""),
    "parks elsewhere": ("G0 X0.000000", "G0 X500.000000"),
    "the current stays": ("H2=0 ; beam", "H2=100 ; beam"),
    "ends before its end": ("N470 M63", "N461 M2\nN470 M63"),
    "a voltage that nobody asked for": ("H1=60 ", "H1=600 "),
    "a name that is cut off": ("STRING[32] LIVE_NAME", "STRING[10] LIVE_NAME"),
    "counts a layer before it is laid": (
        "CALL LIVE_NAME\nN380 R100=R100+1",
        "R100=R100+1\nN380 CALL LIVE_NAME",
    ),
    "takes the layer for the wait": ("R105=R103-R104", "R105=R101-R104"),
    "waits less than no time": ("N300 IF R105<=0 GOTOF LIVE_GO\n", ""),
    "waits far too long": ("N330 LIVE_N", "N321 G4 F100\nN330 LIVE_N"),
    "counts on from the build before": ("N160 R100=0", "N160 R105=0"),
    "calls a program that nobody released": ("N320 LIVE_GO", "N311 R102=3\nN320 LIVE_GO"),
    "takes back what is released": ("N330 LIVE_N", "N321 R101=0\nN330 LIVE_N"),
    "parks without its work offset": ("N520 G0 Z", "N511 TRAFOOF\nN520 G0 Z"),
    "the speed of the wire stays": ("N490 H3=0 ; wire speed, mm/s\n", ""),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_shuts_the_check(fault):
    text, (old, new) = text_of(), FAULTS[fault]
    assert old in text
    check = judged(text.replace(old, new, 1))
    assert not check.passed, fault
    assert check.where.startswith("MAIN_LIVE.MPF:")


def test_expressions_are_those_of_the_control():
    run = Run(lambda run: None, frozenset(), values={"R1": 36.0, "LIVE_N": 10037.0})
    assert Expression('SUBSTR(""<<LIVE_N,1,4)', run).value() == "0037"
    assert Expression("R1-6+1>=31", run).value() is True
    assert Expression("-1<>R1", run).value() is True
    for broken in ("R1+", "R1 R1", "SUBSTR R1", '"A', "R1*2"):
        with pytest.raises((ValueError, IndexError, KeyError)):
            Expression(broken, run).value()


def test_a_control_without_one_is_refused():
    with pytest.raises(SettingsError, match="waits between layers"):
        check_waits(Config().changed(machine={"control": "linuxcnc"}))


@pytest.mark.slow
def test_a_run_writes_it_and_verify_judges_its_text(tmp_path):
    write_stl(box(upper=(30, 24, 5)), tmp_path / "box.stl")
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, "--live", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "box.run" / "run.json").read_text())["program"]["live"]
    path = tmp_path / "box.run" / "live" / record["name"]
    text = path.read_text()
    assert record["validated"]
    assert "; VALIDATED" in text
    again = started("verify", "box.run", "--part", "box.stl", "--json", cwd=tmp_path)
    checks = {check["name"]: check for check in json.loads(again.stdout)}
    assert again.returncode == 0, [check for check in checks.values() if not check["passed"]]
    assert checks["handshake"]["passed"]
    path.write_text(text.replace("GOTOF LIVE_LATE", "GOTOF LIVE_CALL"))
    again = ebamcheck("verify", "box.run", "--part", "box.stl", cwd=tmp_path)
    assert again.returncode == 1

"""The main program that waits between layers: what it does with doors that answer, are silent, late or wrong, and planted faults."""

from __future__ import annotations

import json

import pytest
from command_line import FAST, ebamcheck, started, write_stl
from live_boxes import puts
from parts import box

from ebamcheck.controls.sinumerik.handshake import handshake_check
from ebamcheck.controls.sinumerik.release_keys import PRIME, ReleaseKeys, key_below, seal
from ebamcheck.controls.sinumerik.waiting import waiting_program
from ebamcheck.controls.sinumerik.waiting_run import Expression, Run, run_text
from ebamcheck.errors import SettingsError
from ebamcheck.live.publishing import layer_name
from ebamcheck.pipeline.entry_program import check_waits
from ebamcheck.settings.config import Config

CONFIG = Config().changed(machine={"live_timeout_s": 60.0})
KEYS = ReleaseKeys(1_000_003)


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
    def door(run):
        layer = int(run.values.get("R100", 0)) + 1
        puts(run, KEYS.release(layer, 3, 0.0) if layer <= 12 else KEYS.built(12))

    run = run_text(text_of(), door, CONFIG)
    assert [name for name, _ in run.calls] == [f"{layer_name('MAIN', k, 3)}_L0001" for k in range(12)]
    assert run.stops[-1][0] == "M30"
    assert not run.faults


def test_it_waits_at_least_as_long_as_the_server_says():
    def door(run):
        layer = int(run.values.get("R100", 0)) + 1
        puts(run, KEYS.release(layer, 1, 42.0) if layer <= 3 else KEYS.built(3))

    times = [at_s for _, at_s in run_text(text_of(), door, CONFIG).calls]
    assert all(b - a >= 42.0 for a, b in zip([0.0, *times], times, strict=False))


FAULTS = {
    "no STOPRE before the parameter is read": ("LIVE_WAIT: STOPRE", "LIVE_WAIT: R104=R104"),
    "any release will do": ("IF LIVE_LAYER==R100+1 GOTOF", "IF LIVE_LAYER>=1 GOTOF"),
    "calls without being asked": ("IF LIVE_LAYER==R100+1 GOTOF LIVE_CHECK", "IF LIVE_LAYER==0 GOTOF LIVE_GO"),
    "waits for ever": ("IF R104>=60 GOTOF LIVE_LATE", "IF R104>=600000 GOTOF LIVE_LATE"),
    "gives up too soon": ("IF R104>=60 GOTOF LIVE_LATE", "IF R104>=6 GOTOF LIVE_LATE"),
    "wire stays on when it gives up": ("LIVE_LATE: M63 ; wire off", "LIVE_LATE: R105=0"),
    "does not wait for the part to cool": ("G4 F=R105", "R105=0"),
    "another name": ('<<"_L0001"', '<<"_L0002"'),
    "does not count": ("R100=LIVE_LAYER", "R100=R100"),
    "believes what was left of the build before": ("N230 R101=0", "N230 R105=0"),
    "never ends": ("N590 IF LIVE_LAYER==-1", "N590 IF LIVE_LAYER==-9"),
    "no message": ('MSG("LIVE: NO LAYER RELEASED WITHIN 60 S")', "MSG()"),
    "ends where it should stop": ("M0\n", "M30\n"),
    "a block that nobody knows": ("GOTOB LIVE_NEXT", "GOTOC LIVE_NEXT"),
    "a jump the other way": ("GOTOB LIVE_WAIT", "GOTOF LIVE_WAIT"),
    "the beam stands while it waits": ("LIVE_NEXT: R104=0", "LIVE_NEXT: R104=0\nN291 M60"),
    "the wire runs before a layer": ("N640 LIVE_D", "N631 M62\nN640 LIVE_D"),
    "the tool dives before a layer": ("N640 LIVE_D", "N631 G0 X0 Y0 Z-50\nN640 LIVE_D"),
    "the tool moves after a layer": ("N680 R100", "N671 G0 Z500\nN680 R100"),
    "another work offset": ("N140 G54", "N140 G55"),
    "a work offset that changes": ("N640 LIVE_D", "N631 G55\nN640 LIVE_D"),
    "no modes": ("N100 G17 G710 G90 G94\n", ""),
    "a frame of before": ("N130 TRANS\n", ""),
    "no smoothing": ("N160 SOFT FFWON G642\n", ""),
    "a wide tolerance": ("CTOL=0.05", "CTOL=5"),
    "no tolerance": ("N170 CTOL=0.05\n", ""),
    "the beam of before": ("N190 M61 ; beam off\n", ""),
    "ends under the part's top": ("G0 Z32.0", "G0 Z3.0"),
    "rises at feed": ("G0 Z32.0", "G1 F600 Z32.0"),
    "parks without a rise": ("N820 G0 Z32.000000\n", ""),
    "parks elsewhere": ("G0 X0.000000", "G0 X500.000000"),
    "the current stays": ("H2=0 ; beam", "H2=100 ; beam"),
    "ends before its end": ("N770 M63", "N761 M2\nN770 M63"),
    "a voltage that nobody asked for": ("H1=60 ", "H1=600 "),
    "a name that is cut off": ("STRING[32] LIVE_NAME", "STRING[10] LIVE_NAME"),
    "counts a layer before it is laid": (
        "CALL LIVE_NAME\nN680 R100=LIVE_LAYER",
        "R100=LIVE_LAYER\nN680 CALL LIVE_NAME",
    ),
    "takes the layer for the wait": ("R105=LIVE_S-R104", "R105=R101-R104"),
    "waits less than no time": ("N610 IF R105<=0 GOTOF LIVE_GO\n", ""),
    "waits far too long": ("N640 LIVE_D", "N631 G4 F100\nN640 LIVE_D"),
    "counts on from the build before": ("N220 R100=0", "N220 R105=0"),
    "calls a program that nobody released": ("N650 LIVE_N=LIVE_R", "N650 LIVE_N=3"),
    "takes back what is released": ("N640 LIVE_D", "N631 R101=0\nN640 LIVE_D"),
    "parks without its work offset": ("N820 G0 Z", "N811 TRAFOOF\nN820 G0 Z"),
    "a release without its seal": ("N570 IF LIVE_H<>R112 GOTOB LIVE_NO\n", ""),
    "a seal without the number": ("+20000+LIVE_R", "+20000"),
    "a seal without the wait": ("+TRUNC(1000*LIVE_S+0.5)", ""),
    "a seal without the layer": ("+LIVE_LAYER+1\n", "+R100+2\n"),
    "a key that follows none": ("N500 IF LIVE_H<>LIVE_LAST GOTOB LIVE_NO\n", ""),
    "every key is the first": ("N580 LIVE_LAST=LIVE_KEY\n", ""),
    "keys by another modulus": (
        "N490 LIVE_H=LIVE_H-TRUNC(LIVE_H/33554393)",
        "N490 LIVE_H=LIVE_H-TRUNC(LIVE_H/33554392)",
    ),
    "the number that stands there when it calls": ("N650 LIVE_N=LIVE_R", "N650 LIVE_N=R102"),
    "the wait that stands there when it waits": (
        "N620 G4 F=R105",
        "N620 G4 F=0.1\nN621 STOPRE\nN622 R105=R103-R104",
    ),
    "the speed of the wire stays": ("N790 H3=0 ; wire speed, mm/s\n", ""),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_shuts_the_check(fault):
    text, (old, new) = text_of(), FAULTS[fault]
    assert old in text
    check = judged(text.replace(old, new, 1))
    assert not check.passed, fault
    assert check.where.startswith("MAIN_LIVE.MPF:")


def test_a_key_tells_the_ones_below_and_no_release_fits_other_values():
    for layer in (2, 3, 500, 10_000):
        assert KEYS.of(layer - 1) == key_below(KEYS.of(layer), layer)
    assert len({KEYS.of(layer) for layer in range(1, 10_001)}) > 9990
    right = KEYS.release(7, 2, 1.25)
    others = [(2, 1.25, 8), (3, 1.25, 7), (2, 1.251, 7), (2, 0.0, 7), (0, 0.0, -1)]
    assert right.seal not in {seal(KEYS.of(7), *other) for other in others}
    # Exact in a REAL of the control: 53 bits.
    assert PRIME**2 + 1000 * 10**6 < 2**53
    for wait_s in (0.0, 0.29, 1.1, 999999.999):
        assert KEYS.release(1, 1, wait_s).seal == KEYS.release(1, 1, round(wait_s, 3)).seal


def test_expressions_are_those_of_the_control():
    run = Run(lambda run: None, frozenset(), values={"R1": 36.0, "LIVE_N": 10037.0})
    assert Expression('SUBSTR(""<<LIVE_N,1,4)', run).value() == "0037"
    assert Expression("R1-6+1>=31", run).value() is True
    assert Expression("-1<>R1", run).value() is True
    assert Expression("R1*2-1/4+TRUNC(R1/5)*5", run).value() == 36 * 2 - 0.25 + 35
    for broken in ("R1+", "R1 R1", "SUBSTR R1", '"A', "R1*"):
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

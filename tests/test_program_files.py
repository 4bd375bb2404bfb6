"""The files of a program: their text, their bytes, stamps and folder, and settings that make none."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nc_stack import REACHES_OUT, make_curves, make_plan, stack

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.program import (
    mark_validated,
    program_summary,
    read_program,
    verify_file,
    verify_program,
    write_program,
)
from ebamcheck.settings.config import Config

SQUARE = np.array([(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)], float)

SQUARE_AND_ISLAND = [
    "G17 G710 G90 G94",
    "G40 D0",
    "TRAFOOF",
    "TRANS",
    "G54",
    "COMPOF RTLION",
    "SOFT FFWON G642",
    "CTOL=0.05",
    'MSG("LAYER 1 OF 2")',
    "H1=60 ; accelerating voltage, kV",
    "H2=120 ; beam current, mA",
    "G0 Z21.600",
    "; RING 0",
    "G0 X0.000 Y0.000",
    "G0 Z1.600",
    "M60 ; beam on",
    "H3=31.830989 ; wire speed, mm/s",
    "M62 ; wire on",
    "G1 X10.000 Y0.000 F600",
    "G1 X10.000 Y10.000",
    "G1 X0.000 Y10.000",
    "G1 X0.000 Y0.000",
    "M63 ; wire off",
    "M61 ; beam off",
    "; ISLAND 0",
    "G0 X2.000 Y2.000",
    "M60 ; beam on",
    "H3=31.830989 ; wire speed, mm/s",
    "M62 ; wire on",
    "G1 X8.000 Y2.000 F600",
    "G1 X8.000 Y6.320 ; TURN",
    "G1 X2.000 Y6.320",
    "M63 ; wire off",
    "M61 ; beam off",
    "G0 Z21.600",
    "M17",
]
"""Blocks of a layer with one contour and one island."""

MAIN_OF_TWO_LAYERS = [
    "G17 G710 G90 G94",
    "G40 D0",
    "TRAFOOF",
    "TRANS",
    "G54",
    "COMPOF RTLION",
    "SOFT FFWON G642",
    "CTOL=0.05",
    "M63 ; wire off",
    "M61 ; beam off",
    "H1=60 ; accelerating voltage, kV",
    "H2=120 ; beam current, mA",
    "MAIN_L0001",
    "MAIN_L0002",
    "M63 ; wire off",
    "M61 ; beam off",
    "H3=0 ; wire speed, mm/s",
    "H1=0 ; accelerating voltage, kV",
    "H2=0 ; beam current, mA",
    "G0 Z23.200",
    "G0 X0.000 Y0.000",
    "M30",
]
"""Blocks of the main program over two layers."""


def failed(checks):
    return [(c.name, c.where, c.text) for c in checks if not c.passed and c.name != REACHES_OUT]


def test_the_text_of_a_square_and_an_island(tmp_path):
    curves = make_curves([0.8, 2.4], [[[(SQUARE, None)]], []], [True])
    plan = make_plan([0.8, 2.4], [(0, [(2, 2, 8, 2), (8, 6.32, 2, 6.32)])])
    config = Config().changed(machine={"decimals": 3})
    files = write_program(curves, plan, config, tmp_path / "program")
    assert files.names == ("MAIN.MPF", "MAIN_L0001.SPF", "MAIN_L0002.SPF")
    text = (files.folder / "MAIN_L0001.SPF").read_text()
    lines = text.splitlines()
    assert lines[:4] == [
        "%_N_MAIN_L0001_SPF",
        ";$PATH=/_N_WKS_DIR/_N_EBAMCHECK_WPD",
        "; NOT VALIDATED",
        "; LAYER: 1 OF 2, CUT AT 0.800000, Z 1.600000",
    ]
    numbers = [int(line.split()[0][1:]) for line in lines if line.startswith("N")]
    assert numbers == list(range(10, 10 * len(numbers) + 1, 10))
    assert [re.sub(r"^N\d+ ", "", line) for line in lines[4:]] == SQUARE_AND_ISLAND
    empty = (files.folder / "MAIN_L0002.SPF").read_text().splitlines()
    assert empty[15:] == ["N120 G0 Z23.200", "N130 G0 Z23.200", "N140 M17"]
    main = (files.folder / "MAIN.MPF").read_text().splitlines()
    assert main[0] == "%_N_MAIN_MPF"
    assert [line.split(" ", 1)[1] for line in main if line.startswith("N")] == MAIN_OF_TWO_LAYERS


def test_a_stamped_program_is_that_which_is_written_validated(tmp_path):
    curves, plan = stack()
    files = write_program(curves, plan, Config(), tmp_path / "program", header={"PART SHA-256": "ab" * 32})
    assert read_program(files.main).header["PART SHA-256"] == "ab" * 32
    stamped = mark_validated(files)
    checks = verify_file(stamped.main, config=Config(), curves=curves, plan=plan, sha256=stamped.sha256)
    assert failed(checks) == []
    for name in stamped.names:
        assert hashlib.sha256((files.folder / name).read_bytes()).hexdigest() == stamped.sha256[name]
    direct = write_program(
        curves, plan, Config(), tmp_path / "direct", header={"PART SHA-256": "ab" * 32}, validated=True
    )
    assert direct.sha256 == stamped.sha256
    with (files.folder / files.names[1]).open("ab") as file:
        file.write(b"; more\n")
    with pytest.raises(InputError, match="has changed since"):
        mark_validated(files)


def test_a_program_replaces_an_earlier_one_whole(tmp_path):
    write_program(*stack(count=3), Config(), tmp_path / "program")
    files = write_program(*stack(count=1), Config(), tmp_path / "program")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["program"]
    assert sorted(p.name for p in files.folder.iterdir()) == sorted(files.names)


def test_nothing_half_made_stays_where_writing_fails(tmp_path, monkeypatch):
    whole = Path.write_bytes
    written = []

    def fail_on_second(path, data):
        written.append(path)
        if len(written) == 2:
            raise OSError("disk full")
        return whole(path, data)

    monkeypatch.setattr(Path, "write_bytes", fail_on_second)
    with pytest.raises(OSError, match="disk full"):
        write_program(*stack(), Config(), tmp_path / "program")
    assert list(tmp_path.iterdir()) == []


def test_a_form_that_is_not_licensed_is_refused(tmp_path):
    machine = Config().machine.model_copy(update={"poly_licensed": False})
    config = Config().model_copy(update={"machine": machine})
    with pytest.raises(SettingsError, match="does not have that option"):
        write_program(*stack(), config, tmp_path / "program")
    assert not (tmp_path / "program").exists()


@pytest.mark.parametrize(
    ("machine", "message"),
    [
        ({"beam_on": ["M60 P{power}"]}, "unknown placeholder 'power'"),
        ({"beam_on": ["M60 {power_w"]}, "is not a template"),
        ({"wire_start": ["M62\nM63"]}, "not one line"),
        ({"layer_begin": ["; Schicht für Schicht"]}, "ASCII"),
        ({"program_name": "A" * 19}, "over 24"),
    ],
)
def test_settings_that_make_no_program_are_refused(machine, message, tmp_path):
    with pytest.raises(SettingsError, match=message):
        write_program(*stack(), Config().changed(machine=machine), tmp_path / "program")


def test_curves_and_plan_of_different_stacks_are_refused(tmp_path):
    curves, _ = stack(count=3)
    _, plan = stack(count=2)
    with pytest.raises(SettingsError, match="differ in their heights"):
        write_program(curves, plan, Config(), tmp_path / "program")
    falling = replace(curves, heights=curves.heights[::-1].copy())
    with pytest.raises(SettingsError, match="must rise"):
        write_program(falling, replace(stack(count=3)[1], heights=falling.heights), Config(), tmp_path / "p")


def test_templates_carry_the_values_of_their_layer(tmp_path):
    machine = {
        "layer_begin": ["H9={layer} H8={height_mm:.2f} ; layer"],
        "set_beam": ["H7={power_w}"],
        "set_power": ["H7={power_w}"],
        "aux_codes": ["H8", "H9"],
    }
    config = Config().changed(machine=machine)
    curves, plan = stack(count=2)
    files = write_program(curves, plan, config, tmp_path / "program")
    assert "N110 H9=2 H8=3.00 ; layer" in (files.folder / "MAIN_L0002.SPF").read_text()
    nc = read_program(files.main, config)
    assert set(nc.power_w[nc.deposit]) == {7200.0}
    assert failed(verify_program(nc, config=config, curves=curves, plan=plan)) == []


def test_totals_of_a_square_are_those_of_arithmetic(tmp_path):
    curves = make_curves([0.75], [[[(SQUARE, None)]]], [True])
    plan = make_plan([0.75], [(0, [(2, 2, 8, 2)])])
    config = Config().changed(layers={"layer_height_mm": 1.5})
    nc = read_program(write_program(curves, plan, config, tmp_path / "program").main)
    row = program_summary(nc, config).iloc[0]
    assert row.contour_mm == pytest.approx(40)
    assert row.hatch_mm == pytest.approx(6)
    assert row.deposit_s == pytest.approx(4.6)
    # Rise of the bead model: 2/3 w h v t of metal, whatever the wire.
    assert row.wire_kg == pytest.approx(2 / 3 * 6 * 1.5 * 46 * 4430e-9, rel=1e-6)
    assert row.travel_mm == pytest.approx(np.hypot(2, 2) + 40)


def test_a_stack_without_layers_is_a_program_that_does_nothing(tmp_path):
    curves, plan = make_curves([], [], []), make_plan([], [])
    files = write_program(curves, plan, Config(), tmp_path / "program")
    assert files.names == ("MAIN.MPF",)
    nc = read_program(files.main)
    assert not nc.deposit.any()
    assert len(program_summary(nc, Config())) == 0
    assert [c.name for c in verify_program(nc, config=Config(), heights=[0.5]) if not c.passed] == ["layer count"]

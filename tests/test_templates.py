"""Templates run like any other text: what they hold beyond declared codes is refused, with the template's name."""

from __future__ import annotations

import pytest
from nc_stack import stack
from program_text import CONTROLS, ProgramText

from ebamcheck.errors import SettingsError
from ebamcheck.program import read_program, write_program
from ebamcheck.settings.config import Config

SINUMERIK, LINUXCNC, PLAIN = CONTROLS

WORDS = (
    "G91", "G70", "TRANS X5", "ROT RPL=5", "SCALE X2", "MIRROR X0", "G500", "G55", "G19", "G95", "GOTOF ENDE", "M0",
    "POS[X]=5", "G0 X5", "G1 X5 F100", "X5", "Z=3", "F100", "M30", "T1", "D1", "G641 ADIS=5", "IF R1==1", "M17",
)  # fmt: skip
"""Words of the control: modal words, frames, motions, flow."""

REFUSED = {
    **{f"layer_begin with {word}": {"layer_begin": [word]} for word in WORDS},
    "layer_end with a motion": {"layer_end": ["G0 Z500"]},
    "layer_begin with a code declared nowhere": {"layer_begin": ["M77"]},
    "layer_begin that switches the beam on": {"layer_begin": ["M60"]},
    "beam_on twice": {"beam_on": ["M60", "M60"]},
    "beam_on with G91": {"beam_on": ["G91", "M60"]},
    "beam_on with a move": {"beam_on": ["M60 G1 X5"]},
    "beam_on that waits under the beam": {"beam_on": ["M60", "G4 F2"]},
    "wire_start that waits under the beam": {"wire_start": ["G4 F2", "H3={wire_mm_s}", "M62"]},
    "beam_on with the code of the wire": {"beam_on": ["M62"]},
    "wire_start before its speed": {"wire_start": ["M62", "H3={wire_mm_s}"]},
    "wire_start without a speed": {"wire_start": ["M62"]},
    "set_beam without a current": {"set_beam": ["H1={voltage_kv}"]},
    "layer_pause of a tenth of the time": {"layer_pause": ["G4 F0.{layer_pause_s}"]},
    "beam_off that switches nothing off": {"beam_off": ["M59"]},
    "beam_off with a value alone": {"beam_off": ["H2=0"]},
    "beam_off that switches on": {"beam_off": ["M60", "M61"]},
    "beam_off and wire_stop exchanged": {"beam_off": ["M63"], "wire_stop": ["M61"]},
    "beam on and off exchanged": {"beam_on": ["M61"], "beam_off": ["M60"]},
    "set_power of twice the value": {"set_power": ["H2=2*{current_ma}"]},
    "set_power with a digit before": {"set_power": ["H2=2{current_ma}"]},
    "set_power with a digit behind": {"set_power": ["H2={current_ma}0"]},
    "set_power of a fixed value": {"set_power": ["H2=240"]},
    "set_power in watts": {"set_power": ["H2={power_w}"]},
    "set_power that sets the wire": {"set_power": ["H3={wire_mm_s}"]},
    "set_power that sets nothing": {"set_power": ["H2=0"]},
    "set_wire in millimetres a minute of feed": {"set_wire": ["H3={feed_mm_min}"]},
    "volts and amperes exchanged": {"set_beam": ["H1={current_ma}", "H2={voltage_kv}"]},
    "an axis as an auxiliary code": {"layer_begin": ["X5"], "aux_codes": ["X"]},
    "a mode as an auxiliary code": {"layer_begin": ["G91"], "aux_codes": ["G91"]},
    "a stop as an auxiliary code": {"layer_begin": ["M0"], "aux_codes": ["M0"]},
    "the beam as an auxiliary code": {"layer_begin": ["M60"], "aux_codes": ["M60"]},
    "a beam value in an auxiliary code": {"layer_begin": ["H9={power_w}"], "aux_codes": ["H9"]},
    "an axis behind an auxiliary code": {"layer_begin": ["M77 Z0"], "aux_codes": ["M77 Z0"]},
    "a mode behind an auxiliary code": {"layer_begin": ["M77 G91"], "aux_codes": ["M77 G91"]},
    "a feed behind an auxiliary code": {"layer_end": ["M77 F9"], "aux_codes": ["M77 F9"]},
    "the end behind an auxiliary code": {"layer_end": ["M77 M30"], "aux_codes": ["M77 M30"]},
    "an axis behind the beam": {
        "beam_on": ["M60 Z0"],
        "beam_codes": ["M60 Z0: on", "M61: off", "H1: voltage_kv", "H2: current_ma"],
    },
    "a mode for the beam": {
        "beam_on": ["G91"],
        "beam_codes": ["G91: on", "M61: off", "H1: voltage_kv", "H2: current_ma"],
    },
    "a tool for the wire": {"wire_start": ["H3={wire_mm_s}", "M6"], "wire_stop": ["M73"]},
    "an axis behind the wire": {"wire_start": ["H3={wire_mm_s}", "M72 X9"], "wire_stop": ["M73"]},
    "a turn of the table behind an auxiliary code": {"layer_begin": ["M77 B9"], "aux_codes": ["M77 B9"]},
    "a declaration that is none": {"beam_codes": ["M60"]},
    "another code for off alone": {"beam_codes": ["M60: on", "M61: on"]},
}


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", REFUSED)
def test_a_template_that_does_what_its_name_does_not_say_is_refused(name, tmp_path):
    machine = REFUSED[name]
    config = Config().changed(machine=machine)
    with pytest.raises(SettingsError, match=r"machine\.(" + "|".join((*machine, "beam_o", "wire_")) + ")"):
        write_program(*stack(count=1), config, tmp_path / "program")
    assert not (tmp_path / "program").exists()
    honest = write_program(*stack(count=1), Config(), tmp_path / "honest")
    with pytest.raises(SettingsError):
        read_program(honest.main, config)


OF_OTHERS = {
    LINUXCNC: (
        {"beam_on": ["M64 P0", "M64 P0"]}, {"beam_off": ["M65 P2"]}, {"set_beam": ["M68 E0 Q{current_ma}", "M68 E1 Q{voltage_kv}"]},
        {"layer_begin": ["G91"]}, {"layer_begin": ["G92 X5"]}, {"set_power": ["M67 E1 Q[2*{current_ma}]"]}, {"wire_stop": ["M65 P0"]},
        {"layer_begin": ["O100 CALL"]}, {"set_power": ["M67 E0 Q{current_ma}"]},
    ),
    PLAIN: (
        {"beam_on": ["M3 S{power_w}", "M3 S{power_w}"]}, {"beam_off": ["M107"]}, {"beam_off": ["S0"]}, {"set_power": ["S{current_ma}"]},
        {"layer_begin": ["G91"]}, {"layer_begin": ["G28 X"]}, {"set_power": ["S9999"]}, {"beam_on": ["M3 S9999"]},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("control", "machine"), [(c, m) for c, all_ in OF_OTHERS.items() for m in all_])
def test_so_it_is_on_the_other_controls(control, machine, tmp_path):
    config = Config().changed(machine={"control": control, **machine})
    with pytest.raises(SettingsError, match=rf"machine\.{next(iter(machine))}"):
        write_program(*stack(count=1), config, tmp_path / "program")


OWN = {
    "an auxiliary code": {"layer_begin": ["M77 ; shutter", 'MSG("layer {layer}")'], "aux_codes": ["M77"]},
    "codes with values": {"layer_begin": ["H9={layer} H8={height_mm:.2f}"], "aux_codes": ["H9", "H8"]},
    "other switches": {"beam_on": ["M70"], "beam_off": ["M71"], "wire_start": ["H3={wire_mm_s}", "M72"], "wire_stop": ["M73"]},
    "switches by value": {"beam_on": ["H9=1"], "beam_off": ["H9=0"]},
    "power in watts": {"set_beam": ["H7={power_w}"], "set_power": ["H7={power_w}"]},
    "declared codes": {
        "beam_codes": ["M10: on", "M11: off", "H1: current_ma", "H2: voltage_kv"],
        "beam_on": ["M10"], "beam_off": ["M11"],
        "set_beam": ["H1={current_ma}", "H2={voltage_kv}"], "set_power": ["H1={current_ma}"],
    },
    "a rest before the beam": {"beam_on": ["G4 F2", "M60"]},
    "values taken back with the beam": {"wire_stop": ["M63", "H3=0"]},
}  # fmt: skip


@pytest.mark.parametrize("name", OWN)
def test_a_profile_of_its_own_is_written_and_read(name, tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", OWN[name], {"ramp_up_mm": 4.0, "wire_retract_mm": 3.0})
    assert text.failed() == {}
    nc = read_program(text.files.main, text.config)
    assert nc.power_w[nc.deposit].max() == pytest.approx(7200)
    assert nc.wire[nc.deposit].all()


def test_a_block_that_lacks_the_one_before_it_in_its_template_is_found(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", {"beam_on": ["M77", "M60"], "aux_codes": ["M77"]})
    assert text.failed() == {}
    place = text.drop(*("MAIN_L0002.SPF", "M77"))
    assert text.failed()["order of events"].where == place

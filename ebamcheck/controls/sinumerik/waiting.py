"""The main program that waits between layers for the next one to be released, and calls it by its name.

Eight R parameters from ``machine.live_r`` on are the handshake: layers done, layer released (-1: the part is built), number of its
program, least wait, time waited, wait left, and from the eleventh further on key and seal
(:mod:`ebamcheck.controls.sinumerik.release_keys`). Sources: Siemens Job Planning manual (indirect call by a STRING, ``<<``, SUBSTR,
TRUNC, STOPRE); tried on no control."""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.controls.sinumerik.control import CONTROL, NAME
from ebamcheck.controls.sinumerik.release_keys import PRIME, SET_OFF
from ebamcheck.controls.sinumerik.writing import modes
from ebamcheck.nc.conventions import comment, header_lines, plain
from ebamcheck.nc.files import NOT_VALIDATED, legal_name
from ebamcheck.nc.templates import process_values, usable_templates
from ebamcheck.settings.config import Config
from ebamcheck.writing.blocks import BlockFormat, end_blocks, numbered, start_blocks

# Characters of the program's name that a layer's name keeps, as the server that makes layers has it.
STEM = 10


def waiting_program(config: Config, top_mm: float, header: Mapping[str, str] | None = None) -> tuple[str, str]:
    """Write the waiting main program of a part whose top is to lie at a Z; return the name of its file and its text."""
    machine = config.machine
    name = legal_name(f"{machine.program_name[:STEM]}_LIVE")
    templates, form = usable_templates(config, NAME), BlockFormat(machine.printed_decimals)
    values = process_values(config, 1, config.layer_height_mm, config.layer_height_mm)
    directory = legal_name(machine.workpiece_directory)
    known = header_lines(config, CONTROL, 0) | {"LAYERS": "AS THEY ARE RELEASED"} | dict(header or {})
    safe = [line for block in ("wire_stop", "beam_off") for line in values.fill(block, templates[block])]
    text = [
        f"%_N_{name}_MPF",
        f";$PATH=/_N_WKS_DIR/_N_{directory}_WPD",
        NOT_VALIDATED,
        *(comment(f"{key}: {value}") for key, value in known.items()),
        "DEF INT LIVE_N",
        *(f"DEF REAL LIVE_{name}" for name in ("KEY", "LAST", "LAYER", "R", "S", "H")),
        *(f"DEF STRING[32] LIVE_{name}" for name in ("DIGITS", "NAME")),
        *start_blocks(modes(machine), values, templates),
        *_handshake(config, safe),
        *end_blocks(top_mm, values, config, form, templates),
        "M30",
    ]
    return f"{name}.MPF", numbered(text)


def _handshake(config: Config, safe: list[str]) -> list[str]:
    """The loop: ask, wait, call; what happens when nobody answers; and the way out."""
    machine = config.machine
    done, released, number, wait, waited, rest = (f"R{machine.live_r + k}" for k in range(6))
    key, seal = f"R{machine.live_r + 11}", f"R{machine.live_r + 12}"
    poll, limit = plain(machine.live_poll_s), plain(machine.live_timeout_s)
    late = ["M0", "MSG()", "GOTOB LIVE_NEXT"] if machine.live_late == "stop" else ["GOTOF LIVE_END"]
    remainder = f"LIVE_H=LIVE_H-TRUNC(LIVE_H/{PRIME})*{PRIME}"
    return [
        *(f"{given}=0" for given in (done, released, number, wait, key, seal)),
        "LIVE_LAST=0",
        f"LIVE_NEXT: {waited}=0",
        "LIVE_WAIT: STOPRE",
        f"LIVE_LAYER={released}",
        f"IF LIVE_LAYER=={done}+1 GOTOF LIVE_CHECK",
        "IF LIVE_LAYER==-1 GOTOF LIVE_CHECK",
        f"LIVE_NO: IF {waited}>={limit} GOTOF LIVE_LATE",
        f"G4 F{poll}",
        f"{waited}={waited}+{poll}",
        "GOTOB LIVE_WAIT",
        # From here on nothing that is written over the release counts.
        f"LIVE_CHECK: LIVE_R={number}",
        f"LIVE_S={wait}",
        f"LIVE_KEY={key}",
        "IF LIVE_R<0 GOTOB LIVE_NO",
        "IF LIVE_R>9999 GOTOB LIVE_NO",
        "IF LIVE_S<0 GOTOB LIVE_NO",
        "IF LIVE_S>1000000 GOTOB LIVE_NO",
        "IF LIVE_KEY<1 GOTOB LIVE_NO",
        f"IF LIVE_KEY>{PRIME} GOTOB LIVE_NO",
        "IF LIVE_LAST==0 GOTOF LIVE_SEAL",
        f"LIVE_H=LIVE_KEY*LIVE_KEY+{done}+1",
        remainder,
        "IF LIVE_H<>LIVE_LAST GOTOB LIVE_NO",
        f"LIVE_SEAL: LIVE_H=LIVE_KEY*LIVE_KEY+{SET_OFF}+LIVE_R",
        remainder,
        "LIVE_H=LIVE_H*LIVE_H+TRUNC(1000*LIVE_S+0.5)",
        remainder,
        "LIVE_H=LIVE_H*LIVE_H+LIVE_LAYER+1",
        remainder,
        f"IF LIVE_H<>{seal} GOTOB LIVE_NO",
        "LIVE_LAST=LIVE_KEY",
        "IF LIVE_LAYER==-1 GOTOF LIVE_END",
        f"{rest}=LIVE_S-{waited}",
        f"IF {rest}<=0 GOTOF LIVE_GO",
        f"G4 F={rest}",
        "LIVE_GO: LIVE_N=10000+LIVE_LAYER",
        'LIVE_DIGITS=""<<LIVE_N',
        "LIVE_N=LIVE_R",
        f'LIVE_NAME="{machine.program_name[:STEM]}_K"<<SUBSTR(LIVE_DIGITS,1,4)<<"R"<<LIVE_N<<"_L0001"',
        "CALL LIVE_NAME",
        f"{done}=LIVE_LAYER",
        "GOTOB LIVE_NEXT",
        f"LIVE_LATE: {safe[0]}",
        *safe[1:],
        f'MSG("LIVE: NO LAYER RELEASED WITHIN {limit} S")',
        *late,
        'LIVE_END: MSG("LIVE: END")',
    ]

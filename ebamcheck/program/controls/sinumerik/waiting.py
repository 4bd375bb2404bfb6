"""The main program that waits between layers for the next one to be released, and calls it by its name.

Six R parameters are the handshake, from ``machine.live_r`` on: layers done, layer released, number of its program, least wait
before it, time waited, and what is left to wait. A server writes the second, third and fourth, the second last of all; -1 in it says
that the part is built. Sources: Siemens Job Planning manual (indirect call by a STRING, ``<<``, SUBSTR, STOPRE); written by
the book and tried on no control.
"""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.program.controls.sinumerik.control import CONTROL, NAME
from ebamcheck.program.controls.sinumerik.writing import modes
from ebamcheck.program.language.comments import comment
from ebamcheck.program.language.files import NOT_VALIDATED, legal_name
from ebamcheck.program.language.header import header_lines
from ebamcheck.program.language.numbers import plain
from ebamcheck.program.language.templates import process_values, usable_templates
from ebamcheck.program.writing.blocks import BlockFormat, numbered
from ebamcheck.program.writing.safe_states import end_blocks, start_blocks
from ebamcheck.settings.config import Config

STEM = 10
"""Characters of the program's name that a layer's name keeps, as the server that makes layers has it."""


def waiting_program(
    config: Config, top_mm: float, header: Mapping[str, str] | None = None
) -> tuple[str, str]:
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
        "DEF STRING[32] LIVE_DIGITS",
        "DEF STRING[32] LIVE_NAME",
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
    poll, limit = plain(machine.live_poll_s), plain(machine.live_timeout_s)
    late = ["M0", "MSG()", "GOTOB LIVE_NEXT"] if machine.live_late == "stop" else ["GOTOF LIVE_END"]
    return [
        f"{done}=0",
        f"{released}=0",
        f"{number}=0",
        f"{wait}=0",
        f"LIVE_NEXT: {waited}=0",
        "LIVE_WAIT: STOPRE",
        f"IF {released}=={done}+1 GOTOF LIVE_CALL",
        f"IF {released}==-1 GOTOF LIVE_END",
        f"IF {waited}>={limit} GOTOF LIVE_LATE",
        f"G4 F{poll}",
        f"{waited}={waited}+{poll}",
        "GOTOB LIVE_WAIT",
        "LIVE_CALL: STOPRE",
        f"{rest}={wait}-{waited}",
        f"IF {rest}<=0 GOTOF LIVE_GO",
        f"G4 F={rest}",
        "LIVE_GO: STOPRE",
        f"LIVE_N=10001+{done}",
        'LIVE_DIGITS=""<<LIVE_N',
        f"LIVE_N={number}",
        f'LIVE_NAME="{machine.program_name[:STEM]}_K"<<SUBSTR(LIVE_DIGITS,1,4)<<"R"<<LIVE_N<<"_L0001"',
        "CALL LIVE_NAME",
        f"{done}={done}+1",
        "GOTOB LIVE_NEXT",
        f"LIVE_LATE: {safe[0]}",
        *safe[1:],
        f'MSG("LIVE: NO LAYER RELEASED WITHIN {limit} S")',
        *late,
        'LIVE_END: MSG("LIVE: END")',
    ]

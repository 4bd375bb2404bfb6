"""Faults of the control's state: modes, offsets, frames, smoothing, tools and program flow, written into the text."""

from __future__ import annotations

import re

from benchmarks.faults.kinds import LINUXCNC, PLAIN, SINUMERIK, Ground, NotHereError, Place, kind
from benchmarks.faults.program_text import ProgramText
from benchmarks.faults.subjects import PREHEATED

MODES = r"G17 .*|G5[4-7]|G64.*|CTOL=.*|G40.*|TRANS"


def _insert(ground: Ground, block: str) -> list[Place]:
    """Put a block before the travel to some bead, not the first."""
    text = ground.text
    bead = ground.pick(text.beads()[1:])
    text.insert(bead.file, bead.travel, block)
    ground.what = f"{block} in a layer"
    return ground.line(bead.file, bead.travel, bead.first + 2)


def _insert_in_bead(ground: Ground, block: str) -> list[Place]:
    """Put a block between two motions of a bead."""
    text, bead = ground.text, ground.bead(motions=3)
    i = bead.motions[1 + int(ground.random.integers(len(bead.motions) - 1))]
    text.insert(bead.file, i, block)
    ground.what = f"{block} along a bead"
    return ground.line(bead.file, i, i + 2)


def _after_modes(text: ProgramText, layer: bool = False) -> tuple[str, int]:
    """File and line behind the modes of the first blocks; or of those of the first layer, where it has some."""
    first = text.layers()[0]
    if layer and text.find(MODES, first.file, first.first, text.beads()[0].travel):
        return first.file, text.find(MODES, first.file, first.first, text.beads()[0].travel)[-1] + 1
    end = len(text.files[text.main]) if text.sinumerik else first.first
    return text.main, text.find(MODES, end=end)[-1] + 1


IN_A_LAYER: dict[str, dict[str, tuple[str, ...]]] = {
    "work offset": {SINUMERIK: ("G55", "G500", "G53"), LINUXCNC: ("G55", "G92 X1", "G10 L2 P1 X1"), PLAIN: ("G55", "G92 X0", "G92 E0 X5")},
    "plane": {SINUMERIK: ("G18", "G19"), LINUXCNC: ("G18",), PLAIN: ("G18", "G19")},
    "units": {SINUMERIK: ("G70", "G700"), LINUXCNC: ("G20",), PLAIN: ("G20",)},
    "distance mode": {SINUMERIK: ("G91",), LINUXCNC: ("G91", "G90.1"), PLAIN: ("G91",)},
    "feed mode": {SINUMERIK: ("G95", "G93"), LINUXCNC: ("G95", "G93"), PLAIN: ("G93", "G95")},
    "smoothing": {SINUMERIK: ("G641 ADIS=5", "G60", "G64", "G643", "G645", "CTOL=0.5", "G642 CTOL=2"), LINUXCNC: ("G61", "G64", "G64 P5", "G61.1"), PLAIN: ("G64", "G61")},
    "acceleration": {SINUMERIK: ("BRISK", "FFWOF", "DRIVE"), LINUXCNC: ("M52 P1",), PLAIN: ("M204 S9000", "M205 X20")},
    "frame": {SINUMERIK: ("TRANS X1", "ROT RPL=5", "SCALE X1.1 Y1.1", "MIRROR X0", "ATRANS Z1"), LINUXCNC: ("G52 X1", "G92.3"), PLAIN: ("G52 X1", "G68 X0 Y0 R5", "G51 X2")},
    "tool and length": {SINUMERIK: ("T2", "D2", "G41", "TOFFL=1"), LINUXCNC: ("G43 H2", "G41 D1", "T2 M6", "G43.1 Z1"), PLAIN: ("T1", "G43 H2", "G42")},
    "spindle and coolant": {SINUMERIK: ("M3 S1000", "M8"), LINUXCNC: ("M3 S1000", "M7", "M8"), PLAIN: ("M106 S255", "M7")},
    "program flow": {SINUMERIK: ("M0", "M1", "GOTOF ENDE", "STOPRE", "M17"), LINUXCNC: ("M0", "M1", "%", "M2", "M99"), PLAIN: ("M0", "%", "M2", "M25", "M112")},
    "override": {SINUMERIK: ("OVR=50", "FAD=1", "G26 S100"), LINUXCNC: ("M48", "M50 P0"), PLAIN: ("M220 S50", "M221 S50")},
    "assignment": {SINUMERIK: ("R1=5", "$P_UIFR[1,X,TR]=5", "STOPFIFO"), LINUXCNC: ("#1=5", "#5221=5", "O100 CALL"), PLAIN: ("M500", "M206 X1")},
    "auxiliary axis": {SINUMERIK: ("POS[X]=5", "A90", "G0 C90"), LINUXCNC: ("G0 A90", "G0 U1"), PLAIN: ("G1 E5", "G0 A5")},
    "homing and probing": {SINUMERIK: ("G74 X1=0", "MEAS=1 G1 Z0", "G75 Z0"), LINUXCNC: ("G28", "G30", "G38.2 Z0"), PLAIN: ("G28", "G28 X0", "G30")},
}  # fmt: skip
"""Blocks that change what the blocks after them mean, or what the machine does; by what they touch."""


def _register(what: str, blocks: dict[str, tuple[str, ...]]) -> None:
    @kind(f"{what}, in a layer", "state", blocks)
    def in_a_layer(ground: Ground) -> list[Place]:
        return _insert(ground, ground.variant)

    del in_a_layer


for _what, _blocks in IN_A_LAYER.items():
    _register(_what, _blocks)

ALONG_A_BEAD = {
    SINUMERIK: ("G641 ADIS=5", "BRISK", "G60", "G55", "G91", "M0"),
    LINUXCNC: ("G64 P5", "G55", "G61", "G91", "M0", "%"),
    PLAIN: ("G55", "G91", "M0", "G20", "%"),
}


@kind("mode along a bead", "state", ALONG_A_BEAD)
def along_a_bead(ground: Ground) -> list[Place]:
    """Change a mode with the beam on."""
    return _insert_in_bead(ground, ground.variant)


IN_A_SCAN = {SINUMERIK: ("G55", "G641 ADIS=5", "BRISK", "CTOL=0.5", "TRAFOOF", "M1")}


@kind("mode while it preheats", "state", IN_A_SCAN, subjects=(PREHEATED.name,))
def while_it_preheats(ground: Ground) -> list[Place]:
    """Change a mode in the subprogram that preheats."""
    text = ground.text
    scan = next(file for file in text.files if "_P0" in file)
    i = ground.pick(text.find(ground.text.codes.beam_on, scan))
    text.insert(scan, i, ground.variant)
    ground.what = f"{ground.variant} while it preheats"
    return ground.line(scan, i)


AT_THE_START = {
    SINUMERIK: ("G55", "G500", "G641 ADIS=5", "BRISK", "FFWOF", "G91", "TRANS X1", "G53"),
    LINUXCNC: ("G55", "G64 P5", "G91", "G92 X1", "G61", "G90.1", "G41.1 D1"),
    PLAIN: ("G55", "G91", "G92 X1", "G20"),
}


@kind("mode after the modes", "state", AT_THE_START)
def at_the_start(ground: Ground) -> list[Place]:
    """Undo a mode right after it is set."""
    text = ground.text
    file, i = _after_modes(text, layer=True)
    text.insert(file, i, ground.variant)
    ground.what = f"{ground.variant} after the modes of the first blocks"
    first = text.beads()[0]
    return [*ground.line(file, i, i + 3), *ground.line(first.file, first.travel, first.travel + 3)]


MISSING = {
    SINUMERIK: (
        "G17",
        "G71",
        "G90",
        "G94",
        "G54",
        "SOFT",
        "FFWON",
        "G642",
        "CTOL=0.05",
        "G40",
        "D0",
        "TRAFOOF",
        "TRANS",
        "COMPOF",
        "RTLION",
    ),
    LINUXCNC: ("G17", "G21", "G90", "G91.1", "G94", "G40", "G49", "G80", "G92.1", "G54", "G64 P0.05"),
    PLAIN: ("G17", "G21", "G90", "G94", "G40", "G49", "G80", "G92.1", "G54"),
}


def _replaced(ground: Ground, old: str, new: str) -> list[Place]:
    """Put other words in the place of some wherever they stand, or nothing."""
    text, places = ground.text, []
    pattern = re.compile(rf"(?<!\S){'G710?' if old == 'G71' else re.escape(old)}(?!\S)")
    for file, lines in text.files.items():
        for i in reversed(range(len(lines))):
            code = text.code(file, i)
            if pattern.search(code):
                text.set(file, i, " ".join(pattern.sub(new, code).split()))
                places += ground.line(file, max(i - 4, 0), i + 5)
                if not text.code(file, i):
                    text.delete(file, i)
    if not places:
        raise NotHereError
    first = text.beads()[0]
    return [*places, *ground.line(first.file, first.travel, first.travel + 3)]


@kind("mode missing", "state", MISSING)
def mode_missing(ground: Ground) -> list[Place]:
    """Take a word out of the program."""
    ground.what = f"{ground.variant} is missing"
    return _replaced(ground, ground.variant, "")


OTHER = {
    SINUMERIK: (("G54", "G55"), ("G90", "G91"), ("G71", "G70"), ("G17", "G18"), ("G94", "G95"), ("G642", "G64"), ("CTOL=0.05", "CTOL=0.5")),
    LINUXCNC: (("G54", "G55"), ("G90", "G91"), ("G21", "G20"), ("G91.1", "G90.1"), ("G64 P0.05", "G64 P0.5"), ("G94", "G93"), ("G49", "G43 H1")),
    PLAIN: (("G54", "G55"), ("G90", "G91"), ("G21", "G20"), ("G17", "G18"), ("G94", "G93")),
}  # fmt: skip


@kind("another mode", "state", OTHER)
def another_mode(ground: Ground) -> list[Place]:
    """Put another word of the same group in the first blocks."""
    old, new = ground.variant
    ground.what = f"{new} in place of {old}"
    return _replaced(ground, old, new)


@kind("beam on before the first layer", "state")
def early_beam(ground: Ground) -> list[Place]:
    """Switch the beam on in the first blocks."""
    text = ground.text
    file, i = _after_modes(text)
    on = {SINUMERIK: "M60", LINUXCNC: "M64 P0", PLAIN: "M3 S7200"}[text.control]
    off = {SINUMERIK: "M61", LINUXCNC: "M65 P0", PLAIN: "M5"}[text.control]
    blocks = [on, text.codes.pause_block.format(1.0), off]
    text.insert(file, i, *blocks)
    ground.what = "the beam burns for a second before the first motion"
    return ground.line(file, i, i + 4)


@kind("safe start deleted", "state", ("beam_off", "wire_off"))
def no_safe_start(ground: Ground) -> list[Place]:
    """Take out a switching off before the first layer."""
    text, first = ground.text, ground.text.beads()[0]
    layer = text.layers()[0]
    end = text.find(r"MAIN_L\d+")[0] if text.sinumerik else layer.first
    found = text.find(getattr(text.codes, ground.variant), end=end)
    if not found:
        raise NotHereError
    text.delete(text.main, found[0])
    ground.what = f"{ground.variant} is missing at the start"
    return [
        *ground.line(text.main, found[0] - 3, found[0] + 8),
        *ground.line(first.file, first.travel, first.on),
    ]


@kind("value left at the end", "state", ("power", "wire_speed", "voltage"))
def value_left(ground: Ground) -> list[Place]:
    """Leave beam or wire at a value after the last bead."""
    text = ground.text
    pattern = getattr(text.codes, ground.variant)
    last = text.layers()[-1].end if not text.sinumerik else text.find(r"MAIN_L\d+")[-1]
    found = [i for i in text.find(pattern) if i >= last]
    if not found:
        raise NotHereError
    text.delete(text.main, found[-1])
    ground.what = f"{ground.variant} is not set to zero at the end"
    return ground.line(text.main, last, len(text.files[text.main]))


@kind("ends beside its park position", "state")
def other_park(ground: Ground) -> list[Place]:
    """End elsewhere than the profile says."""
    text = ground.text
    last = text.layers()[-1].end if not text.sinumerik else text.find(r"MAIN_L\d+")[-1]
    found = [i for i in text.find(r"G0 X.*") if i >= last]
    if not found:
        raise NotHereError
    text.set(text.main, found[-1], "G0 X300 Y300")
    ground.what = "the program ends at X 300 Y 300"
    return ground.line(text.main, last, len(text.files[text.main]))


@kind("unknown auxiliary function", "state", {SINUMERIK: ("M77", "H9=1"), LINUXCNC: ("M64 P7", "M68 E5 Q1", "M110"), PLAIN: ("M42 P7 S1", "M80")})  # fmt: skip
def auxiliary(ground: Ground) -> list[Place]:
    """Switch something that the profile does not know."""
    return _insert(ground, ground.variant)

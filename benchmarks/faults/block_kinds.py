"""Faults of blocks and words: modes, offsets, program flow, codes of no meaning, and what a control reads otherwise than a reader."""

from __future__ import annotations

import re
from collections.abc import Callable

from benchmarks.faults.kinds import (
    LINUXCNC,
    METAL,
    MOTION,
    PLAIN,
    RECORD,
    SINUMERIK,
    STATE,
    Ground,
    NotHereError,
    Place,
    kind,
)
from benchmarks.faults.path_kinds import long_line
from benchmarks.faults.program_text import ProgramText
from benchmarks.faults.subjects import PREHEATED

MODES = r"G17 .*|G5[4-7]|G64.*|CTOL=.*|G40.*|TRANS"

# -- blocks put into a layer ---------------------------------------------------------------------------


def _in_a_layer(ground: Ground) -> list[Place]:
    """A block before the way to some bead, not the first."""
    bead = ground.pick(ground.text.beads()[1:])
    ground.text.insert(bead.file, bead.travel, ground.variant)
    return ground.line(bead.file, bead.travel, bead.first + 2)


def _before_second_layer(ground: Ground, *blocks: str) -> list[Place]:
    """Blocks before the way to the first bead of the second layer."""
    blocks = blocks or (ground.variant,)
    bead = next(b for b in ground.text.beads() if b.layer == 1)
    ground.text.insert(bead.file, bead.travel, *blocks)
    ground.what = f"{' | '.join(blocks)} in a layer"
    return ground.line(bead.file, bead.travel, bead.first + len(blocks))


def _along_a_bead(ground: Ground) -> list[Place]:
    bead = ground.bead(motions=3)
    i = bead.motions[1 + int(ground.random.integers(len(bead.motions) - 1))]
    ground.text.insert(bead.file, i, ground.variant)
    return ground.line(bead.file, i, i + 2)


def _while_it_preheats(ground: Ground) -> list[Place]:
    text = ground.text
    scan = next(file for file in text.files if "_P0" in file)
    return ground.insert(scan, ground.pick(text.find(text.codes.beam_on, scan)), ground.variant)


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

for touched, blocks in IN_A_LAYER.items():
    kind(f"{touched}, in a layer", STATE, _in_a_layer, blocks, what="{v} in a layer")


# -- first and last blocks -----------------------------------------------------------------------------


def _after_modes(text: ProgramText, layer: bool = False) -> tuple[str, int]:
    """File and line behind the modes of the first blocks; or of those of the first layer, where it has some."""
    first = text.layers()[0]
    if layer and (modes := text.find(MODES, first.file, first.first, text.beads()[0].travel)):
        return first.file, modes[-1] + 1
    return text.main, text.find(MODES, end=None if text.sinumerik else first.first)[-1] + 1


def _first_way(ground: Ground) -> list[Place]:
    """Lines at the way to the first bead."""
    first = ground.text.beads()[0]
    return ground.line(first.file, first.travel, first.travel + 3)


def _at_the_start(ground: Ground) -> list[Place]:
    """A mode, undone right after it is set."""
    file, i = _after_modes(ground.text, layer=True)
    ground.text.insert(file, i, ground.variant)
    return ground.line(file, i, i + 3) + _first_way(ground)


def _replaced(ground: Ground) -> list[Place]:
    """Other words in the place of some wherever they stand, or nothing."""
    old, new = ground.variant if isinstance(ground.variant, tuple) else (ground.variant, "")
    ground.facts.update(old=old, new=new)
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
    return places + _first_way(ground)


def _early_beam(ground: Ground) -> list[Place]:
    file, i = _after_modes(ground.text)
    on, off = {SINUMERIK: ("M60", "M61"), LINUXCNC: ("M64 P0", "M65 P0"), PLAIN: ("M3 S7200", "M5")}[
        ground.text.control
    ]
    ground.text.insert(file, i, on, ground.text.pause(1.0), off)
    return ground.line(file, i, i + 4)


def _no_safe_start(ground: Ground) -> list[Place]:
    """A switching off before the first layer."""
    text, first = ground.text, ground.text.beads()[0]
    end = text.find(r"MAIN_L\d+")[0] if text.sinumerik else text.layers()[0].first
    i = next(iter(text.find(getattr(text.codes, ground.variant), end=end)), None)
    if i is None:
        raise NotHereError
    text.delete(text.main, i)
    return ground.line(text.main, i - 3, i + 8) + ground.line(first.file, first.travel, first.on)


def _at_the_end(ground: Ground, park: bool = False) -> list[Place]:
    """The last value, or the last way, behind the last layer: deleted, or leading elsewhere."""
    text = ground.text
    last = text.find(r"MAIN_L\d+")[-1] if text.sinumerik else text.layers()[-1].end
    found = text.find(r"G0 X.*" if park else getattr(text.codes, ground.variant), first=last)
    if not found:
        raise NotHereError
    if park:
        text.set(text.main, found[-1], "G0 X300 Y300")
    else:
        text.delete(text.main, found[-1])
    return ground.line(text.main, last, len(text.files[text.main]))


# -- flow ----------------------------------------------------------------------------------------------

FLOW_BLOCKS = {
    "GOTOB": ("AGAIN:", "GOTOB AGAIN"), "REPEAT": ("AGAIN:", "REPEAT AGAIN P=2"), "LOOP": ("LOOP", "ENDLOOP"),
    "WHILE": ("WHILE TRUE", "ENDWHILE"), "EXTCALL": ('EXTCALL("OTHER")',), "repeat": ("O101 REPEAT [2]", "O101 ENDREPEAT"),
    "while": ("O101 WHILE [1]", "O101 ENDWHILE"), "M98": ("M98 P100 L2",), "label": ("N10:",), "M99 P1": ("M99 P1",),
    "GOTO": ("GOTO 10",),
}  # fmt: skip


def _again(ground: Ground) -> list[Place]:
    """Blocks that run twice or for ever."""
    text = ground.text
    if ground.variant in FLOW_BLOCKS:
        return _before_second_layer(ground, *FLOW_BLOCKS[ground.variant])
    i = text.find(r"MAIN_L\d+")[1]
    call = text.code(text.main, i)
    if ground.variant == "other case":
        text.files[f"{call}.SPF".lower()] = text.files[f"{call}.SPF"]
        text.insert(text.main, i, call.lower())
        ground.what = f"{call.lower()}  in the main program"
    else:
        text.set(text.main, i, f"{call} {call if ground.variant == 'twice' else ground.variant}")
        ground.what = f"{text.code(text.main, i)} in the main program"
    return ground.line(text.main, i, i + 2)


def _small_letters(ground: Ground) -> list[Place]:
    """A file beside a layer that a control takes for one of the same name."""
    text, name = ground.text, ground.text.layers()[1].file
    text.files[name.lower()] = list(text.files[name])
    ground.what = f"{name.lower()} beside {name}"
    return ground.line(text.main, 0, len(text.files[text.main]))


def _subprogram_added(ground: Ground) -> list[Place]:
    """A file that is no layer of the part."""
    text = ground.text
    call = text.find(r"MAIN_L\d+")[-1]
    text.files["PARK.SPF"] = [
        "%_N_PARK_SPF",
        ";$PATH=/_N_WKS_DIR/_N_EBAMCHECK_WPD",
        "; VALIDATED",
        "G0 Z60.0",
        "M17",
        "",
    ]
    if ground.variant == "called":
        call += 1
        text.insert(text.main, call, "PARK")
    return [*ground.line(text.main, call), Place("PARK.SPF", 1, 5)]


def _end_of_program(ground: Ground) -> list[Place]:
    text = ground.text
    i = text.find(r"M30|M2")[-1]
    if ground.variant == "deleted":
        text.delete(text.main, i)
    elif ground.variant == "another":
        text.set(text.main, i, "M17" if text.sinumerik else "M99")
    else:
        text.insert(text.main, i + 1, "G0 X10 Y10")
    return ground.line(text.main, i - 1, i + 2)


def _end_of_subprogram(ground: Ground) -> list[Place]:
    text, file = ground.text, ground.layer().file
    i = text.find("M17", file)[-1]
    if ground.variant == "deleted":
        text.delete(file, i)
    else:
        text.set(file, i, "M30")
    return ground.line(file, i - 1, i + 1)


# -- words ---------------------------------------------------------------------------------------------


def _instead(ground: Ground) -> list[Place]:
    """A block in the place of a motion of an island."""
    bead, i = long_line(ground)
    ground.text.set(bead.file, i, ground.variant)
    return ground.line(bead.file, i, i + 2)


TYPED: dict[str, Callable[[str], str]] = {
    "letter for a digit": lambda code: re.sub(r" Y(-?\d*)\d\.", r" Y\1O.", code),
    "comma for a point": lambda code: re.sub(r"( X-?\d+)\.", r"\1,", code),
    "unknown letter": lambda code: code.replace(" X", " V", 1),
    "word twice": lambda code: code + " X1.5",
    "exponent": lambda code: re.sub(r"( X-?\d+\.\d+)", r"\1E1", code),
    "no number": lambda code: re.sub(r" X-?\d+\.\d+", " X", code),
}
"""What is no word of the language."""


def _mistyped(ground: Ground) -> list[Place]:
    bead, i = ground.motion(r"G[123] ")
    ground.text.set(bead.file, i, TYPED[ground.variant](ground.text.code(bead.file, i)))
    return ground.line(bead.file, i)


def _hidden(ground: Ground) -> list[Place]:
    """A word or a block, turned into a comment."""
    text, bead = ground.text, ground.bead(motions=3)
    if ground.variant == "Y":
        lines = [(b, i) for b in text.beads() for i in b.motions if text.code(b.file, i).startswith("G1 ")]
        bead, i = ground.pick(
            [(b, i) for b, i in lines if abs(text.position(b.file, i)[1] - text.position(b.file, i + 1)[1]) > 3.0]
        )
        text.files[bead.file][i] = re.sub(r" Y", " ; Y", text.files[bead.file][i], count=1)
    elif ground.variant == "feed":
        bead = text.beads()[0]
        i = bead.first
        text.files[bead.file][i] = text.files[bead.file][i].replace(" F", " ; F")
    else:
        i = bead.off if ground.variant == "beam off" else ground.pick(text.ways(bead))
        text.files[bead.file][i] = f"; {text.code(bead.file, i)}"
    return ground.line(bead.file, i, bead.first + 1 if i < bead.first else i + 2)


def _skipped(ground: Ground) -> list[Place]:
    """A block that the operator's switch leaves out."""
    bead = ground.bead(motions=3)
    i = bead.motions[1] if ground.variant == "motion" else bead.off
    lines = ground.text.files[bead.file]
    lines[i] = f"{'!' if ground.text.sinumerik else ''}/{lines[i]}"
    return ground.line(bead.file, i)


# -- bytes and lines -----------------------------------------------------------------------------------


def _some_line(ground: Ground) -> tuple[str, int]:
    """File and line of a motion without a comment, not the first of its bead."""
    lines = [(b.file, i) for b in ground.text.beads() for i in b.motions[1:]]
    return ground.pick([(file, i) for file, i in lines if ";" not in ground.text.files[file][i]])


OF_BYTES: dict[str, Callable[[bytes], bytes]] = {
    "all": lambda data: data.replace(b"\n", b"\r\n"),
    "mark": lambda data: b"\xef\xbb\xbf" + data,
    "utf-16": lambda data: data.decode("latin-1").encode("utf-16"),
}
"""What is done to all bytes of a file."""
AT_THE_END = {"one": "\r", "byte": "\xe4", "NUL": "\0", "form feed": "\f", "DEL": "\x7f"}
"""What is put behind a block."""
BYTES = {
    "all": "CR LF throughout", "one": "CR LF in one line",
    "byte": "a letter with an accent", "mark": "a byte order mark", "utf-16": "UTF-16",
}  # fmt: skip


def _odd_bytes(ground: Ground) -> list[Place]:
    file, i = _some_line(ground)
    ground.what = BYTES[ground.variant]
    if ground.variant in OF_BYTES:
        ground.text.raw[file] = OF_BYTES[ground.variant]
        return ground.line(file, 0)
    ground.text.files[file][i] += AT_THE_END[ground.variant]
    return ground.line(file, i)


def _control_character(ground: Ground) -> list[Place]:
    bead = ground.bead(motions=2)
    return ground.replace(bead.file, bead.motions[1], "$", AT_THE_END[ground.variant])


def _cut_off(ground: Ground) -> list[Place]:
    file = ground.layer().file
    lines = ground.text.files[file]
    if ground.variant == "in a block":
        file, i = _some_line(ground)
        lines = ground.text.files[file]
        del lines[i + 1 :]
        lines[i] = lines[i][: lines[i].index(".") + 2]
    else:
        del lines[-2 if ground.variant == "last block" else 2 * len(lines) // 3 :]
    return ground.line(file, len(lines) - 2, len(lines) + 1)


def _block_number(ground: Ground) -> list[Place]:
    """A number that does not rise."""
    file, i = _some_line(ground)
    number = {"fall": "N5", "twice": "N10"}[ground.variant]
    ground.text.files[file][i] = f"!{number} {ground.text.files[file][i].partition(' ')[2]}"
    ground.facts["number"] = number
    return ground.line(file, i)


def _long_block(ground: Ground) -> list[Place]:
    """Blanks, so that the block is as long without its comment."""
    file, i = _some_line(ground)
    ground.text.files[file][i] = ground.text.code(file, i).replace(" ", " " * 110, 2)
    return ground.line(file, i)


# -- the kinds -------------------------------------------------------------------------------------------

# fmt: off
kind("unknown auxiliary function", STATE, _in_a_layer, what="{v} in a layer",
     variants={SINUMERIK: ("M77", "H9=1"), LINUXCNC: ("M64 P7", "M68 E5 Q1", "M110"), PLAIN: ("M42 P7 S1", "M80")})
kind("end of program in a layer", STATE, _before_second_layer, ("M30", "M2"))
kind("axis in a wait", MOTION, lambda g: _before_second_layer(g, f"{g.text.pause(2.0)} {g.variant}"), ("X50", "Z1"))
kind("mode along a bead", STATE, _along_a_bead, what="{v} along a bead", variants={
    SINUMERIK: ("G641 ADIS=5", "BRISK", "G60", "G55", "G91", "M0"),
    LINUXCNC: ("G64 P5", "G55", "G61", "G91", "M0", "%"),
    PLAIN: ("G55", "G91", "M0", "G20", "%"),
})
kind("mode while it preheats", STATE, _while_it_preheats, what="{v} while it preheats", subjects=(PREHEATED.name,),
     variants={SINUMERIK: ("G55", "G641 ADIS=5", "BRISK", "CTOL=0.5", "TRAFOOF", "M1")})
kind("mode after the modes", STATE, _at_the_start, what="{v} after the modes of the first blocks", variants={
    SINUMERIK: ("G55", "G500", "G641 ADIS=5", "BRISK", "FFWOF", "G91", "TRANS X1", "G53"),
    LINUXCNC: ("G55", "G64 P5", "G91", "G92 X1", "G61", "G90.1", "G41.1 D1"),
    PLAIN: ("G55", "G91", "G92 X1", "G20"),
})
kind("mode missing", STATE, _replaced, what="{v} is missing", variants={
    SINUMERIK: ("G17", "G71", "G90", "G94", "G54", "SOFT", "FFWON", "G642", "CTOL=0.05", "G40", "D0", "TRAFOOF", "TRANS", "COMPOF",
                "RTLION"),
    LINUXCNC: ("G17", "G21", "G90", "G91.1", "G94", "G40", "G49", "G80", "G92.1", "G54", "G64 P0.05"),
    PLAIN: ("G17", "G21", "G90", "G94", "G40", "G49", "G80", "G92.1", "G54"),
})
kind("another mode", STATE, _replaced, what="{new} in place of {old}", variants={
    SINUMERIK: (("G54", "G55"), ("G90", "G91"), ("G71", "G70"), ("G17", "G18"), ("G94", "G95"), ("G642", "G64"), ("CTOL=0.05", "CTOL=0.5")),
    LINUXCNC: (("G54", "G55"), ("G90", "G91"), ("G21", "G20"), ("G91.1", "G90.1"), ("G64 P0.05", "G64 P0.5"), ("G94", "G93"), ("G49", "G43 H1")),
    PLAIN: (("G54", "G55"), ("G90", "G91"), ("G21", "G20"), ("G17", "G18"), ("G94", "G93")),
})
kind("beam on before the first layer", STATE, _early_beam, what="the beam burns for a second before the first motion")
kind("safe start deleted", STATE, _no_safe_start, ("beam_off", "wire_off"), what="{v} is missing at the start")
kind("value left at the end", STATE, _at_the_end, ("power", "wire_speed", "voltage"), what="{v} is not set to zero at the end")
kind("ends beside its park position", STATE, _at_the_end, park=True, what="the program ends at X 300 Y 300")
kind("blocks run again", STATE, _again, {
    SINUMERIK: ("P2", "P=2", "twice", "GOTOB", "REPEAT", "LOOP", "WHILE", "EXTCALL", "other case"),
    LINUXCNC: ("repeat", "while", "M98", "label"),
    PLAIN: ("M98", "M99 P1", "GOTO", "label"),
})
kind("subprogram in small letters", STATE, _small_letters, controls=(SINUMERIK,))
kind("subprogram added", STATE, _subprogram_added, ("called", "not called"), controls=(SINUMERIK,), what="a further subprogram, {v}")
kind("end of program", STATE, _end_of_program, ("deleted", "another", "a block after it"), what="M30 or M2: {v}")
kind("end of a subprogram", STATE, _end_of_subprogram, ("deleted", "M30"), controls=(SINUMERIK,), what="M17: {v}")
kind("value that is worked out", MOTION, _instead, what="{v} in place of a motion", variants={
    SINUMERIK: ("G1 X=R1 Y=R2", "G1 X=IC(5) Y=IC(0)", "G1 X=AC(5) Y=AC(5)", "G1 X=DC(5)", "G1 X=5*2 Y=3", "G1 X=$AA_IW[X] Y=3"),
    LINUXCNC: ("G1 X#1 Y#2", "G1 X[5*2] Y3", "G1 X#<_x> Y3", "G1 X1 (5) Y3 [2]"),
    PLAIN: ("G1 X#1 Y#2", "G1 X[5*2] Y3", "G1 XR1 Y3"),
})
kind("polar coordinates", MOTION, _instead, what="{v} in place of a motion", variants={
    SINUMERIK: ("G1 AP=30 RP=10", "G110 X0 Y0", "G111 X5 Y5", "G0 RP=20 AP=45"),
    LINUXCNC: ("G1 @10 ^30", "G16"),
    PLAIN: ("G16", "G1 @10 ^30"),
})
kind("comment within words", MOTION, _instead, what="{v} in place of a motion", variants={
    SINUMERIK: ("G1 X1;0 Y5", 'MSG("G1") G1 X0 Y0', 'MSG("A") M60'),
    LINUXCNC: ("G1 X1(0)2.5 Y5", "G1 X2 (Y5", "G1 X2 (a (b) Y5)", "(MSG,x) G1 X0", "(DEBUG,#1) G1 X0 Y0"),
    PLAIN: ("G1 X1(0)2.5 Y5", "G1 X2 (Y5", "G1 X2 (a (b) Y5)"),
})
kind("two words of one group", MOTION, _instead, what="{v} in place of a motion", variants=(
    "G0 G1 X1 Y1", "G1 G0 X1 Y1", "G2 G1 X1 Y1", "G1 X1 Y1 G1 X2 Y2", "G54 G55", "G1 X--5 Y1", "G1 X1 Y1 F600 F60",
))
kind("mistyped word", STATE, _mistyped, tuple(TYPED))
kind("word behind a semicolon", METAL, _hidden, ("Y", "feed", "beam off", "way"), what="{v} stands in a comment")
kind("block that may be skipped", STATE, _skipped, ("motion", "beam off"), controls=(SINUMERIK, LINUXCNC), what="/ before a {v}")
kind("carriage returns", RECORD, _odd_bytes, ("all", "one"))
kind("encoding", RECORD, _odd_bytes, ("byte", "mark", "utf-16"))
kind("control characters", RECORD, _control_character, ("NUL", "form feed", "DEL"), what="{v} at the end of a block")
kind("file cut off", METAL, _cut_off, ("last block", "a third", "in a block"), what="the file ends early: {v}")
kind("block numbers", RECORD, _block_number, ("fall", "twice"), controls=(SINUMERIK,), what="{number} in the middle of a file")
kind("long block", RECORD, _long_block, what="a block of over 200 characters")
# fmt: on

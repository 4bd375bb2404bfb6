"""Faults of an attacker who knows the languages: words that a reader may pass over, and what a control does with them."""

from __future__ import annotations

import re
from collections.abc import Callable

from benchmarks.faults.kinds import LINUXCNC, PLAIN, SINUMERIK, Ground, NotHereError, Place, kind
from benchmarks.faults.metal_kinds import extra_bead
from benchmarks.faults.program_text import NUMBER, Bead
from benchmarks.faults.shapes import bounds

UNITS = {"mm/s": 1.0 / 60.0, "inch/min": 1.0 / 25.4, "m/min": 1e-3}


def _line(ground: Ground, least_mm: float = 3.0) -> tuple[Bead, int]:
    """A straight motion within an island, of some length."""
    text = ground.text
    found = [
        (b, i)
        for b in text.beads(contour=False)
        for i in b.motions[1:]
        if re.fullmatch(rf"G1 X{NUMBER} Y{NUMBER}", text.code(b.file, i))
        and max(
            abs(p - q) for p, q in zip(text.position(b.file, i), text.position(b.file, i + 1), strict=True)
        )
        > least_mm
    ]
    return ground.pick(found)


def _instead(ground: Ground, code: str) -> list[Place]:
    """Put a block in the place of a motion of an island."""
    bead, i = _line(ground)
    ground.text.set(bead.file, i, code)
    ground.what = f"{code} in place of a motion"
    return ground.line(bead.file, i, i + 2)


def _before_layer(ground: Ground, *blocks: str, layer: int = 1) -> list[Place]:
    """Put blocks before the travel to the first bead of a layer."""
    text = ground.text
    bead = next(b for b in text.beads() if b.layer == layer)
    text.insert(bead.file, bead.travel, *blocks)
    ground.what = f"{' | '.join(blocks)} in a layer"
    return ground.line(bead.file, bead.travel, bead.first + len(blocks))


# -- words that stand for other words -----------------------------------------------------------------

VALUES = {
    SINUMERIK: ("G1 X=R1 Y=R2", "G1 X=IC(5) Y=IC(0)", "G1 X=AC(5) Y=AC(5)", "G1 X=DC(5)", "G1 X=5*2 Y=3", "G1 X=$AA_IW[X] Y=3"),
    LINUXCNC: ("G1 X#1 Y#2", "G1 X[5*2] Y3", "G1 X#<_x> Y3", "G1 X1 (5) Y3 [2]"),
    PLAIN: ("G1 X#1 Y#2", "G1 X[5*2] Y3", "G1 XR1 Y3"),
}  # fmt: skip


@kind("value that is worked out", "motion", VALUES)
def worked_out(ground: Ground) -> list[Place]:
    """Give an axis a parameter, an expression or a distance."""
    return _instead(ground, ground.variant)


POLAR = {
    SINUMERIK: ("G1 AP=30 RP=10", "G110 X0 Y0", "G111 X5 Y5", "G0 RP=20 AP=45"),
    LINUXCNC: ("G1 @10 ^30", "G16"),
    PLAIN: ("G16", "G1 @10 ^30"),
}


@kind("polar coordinates", "motion", POLAR)
def polar(ground: Ground) -> list[Place]:
    """Command a motion by angle and radius, or move the pole."""
    return _instead(ground, ground.variant)


COMMENTED = {
    SINUMERIK: ("G1 X1;0 Y5", 'MSG("G1") G1 X0 Y0', 'MSG("A") M60'),
    LINUXCNC: ("G1 X1(0)2.5 Y5", "G1 X2 (Y5", "G1 X2 (a (b) Y5)", "(MSG,x) G1 X0", "(DEBUG,#1) G1 X0 Y0"),
    PLAIN: ("G1 X1(0)2.5 Y5", "G1 X2 (Y5", "G1 X2 (a (b) Y5)"),
}


@kind("comment within words", "motion", COMMENTED)
def comment_within(ground: Ground) -> list[Place]:
    """Put a comment or a message between words, or leave one open."""
    return _instead(ground, ground.variant)


TWO_WORDS = (
    "G0 G1 X1 Y1",
    "G1 G0 X1 Y1",
    "G2 G1 X1 Y1",
    "G1 X1 Y1 G1 X2 Y2",
    "G54 G55",
    "G1 X--5 Y1",
    "G1 X1 Y1 F600 F60",
)


@kind("two words of one group", "motion", TWO_WORDS)
def two_words(ground: Ground) -> list[Place]:
    """Put two words of one modal group into a block."""
    return _instead(ground, ground.variant)


# -- places that nobody looks at -----------------------------------------------------------------------


@kind("wait at the height of the beads", "state")
def low_wait(ground: Ground) -> list[Place]:
    """Wait after the descent to a bead, not before it."""
    text = ground.text
    found = [
        (b.file, i, k)
        for b in text.beads()
        for i in range(max(b.travel - 6, 0), b.on)
        for k in range(i + 1, b.on)
        if text.code(b.file, i).startswith("G4 ") and text.code(b.file, k).startswith("G0 Z")
    ]
    file, i, k = ground.pick(found)
    wait = text.code(file, i)
    text.insert(file, k + 1, wait)
    text.delete(file, i)
    ground.what = f"{wait} after the descent"
    return ground.line(file, i, k + 1)


@kind("subprogram in small letters", "state", controls=(SINUMERIK,))
def small_letters(ground: Ground) -> list[Place]:
    """Lay a file beside a layer that a control takes for one of the same name."""
    name = ground.text.layers()[1].file
    ground.text.files[name.lower()] = list(ground.text.files[name])
    ground.what = f"{name.lower()} beside {name}"
    return ground.line(ground.text.main, 0, len(ground.text.files[ground.text.main]))


# -- flow -----------------------------------------------------------------------------------------------

FLOW = {
    SINUMERIK: ("P2", "P=2", "twice", "GOTOB", "REPEAT", "LOOP", "WHILE", "EXTCALL", "other case"),
    LINUXCNC: ("repeat", "while", "M98", "label"),
    PLAIN: ("M98", "M99 P1", "GOTO", "label"),
}
FLOW_BLOCKS = {
    "GOTOB": ("AGAIN:", "GOTOB AGAIN"), "REPEAT": ("AGAIN:", "REPEAT AGAIN P=2"), "LOOP": ("LOOP", "ENDLOOP"),
    "WHILE": ("WHILE TRUE", "ENDWHILE"), "EXTCALL": ('EXTCALL("OTHER")',), "repeat": ("O101 REPEAT [2]", "O101 ENDREPEAT"),
    "while": ("O101 WHILE [1]", "O101 ENDWHILE"), "M98": ("M98 P100 L2",), "label": ("N10:",), "M99 P1": ("M99 P1",),
    "GOTO": ("GOTO 10",),
}  # fmt: skip


@kind("blocks run again", "state", FLOW)
def again(ground: Ground) -> list[Place]:
    """Run blocks twice or for ever."""
    text = ground.text
    if ground.variant in FLOW_BLOCKS:
        return _before_layer(ground, *FLOW_BLOCKS[ground.variant])
    i = text.find(r"MAIN_L\d+")[1]
    call = text.code(text.main, i)
    code = {
        "P2": f"{call} P2",
        "P=2": f"{call} P=2",
        "twice": f"{call} {call}",
        "other case": call.lower() + " ",
    }
    if ground.variant == "other case":
        name = f"{call}.SPF"
        text.files[name.lower()] = text.files[name]
        text.insert(text.main, i, call.lower())
    else:
        text.set(text.main, i, code[ground.variant])
    ground.what = f"{code[ground.variant]} in the main program"
    return ground.line(text.main, i, i + 2)


@kind("last layer missing", "metal")
def no_last_layer(ground: Ground) -> list[Place]:
    """Leave the last layer out, and what the text says of it."""
    text = ground.text
    layer = text.layers()[-1]
    ground.what = "the last layer is missing"
    if text.sinumerik:
        i = text.find(layer.file[:-4])[0]
        text.delete(text.main, i)
        del text.files[layer.file]
        return ground.line(text.main, i - 2, i + 2)
    text.delete(layer.file, layer.first, layer.end)
    return [Place(layer.file, max(layer.first - 12, 1), len(text.files[layer.file]))]


@kind("end of program in a layer", "state", ("M30", "M2"))
def early_end(ground: Ground) -> list[Place]:
    """End the program between two beads."""
    return _before_layer(ground, ground.variant)


# -- values ----------------------------------------------------------------------------------------------


@kind("feed in another unit", "metal", tuple(UNITS))
def feed_unit(ground: Ground) -> list[Place]:
    """Give every feed in another unit."""
    text, places = ground.text, []
    for file, i in text.everywhere(rf"(?:G[1235]|POLY) .* F{NUMBER}"):
        code = text.code(file, i)
        text.set(
            file, i, re.sub(rf"F({NUMBER})$", lambda m: f"F{float(m[1]) * UNITS[ground.variant]:g}", code)
        )
        places += ground.line(file, i, i + 2)
    ground.what = f"every feed in {ground.variant}"
    return places


def _number(ground: Ground, pattern: str, change: float, bead: Bead) -> list[Place]:
    text = ground.text
    found = text.find(pattern, bead.file, bead.travel, bead.off)
    if not found:
        raise NotHereError
    i = found[-1]
    code = text.code(bead.file, i)
    start = re.fullmatch(pattern, code).start(1)  # type: ignore[union-attr]
    text.set(bead.file, i, f"{code[:start]}{change * float(code[start:]):g}")
    return ground.line(bead.file, i, bead.off)


@kind("negative value", "state", ("wire_speed", "power"))
def negative(ground: Ground) -> list[Place]:
    """Turn the sign of the wire or of the beam of one bead."""
    ground.what = f"{ground.variant} of a bead is negative"
    pattern = getattr(ground.text.codes, ground.variant)
    beads = [b for b in ground.text.beads() if ground.text.find(pattern, b.file, b.travel, b.off)]
    return _number(ground, pattern, -1.0, ground.pick(beads))


@kind("spike along a bead", "metal", ("wire_speed", "power"))
def spike(ground: Ground) -> list[Place]:
    """Three times the wire, or the full current of the gun, for one motion of a bead."""
    text = ground.text
    bead, i = _line(ground, 5.0)
    block = {
        SINUMERIK: {"wire_speed": "H3=99", "power": "H2=240"},
        LINUXCNC: {"wire_speed": "M67 E2 Q99", "power": "M67 E1 Q240"},
        PLAIN: {"wire_speed": "M42 P1 S99", "power": "S14400"},
    }[text.control][ground.variant]
    text.insert(bead.file, i, block)
    ground.what = f"{block} before a motion of a bead"
    return ground.line(bead.file, i, bead.off)


CHANNELS = {SINUMERIK: ("H2=", "H3="), LINUXCNC: ("E1 ", "E2 ")}


@kind("channels exchanged", "state", controls=(SINUMERIK, LINUXCNC))
def channels(ground: Ground) -> list[Place]:
    """Put the current of a bead on the channel of the wire, and the other way round."""
    text = ground.text
    a, b = CHANNELS[text.control]
    bead = ground.bead()
    for i in range(bead.travel, bead.first):
        code = text.code(bead.file, i)
        text.set(bead.file, i, code.replace(a, "\0").replace(b, a).replace("\0", b))
    ground.what = "current and wire of a bead are exchanged"
    return ground.line(bead.file, bead.travel, bead.off)


@kind("wait under the beam at the end of a bead", "metal", (3.0,))
def end_wait(ground: Ground) -> list[Place]:
    """Stand with beam and wire on before they are switched off."""
    text, bead = ground.text, ground.bead()
    text.insert(bead.file, bead.last + 1, text.codes.pause_block.format(ground.variant))
    ground.what = "a wait before beam and wire are switched off"
    return ground.line(bead.file, bead.last, bead.off + 1)


@kind("axis in a wait", "motion", ("X50", "Z1"))
def moving_wait(ground: Ground) -> list[Place]:
    """Put an axis into the block of a wait."""
    return _before_layer(ground, f"{ground.text.codes.pause_block.format(2.0)} {ground.variant}")


# -- geometry ----------------------------------------------------------------------------------------------


@kind("full circle in a bead", "metal")
def circle(ground: Ground) -> list[Place]:
    """Drive a circle of 4 mm on the way."""
    text = ground.text
    bead, i = _line(ground)
    x, y = text.position(bead.file, i)
    text.insert(bead.file, i, f"G3 X{x:.6f} Y{y:.6f} I2.000000 J0.000000")
    ground.what = "a circle on the way of a bead"
    return ground.line(bead.file, i, i + 2)


@kind("Z creeps along a bead", "metal", (0.05, -0.05))
def creeping(ground: Ground) -> list[Place]:
    """Rise or sink a little along one motion."""
    text = ground.text
    bead, i = _line(ground)
    z = text.layers()[bead.layer].z + ground.variant
    text.set(bead.file, i, f"{text.code(bead.file, i)} Z{z:.6f}")
    ground.what = f"Z is {ground.variant:+g} mm from a motion on"
    return ground.line(bead.file, i, bead.off)


SPELLINGS: dict[str, Callable[[str], str]] = {
    "lower case": str.lower,
    "tabs": lambda code: code.replace(" ", "\t"),
    "no blanks": lambda code: code.replace(" ", ""),
    "leading zeros": lambda code: re.sub(r"\bG(\d)\b", r"G0\1", code),
}


@kind("bead beside the part in other letters", "metal", tuple(SPELLINGS))
def spelled(ground: Ground) -> list[Place]:
    """Spell a bead beside the part as a control takes it and a reader may not."""
    text = ground.text
    least, _ = bounds(text)
    bead = ground.pick([b for b in text.beads() if b.layer > 0])
    x, y = float(least[0]) - 40.0, float(least[1])
    before = len(text.files[bead.file])
    places = extra_bead(ground, bead, [(x, y), (x + 10.0, y)], "in a role")
    added = len(text.files[bead.file]) - before
    change = SPELLINGS[ground.variant]
    for i in range(bead.off + 1, bead.off + 1 + added):
        code = text.code(bead.file, i)
        if re.match(r"G[01] ", code):
            text.set(bead.file, i, change(code))
    ground.what = f"a bead beside the part, {ground.variant}"
    return places


@kind("control characters", "record", ("NUL", "form feed", "DEL"))
def characters(ground: Ground) -> list[Place]:
    """Put a byte of no meaning behind a block."""
    text, bead = ground.text, ground.bead(motions=2)
    i = bead.motions[1]
    line = {"NUL": "\0", "form feed": "\f", "DEL": "\x7f"}[ground.variant]
    text.set(bead.file, i, text.code(bead.file, i) + line)
    ground.what = f"{ground.variant} at the end of a block"
    return ground.line(bead.file, i, i + 1)

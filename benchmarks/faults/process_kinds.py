"""Faults of the process: beam, wire, feed and waits, and the order in which they are commanded."""

from __future__ import annotations

import re
from itertools import pairwise

from benchmarks.faults.kinds import (
    LINUXCNC,
    METAL,
    MOTION,
    PLAIN,
    SINUMERIK,
    STATE,
    Ground,
    NotHereError,
    Place,
    kind,
)
from benchmarks.faults.path_kinds import long_line
from benchmarks.faults.program_text import NUMBER, Bead
from benchmarks.faults.subjects import RETRACTING

Line = tuple[str, int]
"""File, and number of a line of it, counted from 0."""


def _numbers(ground: Ground, pattern: str) -> dict[Line, float]:
    """Number of every block of a kind."""
    text = ground.text
    found = {(f, i): re.fullmatch(pattern, text.code(f, i)) for f, i in text.everywhere(pattern)}
    return {line: float(m[1]) for line, m in found.items() if m}


def _scaled(ground: Ground, quantity: str, factor: float | None = None, lines: list[Line] | None = None) -> list[Place]:
    """Multiply the values of a quantity by the variant or a factor: all of them, or those of some lines."""
    text, places = ground.text, []
    pattern = getattr(text.codes, quantity)
    factor = ground.variant if factor is None else factor
    for (file, i), value in _numbers(ground, pattern).items():
        if lines is None or (file, i) in lines:
            code = text.code(file, i)
            start = re.fullmatch(pattern, code).start(1)  # type: ignore[union-attr]
            text.set(file, i, f"{code[:start]}{value * factor:.6f}".rstrip("0").rstrip("."))
            places += ground.line(file, i, i + 12)
    if not places:
        raise NotHereError
    return places


def _feeds(ground: Ground, factor: float, pattern: str = "(?!G4).*", lines: list[Line] | None = None) -> list[Place]:
    """Multiply the feeds of all motions or of those of some lines."""
    text, places = ground.text, []
    for file, i in text.everywhere(rf"{pattern} F{NUMBER}"):
        if lines is None or (file, i) in lines:
            changed = re.sub(rf"F({NUMBER})$", lambda m: f"F{float(m[1]) * factor:g}", text.code(file, i))
            text.set(file, i, changed)
            places += ground.line(file, i, i + 2)
    return places


def _of_bead(ground: Ground, quantity: str, bead: Bead) -> list[Line]:
    """Lines that set a quantity and belong to a bead: from its way on."""
    pattern = getattr(ground.text.codes, quantity)
    return [(bead.file, i) for i in ground.text.find(pattern, bead.file, bead.travel, bead.off)]


# -- all over ------------------------------------------------------------------------------------------


def _voltage(ground: Ground) -> list[Place]:
    first = ground.text.beads()[0]
    return _scaled(ground, "voltage") + ground.line(first.file, first.travel, first.first + 1)


UNITS = {"mm/s": 1.0 / 60.0, "inch/min": 1.0 / 25.4, "m/min": 1e-3}


# -- values of one bead --------------------------------------------------------------------------------


def _feed_of_bead(ground: Ground) -> list[Place]:
    bead = ground.bead()
    _feeds(ground, ground.variant, lines=[(bead.file, bead.first)])
    return ground.line(bead.file, bead.first, bead.off)


def _feed_within(ground: Ground) -> list[Place]:
    bead = ground.bead(motions=3)
    i = bead.motions[len(bead.motions) // 2]
    ground.replace(bead.file, i, "$", f" F{600 * ground.variant:g}")
    return ground.line(bead.file, i, bead.off)


def _feed_lost(ground: Ground) -> list[Place]:
    """The first feed of the program deleted, or digits of another lost."""
    bead = ground.text.beads()[0] if ground.variant == "deleted" else ground.bead()
    value = {"deleted": "", "zero": " F0", "a digit less": " F60"}[ground.variant]
    ground.replace(bead.file, bead.first, rf" F{NUMBER}$", value)
    return ground.line(bead.file, bead.first, bead.off)


def _wire_of_bead(ground: Ground) -> list[Place]:
    bead = ground.bead(motions=5)
    _scaled(ground, "wire_speed", lines=_of_bead(ground, "wire_speed", bead))
    return ground.line(bead.file, bead.travel, bead.off)


RETRACT = {SINUMERIK: rf"H4=({NUMBER})", LINUXCNC: rf"M68 E3 Q({NUMBER})", PLAIN: rf"M42 P2 S({NUMBER})"}


def _drawn_back_twice(ground: Ground) -> list[Place]:
    """The next bead begins without the wire."""
    text = ground.text
    bead, after = ground.pick([(a, b) for a, b in pairwise(text.beads()) if a.file == b.file])
    i = text.find(RETRACT[text.control], bead.file, bead.last, bead.off + 1)[0]
    return ground.insert(bead.file, i + 1 if ground.variant == "at once" else after.on, text.code(bead.file, i))


def _wire_step_deleted(ground: Ground) -> list[Place]:
    """A change of the wire speed along a bead of more than a tenth."""
    values = _numbers(ground, ground.text.codes.wire_speed)
    bead, (file, i) = ground.pick([
        (bead, b)
        for bead in ground.text.beads()
        for a, b in pairwise(_of_bead(ground, "wire_speed", bead))
        if b[1] > bead.first and abs(values[b] / max(values[a], 1e-9) - 1.0) > 0.1
    ])  # fmt: skip
    ground.text.delete(file, i)
    return ground.line(file, i - 1, bead.off)


def _power_of_bead(ground: Ground) -> list[Place]:
    """Another power before a bead, and the old one after it."""
    text, every = ground.text, ground.text.beads()
    values = _numbers(ground, text.codes.power)
    later = {line: [b for b in every if b.file == line[0] and b.on > line[1]] for line in values}
    file, i = ground.pick([line for line, value in values.items() if value and later[line]])
    bead = later[file, i][0]
    rows = [line for line in _of_bead(ground, "power", bead) if line[1] < bead.first]
    if rows:
        _scaled(ground, "power", lines=rows)
        return ground.line(file, bead.travel, bead.off)
    block = {SINUMERIK: "H2={:g}", LINUXCNC: "M67 E1 Q{:g}", PLAIN: "S{:g}"}[text.control]
    text.insert(file, bead.on, block.format(values[file, i] * ground.variant))
    return ground.line(file, bead.travel, bead.off + 1)


def _power_step_deleted(ground: Ground) -> list[Place]:
    """The power of a layer, so that the one before stays."""
    text, found = ground.text, []
    values = [(f, i, value) for (f, i), value in _numbers(ground, text.codes.power).items()]
    for (f, _, before), (file, i, value), (g, following, _) in zip(
        values, values[1:], [*values[2:], ("", 0, 0.0)], strict=False
    ):
        alone = not re.fullmatch(text.codes.beam_on, text.code(file, i))
        counts = text.find(text.codes.beam_on, file, i + 1, following + 1 if g == file else len(text.files[file]))
        if alone and counts and f == file and before > 0.0 and abs(value / before - 1.0) > 0.05:
            found.append((file, i))
    file, i = ground.pick(found)
    text.delete(file, i)
    if text.control == PLAIN:  # M3 carries the power, too: let it go on at the one before
        known = [v for (_, k), v in _numbers(ground, text.codes.power).items() if k < i]
        for k in text.find(text.codes.beam_on, file, i):
            text.set(file, k, f"M3 S{known[-1] if known else 7200:g}")
    return ground.line(file, i - 1, text.find(text.codes.beam_on, file, i)[0] + 12)


def _negative(ground: Ground) -> list[Place]:
    """The last value of the wire or of the beam in a bead with its sign turned."""
    text, pattern = ground.text, getattr(ground.text.codes, ground.variant)
    bead = ground.pick([b for b in text.beads() if text.find(pattern, b.file, b.travel, b.off)])
    i = text.find(pattern, bead.file, bead.travel, bead.off)[-1]
    code = text.code(bead.file, i)
    start = re.fullmatch(pattern, code).start(1)  # type: ignore[union-attr]
    text.set(bead.file, i, f"{code[:start]}{-float(code[start:]):g}")
    return ground.line(bead.file, i, bead.off)


SPIKES = {
    SINUMERIK: {"wire_speed": "H3=99", "power": "H2=240"},
    LINUXCNC: {"wire_speed": "M67 E2 Q99", "power": "M67 E1 Q240"},
    PLAIN: {"wire_speed": "M42 P1 S99", "power": "S14400"},
}
"""Three times the wire, and the full current of the gun."""


def _spike(ground: Ground) -> list[Place]:
    bead, i = long_line(ground, 5.0)
    ground.facts["block"] = SPIKES[ground.text.control][ground.variant]
    ground.text.insert(bead.file, i, ground.facts["block"])
    return ground.line(bead.file, i, bead.off)


CHANNELS = {SINUMERIK: ("H2=", "H3="), LINUXCNC: ("E1 ", "E2 ")}


def _channels_exchanged(ground: Ground) -> list[Place]:
    text, (a, b), bead = ground.text, CHANNELS[ground.text.control], ground.bead()
    for i in range(bead.travel, bead.first):
        text.set(bead.file, i, text.code(bead.file, i).replace(a, "\0").replace(b, a).replace("\0", b))
    return ground.line(bead.file, bead.travel, bead.off)


# -- switches and their order --------------------------------------------------------------------------


def _switch(ground: Ground, bead: Bead, which: str) -> int:
    """Line of a switch of a bead: of the first that switches on, and of those behind its last motion."""
    first = bead.on if which in ("beam_on", "wire_on") else bead.last
    return ground.text.find(getattr(ground.text.codes, which), bead.file, first, bead.off + 1)[0]


def _switch_deleted(ground: Ground) -> list[Place]:
    bead = ground.bead()
    i = _switch(ground, bead, ground.variant)
    ground.text.delete(bead.file, i)
    return ground.line(bead.file, i - 1, i + 4)


def _switch_moved(ground: Ground) -> list[Place]:
    """A switch on the other side of the motion beside it."""
    text, bead = ground.text, ground.bead(motions=3)
    name, side = ground.variant.rsplit(" ", 1)
    i = _switch(ground, bead, name.replace(" ", "_"))
    line = text.files[bead.file][i]
    ground.what = f"{name} comes {side}"
    if side == "early":
        at = bead.last
        text.delete(bead.file, i)
        text.insert(bead.file, at, line)
    else:
        ways = [k for k in range(bead.off + 1, len(text.files[bead.file])) if text.code(bead.file, k).startswith("G0")]
        if not ways and name.endswith("off"):
            raise NotHereError
        at = (ways[0] if name.endswith("off") else bead.first) + 1
        text.insert(bead.file, at, line)
        text.delete(bead.file, i)
    return ground.line(bead.file, min(i, at) - 1, max(i, at) + 1)


def _switch_order(ground: Ground) -> list[Place]:
    """Two blocks that switch or set, exchanged."""
    text, codes, beads = ground.text, ground.text.codes, ground.text.beads()

    def powers(bead: Bead) -> list[int]:
        return text.find(codes.power, bead.file, bead.travel, bead.on)

    bead = ground.pick([b for b in beads if powers(b)] if ground.variant == "power after beam on" else beads)
    one, other = {
        "wire on before beam on": lambda: (_switch(ground, bead, "beam_on"), _switch(ground, bead, "wire_on")),
        "beam off before wire off": lambda: (_switch(ground, bead, "wire_off"), _switch(ground, bead, "beam_off")),
        "wire speed after wire on": lambda: (
            text.find(codes.wire_speed, bead.file, bead.on, bead.first)[0], _switch(ground, bead, "wire_on")
        ),
        "power after beam on": lambda: (powers(bead)[0], _switch(ground, bead, "beam_on")),
    }[ground.variant]()  # fmt: skip
    lines = text.files[bead.file]
    lines[one], lines[other] = lines[other], lines[one]
    return ground.line(bead.file, min(one, other), max(one, other) + 2)


def _switched_twice(ground: Ground) -> list[Place]:
    bead = ground.bead()
    return ground.insert(bead.file, bead.first, ground.text.files[bead.file][_switch(ground, bead, ground.variant)])


def _on_at_the_end(ground: Ground) -> list[Place]:
    text, bead = ground.text, ground.text.beads()[-1]
    text.delete(bead.file, bead.off)
    places = ground.line(bead.file, bead.off - 1, len(text.files[bead.file]))
    return places + ([Place(text.main, 1, len(text.files[text.main]))] if text.sinumerik else [])


# -- waits ---------------------------------------------------------------------------------------------


def _wait(ground: Ground) -> list[Place]:
    """A wait of at least 10 s, spoilt."""
    text = ground.text
    seconds = {"negative": -10.0, "a day": 86400.0, "deleted": None, "a tenth": 1.5}[ground.variant]
    waits = _numbers(ground, text.codes.pause)
    file, i = ground.pick([line for line, s in waits.items() if s >= 10.0 and text.find(text.codes.beam_on, *line)])
    ground.facts["seconds"] = waits[file, i]
    if seconds is None:
        text.delete(file, i)
    else:
        text.set(file, i, text.pause(seconds))
    return ground.line(file, i - 1, text.find(text.codes.beam_on, file, i)[0] + 6)


def _wait_in_bead(ground: Ground) -> list[Place]:
    bead = ground.bead(motions=2)
    ground.text.insert(bead.file, bead.motions[1], ground.text.pause(ground.variant))
    return ground.line(bead.file, bead.motions[1], bead.motions[1] + 2)


def _wait_at_the_end(ground: Ground) -> list[Place]:
    bead = ground.bead()
    ground.text.insert(bead.file, bead.last + 1, ground.text.pause(ground.variant))
    return ground.line(bead.file, bead.last, bead.off + 1)


def _no_waits(ground: Ground) -> list[Place]:
    text, rows = ground.text, ground.text.everywhere(ground.text.codes.pause)
    if not rows:
        raise NotHereError
    for file, i in reversed(rows):
        text.delete(file, i)
    ground.facts["count"] = len(rows)
    return [Place(layer.file, layer.first + 1, layer.end) for layer in text.layers()]


def _low_wait(ground: Ground) -> list[Place]:
    """A wait after the descent to a bead, not before it."""
    text = ground.text
    before = [
        (b, i)
        for b in text.beads()
        for i in range(max(b.travel - 6, 0), b.on)
        if text.code(b.file, i).startswith("G4 ")
    ]
    bead, i, k = ground.pick([
        (b, i, k) for b, i in before for k in range(i + 1, b.on) if text.code(b.file, k).startswith("G0 Z")
    ])  # fmt: skip
    ground.facts["wait"] = text.code(bead.file, i)
    text.insert(bead.file, k + 1, ground.facts["wait"])
    text.delete(bead.file, i)
    return ground.line(bead.file, i, k + 1)


# -- the kinds -------------------------------------------------------------------------------------------

# fmt: off
kind("feed and wire halved everywhere", METAL, lambda g: _feeds(g, 0.5) + _scaled(g, "wire_speed", 0.5),
     what="feed and wire are half of what they should be in the whole program")
kind("volts and milliamperes exchanged", STATE, lambda g: _scaled(g, "voltage", 2.0) + _scaled(g, "power", 0.5),
     controls=(SINUMERIK, LINUXCNC), what="120 kV and half of every current")
kind("power everywhere", STATE, _scaled, (0.8, 1.2), quantity="power", what="power times {v:g} in the whole program")
kind("voltage", STATE, _voltage, (1.1, 0.5), controls=(SINUMERIK, LINUXCNC), what="voltage times {v:g}")
kind("wire speed everywhere", METAL, _scaled, (0.9, 1.1), quantity="wire_speed", what="wire times {v:g} in the whole program")
kind("feed in another unit", METAL, lambda g: _feeds(g, UNITS[g.variant], "(?:G[1235]|POLY) .*"), tuple(UNITS), what="every feed in {v}")
kind("feed of one bead", METAL, _feed_of_bead, (0.5, 0.9, 1.1, 3.0), what="feed of a bead times {v:g}")
kind("feed of part of a bead", METAL, _feed_within, (0.7, 1.5), what="feed times {v:g} from the middle of a bead on")
kind("feed word lost", MOTION, _feed_lost, ("deleted", "zero", "a digit less"), what="F of a bead: {v}")
kind("wire speed of one bead", METAL, _wire_of_bead, (0.5, 0.7, 1.3, 2.0, 0.0), what="wire of a bead times {v:g}")
kind("wire speed of one bead by a tenth", METAL, _wire_of_bead, (0.9, 1.1), what="wire of a bead times {v:g}",
     unseen="a tenth of the metal of one bead, which layers may be uneven by")
kind("wire drawn back twice", METAL, _drawn_back_twice, ("at once", "before the next bead"), subjects=(RETRACTING.name,),
     what="wire drawn back twice, {v}")
kind("step of the wire deleted", METAL, _wire_step_deleted, what="a change of the wire speed is missing",
     unseen="a share of the metal of part of a bead, which layers may be uneven by")
kind("power of one bead", METAL, _power_of_bead, (0.5, 1.15, 2.5), what="power of a bead times {v:g}")
kind("step of the power deleted", METAL, _power_step_deleted, what="the power of a layer is not set")
kind("negative value", STATE, _negative, ("wire_speed", "power"), what="{v} of a bead is negative")
kind("spike along a bead", METAL, _spike, ("wire_speed", "power"), what="{block} before a motion of a bead")
kind("channels exchanged", STATE, _channels_exchanged, controls=(SINUMERIK, LINUXCNC),
     what="current and wire of a bead are exchanged")
kind("switch deleted", METAL, _switch_deleted, ("beam_on", "beam_off", "wire_on", "wire_off"), what="{v} is missing")
kind("switch late or early", METAL, _switch_moved,
     ("beam off late", "wire off late", "beam on late", "wire on late", "beam off early"))
kind("order of switches", STATE, _switch_order,
     ("wire on before beam on", "beam off before wire off", "wire speed after wire on", "power after beam on"))
kind("switched twice", STATE, _switched_twice, ("beam_on", "wire_on"), what="{v} twice")
kind("beam left on at the end", STATE, _on_at_the_end, what="the last beam off is missing")
kind("wait of no sense", STATE, _wait, ("negative", "a day"), what="a wait of {seconds:g} s: {v}")
kind("wait shortened", STATE, _wait, ("deleted", "a tenth"), what="a wait of {seconds:g} s: {v}",
     unseen="a part that stays under its limit all the same needs no such wait")
kind("wait in a bead", METAL, _wait_in_bead, (2.0,), what="a wait of {v:g} s under the beam")
kind("wait under the beam at the end of a bead", METAL, _wait_at_the_end, (3.0,),
     what="a wait before beam and wire are switched off")
kind("waits deleted everywhere", STATE, _no_waits, what="{count} waits are missing")
kind("wait at the height of the beads", STATE, _low_wait, what="{wait} after the descent")
# fmt: on

"""Faults of the process: beam, wire, feed and waits, and the order in which they are commanded."""

from __future__ import annotations

import itertools
import re

from benchmarks.faults.kinds import LINUXCNC, PLAIN, SINUMERIK, Ground, NotHereError, Place, kind
from benchmarks.faults.program_text import NUMBER, Bead
from benchmarks.faults.subjects import RETRACTING


def _numbers(ground: Ground, pattern: str) -> list[tuple[str, int, float]]:
    """File, line and number of every block of a kind."""
    text = ground.text
    found = [(f, i, re.fullmatch(pattern, text.code(f, i))) for f, i in text.everywhere(pattern)]
    return [(f, i, float(m[1])) for f, i, m in found if m]


def _scale(
    ground: Ground, pattern: str, factor: float, lines: list[tuple[str, int]] | None = None
) -> list[Place]:
    """Multiply the numbers of blocks, all of a kind or those of some lines."""
    text, places = ground.text, []
    for file, i, value in _numbers(ground, pattern):
        if lines is None or (file, i) in lines:
            code = text.code(file, i)
            start = re.fullmatch(pattern, code).start(1)  # type: ignore[union-attr]
            text.set(file, i, f"{code[:start]}{value * factor:.6f}".rstrip("0").rstrip("."))
            places += ground.line(file, i, i + 12)
    if not places:
        raise NotHereError
    return places


def _feeds(ground: Ground, factor: float, lines: set[tuple[str, int]] | None = None) -> list[Place]:
    """Multiply the feeds of all motions or of some lines."""
    text, places = ground.text, []
    for file, i in text.everywhere(rf".* F{NUMBER}"):
        if not text.code(file, i).startswith("G4") and (lines is None or (file, i) in lines):
            text.set(
                file, i, re.sub(rf"F({NUMBER})$", lambda m: f"F{float(m[1]) * factor:g}", text.code(file, i))
            )
            places += ground.line(file, i, i + 2)
    return places


def _of_bead(ground: Ground, pattern: str, bead: Bead, inner: bool = False) -> list[tuple[str, int]]:
    """Lines of a kind that belong to a bead: from its travel on, or between its motions."""
    first = bead.first if inner else bead.travel
    return [(bead.file, i) for i in ground.text.find(pattern, bead.file, first, bead.off)]


# -- all over ------------------------------------------------------------------------------------------


@kind("feed and wire halved everywhere", "metal")
def halved(ground: Ground) -> list[Place]:
    """The same metal at half the feed: twice the line energy."""
    places = _feeds(ground, 0.5) + _scale(ground, ground.text.codes.wire_speed, 0.5)
    ground.what = "feed and wire are half of what they should be in the whole program"
    return places


@kind("volts and milliamperes exchanged", "state", controls=(SINUMERIK, LINUXCNC))
def exchanged(ground: Ground) -> list[Place]:
    """Twice the voltage and half the current: the same power."""
    codes = ground.text.codes
    places = _scale(ground, codes.voltage, 2.0) + _scale(ground, codes.power, 0.5)
    ground.what = "120 kV and half of every current"
    return places


@kind("power everywhere", "state", (0.8, 1.2))
def power_everywhere(ground: Ground) -> list[Place]:
    """Change the power of every bead by the same share."""
    ground.what = f"power times {ground.variant:g} in the whole program"
    return _scale(ground, ground.text.codes.power, ground.variant)


@kind("voltage", "state", (1.1, 0.5), controls=(SINUMERIK, LINUXCNC))
def voltage(ground: Ground) -> list[Place]:
    """Change the accelerating voltage."""
    ground.what = f"voltage times {ground.variant:g}"
    places = _scale(ground, ground.text.codes.voltage, ground.variant)
    first = ground.text.beads()[0]
    return [*places, *ground.line(first.file, first.travel, first.first + 1)]


# -- one bead --------------------------------------------------------------------------------------------


@kind("feed of one bead", "metal", (0.5, 0.9, 1.1, 3.0))
def feed_of_bead(ground: Ground) -> list[Place]:
    """Change the feed of one bead."""
    bead = ground.bead()
    ground.what = f"feed of a bead times {ground.variant:g}"
    _feeds(ground, ground.variant, {(bead.file, bead.first)})
    return ground.line(bead.file, bead.first, bead.off)


@kind("feed of part of a bead", "metal", (0.7, 1.5))
def feed_within(ground: Ground) -> list[Place]:
    """Change the feed half-way along a bead."""
    text, bead = ground.text, ground.bead(motions=3)
    i = bead.motions[len(bead.motions) // 2]
    text.set(bead.file, i, f"{text.code(bead.file, i)} F{600 * ground.variant:g}")
    ground.what = f"feed times {ground.variant:g} from the middle of a bead on"
    return ground.line(bead.file, i, bead.off)


@kind("feed word lost", "motion", ("deleted", "zero", "a digit less"))
def feed_lost(ground: Ground) -> list[Place]:
    """Lose the first feed of the program, or digits of another."""
    text, bead = ground.text, ground.text.beads()[0] if ground.variant == "deleted" else ground.bead()
    code = text.code(bead.file, bead.first)
    value = {"deleted": "", "zero": " F0", "a digit less": " F60"}[ground.variant]
    text.set(bead.file, bead.first, re.sub(rf" F{NUMBER}$", value, code))
    ground.what = f"F of a bead: {ground.variant}"
    return ground.line(bead.file, bead.first, bead.off)


@kind("wire speed of one bead", "metal", (0.5, 0.7, 1.3, 2.0, 0.0))
def wire_of_bead(ground: Ground) -> list[Place]:
    """Change the wire speed of one bead."""
    text, bead = ground.text, ground.bead(motions=5)
    ground.what = f"wire of a bead times {ground.variant:g}"
    _scale(ground, text.codes.wire_speed, ground.variant, _of_bead(ground, text.codes.wire_speed, bead))
    return ground.line(bead.file, bead.travel, bead.off)


@kind("wire speed of one bead by a tenth", "metal", (0.9, 1.1), unseen="a tenth of the metal of one bead, which layers may be uneven by")  # fmt: skip
def wire_of_bead_a_little(ground: Ground) -> list[Place]:
    """Change the wire speed of one bead by less than what the text's metal shows."""
    return wire_of_bead(ground)


RETRACT = {SINUMERIK: rf"H4=({NUMBER})", LINUXCNC: rf"M68 E3 Q({NUMBER})", PLAIN: rf"M42 P2 S({NUMBER})"}


@kind("wire drawn back twice", "metal", ("at once", "before the next bead"), subjects=(RETRACTING.name,))
def drawn_back_twice(ground: Ground) -> list[Place]:
    """Draw the wire back once more: the next bead begins without it."""
    text = ground.text
    bead, after = ground.pick([(a, b) for a, b in itertools.pairwise(text.beads()) if a.file == b.file])
    found = text.find(RETRACT[text.control], bead.file, bead.last, bead.off + 1)
    at = found[0] + 1 if ground.variant == "at once" else after.on
    text.insert(bead.file, at, text.code(bead.file, found[0]))
    ground.what = f"wire drawn back twice, {ground.variant}"
    return ground.line(bead.file, at)


@kind("wire speed everywhere", "metal", (0.9, 1.1))
def wire_everywhere(ground: Ground) -> list[Place]:
    """Change the wire speed of all beads."""
    ground.what = f"wire times {ground.variant:g} in the whole program"
    return _scale(ground, ground.text.codes.wire_speed, ground.variant)


@kind("step of the wire deleted", "metal", unseen="a share of the metal of part of a bead, which layers may be uneven by")  # fmt: skip
def wire_step_deleted(ground: Ground) -> list[Place]:
    """Take out a change of the wire speed along a bead of more than a tenth."""
    text = ground.text
    numbers = {(f, i): v for f, i, v in _numbers(ground, text.codes.wire_speed)}
    found = []
    for bead in text.beads():
        rows = _of_bead(ground, text.codes.wire_speed, bead)
        found += [
            (bead, b)
            for a, b in itertools.pairwise(rows)
            if b[1] > bead.first and abs(numbers[b] / max(numbers[a], 1e-9) - 1.0) > 0.1
        ]
    bead, (file, i) = ground.pick(found)
    text.delete(file, i)
    ground.what = "a change of the wire speed is missing"
    return ground.line(file, i - 1, bead.off)


@kind("power of one bead", "metal", (0.5, 1.15, 2.5))
def power_of_bead(ground: Ground) -> list[Place]:
    """Set another power before a bead, and the old one after it."""
    text = ground.text
    every = text.beads()
    settings = _numbers(ground, text.codes.power)
    file, i, value = ground.pick(
        [x for x in settings if x[2] and any(b.file == x[0] and b.on > x[1] for b in every)]
    )
    blocks = {SINUMERIK: "H2={:g}", LINUXCNC: "M67 E1 Q{:g}", PLAIN: "S{:g}"}
    bead = next(b for b in every if b.file == file and b.on > i)
    rows = [x for x in _of_bead(ground, text.codes.power, bead) if x[1] < bead.first]
    if rows:
        _scale(ground, text.codes.power, ground.variant, rows)
        last = bead.off
    else:
        text.insert(file, bead.on, blocks[text.control].format(value * ground.variant))
        last = bead.off + 1
    ground.what = f"power of a bead times {ground.variant:g}"
    return ground.line(file, bead.travel, last)


@kind("step of the power deleted", "metal")
def power_step_deleted(ground: Ground) -> list[Place]:
    """Take out the power of a layer, so that the one before stays."""
    text = ground.text
    found = []
    settings = _numbers(ground, text.codes.power)
    for (f, _, before), (file, i, value), (g, following, _) in zip(
        settings, settings[1:], [*settings[2:], ("", 0, 0.0)], strict=False
    ):
        alone = not re.fullmatch(text.codes.beam_on, text.code(file, i))
        end = following + 1 if g == file else len(text.files[file])
        counts = text.find(text.codes.beam_on, file, i + 1, end)
        changes = f == file and before > 0.0 and abs(value / before - 1.0) > 0.05
        if alone and changes and counts:
            found.append((file, i))
    file, i = ground.pick(found)
    text.delete(file, i)
    if text.control == PLAIN:  # M3 carries the power, too
        _same_power(ground, file, i)
    on = text.find(text.codes.beam_on, file, i)[0]
    ground.what = "the power of a layer is not set"
    return ground.line(file, i - 1, on + 12)


def _same_power(ground: Ground, file: str, i: int) -> None:
    """Let the beam of plain G-code go on at the power that was set before a line."""
    text = ground.text
    before = [v for f, k, v in _numbers(ground, text.codes.power) if k < i]
    for k in text.find(text.codes.beam_on, file, i):
        text.set(file, k, f"M3 S{before[-1] if before else 7200:g}")


# -- switches and their order --------------------------------------------------------------------------


def _switch(ground: Ground, bead: Bead, which: str) -> int:
    pattern = getattr(ground.text.codes, which)
    first = bead.on if which in ("beam_on", "wire_on") else bead.last
    return ground.text.find(pattern, bead.file, first, bead.off + 1)[0]


@kind("switch deleted", "metal", ("beam_on", "beam_off", "wire_on", "wire_off"))
def switch_deleted(ground: Ground) -> list[Place]:
    """Take a switch of beam or wire out."""
    bead = ground.bead()
    i = _switch(ground, bead, ground.variant)
    ground.text.delete(bead.file, i)
    ground.what = f"{ground.variant} is missing"
    return ground.line(bead.file, i - 1, i + 4)


@kind(
    "switch late or early",
    "metal",
    ("beam off late", "wire off late", "beam on late", "wire on late", "beam off early"),
)
def switch_moved(ground: Ground) -> list[Place]:
    """Move a switch over the motion beside it."""
    text, bead = ground.text, ground.bead(motions=3)
    name, side = ground.variant.rsplit(" ", 1)
    which = name.replace(" ", "_")
    i = _switch(ground, bead, which)
    line = text.files[bead.file][i]
    if side == "early":
        text.delete(bead.file, i)
        text.insert(bead.file, bead.last, line)
        at = bead.last
    else:
        at = bead.first + 1 if which.endswith("on") else next(
            (k for k in range(bead.off + 1, len(text.files[bead.file])) if text.code(bead.file, k).startswith("G0")), -1
        ) + 1  # fmt: skip
        if at <= 0:
            raise NotHereError
        text.insert(bead.file, at, line)
        text.delete(bead.file, i)
    ground.what = f"{name} comes {side}"
    return ground.line(bead.file, min(i, at) - 1, max(i, at) + 1)


@kind("order of switches", "state", ("wire on before beam on", "beam off before wire off", "wire speed after wire on", "power after beam on"))  # fmt: skip
def switch_order(ground: Ground) -> list[Place]:
    """Exchange two blocks that switch or set."""
    text = ground.text
    lines = text.files
    codes = text.codes
    beads = text.beads()
    if ground.variant == "power after beam on":
        beads = [b for b in beads if [x for x in _of_bead(ground, codes.power, b) if b.travel <= x[1] < b.on]]
    bead = ground.pick(beads)
    if ground.variant == "wire on before beam on":
        i, j = _switch(ground, bead, "beam_on"), _switch(ground, bead, "wire_on")
    elif ground.variant == "beam off before wire off":
        i, j = _switch(ground, bead, "wire_off"), _switch(ground, bead, "beam_off")
    elif ground.variant == "wire speed after wire on":
        i, j = (
            text.find(codes.wire_speed, bead.file, bead.on, bead.first)[0],
            _switch(ground, bead, "wire_on"),
        )
    else:
        i, j = _of_bead(ground, codes.power, bead)[0][1], _switch(ground, bead, "beam_on")
    some = lines[bead.file]
    some[i], some[j] = some[j], some[i]
    ground.what = ground.variant
    return ground.line(bead.file, min(i, j), max(i, j) + 2)


@kind("switched twice", "state", ("beam_on", "wire_on"))
def switched_twice(ground: Ground) -> list[Place]:
    """Switch on what is on."""
    bead = ground.bead()
    i = _switch(ground, bead, ground.variant)
    ground.text.insert(bead.file, bead.first, ground.text.files[bead.file][i])
    ground.what = f"{ground.variant} twice"
    return ground.line(bead.file, bead.first)


@kind("beam left on at the end", "state")
def on_at_end(ground: Ground) -> list[Place]:
    """Take out the last switching off of the beam."""
    text = ground.text
    bead = text.beads()[-1]
    text.delete(bead.file, bead.off)
    ground.what = "the last beam off is missing"
    places = ground.line(bead.file, bead.off - 1, len(text.files[bead.file]))
    return places + ([Place(text.main, 1, len(text.files[text.main]))] if text.sinumerik else [])


# -- waits -----------------------------------------------------------------------------------------------


@kind("wait of no sense", "state", ("negative", "a day"))
def senseless_wait(ground: Ground) -> list[Place]:
    """Let a wait be negative, or longer than any part needs."""
    return _wait(ground, {"negative": -10.0, "a day": 86400.0}[ground.variant])


@kind("wait shortened", "state", ("deleted", "a tenth"), unseen="a part that stays under its limit all the same needs no such wait")  # fmt: skip
def short_wait(ground: Ground) -> list[Place]:
    """Spoil one wait of at least 10 s."""
    return _wait(ground, {"deleted": None, "a tenth": 1.5}[ground.variant])


def _wait(ground: Ground, seconds: float | None) -> list[Place]:
    text = ground.text
    waits = _numbers(ground, text.codes.pause)
    file, i, value = ground.pick(
        [x for x in waits if x[2] >= 10.0 and text.find(text.codes.beam_on, x[0], x[1])]
    )
    if seconds is None:
        text.delete(file, i)
    else:
        text.set(file, i, text.codes.pause_block.format(seconds))
    on = text.find(text.codes.beam_on, file, i)[0]
    ground.what = f"a wait of {value:g} s: {ground.variant}"
    return ground.line(file, i - 1, on + 6)


@kind("wait in a bead", "metal", (2.0,))
def wait_in_bead(ground: Ground) -> list[Place]:
    """Stand still with beam and wire on."""
    text, bead = ground.text, ground.bead(motions=2)
    text.insert(bead.file, bead.motions[1], text.codes.pause_block.format(ground.variant))
    ground.what = f"a wait of {ground.variant:g} s under the beam"
    return ground.line(bead.file, bead.motions[1], bead.motions[1] + 2)


@kind("waits deleted everywhere", "state")
def no_waits(ground: Ground) -> list[Place]:
    """Take out every wait."""
    text = ground.text
    rows = text.everywhere(text.codes.pause)
    if not rows:
        raise NotHereError
    for file, i in reversed(rows):
        text.delete(file, i)
    ground.what = f"{len(rows)} waits are missing"
    return [Place(layer.file, layer.first + 1, layer.end) for layer in text.layers()]

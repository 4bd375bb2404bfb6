"""Faults of the text as bytes and blocks: cut off, wrongly coded, hidden in comments, or with words of no meaning."""

from __future__ import annotations

import re

from benchmarks.faults.kinds import LINUXCNC, SINUMERIK, Ground, Place, kind
from benchmarks.faults.program_text import Bead


def _some_file(ground: Ground) -> tuple[str, int]:
    """A file, and a line of some bead in it."""
    lines = ground.text.files
    return ground.pick(
        [(b.file, i) for b in ground.text.beads() for i in b.motions[1:] if ";" not in lines[b.file][i]]
    )


@kind("carriage returns", "record", ("all", "one"))
def carriage_returns(ground: Ground) -> list[Place]:
    """End lines with CR LF."""
    file, i = _some_file(ground)
    if ground.variant == "all":
        ground.text.raw[file] = lambda data: data.replace(b"\n", b"\r\n")
        ground.what = "CR LF throughout"
        return ground.line(file, 0, 1)
    ground.text.files[file][i] += "\r"
    ground.what = "CR LF in one line"
    return ground.line(file, i)


@kind("encoding", "record", ("byte", "mark", "utf-16"))
def encoding(ground: Ground) -> list[Place]:
    """Put bytes into a file that are not ASCII."""
    file, i = _some_file(ground)
    ground.what = {"byte": "a letter with an accent", "mark": "a byte order mark", "utf-16": "UTF-16"}[
        ground.variant
    ]
    if ground.variant == "byte":
        ground.text.files[file][i] += "\xe4"
        return ground.line(file, i)
    change = {
        "mark": lambda data: b"\xef\xbb\xbf" + data,
        "utf-16": lambda data: data.decode("latin-1").encode("utf-16"),
    }
    ground.text.raw[file] = change[ground.variant]
    return ground.line(file, 0)


@kind("file cut off", "metal", ("last block", "a third", "in a block"))
def cut_off(ground: Ground) -> list[Place]:
    """End a file before its end."""
    text = ground.text
    layer = ground.layer()
    file = layer.file
    lines = text.files[file]
    if ground.variant == "last block":
        del lines[-2:]
    elif ground.variant == "a third":
        del lines[2 * len(lines) // 3 :]
    else:
        file, i = _some_file(ground)
        lines = text.files[file]
        del lines[i + 1 :]
        lines[i] = lines[i][: lines[i].index(".") + 2]
    ground.what = f"the file ends early: {ground.variant}"
    return ground.line(file, len(lines) - 2, len(lines) + 1)


@kind("end of program", "state", ("deleted", "another", "a block after it"))
def end_of_program(ground: Ground) -> list[Place]:
    """Spoil the end of the main program."""
    text = ground.text
    i = text.find(r"M30|M2")[-1]
    if ground.variant == "deleted":
        text.delete(text.main, i)
    elif ground.variant == "another":
        text.set(text.main, i, "M17" if text.sinumerik else "M99")
    else:
        text.insert(text.main, i + 1, "G0 X10 Y10")
    ground.what = f"M30 or M2: {ground.variant}"
    return ground.line(text.main, i - 1, i + 2)


@kind("end of a subprogram", "state", ("deleted", "M30"), controls=(SINUMERIK,))
def end_of_subprogram(ground: Ground) -> list[Place]:
    """Spoil M17."""
    text, layer = ground.text, ground.layer()
    i = text.find("M17", layer.file)[-1]
    if ground.variant == "deleted":
        text.delete(layer.file, i)
    else:
        text.set(layer.file, i, "M30")
    ground.what = f"M17: {ground.variant}"
    return ground.line(layer.file, i - 1, i + 1)


@kind("block numbers", "record", ("fall", "twice"), controls=(SINUMERIK,))
def block_numbers(ground: Ground) -> list[Place]:
    """Give a block a number that does not rise."""
    file, i = _some_file(ground)
    number = {"fall": "N5", "twice": "N10"}[ground.variant]
    ground.text.files[file][i] = f"!{number} {ground.text.files[file][i].partition(' ')[2]}"
    ground.what = f"{number} in the middle of a file"
    return ground.line(file, i)


@kind("long block", "record")
def long_block(ground: Ground) -> list[Place]:
    """Write a block of more characters than a control reads."""
    file, i = _some_file(ground)
    # Blanks, so that it is as long without its comment.
    code = ground.text.code(file, i)
    ground.text.files[file][i] = code.replace(" ", " " * 110, 2)
    ground.what = "a block of over 200 characters"
    return ground.line(file, i)


@kind("mistyped word", "state", ("letter for a digit", "comma for a point", "unknown letter", "word twice", "exponent", "no number"))  # fmt: skip
def mistyped(ground: Ground) -> list[Place]:
    """Write what is no word of the language."""
    text = ground.text
    beads = [(b, i) for b in text.beads() for i in b.motions if re.match(r"G[123] ", text.code(b.file, i))]
    bead, i = ground.pick(beads)
    code = text.code(bead.file, i)
    edits = {
        "letter for a digit": lambda: re.sub(r" Y(-?\d*)\d\.", r" Y\1O.", code),
        "comma for a point": lambda: re.sub(r"( X-?\d+)\.", r"\1,", code),
        "unknown letter": lambda: code.replace(" X", " V", 1),
        "word twice": lambda: code + " X1.5",
        "exponent": lambda: re.sub(r"( X-?\d+\.\d+)", r"\1E1", code),
        "no number": lambda: re.sub(r" X-?\d+\.\d+", " X", code),
    }
    text.set(bead.file, i, edits[ground.variant]())
    ground.what = ground.variant
    return ground.line(bead.file, i)


@kind("word behind a semicolon", "metal", ("Y", "feed", "beam off", "way"))
def hidden_word(ground: Ground) -> list[Place]:
    """Turn a word or a block into a comment."""
    text = ground.text
    bead: Bead = ground.bead(motions=3)
    if ground.variant == "Y":
        found = [(b, i) for b in text.beads() for i in b.motions if text.code(b.file, i).startswith("G1 ")
                 and abs(text.position(b.file, i)[1] - text.position(b.file, i + 1)[1]) > 3.0]  # fmt: skip
        bead, i = ground.pick(found)
        text.files[bead.file][i] = re.sub(r" Y", " ; Y", text.files[bead.file][i], count=1)
    elif ground.variant == "feed":
        bead = text.beads()[0]
        i = bead.first
        text.files[bead.file][i] = text.files[bead.file][i].replace(" F", " ; F")
    elif ground.variant == "beam off":
        i = bead.off
        text.files[bead.file][i] = f"; {text.code(bead.file, i)}"
    else:
        ways = [i for i in range(bead.travel, bead.on) if text.code(bead.file, i).startswith("G0 X")]
        i = ground.pick(ways)
        text.files[bead.file][i] = f"; {text.code(bead.file, i)}"
    ground.what = f"{ground.variant} stands in a comment"
    return ground.line(bead.file, i, bead.first + 1 if i < bead.first else i + 2)


@kind("block that may be skipped", "state", ("motion", "beam off"), controls=(SINUMERIK, LINUXCNC))
def skipped(ground: Ground) -> list[Place]:
    """Mark a block so that the operator's switch leaves it out."""
    bead: Bead = ground.bead(motions=3)
    i = bead.motions[1] if ground.variant == "motion" else bead.off
    line = ground.text.files[bead.file][i]
    ground.text.files[bead.file][i] = f"!/{line}" if ground.text.sinumerik else f"/{line}"
    ground.what = f"/ before a {ground.variant}"
    return ground.line(bead.file, i)


@kind("subprogram added", "state", ("called", "not called"), controls=(SINUMERIK,))
def subprogram_added(ground: Ground) -> list[Place]:
    """Add a file that is no layer of the part."""
    text = ground.text
    call = text.find(r"MAIN_L\d+")[-1]
    lines = ["%_N_PARK_SPF", ";$PATH=/_N_WKS_DIR/_N_EBAMCHECK_WPD", "; VALIDATED", "G0 Z60.0", "M17", ""]
    text.files["PARK.SPF"] = lines
    ground.what = f"a further subprogram, {ground.variant}"
    if ground.variant == "not called":
        return [*ground.line(text.main, call), Place("PARK.SPF", 1, 5)]
    text.insert(text.main, call + 1, "PARK")
    return [*ground.line(text.main, call + 1), Place("PARK.SPF", 1, 5)]


@kind("name in the header", "record", controls=(SINUMERIK,))
def wrong_name(ground: Ground) -> list[Place]:
    """Name another file in the first line."""
    layer = ground.layer()
    lines = ground.text.files[layer.file]
    lines[0] = lines[0].replace("_L", "_K")
    ground.what = "the first line names another program"
    return ground.line(layer.file, 0)

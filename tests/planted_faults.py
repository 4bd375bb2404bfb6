"""A program as text with faults planted in it, each with the check that must find it."""

from __future__ import annotations

import re

from nc_stack import stack
from program_text import Text

from ebamcheck.program import verify_file, write_program
from ebamcheck.settings.config import Config

MAIN, FIRST, SECOND = "MAIN.MPF", "MAIN_L0001.SPF", "MAIN_L0002.SPF"


def planted(tmp_path, plant, machine=None):
    """Failed checks, by name, of a program with a fault; and where it was planted."""
    config = Config().changed(machine=machine or {})
    curves, plan = stack()
    files = write_program(curves, plan, config, tmp_path / "program")
    text = Text(files.folder)
    where = plant(text)
    text.save()
    checks = verify_file(files.main, config=config, curves=curves, plan=plan)
    return {c.name: c for c in checks if not c.passed}, where


def edit(name, pattern, replacement, nth=0):
    return lambda text: text.edit(name, pattern, replacement, nth)


def drop(name, pattern, nth=0):
    return lambda text: text.drop(name, pattern, nth)


def told_at(name, pattern, plant, nth=0, shift=0, column=""):
    """The fault is named at another line than that where it is planted: at one that holds a pattern then."""

    def planted_there(text):
        plant(text)
        return f"{name}:{text.find(name, pattern, nth) + 1 + shift}{column}"

    return planted_there


def swap(name, first, second):
    return lambda text: text.swap(name, text.find(name, first), text.find(name, second))


def without(name, plant=lambda text: ""):
    """One file less, and another fault."""

    def planted_less(text):
        del text.lines[name]
        return plant(text)

    return planted_less


def layer_twice(text):
    i = text.find(MAIN, r" MAIN_L0002$")
    text.lines[MAIN].insert(i + 1, "N85 MAIN_L0002")
    return f"{MAIN}:{i + 2}"


def cut_off(name, share):
    def plant(text):
        whole = "\n".join(text.lines[name])
        text.lines[name] = whole[: int(len(whole) * share)].split("\n")
        return f"{name}:{len(text.lines[name])}"

    return plant


def no_last_line_feed(text):
    assert text.lines[SECOND].pop() == ""
    return f"{SECOND}:{len(text.lines[SECOND])}"


def swapped_layers(text):
    i, j = text.find(MAIN, " MAIN_L0001$"), text.find(MAIN, " MAIN_L0002$")
    lines = text.lines[MAIN]
    lines[i], lines[j] = lines[i].replace("L0001", "L0002"), lines[j].replace("L0002", "L0001")
    return f"{MAIN}:{i + 1}"


def block_twice(text):
    i = text.find(FIRST, r"G1 X.*\d$", nth=9)
    text.lines[FIRST].insert(i + 1, text.lines[FIRST][i])
    return f"{FIRST}:{i + 2}"


def swapped_islands(text):
    lines = text.lines[FIRST]
    i, j, k = (text.find(FIRST, rf"; ISLAND {n}$") for n in (0, 1, 2))
    lines[i:k] = lines[j:k] + lines[i:j]
    for n in range(i, len(lines)):
        lines[n] = re.sub(r"^N\d+", f"N{5000 + 10 * (n - i)}", lines[n])
    return f"{FIRST}:{text.find(FIRST, 'G1', begin=i) + 1}"


def dropped_island(text):
    i, j = text.find(SECOND, "; ISLAND 4"), text.find(SECOND, "; ISLAND 5")
    del text.lines[SECOND][i:j]
    return f"{SECOND}:{text.find(SECOND, 'M60', nth=3) + 4}"


def dropped_line(text):
    i = text.find(FIRST, r"G1 X.*\d$", nth=9)
    assert "TURN" in text.lines[FIRST][i + 1]
    del text.lines[FIRST][i]
    return f"{FIRST}:{i + 1}"


def ring_again(text):
    """The beads of the first ring once more, behind themselves: whatever a comment says, they are there twice."""
    i, j = text.find(FIRST, "G0 X"), text.find(FIRST, r"M61 ; beam off")
    again = [re.sub(r"^N(\d+)", r"N\g<1>5", line) for line in text.lines[FIRST][i : j + 1]]
    text.lines[FIRST][j + 1 : j + 1] = ["; RING 77", *again]
    return f"{FIRST}:{text.find(FIRST, 'POLY', nth=0) + 2 + len(again)}"


def shifted_layer(text):
    lines = text.lines[SECOND]
    for i, line in enumerate(lines):
        lines[i] = re.sub(r"(X|PO\[X\]=\()(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 0.1:.6f}", line)
    return SECOND


def other_layer_height(text):
    text.lines[SECOND] = [line.replace("G0 Z3.0", "G0 Z3.1") for line in text.lines[SECOND]]
    return f"{MAIN}:{text.find(MAIN, ' MAIN_L0002') + 1}"


def tenth_more(m):
    return f"{m[1]}{(int(m[2]) + 1) % 10}"


def ring_left_open(text):
    before = text.lines[FIRST][: text.find(FIRST, "M63", nth=1)]
    return text.edit(FIRST, r"(Y-?\d+\.)(\d)", tenth_more, sum(" Y" in line for line in before) - 1)


FAULTS = {
    # -- structure
    "dropped layer": (without(SECOND, drop(MAIN, r" MAIN_L0002$")), "layer count"),
    "dropped layer, its file left": (told_at(MAIN, "MAIN_L0003", drop(MAIN, r" MAIN_L0002$")), "layer heights"),
    "uncalled subprogram": (told_at(MAIN, "MAIN_L0003", drop(MAIN, r" MAIN_L0002$")), "subprograms"),
    "layer twice": (layer_twice, "subprograms"),
    "missing file": (told_at(MAIN, "MAIN_L0002", without(SECOND), column=":6"), "readable"),
    "truncated subprogram": (cut_off(SECOND, 0.5), "end of program"),
    "truncated main program": (cut_off(MAIN, 0.98), "end of program"),
    "no last line feed": (no_last_line_feed, "end of program"),
    "M30 in a subprogram": (edit(SECOND, "M17", "M30"), "end of program"),
    "numbers fall": (edit(FIRST, r"^N200 ", "N20 "), "block numbers"),
    "number twice": (edit(FIRST, r"^N200 ", "N190 "), "block numbers"),
    "wrong name in the header": (edit(FIRST, "L0001", "L0007"), "names and headers"),
    "no path": (edit(FIRST, r"^;\$PATH=", "; PATH "), "names and headers"),
    "long block": (edit(FIRST, "$", f" ; {'x' * 220}", 8), "block length"),
    # -- words
    "unknown word": (edit(FIRST, r"(G1 X)", r"G5 X", 2), "readable"),
    "letter for a digit": (edit(FIRST, r" Y(-?\d)\d", r" Y\1O", 4), "readable"),
    "comma for a point": (edit(FIRST, r"(G1 X-?\d+)\.", r"\1,", 3), "readable"),
    "block twice": (block_twice, "repeated blocks"),
    "swapped layers": (swapped_layers, "layer heights"),
    "another PL": (edit(FIRST, r"(POLY .*PL=)1", r"\g<1>2", 1), "polynomial blocks"),
    # -- machine state
    "missing beam-off": (told_at(FIRST, "G0 ", drop(FIRST, r"M61 ; beam off"), 3), "beam"),
    "missing beam-on": (told_at(FIRST, "POLY", drop(FIRST, "M60")), "beam"),
    "G0 for G1": (edit(FIRST, r"G1 (X.* ; TURN)", r"G0 \1"), "beam"),
    "missing wire stop": (told_at(FIRST, "G0", drop(FIRST, "M63"), 3), "wire"),
    "beam off before wire": (swap(FIRST, "M63", "M61"), "wire"),
    "missing wire start": (told_at(FIRST, "POLY", drop(FIRST, "M62")), "wire"),
    "feed 0": (edit(FIRST, "F600", "F0"), "feed"),
    "feed too high": (edit(SECOND, "F600", "F6000", 2), "feed"),
    "current over the limit": (edit(MAIN, "H2=120", "H2=300"), "process values"),
    "current under the one set": (told_at(FIRST, "POLY", edit(FIRST, "H2=120", "H2=100")), "power"),
    "half the wire": (told_at(FIRST, "POLY", edit(FIRST, r"H3=\d+", "H3=15")), "mass balance"),
    "no G90": (edit(MAIN, " G90", ""), "modes"),
    "no work offset": (told_at(MAIN, "COMPOF", drop(MAIN, "G54"), shift=-1), "modes"),
    "other work offset": (edit(MAIN, "G54", "G55"), "modes"),
    "wide smoothing": (edit(MAIN, "CTOL=0.05", "CTOL=0.5"), "smoothing"),
    "other smoothing": (edit(MAIN, "FFWON G642$", "FFWON G64"), "smoothing"),
    "beyond the travel": (edit(FIRST, r"G1 X-?\d+\.\d+ (Y.* ; TURN)", r"G1 X1000.5 \1"), "travel"),
    "turn 40 mm out": (edit(FIRST, r"G1 X(-?\d+)(\.\d+ Y.* ; TURN)", lambda m: f"G1 X{int(m[1]) + 40}{m[2]}"), "hatch path"),
    # -- path
    "flipped sign of a coefficient": (edit(FIRST, r"(PO\[X\]=\([^,]*,)-?", r"\1-9", nth=1), "contour path"),
    "contour 0.1 mm off": (edit(FIRST, r"(G1 X-?\d+\.)(\d)", tenth_more), "contour path"),
    "hatch 0.1 mm off": (edit(FIRST, r"(Y-?\d+\.)(\d)(?!.* ; TURN$)", tenth_more, 20), "hatch vectors"),
    "ring left open": (ring_left_open, "contours close"),
    "dropped hatch line": (dropped_line, "hatch vectors"),
    "islands in another order": (swapped_islands, "islands"),
    "dropped island": (dropped_island, "islands"),
    "ring twice": (ring_again, "contour rings"),
    "layer at another height": (other_layer_height, "layer heights"),
    "whole layer 0.1 mm off": (shifted_layer, "contour path"),
}  # fmt: skip


def swapped_intervals(text):
    i = text.find(FIRST, r"PL=[1-9]")
    j = text.find(FIRST, r"PL=[1-9]", nth=1)
    lines = text.lines[FIRST]
    a, b = (lines[k].rsplit("PL=", 1) for k in (i, j))
    lines[i], lines[j] = f"{a[0]}PL={b[1]}", f"{b[0]}PL={a[1]}"
    return i, j

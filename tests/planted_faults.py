"""A program as text with faults planted in it, each with the check that must find it."""

from __future__ import annotations

import re

from nc_stack import stack

from ebamcheck.program import verify_file, write_program
from ebamcheck.settings.config import Config

MAIN, FIRST, SECOND = "MAIN.MPF", "MAIN_L0001.SPF", "MAIN_L0002.SPF"


class Text:
    """The lines of a program's files, to plant faults in."""

    def __init__(self, folder):
        self.folder = folder
        self.lines = {p.name: p.read_text().split("\n") for p in sorted(folder.iterdir())}

    def find(self, name, pattern, nth=0):
        """Index of the nth line that holds the pattern."""
        return [i for i, line in enumerate(self.lines[name]) if re.search(pattern, line)][nth]

    def edit(self, name, pattern, replacement, nth=0):
        """Replace within one line; give its place."""
        i = self.find(name, pattern, nth)
        changed = re.sub(pattern, replacement, self.lines[name][i], count=1)
        assert changed != self.lines[name][i]
        self.lines[name][i] = changed
        return f"{name}:{i + 1}"

    def drop(self, name, pattern, nth=0):
        """Delete one line; give its place."""
        i = self.find(name, pattern, nth)
        del self.lines[name][i]
        return f"{name}:{i + 1}"

    def save(self):
        for path in self.folder.iterdir():
            path.unlink()
        for name, lines in self.lines.items():
            (self.folder / name).write_text("\n".join(lines))


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


def dropped_layer(text):
    del text.lines[SECOND]
    return text.drop(MAIN, r" MAIN_L0002$")


def dropped_call(text):
    text.drop(MAIN, r" MAIN_L0002$")
    return f"{MAIN}:{text.find(MAIN, 'MAIN_L0003') + 1}"


def layer_twice(text):
    i = text.find(MAIN, r" MAIN_L0002$")
    text.lines[MAIN].insert(i + 1, "N85 MAIN_L0002")
    return f"{MAIN}:{i + 2}"


def missing_file(text):
    del text.lines[SECOND]
    return f"{MAIN}:{text.find(MAIN, 'MAIN_L0002') + 1}:6"


def later_rapid(text):
    text.drop(FIRST, r"M61 ; beam off")
    return f"{FIRST}:{text.find(FIRST, 'G0 ', nth=3) + 1}"


def cut_off(name, share):
    def plant(text):
        whole = "\n".join(text.lines[name])
        text.lines[name] = whole[: int(len(whole) * share)].split("\n")
        return f"{name}:{len(text.lines[name])}"

    return plant


def no_last_line_feed(text):
    assert text.lines[SECOND].pop() == ""
    return f"{SECOND}:{len(text.lines[SECOND])}"


def swapped_lines(name, first, second):
    def plant(text):
        i, j = text.find(name, first), text.find(name, second)
        a, b = (text.lines[name][k].split(" ", 1) for k in (i, j))
        text.lines[name][i], text.lines[name][j] = f"{a[0]} {b[1]}", f"{b[0]} {a[1]}"
        return f"{name}:{min(i, j) + 1}"

    return plant


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
    for n, line in enumerate(lines[i:k], start=i):
        lines[n] = re.sub(r"^N\d+", f"N{5000 + 10 * (n - i)}", line)
    for n in range(k, len(lines)):
        lines[n] = re.sub(r"^N\d+", f"N{9000 + 10 * (n - k)}", lines[n])
    return f"{FIRST}:{text.find(FIRST, 'G1', nth=text_before(lines, i)) + 1}"


def text_before(lines, i):
    return sum("G1" in line for line in lines[:i])


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


def long_block(text):
    return text.edit(FIRST, "$", f" ; {'x' * 220}", nth=8)


def other_layer_height(text):
    i = text.find(SECOND, r"G0 Z3\.0")
    for name_line in [n for n, line in enumerate(text.lines[SECOND]) if "G0 Z3.0" in line]:
        text.lines[SECOND][name_line] = text.lines[SECOND][name_line].replace("Z3.0", "Z3.1")
    assert i
    return f"{MAIN}:{text.find(MAIN, ' MAIN_L0002') + 1}"


def edit(name, pattern, replacement, nth=0):
    return lambda text: text.edit(name, pattern, replacement, nth)


def drop(name, pattern, nth=0):
    return lambda text: text.drop(name, pattern, nth)


def line_before(plant):
    """The fault is named at the line before the one that is missing."""

    def planted_before(text):
        name, line = plant(text).split(":")
        return f"{name}:{int(line) - 1}"

    return planted_before


FAULTS = {
    # -- structure
    "dropped layer": (dropped_layer, "layer count"),
    "dropped layer, its file left": (dropped_call, "layer heights"),
    "uncalled subprogram": (dropped_call, "subprograms"),
    "layer twice": (layer_twice, "subprograms"),
    "missing file": (missing_file, "readable"),
    "truncated subprogram": (cut_off(SECOND, 0.5), "end of program"),
    "truncated main program": (cut_off(MAIN, 0.98), "end of program"),
    "no last line feed": (no_last_line_feed, "end of program"),
    "M30 in a subprogram": (edit(SECOND, "M17", "M30"), "end of program"),
    "numbers fall": (edit(FIRST, r"^N200 ", "N20 "), "block numbers"),
    "number twice": (edit(FIRST, r"^N200 ", "N190 "), "block numbers"),
    "wrong name in the header": (edit(FIRST, "L0001", "L0007"), "names and headers"),
    "no path": (edit(FIRST, r"^;\$PATH=", "; PATH "), "names and headers"),
    "long block": (long_block, "block length"),
    # -- words
    "unknown word": (lambda text: text.edit(FIRST, r"(G1 X)", r"G5 X", nth=2) + ":6", "readable"),
    "letter for a digit": (lambda text: text.edit(FIRST, r" Y(-?\d)\d", r" Y\1O", nth=4), "readable"),
    "comma for a point": (lambda text: text.edit(FIRST, r"(G1 X-?\d+)\.", r"\1,", nth=3) + ":", "readable"),
    "block twice": (block_twice, "repeated blocks"),
    "swapped layers": (swapped_layers, "layer heights"),
    "another PL": (lambda text: text.edit(FIRST, r"(POLY .*PL=)1", r"\g<1>2", nth=1), "polynomial blocks"),
    # -- machine state
    "missing beam-off": (later_rapid, "beam"),
    "missing beam-on": (
        lambda text: (text.drop(FIRST, "M60"), f"{FIRST}:{text.find(FIRST, 'POLY') + 1}")[1],
        "beam",
    ),
    "G0 for G1": (edit(FIRST, r"G1 (X.* ; TURN)", r"G0 \1"), "beam"),
    "missing wire stop": (
        lambda text: (text.drop(FIRST, "M63"), f"{FIRST}:{text.find(FIRST, 'G0', nth=3) + 1}")[1],
        "wire",
    ),
    "beam off before wire": (
        lambda text: swapped_lines(FIRST, "M63", "M61")(text),
        "wire",
    ),
    "missing wire start": (
        lambda text: (text.drop(FIRST, "M62"), f"{FIRST}:{text.find(FIRST, 'POLY') + 1}")[1],
        "wire",
    ),
    "feed 0": (edit(FIRST, "F600", "F0"), "feed"),
    "feed too high": (edit(SECOND, "F600", "F6000", nth=2), "feed"),
    "current over the limit": (edit(MAIN, "H2=120", "H2=300"), "process values"),
    "current under the one set": (
        lambda text: (text.edit(FIRST, "H2=120", "H2=100"), f"{FIRST}:{text.find(FIRST, 'POLY') + 1}")[1],
        "power",
    ),
    "half the wire": (
        lambda text: (
            text.edit(FIRST, r"H3=\d+", "H3=15"),
            f"{FIRST}:{text.find(FIRST, 'POLY') + 1}",
        )[1],
        "mass balance",
    ),
    "no G90": (edit(MAIN, " G90", ""), "modes"),
    "no work offset": (line_before(drop(MAIN, "G54")), "modes"),
    "other work offset": (edit(MAIN, "G54", "G55"), "modes"),
    "wide smoothing": (edit(MAIN, "CTOL=0.05", "CTOL=0.5"), "smoothing"),
    "other smoothing": (edit(MAIN, "FFWON G642$", "FFWON G64"), "smoothing"),
    "beyond the travel": (edit(FIRST, r"G1 X-?\d+\.\d+ (Y.* ; TURN)", r"G1 X1000.5 \1"), "travel"),
    "turn 40 mm out": (edit(FIRST, r"G1 X(-?\d+)(\.\d+ Y.* ; TURN)", lambda m: f"G1 X{int(m[1]) + 40}{m[2]}"), "hatch path"),
    # -- path
    "flipped sign of a coefficient": (edit(FIRST, r"(PO\[X\]=\([^,]*,)-?", r"\1-9", nth=1), "contour path"),
    "contour 0.1 mm off": (
        edit(FIRST, r"G1 X(-?\d+)\.(\d)", lambda m: f"G1 X{m[1]}.{(int(m[2]) + 1) % 10}"),
        "contour path",
    ),
    "hatch 0.1 mm off": (
        edit(FIRST, r"Y(-?\d+)\.(\d)(.*)(?<! ; TURN)$", lambda m: f"Y{m[1]}.{(int(m[2]) + 1) % 10}{m[3]}", nth=20),
        "hatch vectors",
    ),
    "ring left open": (
        lambda text: (lambda i: text.edit(FIRST, r"Y(-?\d+)\.(\d)", lambda m: f"Y{m[1]}.{(int(m[2]) + 1) % 10}", i))(
            sum(" Y" in line for line in text.lines[FIRST][: text.find(FIRST, "M63", nth=1)]) - 1
        ),
        "contours close",
    ),
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

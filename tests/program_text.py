"""Programs as lines, to plant faults in, and what the checks then say of a small one of any control."""

from __future__ import annotations

import re

from nc_stack import REACHES_OUT, stack

from ebamcheck.program import verify_file, write_program
from ebamcheck.settings.config import Config

CONTROLS = ("sinumerik-840d-sl", "linuxcnc", "plain-gcode")
MAIN = {CONTROLS[0]: "MAIN.MPF", CONTROLS[1]: "MAIN.ngc", CONTROLS[2]: "MAIN.gcode"}


class Text:
    """Lines of every file of a program, to plant faults in."""

    def __init__(self, folder):
        self.folder = folder
        self.lines = {path.name: path.read_text().split("\n") for path in sorted(folder.iterdir())}

    def find(self, name, pattern, nth=0, begin=0):
        """Index of the nth line from `begin` that holds the pattern."""
        lines = self.lines[name][begin:]
        return begin + [i for i, line in enumerate(lines) if re.search(pattern, line)][nth]

    def insert(self, name, i, block):
        """Put a block before the line i; give its place."""
        before = re.match(r"N(\d+)", self.lines[name][i - 1])
        self.lines[name].insert(i, f"N{int(before[1]) + 1} {block}" if before else block)
        return f"{name}:{i + 1}"

    def edit(self, name, pattern, replacement, nth=0, begin=0):
        """Replace within one line; give its place."""
        i = self.find(name, pattern, nth, begin)
        changed = re.sub(pattern, replacement, self.lines[name][i], count=1)
        assert changed != self.lines[name][i]
        self.lines[name][i] = changed
        return f"{name}:{i + 1}"

    def edit_all(self, pattern, replacement):
        """Replace in every line; give the place of the first."""
        places = []
        for name, lines in self.lines.items():
            for i, line in enumerate(lines):
                lines[i] = re.sub(pattern, replacement, line)
                places += [f"{name}:{i + 1}"] if lines[i] != line else []
        return places[0]

    def drop(self, name, pattern, nth=0, begin=0):
        """Delete one line; give its place."""
        i = self.find(name, pattern, nth, begin)
        del self.lines[name][i]
        return f"{name}:{i + 1}"

    def swap(self, name, i, j):
        """Exchange two blocks, their numbers kept; give the place of the first."""
        lines = self.lines[name]
        a, b = (re.match(r"(N\d+ )?(.*)", lines[k]) for k in (i, j))
        lines[i], lines[j] = (a[1] or "") + b[2], (b[1] or "") + a[2]
        return f"{name}:{min(i, j) + 1}"

    def save(self):
        """Write the lines in place of all files."""
        for path in self.folder.iterdir():
            path.unlink()
        for name, lines in self.lines.items():
            (self.folder / name).write_text("\n".join(lines))


class ProgramText(Text):
    """Lines of every file of a program of two layers."""

    def __init__(self, control, folder, machine=None, process=None):
        self.control = control
        self.config = Config().changed(machine={"control": control, **(machine or {})}, process=process or {})
        self.curves, self.plan = stack(count=2)
        self.files = write_program(self.curves, self.plan, self.config, folder)
        super().__init__(folder)

    @property
    def main(self):
        return MAIN[self.control]

    def layer(self, k):
        """File of layer k, from 1, and the index of its first line."""
        if self.control == CONTROLS[0]:
            return f"MAIN_L{k:04d}.SPF", 0
        begin = next(i for i, line in enumerate(self.lines[self.main]) if line.startswith(f"; LAYER: {k} "))
        return self.main, begin

    def in_bead(self, k=2, nth=1):
        """File, and index of the nth motion under beam and wire of layer k."""
        name, begin = self.layer(k)
        return name, self.find(name, r"\bF600\b", begin=begin) + nth

    def failed(self, **given):
        """Write the lines, and return the checks that fail, by name."""
        self.save()
        given.setdefault("curves", self.curves)
        given.setdefault("plan", self.plan)
        checks = verify_file(self.files.main, config=self.config, **given)
        return {check.name: check for check in checks if not check.passed and check.name != REACHES_OUT}

    def failed_by_text(self, **given):
        """Those that fail without curves and plan."""
        return self.failed(curves=None, plan=None, **given)


def near(where, place, lines=3):
    """Whether a place is in the same file, and within so many lines of another."""
    (a, i), (b, j) = (text.split(":")[:2] for text in (where, place))
    return a == b and abs(int(i) - int(j)) <= lines

"""Settings of small runs, a listener to what they say, and what is compared of two of them."""

from __future__ import annotations

import json

from finished_runs import THICK_FAST

SETTINGS = THICK_FAST


class Listener:
    """Keeps what a run says."""

    def __init__(self):
        self.notes, self.stages = [], []

    def stage(self, name, total):
        self.stages.append(name)

    def advance(self, steps):
        pass

    def note(self, text):
        self.notes.append(text)


def gates(result):
    return {gate.name: gate.passed for gate in result.gates}


def untimed(folder):
    return json.loads((folder / "run.json").read_text())


def contents(folder):
    """Bytes of every file that is a function of part and settings alone."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".parquet", ".csv", ".MPF", ".SPF") and path.name != "summary.csv"
    }

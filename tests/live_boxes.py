"""Finished runs of boxes that tests of live layers start from, the other side of a server of lines, and what a layer has to pass."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import FAST, ebamcheck, write_stl
from finished_runs import made_once
from parts import box
from slicers_here import slicers_here

from ebamcheck.live.before import Before
from ebamcheck.live.building import Building
from ebamcheck.live.making import LayerMaker, MadeLayer, Wanted
from ebamcheck.live.publishing import JOURNAL, LAYERS
from ebamcheck.live.relaying import finished_run
from ebamcheck.program import Check
from ebamcheck.settings.config import Config, load_config
from ebamcheck.verification.verify import verify


def run_of_box(factory: pytest.TempPathFactory, size_mm: tuple[float, float, float]) -> Path:
    """Folder with the STL file and the finished run of a box, `box.stl` and `box.run`."""

    def make(at: Path) -> None:
        write_stl(box(upper=size_mm), at / "box.stl")
        with slicers_here():
            # A whole number of layers, of about the bead's height: else metal lacks at the top, and the run is not validated.
            height = size_mm[2] / round(size_mm[2] / Config().layer_height_mm)
            wanted = ("--layer-height", height, "--backends", FAST)
            done = ebamcheck("run", "box.stl", "-o", "box.run", *wanted, cwd=at)
        assert done.returncode == 0, done.stdout + done.stderr

    return made_once(factory, "live-" + "x".join(f"{side:g}" for side in size_mm), make)


@contextmanager
def maker_of(place: Path) -> Iterator[LayerMaker]:
    """Maker of the layers of such a box."""
    found = finished_run(place / "box.run")
    with LayerMaker(found.part, found.config, found.primary) as made:
        yield made


def third_layer(maker: LayerMaker, folder: Path, thickness_mm: float = 1.6) -> MadeLayer:
    """A layer on 3.4 mm of cold metal, as it is made and before it is published."""
    wanted = Wanted(2, 3.4, thickness_mm, "MAIN_K0003R1")
    return maker.make(wanted, Before.cold(maker.config), folder / "program")


def failed_checks(folder: Path, part: Path) -> list[Check]:
    """Checks that a published layer fails by its text, part and settings alone."""
    checks = verify(folder / "program", part, load_config(folder / "settings.toml"))
    assert len(checks) > 50
    return [check for check in checks if not check.passed]


def made_again(maker: LayerMaker, folder: Path, again: Path) -> bool:
    """Whether the journal of a build alone gives every byte of its layers."""
    again.mkdir()
    shutil.copy(folder / JOURNAL, again)
    Building(maker, again).close()
    first, second = (
        {path.relative_to(at): path.read_bytes() for path in (at / LAYERS).rglob("*") if path.is_file()}
        for at in (folder, again)
    )
    return bool(first) and first == second


def puts(run, release):
    """Write a release into the parameters of the program."""
    run.values |= {
        "R101": release.released, "R102": release.number, "R103": release.wait_s, "R111": release.key, "R112": release.seal,
    }  # fmt: skip


# -- lines -------------------------------------------------------------------------------------------


class Server:
    """`ebamcheck live` in a process of its own, spoken to by lines."""

    def __init__(self, command, cwd):
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=cwd)

    def answer(self):
        return json.loads(self._process.stdout.readline())

    def ask(self, line):
        self._process.stdin.write(line + b"\n")
        self._process.stdin.flush()
        return self.answer()

    def tell(self, **message):
        return self.ask(json.dumps(message).encode())

    def kill(self):
        """End it at once, as a power cut does."""
        self._process.kill()
        self.close()

    def close(self):
        self._process.communicate()


def play(tell, folder, growth, most_layers=None):
    """Lay layers from the one that is published on; answers to `start` and to each height."""
    answers = [tell(event="start")]
    while answers[-1]["answer"] == "published" and len(answers) - 1 != most_layers:
        last = answers[-1]
        assert hashlib.sha256((folder / last["program"]).read_bytes()).hexdigest() == last["sha256"]
        height_mm = last["base_mm"] + growth.grown_mm(last["layer"] - 1, last["thickness_mm"])
        answers.append(tell(event="height", done=last["layer"], height_mm=height_mm))
    return answers

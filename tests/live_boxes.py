"""Finished runs of boxes that tests of live layers start from, and what a layer that is published has to pass."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import FAST, ebamcheck, write_stl
from finished_runs import made_once
from parts import box
from slicers_here import slicers_here

from ebamcheck.live.loading import finished_run
from ebamcheck.live.making import LayerMaker
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


def failed_checks(folder: Path, part: Path) -> list[Check]:
    """Checks that a published layer fails by its text, part and settings alone."""
    checks = verify(folder / "program", part, load_config(folder / "settings.toml"))
    assert len(checks) > 50
    return [check for check in checks if not check.passed]


def puts(run, release):
    """Write a release into the parameters of the program."""
    run.values |= {
        "R101": release.released, "R102": release.number, "R103": release.wait_s, "R111": release.key, "R112": release.seal,
    }  # fmt: skip

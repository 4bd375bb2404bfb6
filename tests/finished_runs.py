"""Finished runs that several test files start from: each is made once, by whichever worker needs it first."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import FAST, WIDE, frame, write_stl
from parts import box
from slicers_here import slicers_here

from ebamcheck.errors import ExitCode
from ebamcheck.pipeline import RunResult, run_job
from ebamcheck.settings.config import Config

FOUR_MM = Config().changed(layers={"layer_height_mm": 4.0}, slicing={"backends": tuple(FAST.split(","))}, process=WIDE)
"""Settings of the plate with a certificate."""

THICK_FAST = FOUR_MM.changed(layers={"layer_height_mm": 6.0})
"""The same in two layers."""

THICK = Config().changed(layers={"layer_height_mm": 6.0}, process=WIDE)
"""Settings of the plate that every slicer cuts."""


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return the folder that ``make`` fills: nobody writes to it afterwards, for all workers share it."""
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    folder, done = base / "shared" / name, base / "shared" / f"{name}.done"
    folder.parent.mkdir(exist_ok=True)
    with (base / "shared" / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def certified_plate(factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder of a validated run of a plate with a hole, and the part's file."""

    def make(at: Path) -> None:
        with slicers_here():
            run_job(write_stl(frame(), at / "frame.stl"), at / "frame.run", FOUR_MM)

    folder = made_once(factory, "certified", make)
    return folder / "frame.run", folder / "frame.stl"


def plate_of_two_layers(factory: pytest.TempPathFactory) -> Path:
    """Folder of a validated run of the plate in two layers."""
    folder = made_once(
        factory,
        "two-layers",
        lambda at: run_job(write_stl(frame(), at / "frame.stl"), at / "frame.run", THICK_FAST),
    )
    return folder / "frame.run"


def thin_plate(factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder of a run that is not validated, of a plate so thin that no bead fits it, and the part's file."""

    def make(at: Path) -> None:
        path = write_stl(box((0, 0, 0), (40, 2.0, 8)), at / "thin.stl")
        with slicers_here():
            assert run_job(path, at / "thin.run", FOUR_MM).exit_code is ExitCode.OUT_OF_TOLERANCE

    folder = made_once(factory, "thin", make)
    return folder / "thin.run", folder / "thin.stl"


def plate_of_every_slicer(factory: pytest.TempPathFactory) -> tuple[RunResult, Path]:
    """Validated run of a plate with a hole, with every backend that there is, and the part's file."""

    def make(at: Path) -> None:
        result = run_job(write_stl(frame(), at / "frame.stl"), at / "frame.run", THICK)
        (at / "result.pickle").write_bytes(pickle.dumps(result))

    folder = made_once(factory, "every-slicer", make)
    return pickle.loads((folder / "result.pickle").read_bytes()), folder / "frame.stl"

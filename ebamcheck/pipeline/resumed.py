"""Programs that go on after a break: they are no proof of the part, but the end of a whole program that is."""

from __future__ import annotations

from os.path import realpath
from pathlib import Path

import numpy as np

from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.entry_program import FOLDER
from ebamcheck.pipeline.run_folder import MANIFEST, RunFolder, own_file
from ebamcheck.program import Check, read_program
from ebamcheck.program.checking.entry_check import NAME, PLACE_MM, entry_check
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config, validated


def entry_of_whole(program: Path, whole: Path, config: Config) -> Check:
    """Check a program that begins at a layer against the whole one, a program or that of a run folder.

    The layer is the one at whose Z the text lays its first metal, whatever its comments say.

    Raises
    ------
    InputError
        If either cannot be read.
    SettingsError
        If the run has no program.
    """
    said_validated = False
    if own_file(whole / MANIFEST):
        run = RunFolder(whole)
        record = run.manifest().get("program")
        if record is None:
            raise SettingsError(f"{whole}: this run wrote no program")
        config = validated(run.manifest()["settings"], f"{whole / MANIFEST}: settings")
        whole = run.program_folder / record["files"][0]["name"]
        inside = Path(realpath(program)).is_relative_to(realpath(run.path / FOLDER))
        said_validated = inside and bool(record["validated"])
    complete, entry = read_program(whole, config), read_program(program, config)
    tops = np.unique(np.round(complete.end[complete.deposit, 2], 3))
    z_mm = _first_mm(entry)
    if not tops.size or not np.isfinite(z_mm):
        return Check(NAME, False, 1.0, 0.0, "faults", program.name, "one of the two programs lays no metal")
    layer = int(np.abs(tops - z_mm).argmin())
    return entry_check(complete, entry, layer + 1, float(tops[layer]), config, said_validated)


def begins_later(program: Path, z_of: Floats, config: Config) -> list[Check]:
    """A failed check where a program lays its first metal over the first layer of the part, and how it is verified; else none.

    Parameters
    ----------
    z_of
        (L,) Z of the layers of the part, mm.
    """
    try:
        nc = read_program(program, config)
    except EbamcheckError:  # A check of its own tells that.
        return []
    z_mm = _first_mm(nc)
    if not len(z_of) or not z_mm > z_of[0] + PLACE_MM:
        return []
    layer = int(np.abs(z_of - z_mm).argmin()) + 1
    text = (
        f"the program begins at Z {z_mm:.3f}, layer {layer} of {len(z_of)}, and so does not make the whole part: one that goes on "
        "after a break is verified against the whole program, --whole RUN or --whole PROGRAM"
    )
    return [Check(NAME, False, float(layer), 1.0, "layer", nc.where(_first(nc)), text)]


def _first(nc: NCProgram) -> int:
    """Motion with which a program begins to lay metal; -1 where it lays none."""
    laid = np.flatnonzero(nc.deposit)
    return int(laid[0]) if laid.size else -1


def _first_mm(nc: NCProgram) -> float:
    first = _first(nc)
    return float(nc.end[first, 2]) if first >= 0 else np.nan

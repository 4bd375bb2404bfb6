"""The main job on small parts: what it calls, ``ebamcheck warm`` has compiled."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import numpy as np
import shapely

from ebamcheck.checks.matching import nearest_each
from ebamcheck.curves import fit
from ebamcheck.layers.stack import from_rings
from ebamcheck.mesh.files import load
from ebamcheck.metal.target import moved_to_neighbours
from ebamcheck.pipeline import run_job
from ebamcheck.plugins import registry
from ebamcheck.program import read_program, verify_program, write_program
from ebamcheck.saving import save
from ebamcheck.scan import plan_scan, plan_stack
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import Slicing, slice_part
from ebamcheck.testing.solids import box, mapped, revolved, torus

_SIDE_MM = 40.0
# A box that leans, so that sections have slanted edges
_BOX = mapped(box((0.0, 0.0, 0.0), (_SIDE_MM,) * 3), ((1.0, 0.0, 0.1), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def _sections(folder: Path) -> None:
    """Slice a leaning box with every slicer of the house, along z and along a slanted direction."""
    part = load(save(_BOX, folder / "cube.stl"))
    for name in registry.house_slicers():
        if registry.probe(name).available:
            with Slicing(part, name) as slicing, slicing.along((0.0, 0.6, 0.8)) as turned:
                slicing.layers([1.0, 2.0, 3.0])
                turned.at(1.0)
                turned.layers(np.arange(20.0))


def _curves(folder: Path) -> None:
    """Fit curves to sections of a cone, which is lifted by its normals, and of a torus, which is a surface by formula."""
    cone = revolved([(0.0, 0.0), (_SIDE_MM, 0.0), (0.0, _SIDE_MM)], 32, closed=False)
    for part in (cone, torus(2.0 * _SIDE_MM, 0.5 * _SIDE_MM, 48, 24)):
        curved = load(save(mapped(part, shift=(0.0, 0.0, -part.bounds[0, 2])), folder / "round.stl"))
        fit(slice_part(curved, [0.3 * _SIDE_MM, 0.6 * _SIDE_MM]), part=curved)


def _program(folder: Path) -> None:
    """Make the program of two layers of a box, far thicker than any process lays them."""
    path = save(_BOX, folder / "cube.stl")
    thick = {"wire_speed_max_mm_s": 1000.0, "layer_over_bead": (0.5, 20.0)}
    config = Config().changed(layers={"layer_height_mm": 20.0}, process=thick)
    run_job(path, folder / "run", config, reference=path)
    # What a box has not: splines in a program, and metal that lies beside the part.
    nearest_each(np.eye(2), np.eye(4))
    field = np.eye(2)
    moved_to_neighbours(np.zeros((2, 2)), field, field > 0.0, field == 0.0)


def _orders(_folder: Path) -> None:
    """Order the islands of a square: a box of the size that the others have is one island."""
    plan_scan(shapely.box(0.0, 0.0, 3.0 * _SIDE_MM, 2.0 * _SIDE_MM))


def _checks(folder: Path) -> None:
    """Write, read and prove the program of two squares, so that no process meets the other at the end of the main job."""
    square = [(0.0, 0.0), (_SIDE_MM, 0.0), (_SIDE_MM, _SIDE_MM), (0.0, _SIDE_MM)]
    layers = from_rings([1.0, 3.0], [[square]] * 2)
    config = Config().changed(layers={"layer_height_mm": 2.0})
    curves, plan = fit(layers), plan_stack(layers, config)
    write_program(curves, plan, config, folder / "program")
    nc = read_program(folder / "program", config=config)
    verify_program(
        nc, config=config, curves=curves, plan=plan, layers=layers, smooth=layers,
        beads=True, metal=True, heat=True,
    )  # fmt: skip


# What each of two processes does, in a folder of its name: each begins at another end
JOBS = {"first": (_sections, _program), "second": (_orders, _curves, _checks, _program)}


if __name__ == "__main__":
    own = Path(sys.argv[2], sys.argv[1])
    own.mkdir()
    logging.getLogger("ebamcheck").setLevel(logging.ERROR)  # nobody has asked for these parts and layers
    for job in JOBS[sys.argv[1]]:
        job(own)

"""The main job on small parts: what it calls, ``ebamcheck warm`` has compiled."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.curves import fit
from ebamcheck.layers.stack import from_rings
from ebamcheck.mesh.files import load
from ebamcheck.pipeline import run_job
from ebamcheck.plugins import registry
from ebamcheck.program import read_program, verify_program, write_program
from ebamcheck.scan import plan_scan, plan_stack
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import Slicing, slice_part

_SIDE_MM, _CONE_SIDES = 40.0, 32
_RING_SIDES = 48, 24


def _sections(folder: Path) -> None:
    """Slice a leaning box with every slicer of the house, along z and along a slanted direction."""
    part = load(_written(_leaning_box(), folder / "cube.stl"))
    for name in registry.house_slicers():
        if registry.probe(name).available:
            with Slicing(part, name) as slicing, slicing.along((0.0, 0.6, 0.8)) as turned:
                slicing.layers([1.0, 2.0, 3.0])
                turned.at(1.0)
                turned.layers(np.arange(20.0))


def _curves(folder: Path) -> None:
    """Fit curves to sections of a cone, which is lifted by its normals, and of a torus, which is a surface by formula."""
    for facets in (_cone(), _ring()):
        curved = load(_written(facets, folder / "round.stl"))
        fit(slice_part(curved, [0.3 * _SIDE_MM, 0.6 * _SIDE_MM]), part=curved)


def _program(folder: Path) -> None:
    """Make the program of two layers of a box, far thicker than any process lays them."""
    path = _written(_leaning_box(), folder / "cube.stl")
    thick = {"wire_speed_max_mm_s": 1000.0, "layer_over_bead": (0.5, 20.0)}
    config = Config().changed(layers={"layer_height_mm": 20.0}, process=thick)
    with _errors_alone():
        run_job(path, folder / "run", config, reference=path)
    _what_a_box_has_not()


def _orders(_folder: Path) -> None:
    """Order the islands of a square: a box of the size that the others have is one island."""
    plan_scan(shapely.box(0.0, 0.0, 3.0 * _SIDE_MM, 2.0 * _SIDE_MM))


def _checks(folder: Path) -> None:
    """Write, read and prove the program of two squares, so that no process meets the other at the end of the main job."""
    square = [(0.0, 0.0), (_SIDE_MM, 0.0), (_SIDE_MM, _SIDE_MM), (0.0, _SIDE_MM)]
    layers = from_rings([1.0, 3.0], [[square]] * 2)
    config = Config().changed(layers={"layer_height_mm": 2.0})
    curves, plan = fit(layers), plan_stack(layers, config)
    with _errors_alone():
        write_program(curves, plan, config, folder / "program")
        nc = read_program(folder / "program", config=config)
        verify_program(
            nc, config=config, curves=curves, plan=plan, layers=layers, smooth=layers,
            beads=True, metal=True, heat=True,
        )  # fmt: skip


# What each of two processes does, in a folder of its name: each begins at another end
JOBS = {"first": (_sections, _program), "second": (_orders, _curves, _checks, _program)}


@contextlib.contextmanager
def _errors_alone() -> Iterator[None]:
    """Say nothing of parts and layers that nobody has asked for."""
    logger = logging.getLogger("ebamcheck")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _what_a_box_has_not() -> None:
    """Splines in a program, and metal that lies beside the part."""
    from ebamcheck.checks.matching import nearest_each
    from ebamcheck.metal.target import moved_to_neighbours

    nearest_each(np.eye(2), np.eye(4))
    field = np.eye(2)
    moved_to_neighbours(np.zeros((2, 2)), field, field > 0.0, field == 0.0)


def _written(corners: NDArray[np.float32], path: Path) -> Path:
    """Write facets (F, 3, 3) as binary STL."""
    from ebamcheck.mesh.stl import FACET

    facets = np.zeros(len(corners), FACET)
    facets["corners"] = corners
    path.write_bytes(b"warm".ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())
    return path


def _cone() -> NDArray[np.float32]:
    """Facets (F, 3, 3) of a cone that is as coarse as a curved surface can be told by."""
    angle = 2.0 * np.pi * np.arange(_CONE_SIDES) / _CONE_SIDES
    rim = np.column_stack([_SIDE_MM * np.cos(angle), _SIDE_MM * np.sin(angle), np.zeros(_CONE_SIDES)])
    after = np.roll(rim, -1, axis=0)
    tip, middle = np.tile([0.0, 0.0, _SIDE_MM], (_CONE_SIDES, 1)), np.zeros((_CONE_SIDES, 3))
    sides, bottom = np.stack([rim, after, tip], axis=1), np.stack([after, rim, middle], axis=1)
    return np.concatenate([sides, bottom]).astype(np.float32)


def _ring() -> NDArray[np.float32]:
    """Facets (F, 3, 3) of a torus."""
    u, v = np.meshgrid(*(2.0 * np.pi * np.arange(count + 1) / count for count in _RING_SIDES), indexing="ij")
    across = _SIDE_MM * (2.0 + 0.5 * np.cos(v))
    at = np.stack([across * np.cos(u), across * np.sin(u), 0.5 * _SIDE_MM * (1.0 + np.sin(v))], axis=-1)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    facets = np.concatenate(
        [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    )
    return facets.astype(np.float32)


def _leaning_box() -> NDArray[np.float32]:
    """Facets (F, 3, 3) of a box that leans, so that sections have slanted edges."""
    low, high = 0.0, _SIDE_MM
    corners = np.array(
        [
            (x + 0.1 * z, y, z)
            for z in (low, high)
            for x, y in ((low, low), (high, low), (high, high), (low, high))
        ],
        dtype=np.float32,
    )
    faces = [
        (0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4),
        (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7),
    ]  # fmt: skip
    return np.asarray(corners[np.array(faces)], dtype=np.float32)


if __name__ == "__main__":
    own = Path(sys.argv[2], sys.argv[1])
    own.mkdir()
    for job in JOBS[sys.argv[1]]:
        job(own)

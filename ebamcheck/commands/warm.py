"""Compile the kernels once: those of the main job, ahead of it, on all cores."""

from __future__ import annotations

import contextlib
import io
import logging
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.plugins import registry
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import Slicing, slice_part

_SIDE_MM, _CONE_SIDES = 40.0, 32
_RING_SIDES = 48, 24


def warm_kernels() -> float:
    """Compile what the list of kernels names and the cache lacks; returns the seconds that it took.

    What is compiled lies in numba's cache beside the code (or in the user's cache folder where that cannot be
    written), so the second call takes seconds. What the list lacks is compiled when it is first called.
    """
    start = time.perf_counter()
    from ebamcheck.numeric.compiling_ahead import compile_ahead
    from ebamcheck.numeric.kernel_list import read_list

    compile_ahead(read_list().main)
    return time.perf_counter() - start


def main_job(folder: Path) -> None:
    """Do the main job on a cube, in this process and into `folder`: it calls the kernels that ``ebamcheck warm`` compiles."""
    from ebamcheck.curves import fit
    from ebamcheck.pipeline import run_job
    from ebamcheck.scan import plan_scan

    path = folder / "cube.stl"
    _write(_leaning_box(), path)
    # In this process and one after the other: workers side by side would compile the same things twice.
    from ebamcheck.mesh.files import load

    part = load(path)
    for name in registry.house_slicers():
        if registry.probe(name).available:
            with Slicing(part, name) as slicing, slicing.along((0.0, 0.6, 0.8)) as turned:
                slicing.layers([1.0, 2.0, 3.0])
                turned.at(1.0)
                turned.layers(np.arange(20.0))
    # A box has no curved region: a cone is lifted by its normals, a ring is a surface by formula.
    for facets in (_cone(), _ring()):
        round_path = folder / "round.stl"
        _write(facets, round_path)
        curved = load(round_path)
        fit(slice_part(curved, [0.3 * _SIDE_MM, 0.6 * _SIDE_MM]), part=curved)
    # Two layers, far thicker than any process lays them.
    thick = {"wire_speed_max_mm_s": 1000.0, "layer_over_bead": (0.5, 20.0)}
    config = Config().changed(layers={"layer_height_mm": 20.0}, process=thick)
    with _errors_alone():
        run_job(path, folder / "run", config, reference=path)
    # The cube is one island, which needs no order.
    plan_scan(shapely.box(0.0, 0.0, 3.0 * _SIDE_MM, 2.0 * _SIDE_MM))
    _what_a_box_has_not()


def other_jobs(folder: Path) -> None:
    """Do what other commands do with a run, a section and a part, after :func:`main_job` in the same folder."""
    from ebamcheck.commands.scan import scan_layer
    from ebamcheck.mesh.files import load
    from ebamcheck.verification.verify import verify

    if registry.probe("stencil").available:
        with Slicing(load(folder / "cube.stl"), "stencil", mode="literal") as literal:
            literal.layers([1.0, 2.0, 3.0])
    with _errors_alone(), contextlib.redirect_stdout(io.StringIO()):
        verify(folder / "run")
        # Bodies of several islands that overlap: their rings are united.
        box = np.float32(3.0) * _leaning_box()
        path = folder / "bodies.stl"
        _write(np.concatenate([box, box + np.float32(_SIDE_MM)]), path)
        scan_layer(
            load(path), Config(), 2.0 * _SIDE_MM, ("thermal", "random"), 1, (), folder / "orders", False
        )


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
    """Splines in a program."""
    from ebamcheck.checks.matching import shape_distance

    shape_distance(np.eye(2)[None], np.eye(2)[None])


def _write(corners: NDArray[np.float32], path: Path) -> None:
    """Write facets (F, 3, 3) as binary STL."""
    from ebamcheck.mesh.stl import FACET

    facets = np.zeros(len(corners), FACET)
    facets["corners"] = corners
    path.write_bytes(b"warm".ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())


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

"""Compile the kernels once: those of the main job, ahead of it, on all cores."""

from __future__ import annotations

import logging
import time
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.plugins import registry
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import Slicing

_SIDE_MM = 40.0


def warm_kernels() -> float:
    """Compile what the list of kernels names and the cache lacks; returns the seconds that it took.

    What is compiled lies in numba's cache beside the code (or in the user's cache folder where that cannot be
    written), so the second call takes seconds. What the list lacks is compiled when it is first called.
    """
    start = time.perf_counter()
    from ebamcheck.numeric.compiling_ahead import compile_ahead
    from ebamcheck.numeric.kernel_list import read_list

    compile_ahead(read_list())
    return time.perf_counter() - start


def main_job() -> None:
    """Do the main job on a cube, in this process: it calls every kernel that the list is to name."""
    from ebamcheck.mesh.stl import FACET
    from ebamcheck.pipeline import run_job
    from ebamcheck.scan import plan_scan

    with scratch_folder() as folder:
        path = Path(folder, "cube.stl")
        corners = _leaning_box()
        facets = np.zeros(len(corners), FACET)
        facets["corners"] = corners
        path.write_bytes(b"warm".ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())
        # In this process and one after the other: workers side by side would compile the same things twice.
        from ebamcheck.mesh.files import load

        part = load(path)
        for name in registry.house_slicers():
            if registry.probe(name).available:
                with Slicing(part, name) as slicing, slicing.along((0.0, 0.6, 0.8)) as turned:
                    slicing.layers([1.0, 2.0, 3.0])
                    turned.at(1.0)
                    turned.layers(np.arange(20.0))
        level = logging.getLogger("ebamcheck").level
        logging.getLogger("ebamcheck").setLevel(logging.ERROR)
        # Two layers, far thicker than any process lays them.
        thick = {"wire_speed_max_mm_s": 1000.0, "layer_over_bead": (0.5, 20.0)}
        settings = Config().changed(layers={"layer_height_mm": 20.0}, process=thick)
        run_job(path, Path(folder, "run"), settings, reference=path)
        logging.getLogger("ebamcheck").setLevel(level)
        # The cube is one island, which needs no order.
        plan_scan(shapely.box(0.0, 0.0, 3.0 * _SIDE_MM, 2.0 * _SIDE_MM))


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

"""Whether the in-plane rays place their crossings right, whether any layer is broken, and what Embree takes by itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import shapely

from benchmarks.timing import some_of
from benchmarks.worker import Begin
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.files import load
from ebamcheck.plugins import registry
from ebamcheck.threads import thread_count
from ebamcheck_embree.scene import Scene

JUDGED_LAYERS = 48
GRID_MM = 0.1


def crossings(begin: Begin, stl: str, layer_mm: float) -> dict[str, Any]:
    """Cut all layers with in-plane rays and hold them against the exact cut.

    Returns
    -------
    ``farthest_mm`` greatest distance of a point from the exact contour, on ``judged_layers``; ``broken_layers`` that
    have an open path, or other numbers of rings or holes than the exact cut; ``slice_s``; ``casts_s`` that
    all threads spend within Embree's own casts, over their number.
    """
    part = load(Path(stl))
    heights = layer_heights(part, layer_mm)
    begin()
    stacks: dict[str, Layers] = {}
    slice_s = 0.0
    casts_s: dict[str, float] = {}
    for name, values in (("planecut", {}), ("embree", {"grid_mm": GRID_MM})):
        with (
            casts() as each_s,
            registry.available_slicer(name).prepare(part, registry.slicer_settings(name, values)) as prepared,
        ):
            start = time.perf_counter()
            stacks[name] = prepared.slice(heights)
            slice_s = time.perf_counter() - start
        casts_s[name] = sum(each_s) / thread_count()
    exact, found = stacks["planecut"], stacks["embree"]
    broken = (
        (found.open_counts() > 0)
        | (found.ring_counts() != exact.ring_counts())
        | (found.hole_counts() != exact.hole_counts())
    )
    judged = np.searchsorted(heights, some_of(heights, JUDGED_LAYERS))
    return {
        "farthest_mm": max(farthest_mm(found, exact, int(k)) for k in judged),
        "judged_layers": len(judged),
        "broken_layers": int(np.count_nonzero(broken)),
        "slice_s": slice_s,
        "casts_s": casts_s["embree"],
    }


class Timed:
    """Embree's scene, each cast of which is timed."""

    def __init__(self, scene: Any, tell: Callable[[float], None]) -> None:
        self._scene, self._tell = scene, tell

    def run(self, *args: Any, **kwargs: Any) -> Any:
        """Cast all rays of a call."""
        start = time.perf_counter()
        found = self._scene.run(*args, **kwargs)
        self._tell(time.perf_counter() - start)
        return found


@contextmanager
def casts() -> Iterator[list[float]]:
    """Time, s, of each call of Embree on scenes that are made in the block, whichever thread makes it."""
    taken_s: list[float] = []
    plain = Scene.__init__

    def timed(scene: Scene, *mesh: Any) -> None:
        plain(scene, *mesh)
        scene._scene = Timed(scene._scene, taken_s.append)

    with mock.patch.object(Scene, "__init__", timed):
        yield taken_s


def farthest_mm(found: Layers, exact: Layers, layer: int) -> float:
    """Greatest distance of a point of one stack from the contours of another on a layer, mm."""
    points = [found.ring(r) for r in found.rings_of(layer)]
    rings = [exact.ring(r) for r in exact.rings_of(layer)]
    if not points or not rings:
        return 0.0 if len(points) == len(rings) else float("inf")
    edges = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings])
    tree = shapely.STRtree(np.asarray(shapely.linestrings(edges)))
    _, apart = tree.query_nearest(
        shapely.points(np.concatenate(points)), return_distance=True, all_matches=False
    )
    return float(np.max(apart))

"""What both methods share: the part about its centre, blocks of layers on all threads, one stack at the end."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from threading import Lock
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import run_blocks
from ebamcheck.layers import Layers, canonical
from ebamcheck.part import Part
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.scene import Facets, Floats, Ints, Scene

log = logging.getLogger(__name__)


class LayerRings(NamedTuple):
    """Rings of one layer, about the centre of the part, and how many of its rays did not pair."""

    points: Floats
    starts: Ints
    unpaired: int


class Rays(ABC):
    """A part made ready for one way of casting rays."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        self.part = part
        self.grid = grid
        self.rays_per_call = rays_per_call
        self.labels = labels
        self.centre_mm: Floats = part.bounds.mean(axis=0)
        self.vertices: Floats = np.ascontiguousarray(part.vertices - self.centre_mm)
        self.faces: Facets = np.ascontiguousarray(part.faces, dtype=np.int32)
        self._scene: Scene | None = Scene(self.vertices, self.faces)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._scene = None

    @property
    def scene(self) -> Scene:
        """The tree; raises :class:`BackendFailed` once it was released."""
        return self._require_scene()

    def _require_scene(self) -> Scene:
        if self._scene is None:
            raise BackendFailed(f"embree: part {self.part.name!r} was released: prepare it again")
        return self._scene

    @abstractmethod
    def cut(self, z_mm: Floats, report: Progress) -> list[LayerRings]:
        """Cut at consecutive heights about the centre of the part; a layer's result is its own."""

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm, on all threads."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        z_mm = heights - self.centre_mm[2]
        lock = Lock()

        def report(count: int) -> None:
            if progress is not None:
                with lock:
                    progress(count)

        self._require_scene()
        blocks = run_blocks(lambda a, b: self.cut(z_mm[a:b], report), len(heights)) if len(heights) else []
        return self._stack(heights, [layer for block in blocks for layer in block])

    def _stack(self, heights: Floats, layers: list[LayerRings]) -> Layers:
        unpaired = [layer.unpaired for layer in layers]
        if any(unpaired):
            worst = int(np.argmax(unpaired))
            log.warning(
                "embree: part %r is open or has facets turned over: in %d of %d layers rays do not pair "
                "(most at z = %.6g mm: %d); they were mended from their neighbours",
                self.part.name, sum(n > 0 for n in unpaired), len(layers), heights[worst], unpaired[worst],
            )  # fmt: skip
        sizes = [np.diff(layer.starts) for layer in layers]
        points = np.concatenate([layer.points for layer in layers]) if layers else np.zeros((0, 2))
        ring_sizes = np.concatenate(sizes) if sizes else np.zeros(0, np.int64)
        return canonical(
            heights,
            points + self.centre_mm[:2],
            np.concatenate([[0], np.cumsum(ring_sizes)]),
            np.concatenate([[0], np.cumsum([len(size) for size in sizes])]),
            np.ones(len(ring_sizes), np.bool_),
            part=self.part.sha256,
            direction=self.part.direction,
            backend="embree",
            settings=dict(self.labels),
        )

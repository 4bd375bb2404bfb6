"""What both methods share: the part about its centre, blocks of layers on all threads, one stack at the end."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from threading import Lock
from types import TracebackType
from typing import Any, ClassVar, Self

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers, canonical, concatenate
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import run_blocks
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.rings import Rings, room_for_rings
from ebamcheck_embree.scene import Floats, Ints, Scene
from ebamcheck_embree.section import Mesh

log = logging.getLogger(__name__)


class GridRays(ABC):
    """A part made ready for one way of casting rays."""

    layers_a_block: ClassVar[int]
    """Layers that a thread takes at least: fewer cost more than they save."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        self.part = part
        self.grid = grid
        self.rays_per_call = rays_per_call
        self.labels = labels
        self.centre_mm: Floats = part.bounds.mean(axis=0)
        self.mesh = Mesh(
            np.ascontiguousarray(part.vertices - self.centre_mm),
            np.ascontiguousarray(part.faces, dtype=np.int32),
        )
        self._scene: Scene | None = Scene(*self.mesh)

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
    def cut(self, z_mm: Floats, report: Progress) -> Iterator[Rings]:
        """Cut at consecutive heights about the centre of the part, piece by piece; a layer's result is its own."""

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm, on all threads."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        self._require_scene()
        if not heights.size:
            return self._layers(heights, room_for_rings(0))
        lock = Lock()

        def report(count: int) -> None:
            if progress is not None:
                with lock:
                    progress(count)

        def cut(start: int, stop: int) -> list[tuple[Layers, Ints]]:
            done: list[tuple[Layers, Ints]] = []
            for rings in self.cut(heights[start:stop] - self.centre_mm[2], report):
                past = start + len(rings.unpaired)
                done.append((self._layers(heights[start:past], rings), rings.unpaired))
                start = past
            return done

        pieces = [piece for block in run_blocks(cut, len(heights), self.layers_a_block) for piece in block]
        self._report_unpaired(heights, np.concatenate([unpaired for _, unpaired in pieces]))
        return concatenate([layers for layers, _ in pieces])

    def _layers(self, heights: Floats, rings: Rings) -> Layers:
        """Canonical layers of the rings of consecutive layers."""
        points, count = rings.used
        return canonical(
            heights,
            rings.points[:points],
            rings.ring_starts[: count + 1],
            rings.layer_starts,
            np.ones(count, np.bool_),
            part=self.part.sha256,
            direction=self.part.direction,
            backend="embree",
            settings=dict(self.labels),
        )

    def _report_unpaired(self, heights: Floats, unpaired: Ints) -> None:
        """Warn of layers in which rays do not pair."""
        if unpaired.any():
            worst = int(np.argmax(unpaired))
            log.warning(
                "embree: part %r is open or has facets turned over: in %d of %d layers rays do not pair "
                "(most at z = %.6g mm: %d); they were mended from their neighbours",
                self.part.name, int((unpaired > 0).sum()), len(unpaired), heights[worst], unpaired[worst],
            )  # fmt: skip

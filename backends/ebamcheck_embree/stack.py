"""Base of both ray-casting methods: coordinates from the part's centre, and blocks of layers on all threads."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Self

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers, canonical, stacked
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import run_in_order
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.rings import Rings, room_for_rings
from ebamcheck_embree.scene import Floats, Ints
from ebamcheck_embree.section import Mesh

log = logging.getLogger(__name__)


PIECES_A_THREAD = 4
"""Least number of pieces of a stack per thread, if it has enough layers: they take unequal time."""


class GridRays(ABC):
    """A part prepared for one way of casting rays."""

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
        self._released = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._released = True

    @abstractmethod
    def pieces(self, z_mm: Floats) -> Ints:
        """Divide consecutive heights (L,) into pieces that threads cut one after the other: from 0 to L, ascending."""

    @abstractmethod
    def cut(self, z_mm: Floats) -> Iterator[Rings]:
        """Cut a piece at heights from the centre of the part, some layers at a time; no layer depends on the others."""

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm, on all threads."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        if self._released:
            raise BackendFailed(f"embree: part {self.part.name!r} was released: prepare it again")
        if not heights.size:
            return self._layers(heights, room_for_rings(0))
        z_mm = heights - self.centre_mm[2]

        def cut(start: int, stop: int) -> list[tuple[Layers, Ints]]:
            done: list[tuple[Layers, Ints]] = []
            for rings in self.cut(z_mm[start:stop]):
                past = start + len(rings.unpaired)
                done.append((self._layers(heights[start:past], rings), rings.unpaired))
                start = past
            return done

        unpaired: list[Ints] = []

        def layers_in_order() -> Iterator[Layers]:
            for piece in run_in_order(cut, self.pieces(z_mm).tolist()):
                for layers, odd in piece:
                    unpaired.append(odd)
                    yield layers
                    if progress is not None:
                        progress(len(layers))

        stack = stacked(layers_in_order())
        self._report_unpaired(heights, np.concatenate(unpaired))
        return stack

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
        """Warn of layers with rays whose borders do not come in pairs."""
        if unpaired.any():
            worst = int(np.argmax(unpaired))
            log.warning(
                "embree: part %r is open or has facets turned over: in %d of %d layers rays do not pair "
                "(most at z = %.6g mm: %d); they were mended from their neighbours",
                self.part.name, int((unpaired > 0).sum()), len(unpaired), heights[worst], unpaired[worst],
            )  # fmt: skip

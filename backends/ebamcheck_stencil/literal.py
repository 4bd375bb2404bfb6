"""The paper's form (section 2.2): for every layer, draw the facets above it into a stencil buffer and keep which pixels are solid.

The near plane at the slice height clips what lies below. A ray upwards adds 1 to the stencil at a facet that faces forward (normal
up) and subtracts 1 at one that faces backward, in wrapping 8-bit arithmetic; pixels that end at 1 or 2 are solid. A compute shader
packs them into bitmaps; contours of one block of layers are followed while the next is drawn."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.threads import run_blocks
from ebamcheck_stencil.crossings import Flips, empty_bitmap
from ebamcheck_stencil.drawn_facets import drawn_facets
from ebamcheck_stencil.field_of_view import SUBPIXELS, WORD_BITS, FieldOfView, windows
from ebamcheck_stencil.marching_squares import Rings, contours_of_layers, layers_of
from ebamcheck_stencil.stencil_target import PACKED_BITS, Drawing, StencilTarget

if TYPE_CHECKING:
    import moderngl

# Height of the far plane above the part, over the part's height: nothing may be clipped there
DEPTH_SLACK = 1.0 / 64.0

# Most layers, and about the most bytes of bitmaps, that are drawn before they are read back
LAYERS_AT_ONCE, BYTES_AT_ONCE = 16, 2**24
NO_FLIPS = Flips(np.zeros(1, np.int64), np.empty(0, np.uint32))
DRAWS_AT_WORK = 2  # readings that the device is given at a time: it draws one while another is copied
DRAWS_A_BLOCK = 8  # readings whose contours are followed together: few layers are not worth all threads
BLOCKS_AT_WORK = 2  # blocks of bitmaps that are drawn or followed at a time
# Distance from the near plane, as a share of the part's height, at which float32 may still put a facet on it
BELOW_SLACK = 2.0**-22

VERTEX_SHADER = """
#version 430
in vec3 place;
uniform float slice_height;
uniform float depth_per_mm;
void main() {
    gl_Position = vec4(place.xy, (place.z - slice_height) * depth_per_mm - 1.0, 1.0);
}
"""

FRAGMENT_SHADER = """
#version 430
void main() {}
"""


class LiteralSlices:
    """A part on the graphics device, cut by one draw per layer."""

    def __init__(
        self, context: moderngl.Context, part: Part, view: FieldOfView, largest_px: int,
        labels: dict[str, Any],
    ) -> None:  # fmt: skip
        self._context = context
        self._view = view
        self._labels = labels
        self._windows = list(windows(view, max(1, largest_px // PACKED_BITS) * PACKED_BITS))
        self._middle_mm = float(part.bounds[:, 2].mean())
        self._top_mm = float(part.bounds[1, 2])
        self._height_mm = float(part.size[2])
        self._program = context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
        lattice = view.snapped(part.vertices)
        heights = (part.vertices[:, 2] - self._middle_mm).astype(np.float32)
        self._drawn = drawn_facets(part, lattice, heights, view)
        # A power of two times a whole number: exact in float32.
        across = lattice * (2.0 / (view.viewport_px * SUBPIXELS)) - 1.0
        self._facets = context.vertex_array(
            self._program,
            [(context.buffer(np.column_stack([across.astype(np.float32), heights])), "3f", "place")],
            # A device takes no empty list.
            index_buffer=context.buffer(self._drawn.faces if len(self._drawn.faces) else part.faces[:1]),
        )
        self._bitmap_bytes, self._bitmap_words = empty_bitmap(view).nbytes, empty_bitmap(view).size
        self._at_once = max(1, min(LAYERS_AT_ONCE, BYTES_AT_ONCE // self._bitmap_bytes))
        self._target = StencilTarget(context, self._windows, view)
        self._drawings = [Drawing(context, self._at_once * self._bitmap_bytes) for _ in range(DRAWS_AT_WORK)]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.release()

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,): one draw per layer, of the facets above it that a ray can meet."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        size = min(DRAWS_A_BLOCK * self._at_once, max(1, heights.size))
        room = np.empty((BLOCKS_AT_WORK, size, self._bitmap_words), np.uint64)
        blocks: list[Future[list[Rings]]] = []
        with ThreadPoolExecutor(1) as pool:
            for first in range(0, max(1, heights.size), size):
                if len(blocks) >= BLOCKS_AT_WORK:
                    blocks[-BLOCKS_AT_WORK].result()
                chosen = heights[first : first + size]
                bitmaps = room[len(blocks) % BLOCKS_AT_WORK, : chosen.size]
                for drawn in self._draw(chosen, bitmaps):
                    if progress is not None:
                        progress(drawn)
                blocks.append(pool.submit(self._rings, bitmaps))
            found = [rings for block in blocks for rings in block.result()]
        return layers_of(heights, found, self._view, self._labels)

    def _draw(self, heights: NDArray[np.float64], bitmaps: NDArray[np.uint64]) -> Iterator[int]:
        """Draw the bitmaps (heights, words) of a block of layers; yields the number of layers that became ready. The device draws
        some while others are fetched."""
        drawn = int(np.searchsorted(heights, self._top_mm, side="right")) if self._height_mm > 0.0 else 0
        bitmaps[drawn:] = 0
        edges = [*range(0, drawn, self._at_once), drawn]
        waiting: deque[tuple[Drawing, NDArray[np.uint64]]] = deque()
        # An earlier draw may have left another context current, from which reads return noise. (Contexts do not nest:
        # after leaving an inner one, none is current.)
        for k, (start, stop) in enumerate(pairwise(edges)):
            drawing = self._drawings[k % DRAWS_AT_WORK]
            with self._context:
                self._submit(heights[start:stop], drawing)
            waiting.append((drawing, bitmaps[start:stop]))
            if len(waiting) == DRAWS_AT_WORK:
                yield self._fetch(*waiting.popleft())
        while waiting:
            yield self._fetch(*waiting.popleft())
        if drawn < heights.size:
            yield heights.size - drawn

    def _fetch(self, drawing: Drawing, bitmaps: NDArray[np.uint64]) -> int:
        """Wait for bitmaps and copy them."""
        with self._context:
            drawing.fetch(bitmaps)
        return len(bitmaps)

    def _submit(self, heights: NDArray[np.float64], drawing: Drawing) -> None:
        """Have the device draw a few layers at or below the top, and wait for nothing."""
        planes = heights - self._middle_mm
        facets = self._drawn.ranges(planes, BELOW_SLACK * self._height_mm)
        self._target.begin(drawing.bitmaps)
        for layer, (plane, runs) in enumerate(zip(planes.tolist(), facets, strict=True)):
            depth_mm = self._top_mm - self._middle_mm - plane
            self._program["slice_height"] = plane
            self._program["depth_per_mm"] = 2.0 / (depth_mm + DEPTH_SLACK * self._height_mm)
            for window in self._windows:
                self._target.draw(window, self._facets, runs, layer)
        drawing.submitted(len(heights) * self._bitmap_bytes)

    def _rings(self, bitmaps: NDArray[np.uint64]) -> list[Rings]:
        """Rings of drawn bitmaps, on all threads."""
        row_words = self._view.stride_px // WORD_BITS

        def rings_between(start: int, stop: int) -> Rings:
            return contours_of_layers(NO_FLIPS, bitmaps, start, stop, row_words)

        return run_blocks(rings_between, len(bitmaps))

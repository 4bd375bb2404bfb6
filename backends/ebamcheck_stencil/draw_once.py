"""The draw-once form: a single draw lists the facets that the ray of every pixel meets.

Heights and signs follow in double precision (:mod:`ebamcheck_stencil.crossings`); any height is cut without drawing again.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.threads import block_edges, run_blocks, run_in_order
from ebamcheck_stencil.crossings import Crossings, crossings_of_fragments, empty_bitmap, flips_by_layer, join
from ebamcheck_stencil.field_of_view import SUBPIXELS, WORD_BITS, FieldOfView, Window, windows
from ebamcheck_stencil.marching_squares import Rings, contours_of_layers, layers_of

if TYPE_CHECKING:
    import moderngl

log = logging.getLogger(__name__)

LAYERS_AT_ONCE = 256  # most layers between two reports of progress

BYTES_PER_FRAGMENT = 8
FACETS_A_BLOCK = 65536  # fewest facets worth a thread
# Buffer size over the estimate by projected area, which is right to well below a percent; the counter shows an overflow
ESTIMATE_SLACK = 1.05
# Least size of the buffer, in fragments: the estimate is poor if facets are few and smaller than pixels
SMALLEST_BUFFER = 4096

VERTEX_SHADER = """
#version 430
in ivec2 lattice;
uniform float ndc_per_step;
void main() { gl_Position = vec4(vec2(lattice) * ndc_per_step - 1.0, 0.0, 1.0); }
"""

FRAGMENT_SHADER = """
#version 430
layout(std430, binding = 0) buffer Counter { uint count; };
layout(std430, binding = 1) buffer Fragments { uvec2 fragments[]; };
uniform uint capacity;
uniform uint stride;
uniform ivec2 corner;
void main() {
    uint place = atomicAdd(count, 1u);
    if (place < capacity) {
        ivec2 pixel = ivec2(gl_FragCoord.xy) + corner;
        fragments[place] = uvec2(uint(pixel.y) * stride + uint(pixel.x), uint(gl_PrimitiveID));
    }
}
"""


def draw_crossings(
    context: moderngl.Context, part: Part, view: FieldOfView, largest_px: int, buffer_bytes: int
) -> Crossings:
    """Draw a part once and find where the ray of each pixel enters and leaves the solid.

    The field is drawn in windows of at most `largest_px` a side whose fragments fit into `buffer_bytes`; the result does not depend
    on them. :class:`BackendFailed` is raised where the fragments of a single pixel do not fit.
    """
    if not len(part.faces):
        return join([])
    lattice = view.snapped(part.vertices)
    expected = _expected_fragments(lattice, part.faces)
    largest = max(1, buffer_bytes // BYTES_PER_FRAGMENT)
    capacity = min(largest, int(ESTIMATE_SLACK * expected) + SMALLEST_BUFFER)
    waiting = list(windows(view, largest_px, bands=1 + int(expected / capacity)))[::-1]
    found: list[Crossings] = []
    drawing = _Drawing(context, lattice, part.faces, view, capacity)
    while waiting:
        window = waiting.pop()
        fragments = drawing.fragments(window)
        if fragments is not None:
            found.extend(crossings_of_fragments(fragments, part, lattice, view.stride_px, window.y, window.height))
            continue
        halves = window.halves()
        if halves is None:
            raise BackendFailed(
                f"stencil: over {capacity} facets lie over one pixel of {view.pixel_mm:g} mm at "
                f"({window.x}, {window.y}): raise buffer_mb"
            )
        log.debug("%s overflows a buffer of %d fragments: drawn in two", window, capacity)
        waiting.extend(halves[::-1])
    return join(found)


def _expected_fragments(lattice: NDArray[np.int32], faces: NDArray[np.int32]) -> float:
    """Projected area of all facets, in pixels."""

    def doubled(start: int, stop: int) -> float:
        a, b, c = faces[start:stop].T
        (ux, uy), (vx, vy) = ((lattice[k] - lattice[a]).astype(np.float64).T for k in (b, c))
        return float(np.abs(ux * vy - uy * vx).sum())

    return sum(run_blocks(doubled, len(faces), FACETS_A_BLOCK)) / (2.0 * SUBPIXELS**2)


class _Drawing:
    """Program and buffers of the draw; they are released with their context."""

    def __init__(
        self, context: moderngl.Context, lattice: NDArray[np.int32], faces: NDArray[np.int32],
        view: FieldOfView, capacity: int,
    ) -> None:  # fmt: skip
        self._context = context
        self._view = view
        self._capacity = capacity
        self._program = context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
        self._program["ndc_per_step"] = 2.0 / (view.viewport_px * SUBPIXELS)
        self._program["stride"] = view.stride_px
        self._program["capacity"] = capacity
        self._facets = context.vertex_array(
            self._program,
            [(context.buffer(lattice), "2i", "lattice")],
            index_buffer=context.buffer(np.ascontiguousarray(faces)),
        )
        self._counter = context.buffer(reserve=4)
        self._fragments = context.buffer(reserve=capacity * BYTES_PER_FRAGMENT)
        self._counter.bind_to_storage_buffer(0)
        self._fragments.bind_to_storage_buffer(1)

    def fragments(self, window: Window) -> NDArray[np.uint32] | None:
        """Draw one window: (n, 2) pixel and facet of each fragment, in any order; None on overflow."""
        side = self._view.viewport_px
        target = self._context.empty_framebuffer((window.width, window.height))
        target.use()
        # The viewport holds the whole field, lest a facet be clipped at a window's border.
        target.viewport = (-window.x, -window.y, side, side)
        self._program["corner"] = (window.x, window.y)
        self._counter.write(bytes(4))
        self._facets.render()
        self._context.memory_barrier()
        self._context.finish()
        target.release()
        count = int.from_bytes(self._counter.read(), "little")
        if count > self._capacity:
            return None
        data = self._fragments.read(size=count * BYTES_PER_FRAGMENT) if count else b""
        return np.frombuffer(data, np.uint32).reshape(-1, 2)


class DrawnOnce:
    """A part drawn once: the crossings of all rays, from which any layer follows without OpenGL."""

    def __init__(self, view: FieldOfView, crossings: Crossings, labels: dict[str, Any]) -> None:
        self._view = view
        self._crossings = crossings
        self._labels = labels

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Free nothing: the context was released when the part had been drawn."""

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), in any number of calls."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        flips = flips_by_layer(self._crossings, heights)
        none, row_words = empty_bitmap(self._view).reshape(1, -1)[:0], self._view.stride_px // WORD_BITS

        def rings_between(start: int, stop: int) -> Rings:
            return contours_of_layers(flips, none, start, stop, row_words)

        edges = block_edges(heights.size, largest=LAYERS_AT_ONCE)
        found: list[Rings] = []
        for first, rings in zip(edges, run_in_order(rings_between, edges), strict=False):
            found.append(rings)
            if progress is not None:
                progress(edges[len(found)] - first)
        return layers_of(heights, found, self._view, self._labels)

"""The draw-once form: a single draw lists the facets that the ray of every pixel meets.

The fragment shader only appends (pixel, facet) to a buffer, by an atomic counter. Heights and signs
follow on the processor in double precision (:mod:`ebamcheck_stencil.crossings`); any height can be
cut from them without drawing again.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import BackendFailed
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck_stencil.crossings import Crossings, crossings_of_fragments, join
from ebamcheck_stencil.field_of_view import SUBPIXELS, FieldOfView
from ebamcheck_stencil.windows import Window, windows

if TYPE_CHECKING:
    import moderngl

log = logging.getLogger(__name__)

BYTES_PER_FRAGMENT = 8
FACETS_A_BLOCK = 65536
"""Fewest facets worth a thread."""
ESTIMATE_SLACK = 1.05
"""Buffer size over the estimate by projected area, which is right to well below a percent; the counter shows an overflow."""
SMALLEST_BUFFER = 4096
"""Least size of the buffer, in fragments: the estimate is poor if facets are few and smaller than pixels."""

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

    The field is drawn window by window where an image is limited to `largest_px` or the fragments do not
    fit into `buffer_bytes`. A window keeps the rays of its pixels whole, so the result is the same for
    any tiling.

    Raises
    ------
    BackendFailed
        If the fragments of a single pixel do not fit into the buffer.
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
            found.extend(
                crossings_of_fragments(fragments, part, lattice, view.stride_px, window.y, window.height)
            )
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
    areas = run_blocks(
        lambda start, stop: _doubled_area(lattice, faces, start, stop), len(faces), FACETS_A_BLOCK
    )
    return sum(areas) / (2.0 * SUBPIXELS**2)


@kernel
def _doubled_area(lattice: NDArray[np.int32], faces: NDArray[np.int32], start: int, stop: int) -> float:
    """Twice the projected area of facets ``start .. stop - 1``, in lattice steps."""
    total = 0.0
    for i in range(start, stop):
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        ax, ay = np.int64(lattice[a, 0]), np.int64(lattice[a, 1])
        ux, uy = np.int64(lattice[b, 0]) - ax, np.int64(lattice[b, 1]) - ay
        vx, vy = np.int64(lattice[c, 0]) - ax, np.int64(lattice[c, 1]) - ay
        total += abs(ux * vy - uy * vx)
    return total


class _Drawing:
    """Program and buffers of the draw; they are released with their context."""

    def __init__(
        self,
        context: moderngl.Context,
        lattice: NDArray[np.int32],
        faces: NDArray[np.int32],
        view: FieldOfView,
        capacity: int,
    ) -> None:
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

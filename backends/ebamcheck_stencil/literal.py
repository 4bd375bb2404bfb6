"""The paper's form: for every layer, draw the facets above it into a stencil buffer and keep which pixels are solid.

As in section 2.2 of the paper, the projection puts the near plane at the slice height, which clips what lies
below; facets that are below it as a whole are not sent. A ray upwards adds 1 to the stencil at a facet that faces
forward (normal up) and subtracts 1 at one that faces backward, in wrapping 8-bit arithmetic; pixels that end at 1 or 2
are solid. A compute shader packs them into bitmaps, a bit each, so that little is read back; contours of one block of
layers are followed while the next is drawn. The stencil buffer is OpenGL's own, used through PyOpenGL on the context
that moderngl opened, because moderngl has no stencil state.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.layers.stack import Layers, concatenate
from ebamcheck.mesh.part import Part
from ebamcheck_stencil.bitmaps import as_image, empty_bitmap
from ebamcheck_stencil.contours import Rings, contoured
from ebamcheck_stencil.field_of_view import SUBPIXELS, WORD_BITS, FieldOfView
from ebamcheck_stencil.marching_squares import contours_of_bitmaps
from ebamcheck_stencil.windows import Window, windows

if TYPE_CHECKING:
    import moderngl

INSIDE_COUNTS = (1, 2)
"""Stencil values of solid pixels, as in the paper."""

DEPTH_SLACK = 1.0 / 64.0
"""Height of the far plane above the part, over the part's height: nothing may be clipped there."""

LAYERS_AT_ONCE = 16
BYTES_AT_ONCE = 2**24
"""Most layers, and about the most bytes of bitmaps, that are drawn before they are read back."""

DRAWS_A_BLOCK = 8
"""Readings whose contours are followed together: few layers are not worth all threads."""

BLOCKS_AT_WORK = 2
"""Blocks of bitmaps that are drawn or followed at a time."""

BELOW_SLACK = 2.0**-22
"""Depth below the near plane, as a share of the part's height, at which float32 may still put a facet on it."""

PACKED_BITS = 32
"""Bits of a word of GLSL; two of them are a word of a bitmap."""

PACKING_SIDE = 8
"""Side of the square of words that a group of the compute shader packs."""

VERTEX_SHADER = """
#version 430
in ivec2 lattice;
in float height;
uniform float ndc_per_step;
uniform float slice_height;
uniform float depth_per_mm;
void main() {
    vec2 place = vec2(lattice) * ndc_per_step - 1.0;
    gl_Position = vec4(place, (height - slice_height) * depth_per_mm - 1.0, 1.0);
}
"""

FRAGMENT_SHADER = """
#version 430
void main() {}
"""

PACKING_SHADER = f"""
#version 430
layout(local_size_x = {PACKING_SIDE}, local_size_y = {PACKING_SIDE}) in;
layout(binding = 0) uniform usampler2D counts;
layout(std430, binding = 0) buffer Bitmaps {{ uint words[]; }};
uniform ivec2 corner;
uniform ivec2 size;
uniform int row_words;
uniform int first_word;
void main() {{
    int column = corner.x / 32 + int(gl_GlobalInvocationID.x);
    ivec2 pixel = ivec2(32 * column - corner.x, int(gl_GlobalInvocationID.y));
    if (column >= row_words || pixel.y >= size.y) return;
    int place = first_word + (corner.y + pixel.y) * row_words + column;
    // The window to the left has drawn the pixels of this word that lie before this one.
    uint word = pixel.x < 0 ? words[place] : 0u;
    for (int bit = max(0, -pixel.x); bit < min(32, size.x - pixel.x); ++bit) {{
        uint count = texelFetch(counts, pixel + ivec2(bit, 0), 0).r;
        if (count >= {INSIDE_COUNTS[0]}u && count <= {INSIDE_COUNTS[1]}u) word |= 1u << bit;
    }}
    words[place] = word;
}}
"""


class LiteralSlices:
    """A part on the graphics device, cut by one draw per layer."""

    def __init__(
        self,
        context: moderngl.Context,
        part: Part,
        view: FieldOfView,
        largest_px: int,
        labels: dict[str, Any],
    ) -> None:
        self._context = context
        self._view = view
        self._labels = labels
        self._windows = list(windows(view, largest_px))
        self._middle_mm = float(part.bounds[:, 2].mean())
        self._top_mm = float(part.bounds[1, 2])
        self._height_mm = float(part.size[2])
        self._program = context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
        self._program["ndc_per_step"] = 2.0 / (view.viewport_px * SUBPIXELS)
        heights = (part.vertices[:, 2] - self._middle_mm).astype(np.float32)
        tops = heights[part.faces].max(axis=1)
        downwards = np.argsort(-tops)
        self._facet_depths = -tops[downwards].astype(np.float64)
        self._facets = context.vertex_array(
            self._program,
            [
                (context.buffer(view.snapped(part.vertices)), "2i", "lattice"),
                (context.buffer(heights), "f", "height"),
            ],
            index_buffer=context.buffer(part.faces[downwards]),
        )
        self._bitmap_bytes, self._bitmap_words = empty_bitmap(view).nbytes, empty_bitmap(view).size
        self._at_once = max(1, min(LAYERS_AT_ONCE, BYTES_AT_ONCE // self._bitmap_bytes))
        self._bitmaps = context.buffer(reserve=self._at_once * self._bitmap_bytes)
        self._target = _StencilTarget(context, self._windows, view)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.release()

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), one draw of all facets above for each."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        size = min(DRAWS_A_BLOCK * self._at_once, max(1, heights.size))
        room = np.empty((BLOCKS_AT_WORK, size, self._bitmap_words), np.uint64)
        blocks: list[Future[Layers]] = []
        with ThreadPoolExecutor(1) as pool:
            for first in range(0, max(1, heights.size), size):
                if len(blocks) >= BLOCKS_AT_WORK:
                    blocks[-BLOCKS_AT_WORK].result()
                chosen = heights[first : first + size]
                bitmaps = room[len(blocks) % BLOCKS_AT_WORK, : chosen.size]
                for start in range(0, chosen.size, self._at_once):
                    drawn = slice(start, start + self._at_once)
                    self._draw(chosen[drawn], bitmaps[drawn])
                    if progress is not None:
                        progress(chosen[drawn].size)
                blocks.append(pool.submit(self._layers, chosen, bitmaps))
            return concatenate([block.result() for block in blocks])

    def bitmap(self, height_mm: float) -> NDArray[np.bool_]:
        """Image (height, width) of the section at a height, row 0 at the least y."""
        bitmaps = np.empty((1, self._bitmap_words), np.uint64)
        self._draw(np.array([height_mm]), bitmaps)
        return as_image(bitmaps[0], self._view)

    def _draw(self, heights: NDArray[np.float64], bitmaps: NDArray[np.uint64]) -> None:
        """Draw the bitmaps (heights, words) of a block of layers and read them."""
        drawn = int(np.searchsorted(heights, self._top_mm, side="right")) if self._height_mm > 0.0 else 0
        bitmaps[drawn:] = 0
        if not drawn:
            return
        # An earlier draw may have left another context current, from which reads return noise. (Contexts do not nest:
        # after leaving an inner one, none is current.)
        with self._context:
            self._submit(heights[:drawn])
            self._target.wait()
            self._bitmaps.read_into(bitmaps[:drawn], size=drawn * self._bitmap_bytes)

    def _submit(self, heights: NDArray[np.float64]) -> None:
        """Have the device draw a block of layers at or below the top, and wait for nothing."""
        planes = heights - self._middle_mm
        facets = np.searchsorted(self._facet_depths, BELOW_SLACK * self._height_mm - planes, side="right")
        self._target.begin(self._bitmaps)
        for layer, (plane, count) in enumerate(zip(planes.tolist(), facets.tolist(), strict=True)):
            depth_mm = self._top_mm - self._middle_mm - plane
            self._program["slice_height"] = plane
            self._program["depth_per_mm"] = 2.0 / (depth_mm + DEPTH_SLACK * self._height_mm)
            for window in self._windows:
                self._target.draw(window, self._facets, count, layer)

    def _layers(self, heights: NDArray[np.float64], bitmaps: NDArray[np.uint64]) -> Layers:
        """Contours of drawn bitmaps, on all threads."""
        row_words = self._view.stride_px // WORD_BITS

        def rings_between(start: int, stop: int) -> Rings:
            return contours_of_bitmaps(bitmaps[start:stop], row_words)

        return contoured(heights, rings_between, self._view, self._labels)


class _StencilTarget:
    """A framebuffer that is a stencil buffer, with the paper's counting switched on, and the packing of its pixels."""

    def __init__(self, context: moderngl.Context, drawn: Sequence[Window], view: FieldOfView) -> None:
        try:
            from OpenGL import GL as gl  # noqa: N811
        except Exception as error:  # PyOpenGL raises whatever its platform plugin does
            raise BackendMissing(f"mode 'literal' needs PyOpenGL, which does not load: {error}") from None
        self._gl = gl
        self._context = context
        self._view = view
        self._window: Window | None = None
        width, height = max(w.width for w in drawn), max(w.height for w in drawn)
        self._pack = context.compute_shader(PACKING_SHADER)
        self._row_words = view.stride_px // PACKED_BITS
        self._pack["row_words"] = self._row_words
        self._framebuffer = gl.glGenFramebuffers(1)
        self._counts = gl.glGenTextures(1)
        gl.glBindTexture(gl.GL_TEXTURE_2D, self._counts)
        gl.glTexStorage2D(gl.GL_TEXTURE_2D, 1, gl.GL_DEPTH24_STENCIL8, width, height)
        gl.glTexParameteri(gl.GL_TEXTURE_2D, gl.GL_DEPTH_STENCIL_TEXTURE_MODE, gl.GL_STENCIL_INDEX)
        for end in (gl.GL_TEXTURE_MIN_FILTER, gl.GL_TEXTURE_MAG_FILTER):
            gl.glTexParameteri(gl.GL_TEXTURE_2D, end, gl.GL_NEAREST)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        gl.glFramebufferTexture2D(
            gl.GL_FRAMEBUFFER, gl.GL_DEPTH_STENCIL_ATTACHMENT, gl.GL_TEXTURE_2D, self._counts, 0
        )
        gl.glDrawBuffer(gl.GL_NONE)
        gl.glReadBuffer(gl.GL_NONE)
        status = gl.glCheckFramebufferStatus(gl.GL_FRAMEBUFFER)
        if status != gl.GL_FRAMEBUFFER_COMPLETE:
            raise BackendFailed(
                f"stencil: this driver refuses a stencil buffer of {width} x {height} pixels "
                f"(status {int(status):#x}): use mode 'draw-once'"
            )

    def begin(self, bitmaps: moderngl.Buffer) -> None:
        """Set the paper's counting, and where bitmaps go."""
        gl = self._gl
        self._window = None
        bitmaps.bind_to_storage_buffer(0)
        gl.glActiveTexture(gl.GL_TEXTURE0)
        gl.glBindTexture(gl.GL_TEXTURE_2D, self._counts)
        for switched_off in (gl.GL_DEPTH_TEST, gl.GL_CULL_FACE, gl.GL_SCISSOR_TEST, gl.GL_BLEND):
            gl.glDisable(switched_off)
        gl.glEnable(gl.GL_STENCIL_TEST)
        gl.glStencilMask(0xFF)
        gl.glClearStencil(0)
        gl.glStencilFunc(gl.GL_ALWAYS, 0, 0xFF)
        gl.glFrontFace(gl.GL_CCW)
        gl.glStencilOpSeparate(gl.GL_FRONT, gl.GL_KEEP, gl.GL_KEEP, gl.GL_INCR_WRAP)
        gl.glStencilOpSeparate(gl.GL_BACK, gl.GL_KEEP, gl.GL_KEEP, gl.GL_DECR_WRAP)

    def draw(self, window: Window, facets: moderngl.VertexArray, count: int, layer: int) -> None:
        """Draw the first facets over a window and pack its solid pixels into the bitmap of a layer of the block."""
        gl = self._gl
        side = self._view.viewport_px
        if window != self._window:
            # The viewport holds the whole field, lest a facet be clipped at a window's border.
            gl.glViewport(-window.x, -window.y, side, side)
            self._pack["corner"] = (window.x, window.y)
            self._pack["size"] = (window.width, window.height)
            self._window = window
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        gl.glClear(gl.GL_STENCIL_BUFFER_BIT)
        facets.render(vertices=3 * count)
        # What is drawn into must not be read from.
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, 0)
        self._context.memory_barrier()
        self._pack["first_word"] = layer * self._view.height_px * self._row_words
        columns = self._row_words - window.x // PACKED_BITS
        self._pack.run(-(-columns // PACKING_SIDE), -(-window.height // PACKING_SIDE))
        self._context.memory_barrier()

    def wait(self) -> None:
        """Wait for what was drawn: PyOpenGL lets other threads run meanwhile, which moderngl's reading does not."""
        self._gl.glFinish()

"""The stencil buffer of the literal mode, the packing of its pixels into bitmaps, and their way to the processor."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck_stencil.field_of_view import FieldOfView, Window

if TYPE_CHECKING:
    import moderngl

INSIDE_COUNTS = (1, 2)  # stencil values of solid pixels, as in the paper
PACKED_BITS, WORD_BYTES = 32, 4  # size of a word of GLSL; two of them are a word of a bitmap
PADDING_WORDS = 1  # most words without a pixel at the end of a bitmap's row
PACKING_SIDE = 8  # side of the square of words that a group of the compute shader packs

COUNT_BITS = 8
COUNTS_PACKED = PACKED_BITS // COUNT_BITS  # bits of a stencil value, and values in a word
WAIT_NS = 10**9  # time after which it is asked anew whether a drawing is done

PACKING_SHADER = f"""
#version 430
layout(local_size_x = {PACKING_SIDE}, local_size_y = {PACKING_SIDE}) in;
layout(binding = 0) uniform usampler2D counts;
layout(std430, binding = 0) buffer Bitmaps {{ uint words[]; }};
layout(std430, binding = 1) buffer Before {{ uint before[]; }};
uniform ivec2 corner;
uniform ivec2 size;
uniform int columns;
uniform int row_words;
uniform int first_word;
void main() {{
    // A word of the window, whose counts lie where the window's image has them.
    ivec2 group = ivec2(gl_GlobalInvocationID.xy);
    if (group.x >= columns || group.y >= size.y) return;
    uint word = 0u;
    for (int part = 0; part < {COUNT_BITS}; ++part) {{
        int place = (group.y * columns + group.x) * {COUNT_BITS} + part;
        uint earlier = before[place], sums = 0u;
        for (int k = 0; k < {COUNTS_PACKED}; ++k) {{
            int bit = {COUNTS_PACKED} * part + k, shift = {COUNT_BITS} * k;
            ivec2 pixel = ivec2({PACKED_BITS} * group.x + bit, group.y);
            uint was = (earlier >> shift) & 255u;
            uint sum = pixel.x < size.x ? texelFetch(counts, pixel, 0).r : was;
            uint count = (sum - was) & 255u;
            if (count >= {INSIDE_COUNTS[0]}u && count <= {INSIDE_COUNTS[1]}u) word |= 1u << bit;
            sums |= sum << shift;
        }}
        before[place] = sums;
    }}
    int column = corner.x / {PACKED_BITS} + group.x;
    if (column < row_words) words[first_word + (corner.y + group.y) * row_words + column] = word;
}}
"""


class StencilTarget:
    """A framebuffer that is a stencil buffer with the paper's counting, and the packing of its pixels.

    It is not cleared for each layer, which would take longer: a layer's counts are what its draw has added to those before it.
    """

    def __init__(self, context: moderngl.Context, drawn: Sequence[Window], view: FieldOfView) -> None:
        self._gl = gl = pyopengl()
        if not gl.glBufferStorage:
            raise BackendMissing(
                f"mode 'literal' needs OpenGL 4.4, {context.info['GL_RENDERER']} has less: use mode 'draw-once'"
            )
        self._context = context
        self._view = view
        self._window: Window | None = None
        width, height = max(w.width for w in drawn), max(w.height for w in drawn)
        self._pack = context.compute_shader(PACKING_SHADER)
        self._row_words = view.stride_px // PACKED_BITS
        self._pack["row_words"] = self._row_words
        # A bitmap's rows are padded: the last window has the padding, too.
        self._columns = min(self._row_words, -(-width // PACKED_BITS) + PADDING_WORDS)
        self._pack["columns"] = self._columns
        self._before = context.buffer(reserve=height * self._columns * COUNT_BITS * WORD_BYTES)
        self._framebuffer = gl.glGenFramebuffers(1)
        self._counts = gl.glGenTextures(1)
        gl.glBindTexture(gl.GL_TEXTURE_2D, self._counts)
        gl.glTexStorage2D(gl.GL_TEXTURE_2D, 1, gl.GL_DEPTH24_STENCIL8, width, height)
        gl.glTexParameteri(gl.GL_TEXTURE_2D, gl.GL_DEPTH_STENCIL_TEXTURE_MODE, gl.GL_STENCIL_INDEX)
        for end in (gl.GL_TEXTURE_MIN_FILTER, gl.GL_TEXTURE_MAG_FILTER):
            gl.glTexParameteri(gl.GL_TEXTURE_2D, end, gl.GL_NEAREST)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        gl.glFramebufferTexture2D(gl.GL_FRAMEBUFFER, gl.GL_DEPTH_STENCIL_ATTACHMENT, gl.GL_TEXTURE_2D, self._counts, 0)
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
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        gl.glClear(gl.GL_STENCIL_BUFFER_BIT)
        self._before.bind_to_storage_buffer(1)
        gl.glBindBuffer(gl.GL_COPY_WRITE_BUFFER, self._before.glo)
        words = gl.GL_R32UI, gl.GL_RED_INTEGER, gl.GL_UNSIGNED_INT
        gl.glClearBufferData(gl.GL_COPY_WRITE_BUFFER, *words, None)
        self._context.memory_barrier()

    def draw(self, window: Window, facets: moderngl.VertexArray, runs: Sequence[tuple[int, int]], layer: int) -> None:
        """Draw runs of facets (first, number) over a window and pack its solid pixels into the bitmap of a layer of the block."""
        gl = self._gl
        side = self._view.viewport_px
        if window != self._window:
            # The viewport holds the whole field, lest a facet be clipped at a window's border.
            gl.glViewport(-window.x, -window.y, side, side)
            self._pack["corner"] = (window.x, window.y)
            self._pack["size"] = (window.width, window.height)
            self._window = window
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        for first, count in runs:
            if count:
                facets.render(vertices=3 * count, first=3 * first)
        # What is drawn into must not be read from.
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, 0)
        self._context.memory_barrier()
        self._pack["first_word"] = layer * self._view.height_px * self._row_words
        self._pack.run(-(-self._columns // PACKING_SIDE), -(-window.height // PACKING_SIDE))
        self._context.memory_barrier()


class Drawing:
    """Bitmaps of a few layers: where the device packs them, and memory of the processor to which it copies them."""

    def __init__(self, context: moderngl.Context, size: int) -> None:
        self._gl = gl = pyopengl()
        self.bitmaps = context.buffer(reserve=size)
        self._fetched = gl.glGenBuffers(1)
        self._fence: Any = None
        access = gl.GL_MAP_READ_BIT | gl.GL_MAP_PERSISTENT_BIT | gl.GL_MAP_COHERENT_BIT
        gl.glBindBuffer(gl.GL_COPY_WRITE_BUFFER, self._fetched)
        gl.glBufferStorage(gl.GL_COPY_WRITE_BUFFER, size, None, access | gl.GL_CLIENT_STORAGE_BIT)
        address = gl.glMapBufferRange(gl.GL_COPY_WRITE_BUFFER, 0, size, access)
        if not address:
            raise BackendFailed(f"stencil: this driver maps no buffer of {size} bytes: use mode 'draw-once'")
        self._words = np.frombuffer(memoryview((ctypes.c_ubyte * size).from_address(int(address))), np.uint64)

    def submitted(self, size: int) -> None:
        """Have the first bytes copied once they are packed, and mark that moment."""
        gl = self._gl
        if self._fence is not None:  # of a drawing that nobody has fetched
            gl.glDeleteSync(self._fence)
        gl.glBindBuffer(gl.GL_COPY_READ_BUFFER, self.bitmaps.glo)
        gl.glBindBuffer(gl.GL_COPY_WRITE_BUFFER, self._fetched)
        gl.glCopyBufferSubData(gl.GL_COPY_READ_BUFFER, gl.GL_COPY_WRITE_BUFFER, 0, 0, size)
        self._fence = gl.glFenceSync(gl.GL_SYNC_GPU_COMMANDS_COMPLETE, 0)
        gl.glFlush()

    def fetch(self, bitmaps: NDArray[np.uint64]) -> None:
        """Wait for what was submitted, while other threads run, and copy it to bitmaps (n, words)."""
        gl = self._gl
        state = gl.GL_TIMEOUT_EXPIRED
        while state == gl.GL_TIMEOUT_EXPIRED:
            state = gl.glClientWaitSync(self._fence, 0, WAIT_NS)
        gl.glDeleteSync(self._fence)
        self._fence = None
        if state == gl.GL_WAIT_FAILED:
            raise BackendFailed("stencil: the graphics device gave up a drawing: use mode 'draw-once'")
        bitmaps[:] = self._words[: bitmaps.size].reshape(bitmaps.shape)


def pyopengl() -> Any:
    """PyOpenGL on the platform of the context, which only this mode needs; :class:`BackendMissing` if it does not load."""
    try:
        from OpenGL import GL as gl  # noqa: N811
    except Exception as error:  # PyOpenGL raises whatever its platform plugin does
        raise BackendMissing(f"mode 'literal' needs PyOpenGL, which does not load: {error}") from None
    return gl

"""The paper's form: for every layer, draw every facet into a stencil buffer and read the bitmap.

As in section 2.2 of the paper, the projection puts the near plane at the slice height, which clips what lies
below. A ray upwards adds 1 to the stencil at a facet that faces forward (normal up) and subtracts 1 at one
that faces backward, in wrapping 8-bit arithmetic; pixels that end at 1 or 2 are solid. Contours are found by the
marching squares of scikit-image. The stencil buffer is OpenGL's own, used through PyOpenGL on the context that
moderngl opened, because moderngl has no stencil state.
"""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.mesh.part import Part
from ebamcheck_stencil.field_of_view import SUBPIXELS, FieldOfView
from ebamcheck_stencil.windows import Window, windows

if TYPE_CHECKING:
    import moderngl

INSIDE_COUNTS = (1, 2)
"""Stencil values of solid pixels, as in the paper."""

DEPTH_SLACK = 1.0 / 64.0
"""Height of the far plane above the part, over the part's height: nothing may be clipped there."""

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


class LiteralSlices:
    """A part on the graphics device, cut by one full draw per layer."""

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
        lattice = context.buffer(view.snapped(part.vertices))
        height = context.buffer((part.vertices[:, 2] - self._middle_mm).astype(np.float32))
        self._facets = context.vertex_array(
            self._program,
            [(lattice, "2i", "lattice"), (height, "f", "height")],
            index_buffer=context.buffer(np.ascontiguousarray(part.faces)),
        )
        self._target = _StencilTarget(
            max(w.width for w in self._windows), max(w.height for w in self._windows), view.viewport_px
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.release()

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), one draw of the whole part for each."""
        rings: list[NDArray[np.float64]] = []
        layer_starts = [0]
        for height in heights:
            rings.extend(_contours(self.bitmap(float(height))))
            layer_starts.append(len(rings))
            if progress is not None:
                progress(1)
        half_pixels = np.concatenate(rings) if rings else np.zeros((0, 2))
        return canonical(
            heights,
            self._view.to_mm(np.rint(half_pixels).astype(np.int32)),
            np.concatenate([[0], np.cumsum([len(r) for r in rings], dtype=np.int64)]),
            layer_starts,
            np.ones(len(rings), np.bool_),
            **self._labels,
        )

    def bitmap(self, height_mm: float) -> NDArray[np.bool_]:
        """Image (height, width) of the section at a height, row 0 at the least y."""
        image = np.zeros((self._view.height_px, self._view.width_px), np.bool_)
        depth_mm = self._top_mm - height_mm
        if depth_mm < 0.0 or not self._height_mm > 0.0:
            return image
        # An earlier draw may have left another context current, from which reads return noise. (Contexts do not nest:
        # after leaving an inner one, none is current.)
        with self._context:
            self._program["slice_height"] = height_mm - self._middle_mm
            self._program["depth_per_mm"] = 2.0 / (depth_mm + DEPTH_SLACK * self._height_mm)
            for window in self._windows:
                counts = self._target.count(window, self._facets)
                rows = slice(window.y, window.y + window.height)
                columns = slice(window.x, window.x + window.width)
                image[rows, columns] = (counts >= INSIDE_COUNTS[0]) & (counts <= INSIDE_COUNTS[1])
        return image


class _StencilTarget:
    """A framebuffer that is a stencil buffer, with the paper's counting switched on for each draw."""

    def __init__(self, width: int, height: int, viewport_px: int) -> None:
        try:
            from OpenGL import GL
        except Exception as error:  # PyOpenGL raises whatever its platform plugin does
            raise BackendMissing(f"mode 'literal' needs PyOpenGL, which does not load: {error}") from None
        self._gl = GL
        self._viewport_px = viewport_px
        self._framebuffer = GL.glGenFramebuffers(1)
        buffer = GL.glGenRenderbuffers(1)
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_DEPTH24_STENCIL8, width, height)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        GL.glFramebufferRenderbuffer(
            GL.GL_FRAMEBUFFER, GL.GL_DEPTH_STENCIL_ATTACHMENT, GL.GL_RENDERBUFFER, buffer
        )
        GL.glDrawBuffer(GL.GL_NONE)
        GL.glReadBuffer(GL.GL_NONE)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        if status != GL.GL_FRAMEBUFFER_COMPLETE:
            raise BackendFailed(
                f"stencil: this driver refuses a stencil buffer of {width} x {height} pixels "
                f"(status {int(status):#x}): use mode 'draw-once'"
            )

    def count(self, window: Window, facets: moderngl.VertexArray) -> NDArray[np.uint8]:
        """Draw the facets over a window and read the stencil values (height, width)."""
        gl = self._gl
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        # The viewport holds the whole field, lest a facet be clipped at a window's border.
        gl.glViewport(-window.x, -window.y, self._viewport_px, self._viewport_px)
        for switched_off in (gl.GL_DEPTH_TEST, gl.GL_CULL_FACE, gl.GL_SCISSOR_TEST, gl.GL_BLEND):
            gl.glDisable(switched_off)
        gl.glEnable(gl.GL_STENCIL_TEST)
        gl.glStencilMask(0xFF)
        gl.glClearStencil(0)
        gl.glClear(gl.GL_STENCIL_BUFFER_BIT)
        gl.glStencilFunc(gl.GL_ALWAYS, 0, 0xFF)
        gl.glFrontFace(gl.GL_CCW)
        gl.glStencilOpSeparate(gl.GL_FRONT, gl.GL_KEEP, gl.GL_KEEP, gl.GL_INCR_WRAP)
        gl.glStencilOpSeparate(gl.GL_BACK, gl.GL_KEEP, gl.GL_KEEP, gl.GL_DECR_WRAP)
        facets.render()
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
        counts = np.empty((window.height, window.width), np.uint8)
        gl.glReadPixels(0, 0, window.width, window.height, gl.GL_STENCIL_INDEX, gl.GL_UNSIGNED_BYTE, counts)
        return counts


def _contours(image: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Contours of a bitmap by marching squares, in half pixels (n, 2: x, y), solid on the left."""
    from skimage import measure

    if not image.any():
        return []
    # `fully_connected="low"`: empty pixels connect across corners, solid ones do not, as in the draw-once form.
    found: list[NDArray[np.float64]] = measure.find_contours(  # type: ignore[no-untyped-call]
        image.astype(np.float64), 0.5, fully_connected="low", positive_orientation="low"
    )
    return [_corners(2.0 * ring[:-1, ::-1]) for ring in found]


def _corners(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leave out the points (n, 2) of a closed ring that lie within straight runs."""
    ahead = np.roll(ring, -1, axis=0) - ring
    behind = np.roll(ahead, 1, axis=0)
    turn = ahead[:, 0] * behind[:, 1] - ahead[:, 1] * behind[:, 0]
    corners: NDArray[np.float64] = ring[turn != 0.0]
    return corners

"""OpenGL without a window: opening a context, its limits, and why none could be opened."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ebamcheck.errors import BackendMissing

if TYPE_CHECKING:
    import moderngl

NEEDED_VERSION = 430  # OpenGL 4.3: shader storage buffers, which the draw-once form writes its fragments to
# Fewest subpixel bits of the rasteriser: it must keep the lattice of `ebamcheck_stencil.field_of_view.SUBPIXELS`
NEEDED_SUBPIXEL_BITS = 8

INSTALL_HINT = (
    "on Debian or Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri "
    "(Mesa's software renderer is enough, no GPU is needed)"
)


@dataclass(frozen=True)
class Device:
    """The renderer of a context and its limits."""

    renderer: str
    gl_version: str
    buffer_bytes: int  # size of the largest shader storage buffer
    texture_px: int  # largest side of an image that can be drawn at once
    viewport_px: int  # largest side of a viewport, which must hold the whole field of view
    subpixel_bits: int


def open_context() -> moderngl.Context:
    """Open a context without a window, by EGL, else by the platform's default way; or raise with the reasons of both."""
    try:
        import moderngl
    except ImportError as error:
        raise BackendMissing(f"moderngl does not load: {error}") from None
    reasons: list[str] = []
    for way in ("egl", None):
        try:
            options: dict[str, Any] = {"backend": way} if way else {}
            context = moderngl.create_context(standalone=True, require=NEEDED_VERSION, **options)
        except Exception as error:  # the bindings raise bare Exception
            reasons.append(f"{way or 'the default way'}: {str(error) or type(error).__name__}")
            continue
        bits = device(context).subpixel_bits
        if bits >= NEEDED_SUBPIXEL_BITS:
            if way == "egl":  # PyOpenGL, which the literal mode loads later, is to use this platform, too
                os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
            return context
        context.release()
        reasons.append(f"{way or 'the default way'}: its rasteriser keeps {bits} of {NEEDED_SUBPIXEL_BITS} bits")
    raise BackendMissing(f"no OpenGL {NEEDED_VERSION / 100:.1f} context: {'; '.join(reasons)}")


def device(context: moderngl.Context) -> Device:
    """Read the renderer and the limits of a context."""
    info = context.info
    sides = ("TEXTURE_SIZE", "RENDERBUFFER_SIZE", "FRAMEBUFFER_WIDTH", "FRAMEBUFFER_HEIGHT")
    return Device(
        renderer=str(info["GL_RENDERER"]),
        gl_version=str(info["GL_VERSION"]),
        buffer_bytes=int(info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]),
        texture_px=int(min(info[f"GL_MAX_{side}"] for side in sides)),
        viewport_px=int(min(info["GL_MAX_VIEWPORT_DIMS"])),
        subpixel_bits=int(info["GL_SUBPIXEL_BITS"]),
    )

"""The backend ``stencil``: the paper's slicer with one draw for all layers, or one draw per layer."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from importlib.metadata import version
from typing import Annotated, ClassVar, Literal

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Prepared, Probe, labels_of
from ebamcheck.errors import BackendMissing, SettingsError
from ebamcheck.kernels import ShortInts
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import components, direction_balance, edge_groups, weld
from ebamcheck.settings.base import Between
from ebamcheck_stencil import opengl
from ebamcheck_stencil.field_of_view import SUBPIXELS, WORD_BITS, FieldOfView, field_of_view

log = logging.getLogger(__name__)

# Greatest distance, px, of a point of a marching-squares cell from the nearest pixel centre of its own side: that of the middle
# of the cut in a cell with three solid corners and an empty one, or the reverse
CONTOUR_REACH_PX = math.sqrt(10.0) / 4.0

# Greatest distance, px, that a vertex, and with it a contour, moves onto the lattice
LATTICE_MOVE_PX = math.sqrt(2.0) / (2.0 * SUBPIXELS)
# The same for points made by clipping at the literal mode's near plane, which drivers may round down
CLIP_MOVE_PX = math.sqrt(2.0) / SUBPIXELS

FLOAT32_STEP = 2.0**-23
FLOAT64_STEP = 2.0**-52


class StencilSettings(BackendSettings):
    """Settings of the backend ``stencil``."""

    pixel_mm: Annotated[float, Between(1e-7, 1000.0)] | None = None
    """Side of a pixel; None: 0.1 mm or 1/1024 of the larger side of the part, whichever is finer, but at
    least 1/4096 of it."""
    mode: Literal["draw-once", "literal"] = "draw-once"
    """One draw for all layers, or the paper's one draw for each layer, of all facets above it."""
    buffer_mb: Annotated[float, Between(1e-4, 1e5)] = 512.0
    """Limit of the buffer of fragments, as far as the driver has as large a one; the field of view is
    drawn in parts where it does not suffice. Resolving a part takes up to five times as much of the processor's
    memory for a while."""
    max_texture_px: Annotated[int, Between(1, 1_000_000)] | None = None
    """Limit of an image's side; None: what the driver offers. The literal mode draws 32 pixels at least, a word of
    a bitmap."""


def inside_rule(settings: StencilSettings) -> str:
    """Rule for the winding numbers that are solid, under these settings; the literal mode has the paper's."""
    return "1..2" if settings.mode == "literal" else Stencil.inside_rule


class Stencil:
    """Signed count of forward and reverse facets along the ray of each pixel, then marching squares."""

    name: ClassVar[str] = "stencil"
    summary: ClassVar[str] = "OpenGL: signed count of facets along the ray of each pixel, marching squares"
    exact: ClassVar[bool] = False
    priority: ClassVar[int] = 10
    coplanar_rule: ClassVar[CoplanarRule] = "undefined"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = StencilSettings

    def probe(self) -> Probe:
        """Open a context and report its renderer; never raises."""
        try:
            context = opengl.open_context()
            try:
                found = opengl.device(context)
            finally:
                context.release()
            versions = {name: version(name) for name in ("moderngl", "PyOpenGL")}
            return Probe(True, versions={**versions, "GL_VERSION": found.gl_version}, device=found.renderer)
        except BackendMissing as error:
            return Probe(False, why=str(error), hint=opengl.INSTALL_HINT)
        except Exception as error:  # a driver's or a binding's own fault is a reason like any other
            return Probe(False, why=f"{type(error).__name__}: {error}", hint=opengl.INSTALL_HINT)

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the promised bound r, mm: sqrt(10)/4 pixel plus how far the lattice moves a contour.

        It holds where no opening of the surface is cut; in literal mode on closed surfaces of winding numbers up to 2. Between
        bodies that touch along differently tessellated faces, pixel centres can fall into a gap of at most 1/256 pixel.
        """
        checked = StencilSettings.own(settings, self.name)
        view = field_of_view(part, checked.pixel_mm)
        move_px = LATTICE_MOVE_PX
        if checked.mode == "literal":
            move_px = CLIP_MOVE_PX + 4.0 * FLOAT32_STEP * view.viewport_px
        largest_mm = float(np.abs(part.bounds[:, :2]).max())
        return (CONTOUR_REACH_PX + move_px) * view.pixel_mm + 4.0 * FLOAT64_STEP * largest_mm

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of heights, mm: double precision; in literal mode float32, about the part's middle."""
        largest_mm = float(np.abs(part.bounds[:, 2]).max())
        rounding = 8.0 * FLOAT64_STEP * largest_mm
        if StencilSettings.own(settings, self.name).mode == "literal":
            rounding += 4.0 * FLOAT32_STEP * float(part.size[2])
        return rounding

    def prepare(self, part: Part, settings: BackendSettings) -> Prepared:
        """Draw the part (draw-once), or load it onto the device (literal).

        Where rays meet an open surface, the draw-once form caps its openings and draws again.
        """
        from ebamcheck_stencil.draw_once import DrawnOnce, draw_crossings

        checked = StencilSettings.own(settings, self.name)
        view = field_of_view(part, checked.pixel_mm)
        context = opengl.open_context()
        try:
            found = opengl.device(context)
            _check_size(view, found, checked.mode)
            largest_px = min(found.texture_px, checked.max_texture_px or found.texture_px)
            shown = {
                "pixel_mm": view.pixel_mm,
                "inside_rule": inside_rule(checked),
                "GL_RENDERER": found.renderer,
                "GL_VERSION": found.gl_version,
            }
            labels = labels_of(part, self.name, {**checked.model_dump(), **shown})
            if checked.mode == "literal" and len(part.faces):
                from ebamcheck_stencil.literal import LiteralSlices

                _warn_of_openings(part)
                # A window's counts lie in one buffer, a byte each.
                largest_px = min(largest_px, math.isqrt(found.buffer_bytes) - WORD_BITS)
                return LiteralSlices(context, part, view, largest_px, labels)
            buffer_bytes = min(found.buffer_bytes, int(checked.buffer_mb * 2**20))
            crossings = draw_crossings(context, part, view, largest_px, buffer_bytes)
            labels["settings"]["unbalanced_pixels"] = crossings.unbalanced
            if crossings.unbalanced:
                closed = capped(part)
                crossings = draw_crossings(context, closed, view, largest_px, buffer_bytes)
        except BaseException:
            context.release()
            raise
        context.release()
        return DrawnOnce(view, crossings, labels)


def _warn_of_openings(part: Part) -> None:
    """Warn that the literal mode counts wrong where a ray passes a hole: like the paper's method it caps none."""
    # A part made from arrays may be unwelded.
    edges = len(border(part.faces)) and len(border(weld(part.triangles)[1]))
    if edges:
        log.warning(
            "stencil: part %r has %d open or turned edges: in literal mode rays through them are counted as they are, "
            "and contours may be missing or false",
            part.name,
            edges,
        )


def _check_size(view: FieldOfView, found: opengl.Device, mode: str) -> None:
    """Refuse a field of view that is larger than any viewport of the driver, or whose bitmap is larger than any buffer."""
    bitmap_bytes = view.height_px * view.stride_px // 8
    if mode == "literal" and bitmap_bytes > found.buffer_bytes:
        raise SettingsError(
            f"stencil: pixel_mm {view.pixel_mm:g} makes bitmaps of {bitmap_bytes} bytes, over the largest buffer of "
            f"{found.renderer}, {found.buffer_bytes}: give at least "
            f"{view.pixel_mm * math.sqrt(bitmap_bytes / found.buffer_bytes):.3g}, or mode 'draw-once'"
        )
    if view.viewport_px > found.viewport_px:
        larger = max(view.width_px, view.height_px)
        raise SettingsError(
            f"stencil: pixel_mm {view.pixel_mm:g} makes a field of view of {larger} pixels, over the largest "
            f"viewport of {found.renderer}, {found.viewport_px}: give at least "
            f"{view.pixel_mm * larger / (found.viewport_px - WORD_BITS):.3g}"
        )


# -- Openings of a surface, and caps that close them -------------------------------------------------------------
#
# A fan of facets from the middle of each opening's border balances every ray. A cap stays within the heights of its border, so a
# layer that cuts no opening is that of the closed surface. A flipped facet is an opening whose border runs twice along it.


def border(faces: ShortInts) -> ShortInts:
    """Directed edges (n, 2) that facets (F, 3) use more often in this direction than in the other, once per excess use."""
    groups = edge_groups(faces, int(faces.max(initial=-1)) + 1)
    surplus = direction_balance(faces, groups)
    first = groups.half_edges[groups.starts[:-1]]
    corners = faces.ravel()
    after = corners[np.where(first % 3 == 2, first - 2, first + 1)]
    edges = np.sort(np.column_stack([corners[first], after]), axis=1)
    edges[surplus < 0] = edges[surplus < 0, ::-1]
    return np.repeat(edges, np.abs(surplus), axis=0)


def capped(part: Part) -> Part:
    """Close every opening of a part by a fan from the mean of the points of its border."""
    # A part made from arrays may be unwelded: then every facet would be an opening.
    vertices, welded = np.unique(part.vertices + 0.0, axis=0, return_inverse=True)
    part = replace(part, vertices=vertices, faces=welded.reshape(-1)[part.faces].astype(np.int32))
    edges = border(part.faces)
    if not len(edges):
        return part
    used, local = np.unique(edges, return_inverse=True)
    local = local.reshape(-1, 2)
    opening = components(len(used), *local.T)
    sizes = np.bincount(opening)
    points = part.vertices[used]
    reference = points[0]
    middles = np.column_stack([np.bincount(opening, column) / sizes for column in (points - reference).T])
    # Rounding must not move a middle outside the heights of its border.
    lowest, highest = np.full(sizes.size, np.inf), np.full(sizes.size, -np.inf)
    np.minimum.at(lowest, opening, points[:, 2])
    np.maximum.at(highest, opening, points[:, 2])
    middles += reference
    middles[:, 2] = np.clip(middles[:, 2], lowest, highest)
    apex = len(part.vertices) + opening[local[:, 0]]
    caps = np.column_stack([edges[:, 1], edges[:, 0], apex])
    return replace(
        part,
        vertices=np.vstack([part.vertices, middles]),
        faces=np.vstack([part.faces, caps]).astype(np.int32),
    )

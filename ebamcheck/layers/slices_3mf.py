"""Contours as a slice stack of 3MF (3MF Slice Extension 1.0), through lib3mf.

A slice stands for the metal up to its ``ztop``: half way from one cut to the next, and as far over the last one. What is read was cut
half way up each slice. Coordinates are 32-bit numbers.
"""

from __future__ import annotations

import contextlib
import locale
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers, from_rings

# Millimetres of the units of a 3MF model, as lib3mf numbers them: micrometre to metre
MM_A_UNIT = {0: 0.001, 1: 1.0, 2: 10.0, 3: 25.4, 4: 304.8, 5: 1000.0}


@contextlib.contextmanager
def keeping_locale() -> Iterator[None]:
    """Put the locale of the process back, which lib3mf sets to C: files would else be read as ASCII from then on."""
    before = locale.setlocale(locale.LC_ALL)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write the closed contours as slices; an empty stack, heights that do not rise and open paths are refused.

    The object has the facets of the part where the layers were cut from one in this process; else a box around the layers stands
    for it, and the file says that its mesh is a rough one.
    """
    import lib3mf

    bottom, tops = slice_heights(layers)
    open_paths = int(np.count_nonzero(~layers.closed))
    if open_paths:
        raise SettingsError(f"{path}: 3MF holds closed contours only: the stack has {open_paths} open paths")
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    stack = model.AddSliceStack(bottom)
    for layer, top in enumerate(tops.tolist()):
        _add_slice(lib3mf, stack.AddSlice(top), layers, layer)
    body = model.AddMeshObject()
    _set_mesh(lib3mf, body, layers, bottom, float(tops[-1]))
    body.AssignSliceStack(stack)
    rough = layers.mesh is None
    resolution = lib3mf.SlicesMeshResolution
    body.SetSlicesMeshResolution(resolution.Lowres if rough else resolution.Fullres)
    model.AddBuildItem(body, wrapper.GetIdentityTransform())
    writer = model.QueryWriter("3mf")
    with replacing(path) as temporary, keeping_locale():
        writer.WriteToFile(str(temporary))


def read_stack(path: str | Path) -> Layers:
    """Read the one stack of slices in a file."""
    import lib3mf

    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        with keeping_locale():
            model = lib3mf.get_wrapper().CreateModel()
            model.QueryReader("3mf").ReadFromBuffer(data)
            found = model.GetSliceStacks()
            if found.Count() != 1:
                raise InputError(f"{path}: holds {found.Count()} stacks of slices, where one belongs")
            found.MoveNext()
            stack = found.GetCurrentSliceStack()
            scale = MM_A_UNIT[model.GetUnit()]
            bottom = stack.GetBottomZ()
            slices = [stack.GetSlice(k) for k in range(stack.GetSliceCount())]
            tops = np.array([bottom, *(one.GetZTop() for one in slices)])
            rings = [_rings(one) for one in slices]
    except lib3mf.ELib3MFException as error:
        raise InputError(f"{path}: is no 3MF that can be read: {error}") from None
    closed = [
        [ring[:-1] * scale for ring in layer if ring[0].tolist() == ring[-1].tolist()] for layer in rings
    ]
    open_ = [[ring * scale for ring in layer if ring[0].tolist() != ring[-1].tolist()] for layer in rings]
    return from_rings(0.5 * (tops[1:] + tops[:-1]) * scale, closed, open_)


def _rings(one: Any) -> list[Floats]:
    """Points of the polygons of a slice, in units of the file."""
    points = np.array([tuple(vertex.Coordinates) for vertex in one.GetVertices()], np.float64).reshape(-1, 2)
    return [points[np.array(one.GetPolygonIndices(k), np.int64)] for k in range(one.GetPolygonCount())]


def slice_heights(layers: Layers) -> tuple[float, Floats]:
    """Bottom of the first slice and the top of each, mm, from the heights of the cuts."""
    cuts = layers.heights
    steps = np.diff(cuts)
    if cuts.size < 2 or (steps <= 0.0).any():
        raise SettingsError(
            "3MF slices need at least two layers whose heights rise: sort them and drop repeats"
        )
    borders = cuts[:-1] + 0.5 * steps
    return float(cuts[0] - 0.5 * steps[0]), np.append(borders, cuts[-1] + 0.5 * steps[-1])


def _add_slice(lib3mf: Any, made: Any, layers: Layers, layer: int) -> None:
    of = layers.rings_of(layer)
    if not len(of):
        return
    first, last = int(layers.ring_starts[of.start]), int(layers.ring_starts[of.stop])
    points = np.ascontiguousarray(layers.points[first:last], np.float32)
    made.SetVertices([lib3mf.Position2D.from_buffer_copy(row) for row in points])
    for ring in of:
        a, b = (int(layers.ring_starts[r]) - first for r in (ring, ring + 1))
        made.AddPolygon([*range(a, b), a])


def _set_mesh(lib3mf: Any, body: Any, layers: Layers, bottom: float, top: float) -> None:
    mesh = layers.mesh
    vertices, faces = _box(layers, bottom, top) if mesh is None else (mesh.vertices, mesh.faces)
    corners = np.ascontiguousarray(vertices, np.float32)
    rows = np.ascontiguousarray(faces, np.uint32)
    body.SetGeometry(
        [lib3mf.Position.from_buffer_copy(row) for row in corners],
        [lib3mf.Triangle.from_buffer_copy(row) for row in rows],
    )


def _box(layers: Layers, bottom: float, top: float) -> tuple[Floats, NDArray[np.int32]]:
    if not len(layers.points):
        raise SettingsError("there is no contour on any layer: there is nothing to write as 3MF")
    x0, y0, x1, y1 = layers.bounds()
    corners = [(x, y, z) for z in (bottom, top) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    sides = [(k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4)]
    facets = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    facets += [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return np.array(corners), np.array(facets, np.int32)

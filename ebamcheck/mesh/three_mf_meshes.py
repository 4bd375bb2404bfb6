"""Meshes of a 3MF file as its build places them, by lib3mf in a process of its own: it sets the locale and may crash."""

from __future__ import annotations

import json
import resource
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import lib3mf
import numpy as np
from numpy.typing import NDArray

MOST_FACETS = 30_000_000  # most facets of all placed meshes together

# Farthest that a mesh is moved, in its own size: there the rounding of its place becomes coarser than that of its file
FARTHEST = 2.0**28

MOST_MEMORY_BYTES = 8 << 30

# Warnings of lib3mf (NMR_ErrorConst.h) after which it is not known what the file holds
REFUSED = {
    0x801E: "its unit is none that 3MF knows",
    0x8092: "it requires an extension of 3MF that is not known",
    0x805F: "the type of an object is none that 3MF knows",
    0x1048: "a model part is empty",
    0x80E7: "it is of a version of 3MF before the first",
}
# Warnings that have nothing to do with the solid
HARMLESS = {
    0x80B0,  # a UUID is missing: the extension for production asks for them
    0x80A0,  # or stands twice
    0x80A7,  # an attribute that a slicer added
    0x80B2, 0x805D, 0x805C, 0x80AE, 0x80C6,  # metadata
    0x80BD,  # an item of type "other", which is told in any case
    0x8078, 0x805B, 0x2020, 0x80BB, 0x80BE,  # textures, colours and materials
    0x104B,  # an attachment
}  # fmt: skip
# Types of objects, by their numbers in lib3mf
KINDS = ("an object of type other", "part of the solid", "a support", "a solid support", "a surface")

MODEL = 1

Floats = NDArray[np.float64]


class Refused(Exception):
    """The file cannot be read exactly; the text says why."""


def main() -> None:
    """Read the file that the standard input names; write its corners (F, 3, 3) as ``.npy``, and the notes as JSON."""
    asked = json.load(sys.stdin)
    resource.setrlimit(resource.RLIMIT_CPU, (asked["seconds"], asked["seconds"] + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
    try:
        corners, notes = placed(asked)
        np.save(asked["corners"], corners)
        told: dict[str, Any] = {"notes": notes}
    except Refused as why:
        told = {"error": str(why)}
    except MemoryError:
        told = {"error": f"needs more than {MOST_MEMORY_BYTES >> 30} GB of memory to be read"}
    except lib3mf.ELib3MFException as why:
        told = {"error": " ".join(str(why).split())[:160]}
    sys.stdout.write(json.dumps(told))


def placed(asked: dict[str, Any]) -> tuple[Floats, list[str]]:
    """Corners (F, 3, 3) of the facets that are built, in the file's unit, and what is left out or ignored.

    Asked are the `file`, how many `items` its build has, `unprintable` ones, `volumes` of facets that are no part of the solid
    (first, last or -1, kind) by ``path#number`` of their object, and whole objects `marked` so, by that, or by two where it holds
    in one assembly alone."""
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.ReadFromFile(asked["file"])
    notes = _remarks(reader)
    build = list(_each(model.GetBuildItems(), lambda rows: rows.GetCurrent()))
    if len(build) != asked["items"]:
        raise Refused(f"its build lists {asked['items']} items, of which lib3mf reads {len(build)}")
    meshes = _Meshes(asked["volumes"], asked["marked"])
    for k, item in enumerate(build):
        whole = item.GetObjectResource()
        if k in asked["unprintable"]:
            meshes.leave_out(whole, "not to be printed (printable=0)")
            meshes.pass_over(whole)
            continue
        turn = _matrix(item.GetObjectTransform()) if item.HasObjectTransform() else np.eye(4)
        for body, matrix in _parts(whole, turn, meshes.is_solid):
            meshes.add(body, matrix)
    for other in _each(model.GetObjects(), lambda rows: rows.GetCurrentObject()):
        if other.GetUniqueResourceID() not in meshes.seen:
            meshes.leave_out(other, "not in the build")
    notes += [f"left out: {_listed(which)}: {why}" for why, which in meshes.left_out.items()]
    if not meshes.corners or not sum(map(len, meshes.corners)):
        raise Refused("; ".join(["holds no facet that is built", *notes]))
    return np.concatenate(meshes.corners), notes


class _Meshes:
    """Placed meshes so far; each mesh is asked for once."""

    def __init__(self, volumes: dict[str, list[tuple[int, int, str]]], marked: dict[str, str]) -> None:
        self.corners: list[Floats] = []
        self.seen: set[int] = set()
        self.left_out: dict[str, list[str]] = {}
        self._volumes, self._marked = volumes, marked
        self._known: dict[int, Floats] = {}
        self._why_not: dict[tuple[int, int], str] = {}
        self._facets = 0

    def leave_out(self, body: Any, why: str) -> None:
        """Note that an object, or some of it, is left out."""
        which = self.left_out.setdefault(why, [])
        if _called(body) not in which:
            which.append(_called(body))

    def is_solid(self, body: Any, assembly: Any) -> bool:
        """Whether an object in an assembly, or None, is part of the solid; others are left out with all that they contain."""
        number = body.GetUniqueResourceID()
        self.seen.add(number)
        place = (assembly.GetUniqueResourceID() if assembly else 0, number)
        if place not in self._why_not:
            self._why_not[place] = self._judged(body, assembly)
        if why := self._why_not[place]:
            self.pass_over(body)
            self.leave_out(body, why)
        return not why

    def _judged(self, body: Any, assembly: Any) -> str:
        """What an object is if it is no part of the solid, by its marks and its type."""
        if kind := self._marked.get(_key(body)):
            return f"a {kind}"
        if assembly and (kind := self._marked.get(f"{_key(assembly)} {_key(body)}")):
            return f"a {kind} of another object"
        if (number := int(body.GetType())) != MODEL:
            return KINDS[number]
        if body.HasSlices(False) and body.GetSlicesMeshResolution() == lib3mf.SlicesMeshResolution.Lowres:
            raise Refused(f"{_called(body)} is given by slices, and its mesh is a rough one: export it as a mesh")
        return ""

    def pass_over(self, whole: Any) -> None:
        """Note that an object is left out with all that it contains."""

        def seen(body: Any, _: Any) -> bool:
            self.seen.add(body.GetUniqueResourceID())
            return True

        list(_parts(whole, np.eye(4), seen))

    def add(self, body: Any, matrix: Floats) -> None:
        """Place a mesh."""
        number = body.GetUniqueResourceID()
        if number not in self._known:
            self._known[number] = self._solid(body)
        corners = self._known[number]
        self._facets += len(corners)
        if self._facets > MOST_FACETS:
            raise Refused(f"its build places more than {MOST_FACETS} facets: build fewer copies, or a coarser mesh")
        turn, scale = matrix[:3, :3], float(np.abs(matrix[:3, :3]).max(initial=0.0))
        size = float(np.linalg.det(turn))
        if not np.isfinite(matrix).all() or abs(size) <= 1e-9 * scale**3 or scale == 0.0:
            raise Refused(f"the transform of {_called(body)} is no placing: {matrix[:, :3].round(6).tolist()}")
        if len(corners) and np.abs(matrix[3, :3]).max() > FARTHEST * scale * np.abs(corners).max():
            raise Refused(
                f"the transform of {_called(body)} moves it so far that its coordinates are lost: {matrix[3, :3].tolist()}"
            )
        there = corners @ turn + matrix[3, :3]
        # A mirrored body has its facets the other way round.
        self.corners.append(there if size > 0.0 else there[:, ::-1])

    def _solid(self, body: Any) -> Floats:
        """Corners (F, 3, 3) of the facets of a mesh that are part of the solid, where it stands by itself."""
        if not body.IsMeshObject():
            raise Refused(f"{_called(body)} is given by a function, not by a mesh: export it as a mesh")
        if (lattice := body.BeamLattice()).GetBeamCount() or lattice.GetBallCount():
            beams = lattice.GetBeamCount()
            raise Refused(f"{_called(body)} has a beam lattice ({beams} beams): export it as a mesh")
        points = body.GetVertices()
        vertices = np.frombuffer((lib3mf.Position * len(points))(*points), np.float32).reshape(-1, 3)
        rows = body.GetTriangleIndices()
        faces = np.frombuffer((lib3mf.Triangle * len(rows))(*rows), np.uint32).reshape(-1, 3)
        kept = np.ones(len(faces), np.bool_)
        for first, last, kind in self._volumes.get(_key(body), []):
            if not 0 <= first <= max(last, first) < max(len(faces), 1):
                raise Refused(f"a {kind} of {_called(body)} has facets {first} to {last} of {len(faces)}")
            kept[first : last + 1 if last >= 0 else len(faces)] = False
            self.leave_out(body, f"a {kind} in it" if last >= 0 else f"a {kind}")
        corners: Floats = vertices.astype(np.float64)[faces[kept]]
        return corners


def _remarks(reader: Any) -> list[str]:
    """Warnings of lib3mf that may concern the solid, each once; raises where what the file holds is not known."""
    told = Counter[str]()
    for k in range(reader.GetWarningCount()):
        code, words = reader.GetWarning(k)
        if code in REFUSED:
            raise Refused(f"{REFUSED[code]}: export it anew")
        if code not in HARMLESS:
            told[words] += 1
    return [f"lib3mf says: {words.rstrip('.')}" + (f" ({n} times)" if n > 1 else "") for words, n in told.items()]


def _parts(whole: Any, turn: Floats, wanted: Callable[[Any, Any], bool]) -> Iterator[tuple[Any, Floats]]:
    """Meshes in an object with the matrices that place them; not objects that are not wanted in the assembly where they stand."""
    open_objects = [(whole, None, turn)]
    while open_objects:
        body, assembly, matrix = open_objects.pop()
        if not wanted(body, assembly):
            continue
        if not body.IsComponentsObject():
            yield body, matrix
            continue
        inner = []
        for k in range(body.GetComponentCount()):
            component = body.GetComponent(k)
            own = _matrix(component.GetTransform()) if component.HasTransform() else np.eye(4)
            inner.append((component.GetObjectResource(), body, own @ matrix))
        open_objects += inner[::-1]


def _matrix(transform: Any) -> Floats:
    """Matrix (4, 4) of a transform: a row (x, y, z, 1) times it is the place."""
    matrix = np.eye(4)
    matrix[:, :3] = np.array([list(row) for row in transform.Fields])
    return matrix


def _each(rows: Any, current: Callable[[Any], Any]) -> Iterator[Any]:
    while rows.MoveNext():
        yield current(rows)


def _key(body: Any) -> str:
    """An object as the look at the package calls it."""
    return f"{body.PackagePart().GetPath().lower()}#{body.GetModelResourceID()}"


def _called(body: Any) -> str:
    name = body.GetName()
    return f"object {body.GetModelResourceID()}" + (f" ({name[:40]!r})" if name else "")


def _listed(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


if __name__ == "__main__":
    main()

"""Slicers of others that know evenly spaced planes only: the lattices of planes that any heights need, and the program that is run
for each. A part is stretched along z so that a plane lies in the middle of every layer. A program gets no shell, and a time limit.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, Self

import numpy as np

from ebamcheck.backend import BackendSettings, Probe, Progress
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.geometry.rings import EPSILON
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers, concatenate, from_paths
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import edge_groups
from ebamcheck.plugins.processes import code_in_words, end_with_children
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.base import Between
from ebamcheck.threads import worker_threads

SAME_PLANE_MM = 1e-9  # heights ``bottom + (k + 0.5) * step`` are rounded
LEAST_RUN = 3  # heights of equal step that make a lattice: any two heights have one step
# Most planes of a lattice for each height that is asked of it: a program cuts some hundred of them in the time of starting once more
PLANES_A_RUN = 2000
KEPT_LATTICES, KEPT_PLANES = 4, 256  # lattices and single planes that are kept; the oldest go first


@dataclass(frozen=True)
class Lattice:
    """Planes at ``first_mm + k * step_mm``, k = 0 .. count - 1; all that lie in a part."""

    first_mm: float
    step_mm: float
    count: int

    @property
    def heights(self) -> Floats:
        """Heights of the planes (count,), mm."""
        return np.asarray(self.first_mm + np.arange(self.count) * self.step_mm, dtype=np.float64)

    def indices(self, heights: Floats) -> Ints:
        """Plane at each height, (L,); -1 where there is none."""
        nearest = np.rint((heights - self.first_mm) / self.step_mm).astype(np.int64)
        off = np.abs(heights - (self.first_mm + nearest * self.step_mm)) > same_plane_mm(heights)
        return np.where(off | (nearest < 0) | (nearest >= self.count), -1, nearest)


def same_plane_mm(heights: Floats) -> Floats:
    """How near two heights are one plane, (L,) mm."""
    return np.asarray(SAME_PLANE_MM + 16.0 * EPSILON * np.abs(heights))


def lattices_of(heights: Floats, least_mm: float, greatest_mm: float) -> list[Lattice]:
    """Lattices that hold all of strictly increasing heights (L,), mm, of a part between its ends.

    Each goes from the bottom of the part to its top. One that would have far more planes than are asked of it is left as single
    planes, whose step is the height of the part.

    >>> lattices_of(np.array([0.75, 1.25, 1.75, 7.0]), 0.0, 10.0)
    [Lattice(first_mm=0.25, step_mm=0.5, count=20), Lattice(first_mm=7.0, step_mm=10.0, count=1)]
    """
    found: list[Lattice] = []
    alone = np.ones(heights.size, np.bool_)
    for start, stop in _even_runs(heights):
        step_mm = float(heights[stop - 1] - heights[start]) / (stop - start - 1)
        below = math.floor((heights[start] - least_mm) / step_mm)
        above = math.floor((greatest_mm - heights[start]) / step_mm)
        lattice = Lattice(float(heights[start]) - below * step_mm, step_mm, below + above + 1)
        if alone[start:stop].any() and lattice.count <= PLANES_A_RUN * (stop - start):
            found.append(lattice)
            alone &= lattice.indices(heights) < 0
    return found + [Lattice(z, greatest_mm - least_mm, 1) for z in heights[alone].tolist()]


def _even_runs(heights: Floats) -> list[tuple[int, int]]:
    """Runs ``[start, stop)`` of heights of equal steps; none overlaps another."""
    steps = np.diff(heights)
    if steps.size < LEAST_RUN - 1:
        return []
    changes = np.flatnonzero(np.abs(np.diff(steps)) > 2.0 * same_plane_mm(heights[2:])) + 1
    runs: list[tuple[int, int]] = []
    for first, past in zip([0, *changes.tolist()], [*changes.tolist(), steps.size], strict=True):
        start = max(first, runs[-1][1]) if runs else first
        if past + 1 - start >= LEAST_RUN:
            runs.append((start, past + 1))
    return runs


class LatticeStack:
    """A part that `cut` cuts at the planes of a lattice, from several threads; lattices are kept for later blocks."""

    def __init__(self, part: Part, labels: dict[str, Any], cut: Callable[[Lattice], Layers]) -> None:
        self.part = part
        self._labels = labels
        self._cut: Callable[[Lattice], Layers] | None = cut
        self._kept: dict[Lattice, Layers] = {}
        self._lock = Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._cut = None
        self._kept.clear()

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm."""
        with self._lock:
            return self._slice(heights, progress or (lambda _: None))

    def _slice(self, heights: Floats, progress: Progress) -> Layers:
        if self._cut is None:
            raise BackendFailed(f"part {self.part.name!r} was released: prepare it again")
        least, greatest = self.part.bounds[:, 2].tolist()
        waiting: Bools = (least < heights) & (heights < greatest)
        places = [np.flatnonzero(~waiting)]
        blocks = [from_paths(heights[places[0]], [[]] * places[0].size, **self._labels)]
        if places[0].size:
            progress(places[0].size)

        def take(lattice: Lattice, layers: Layers) -> None:
            where = lattice.indices(heights)
            here = np.flatnonzero(waiting & (where >= 0))
            if here.size:
                blocks.append(layers.take(where[here]))
                places.append(here)
                waiting[here] = False
                progress(here.size)

        # A plane of two lattices is taken from the older one, so that the same question has the same answer.
        for lattice, layers in self._kept.items():
            take(lattice, layers)
        wanted = lattices_of(heights[waiting], least, greatest)
        with worker_threads() as pool:
            for lattice, layers in zip(wanted, pool.map(self._cut, wanted), strict=True):
                self._keep(lattice, layers)
                take(lattice, layers)
        order = np.argsort(np.concatenate(places), kind="stable")
        return replace(concatenate(blocks).take(order), heights=heights, **self._labels)

    def _keep(self, lattice: Lattice, layers: Layers) -> None:
        self._kept[lattice] = layers
        for single, most in ((True, KEPT_PLANES), (False, KEPT_LATTICES)):
            alike = [one for one in self._kept if (one.count == 1) == single]
            for old in alike[: max(0, len(alike) - most)]:
                del self._kept[old]


LAYERS_OF_A_SINGLE = 16  # layers over the height of a part of which one single plane is wanted: coordinates then lose no bit to the margins
MARK_SHARE = 2.0**-10  # side of a mark over the smaller side of the part
MARK_LAYERS = (
    0.6  # height of a mark over that of a layer: the lower one is cut in the middle of layer 0, the upper one nowhere
)

MARK = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
# A tetrahedron with facets counter-clockwise seen from outside
MARK_FACETS = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])

HALF_STEP = 2.0**-25  # largest rounding of a 32-bit float, over its value


@dataclass(frozen=True)
class Placement:
    """A part and its planes as a program gets them: magnified by `scale` across the plane, layers `layer` high from z = 0."""

    part: Part
    lattice: Lattice
    scale: float
    layer: float

    @property
    def step_mm(self) -> float:
        """Height of a layer in the part, mm."""
        single_mm = float(self.part.size[2]) / LAYERS_OF_A_SINGLE
        return self.lattice.step_mm if self.lattice.count > 1 else single_mm

    @property
    def first_layer(self) -> int:
        """Layer in whose middle the lattice begins; the part stands above the middle of layer 0."""
        return math.floor((self.lattice.first_mm - float(self.part.bounds[0, 2])) / self.step_mm) + 1

    @property
    def layer_count(self) -> int:
        """Layers from the bed to the upper mark."""
        above_mm = float(self.part.bounds[1, 2]) - self.lattice.first_mm
        return self.first_layer + math.floor(above_mm / self.step_mm) + 2

    def triangles(self) -> Floats:
        """Corners of all facets and of the two marks, (F + 8, 3, 3)."""
        placed = self.part.triangles - (*self.part.bounds[0, :2].tolist(), self.lattice.first_mm)
        placed *= (self.scale, self.scale, self.layer / self.step_mm)
        placed[:, :, 2] += (self.first_layer + 0.5) * self.layer
        side = MARK_SHARE * self.scale * float(self.part.size[:2].min())
        mark = (MARK * (side, side, MARK_LAYERS * self.layer))[MARK_FACETS]
        top = (0.0, 0.0, (self.layer_count - 0.25) * self.layer)
        return np.concatenate([placed, mark, mark + top])

    def layers(self, found: dict[int, list[Floats]], **labels: Any) -> Layers:
        """Make layers of rings by the program's layer; a ring that ends where it begins is closed, another open."""
        corner, first = self.part.bounds[0, :2], self.first_layer
        layers = [
            [(ring / self.scale + corner, bool((ring[0] == ring[-1]).all())) for ring in found.get(first + k, [])]
            for k in range(self.lattice.count)
        ]
        return from_paths(self.lattice.heights, layers, **labels)


def scale_to(part: Part, size: float) -> float:
    """Power of two that takes the larger side of a part across the plane to between half of a size and that size."""
    side = float(part.size[:2].max())
    exponent = math.frexp(size / side)[1] - 1 if side > 0.0 else 0
    return math.ldexp(1.0, max(-200, min(200, exponent)))


def coordinate_rounding_mm(part: Part) -> float:
    """Largest rounding of a coordinate across the plane to 32 bits and back, mm."""
    return HALF_STEP * float(part.size[:2].max()) + 4.0 * EPSILON * float(np.abs(part.bounds).max())


def height_rounding_mm(part: Part) -> float:
    """Largest rounding of a height to 32 bits, mm: a lattice has a plane at every half of the part at least."""
    largest = float(np.abs(part.bounds).max())
    return HALF_STEP * 2.0 * float(part.size[2]) + SAME_PLANE_MM + 8.0 * EPSILON * largest


def refuse_what_is_mended(part: Part, program: str) -> None:
    """Raise :class:`BackendFailed` for parts that a program would mend in silence: its slices were of another part."""
    groups = edge_groups(part.faces, len(part.vertices))
    uneven = int(np.count_nonzero(np.diff(groups.starts) % 2))
    if uneven:
        raise BackendFailed(
            f"part {part.name!r} is open: {uneven} edges have an odd number of facets, and {program} would close them in "
            "its own way; mend the mesh or use another backend"
        )
    if part.volume < 0.0:
        raise BackendFailed(
            f"part {part.name!r} has a negative volume ({part.volume:.6g} mm3), and {program} would turn it; turn its "
            "facets (--fix-orientation) or use another backend"
        )


VERSION_LIMIT_S = (
    20.0  # time that a program may take to tell its version: the first start after a boot reads it from a slow disk
)
TAIL_BYTES = 8192  # how much of the end of a program's output is kept for messages


class ProgramSettings(BackendSettings):
    """Settings of every backend that runs a program of others."""

    time_limit_s: Annotated[float, Between(0.001, 1e7)] = 600.0
    """Time that one run of the program may take."""


@dataclass(frozen=True)
class Program:
    """A program of others: its command or the variable that names it, its Debian package, and how to ask for its version."""

    name: str
    command: str
    variable: str
    package: str
    version_arguments: tuple[str, ...]
    version_pattern: str

    @property
    def hint(self) -> str:
        """How to get it, in one line."""
        return f"apt install {self.package}, or name the executable in {self.variable}"

    def find(self) -> Path | None:
        """Where it is: as its variable says, else on the search path; None where it is not."""
        found = shutil.which(os.environ.get(self.variable) or self.command)
        return None if found is None else Path(found)

    def path(self) -> Path:
        """Where it is; raises :class:`BackendMissing` with a hint where it is not."""
        found = self.find()
        if found is None:
            raise BackendMissing(f"{self.name} is not installed; {self.hint}")
        return found

    def probe(self) -> Probe:
        """Whether it is there and answers, with its version."""
        found = self.find()
        if found is None:
            named = os.environ.get(self.variable)
            why = f"{self.variable}={named} is no executable" if named else f"{self.command} is not on the PATH"
            return Probe(False, why=why, hint=self.hint)
        try:
            version = _version(self, found)
        except BackendFailed as failure:
            return Probe(False, why=str(failure), hint=self.hint)
        return Probe(True, versions={self.name: version})

    def run(self, arguments: Sequence[str | Path], folder: Path, time_limit_s: float) -> str:
        """Run it in a folder, which also is its home; returns the end of its output, or raises its last words in one line."""
        code, said = _run([str(self.path()), *map(str, arguments)], folder, time_limit_s)
        if code is None:
            raise BackendFailed(f"{self.name} was ended: it took over {time_limit_s:g} s (time_limit_s)")
        if code:
            raise self.failed(f"ended with {_exit(code)}", said)
        return said

    def failed(self, why: str, said: str = "") -> BackendFailed:
        """Make the error for a run that came to an end without a result, with the program's last words."""
        lines = [line.strip() for line in said.splitlines() if line.strip()]
        return BackendFailed(f"{self.name} {why}{f': {lines[-1][:200]}' if lines else ''}")


@cache
def _version(program: Program, path: Path) -> str:
    with scratch_folder() as folder:
        code, said = _run([str(path), *program.version_arguments], folder, VERSION_LIMIT_S)
    found = re.search(program.version_pattern, said)
    if found is None:
        what = f"took over {VERSION_LIMIT_S:g} s" if code is None else f"ended with {_exit(code)}"
        raise BackendFailed(f"{path} does not tell a version of {program.name}: it {what}")
    return found[1]


def _run(command: list[str], folder: Path, time_limit_s: float) -> tuple[int | None, str]:
    """Exit code (None: the time was up) and the end of the output."""
    output = folder / "output.txt"
    try:
        with output.open("wb") as file:
            process = subprocess.Popen(
                [*_ended_with_us(), *command],
                cwd=folder,
                env={**os.environ, "HOME": str(folder), "LC_ALL": "C"},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )
    except OSError as error:
        raise BackendFailed(f"{command[0]} does not start: {error.strerror}") from None
    code: int | None = None
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(time_limit_s)
    finally:
        end_with_children(process)
    with output.open("rb") as file:
        file.seek(max(0, output.stat().st_size - TAIL_BYTES))
        return code, file.read().decode("utf-8", "replace")


@cache
def _ended_with_us() -> tuple[str, ...]:
    """Command that asks Linux to end what follows it once this process is gone, where there is one."""
    path = shutil.which("setpriv")
    if path is None:
        return ()
    asked = subprocess.run([path, "--pdeathsig", "KILL", "true"], capture_output=True, check=False)
    return () if asked.returncode else (path, "--pdeathsig", "KILL")


def _exit(code: int) -> str:
    return f"exit code {code}" if code >= 0 else code_in_words(code).removeprefix("by ")

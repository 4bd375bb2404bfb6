"""The program Slic3r as a slicer: an independent check, read from its SVG export.

Slic3r closes gaps under 0.1 mm, cuts no layer over 1 mm, reads layer heights to six digits and coordinates to 32 bits.
So the part is scaled: in x and y until the gaps that it closes are negligible, and in z to layers of 1 mm.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import partial
from typing import ClassVar

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, labels_of
from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.scratch import scratch_folder
from ebamcheck.slicers.outside import lattices
from ebamcheck.slicers.outside.lattices import Lattice, LatticeStack, Placement, Program, ProgramSettings
from ebamcheck.threads import thread_count

PROGRAM = Program(
    name="Slic3r", command="slic3r", variable="EBAMCHECK_SLIC3R", package="slic3r",
    version_arguments=("--version",), version_pattern=r"(\d+\.\d+\.\d\S*)",
)  # fmt: skip

# Larger side of the part as Slic3r gets it, mm, or half of it: far below its 64-bit integers of 1e-6 mm, which offsets multiply by 1e5
WORKING_SIZE = 2.0**20
LAYER = 1.0  # height of a layer as Slic3r gets it, mm; the highest that it cuts
# Radius of the closing that Slic3r applies to every slice, mm in its coordinates (`safety_offset` in its source)
CLOSING = 0.0499
# Roundings to 32 bits that a crossing goes through: file, scale, difference of two ends, place along the edge (three), sum; times the
# square root of two for both coordinates
PLANE_ROUNDINGS = 10.0
HEIGHT_ROUNDINGS = 3.0  # the same for heights: file, scale of the vertex, scale of the plane
# Messages of Slic3r when it leaves out loops or makes up a layer from its neighbours
TROUBLE = ("overlapping or self-intersecting facets", "Unable to close this loop")


class Slic3r:
    """Slices that Slic3r exports, its loops united; open meshes and parts of negative volume, which it mends silently, are
    refused."""

    name: ClassVar[str] = "slic3r"
    summary: ClassVar[str] = "witness: the program Slic3r (SVG export); refuses open meshes"
    exact: ClassVar[bool] = True
    priority: ClassVar[int] = -20
    coplanar_rule: ClassVar[CoplanarRule] = "undefined"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = ProgramSettings

    def probe(self) -> Probe:
        """Whether Slic3r is installed, and its version."""
        return PROGRAM.probe()

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the roundings to 32-bit floats on the way, and what the closing may fill, mm."""
        return PLANE_ROUNDINGS * lattices.coordinate_rounding_mm(part) + 2.0 * CLOSING / lattices.scale_to(
            part, WORKING_SIZE
        )

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the roundings of vertices and planes to 32-bit floats, mm."""
        return HEIGHT_ROUNDINGS * lattices.height_rounding_mm(part)

    def prepare(self, part: Part, settings: BackendSettings) -> LatticeStack:
        """Check the part; Slic3r itself runs when heights are known."""
        own = ProgramSettings.own(settings, self.name)
        PROGRAM.path()
        lattices.refuse_what_is_mended(part, PROGRAM.name)
        return LatticeStack(part, labels_of(part, self.name, own.model_dump()), partial(_cut, part, own))


def _cut(part: Part, settings: ProgramSettings, lattice: Lattice) -> Layers:
    """Run Slic3r on a part for the planes of a lattice."""
    placement = Placement(part, lattice, lattices.scale_to(part, WORKING_SIZE), LAYER)
    with scratch_folder() as folder:
        write_triangles(placement.triangles(), folder / "part.stl")
        said = PROGRAM.run(_arguments(), folder, settings.time_limit_s)
        if any(words in said for words in TROUBLE):
            raise PROGRAM.failed(f"leaves loops of part {part.name!r} open or makes layers up from others")
        file = folder / "part.svg"
        if not file.exists():
            raise PROGRAM.failed(f"wrote no slices of part {part.name!r}", said)
        with file.open("rb") as lines:
            found = {round(height / LAYER - 0.5): rings for height, rings in slices(lines)}
    return placement.layers(found)


def _arguments() -> list[str]:
    """Command line; the nozzle diameter matters only in that it must exceed the layer height."""
    return [
        "--no-gui", "--datadir=.", "--export-svg", f"--first-layer-height={LAYER}", f"--layer-height={LAYER}",
        f"--nozzle-diameter={2.0 * LAYER}", "--resolution=0", "--print-center=0,0", f"--threads={thread_count()}",
        "--output=part.svg", "part.stl",
    ]  # fmt: skip


# Unit of heights in the file, mm: Slic3r wrongly divides them by a million, as if they were its integers
HEIGHT_UNIT_MM = 1e6

_LAYER = re.compile(rb'<g id="layer\d+"(?: slic3r:z="([^"]*)")?')
_POLYGON = re.compile(rb'<polygon slic3r:type="(contour|hole)" points="([^"]*)"')


def slices(lines: Iterable[bytes]) -> Iterator[tuple[float, list[Floats]]]:
    """Height, mm above the bed, and rings (n, 2), closed, mm from the part's least corner, of one slice of an SVG after the other.

    Holes run clockwise. :class:`BackendFailed` is raised on text that Slic3r does not write.
    """
    height_mm = 0.0
    rings: list[Floats] | None = None
    line = b""
    for line in lines:
        if polygon := _POLYGON.search(line):
            if rings is None:
                raise BackendFailed("Slic3r wrote a polygon outside of any layer")
            rings.append(_ring(polygon[1], polygon[2]))
        elif layer := _LAYER.search(line):
            if rings is not None:
                yield height_mm, rings
            if layer[1] is None:
                raise BackendFailed("Slic3r wrote a layer without a height")
            height_mm, rings = float(layer[1]) * HEIGHT_UNIT_MM, []
    if line.strip() != b"</svg>":
        raise BackendFailed("what Slic3r wrote is cut: the file does not end with </svg>")
    if rings is not None:
        yield height_mm, rings


def _ring(kind: bytes, text: bytes) -> Floats:
    try:
        numbers = np.array(text.replace(b",", b" ").split(), dtype="S").astype(np.float64)
        points = numbers.reshape(-1, 2)
    except ValueError:
        raise BackendFailed(f"Slic3r wrote points that are none: {text[:60].decode('ascii', 'replace')!r}") from None
    points = np.concatenate([points, points[:1]])
    x, y = (points - points[:1]).T
    twice_area = float(np.dot(x[:-1], y[1:]) - np.dot(y[:-1], x[1:]))
    return points if (twice_area > 0.0) == (kind == b"contour") else points[::-1]

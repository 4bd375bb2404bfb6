"""Whether the part that is built is the one in its file: of that size, that way up, and no other.

Unit, slicing direction and place are applied once, before anything else looks at the part: slicers, gates and `verify` all get it as
it comes from there. So an STL file is read again here, by other code, and held against the part: how long it is along the
slicing direction, its surface, and how high the middle of its surface lies.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from ebamcheck.mesh.part import Part
from ebamcheck.mesh.plates import PlatePart
from ebamcheck.numeric.rings import Floats
from ebamcheck.program.checking.checks import Check
from ebamcheck.program.checking.deposit_checks import PART_FILE
from ebamcheck.settings.config import Config

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4, "ft": 12.0 * 25.4}
"""Millimetres in one unit: the inch is exact since 1959. Written anew here."""

SAME_SIZE = 1e-4
"""Share of its size by which a part may be off: coordinates of an STL file have seven digits."""

HEAD, FACET = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
"""Bytes before the first facet of a binary STL file, and a facet."""

AT_ONCE = 500_000
"""Facets that are held at once."""

FACET_TEXT = re.compile(rb"\bloop" + 3 * (rb"\s+vertex" + 3 * rb"\s+(\S+)"), re.IGNORECASE)
"""Corners of a facet in an ASCII STL file. A word by itself may be part of the name of the solid."""


def file_check(part: Part, config: Config) -> Check:
    """Check that the part is as large as in its STL file, and stands as the settings say; of other files nothing is said."""
    path = Path(part.source) if part.source else None
    if isinstance(part, PlatePart) or path is None or path.suffix.lower() != ".stl" or not path.is_file():
        return Check(PART_FILE, True, 0.0, SAME_SIZE, "of its size", "", "no STL file of one part")
    wanted = _measured(_facets_of(path), config.part.direction, UNIT_MM[config.part.units])
    blocks = (part.vertices[part.faces[k : k + AT_ONCE]] for k in range(0, len(part.faces), AT_ONCE))
    found = _measured(blocks, (0.0, 0.0, 1.0), 1.0)
    size = max(float(np.linalg.norm(part.size)), 1e-9)
    off = {
        "is longer or shorter along the slicing direction than": abs(found[0] - wanted[0]) / size,
        "has another surface than": abs(found[1] - wanted[1]) / max(wanted[1], 1e-9),
        "does not stand as the slicing direction says for the one": abs(found[2] - wanted[2]) / size,
    }
    what = max(off, key=lambda name: off[name])
    good = f"{path.name} in {config.part.units}, {found[0]:.6g} mm high"
    text = (
        good
        if off[what] <= SAME_SIZE
        else f"the part {what} in {path.name}: {found[0]:.6g} mm high, {wanted[0]:.6g} mm in the file"
    )
    return Check(PART_FILE, off[what] <= SAME_SIZE, off[what], SAME_SIZE, "of its size", "", text)


def _measured(
    facets: Iterator[Floats], direction: tuple[float, ...], unit_mm: float
) -> tuple[float, float, float]:
    """Length along a direction, mm, surface, mm2, and how high the middle of the surface lies, mm, of facets (n, 3, 3)."""
    up = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    low, high, surface, moment = np.inf, -np.inf, 0.0, 0.0
    for some in facets:
        corners = np.asarray(some, np.float64) * unit_mm
        along = corners @ up
        area = 0.5 * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        low, high = min(low, float(along.min(initial=np.inf))), max(high, float(along.max(initial=-np.inf)))
        surface += float(area.sum())
        moment += float((area * along.mean(axis=1)).sum())
    return high - low, surface, moment / max(surface, 1e-9) - low


def _facets_of(path: Path) -> Iterator[Floats]:
    """Corners (n, 3, 3) of the facets of an STL file, in the unit of the file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEAD)
        count = int.from_bytes(head[80:84], "little")
        # The reader of parts leaves out padding behind the last facet, too; in text these bytes count more facets than a file holds.
        if len(head) == HEAD and 0 < count * FACET.itemsize <= size - HEAD:
            for first in range(0, count, AT_ONCE):
                yield np.fromfile(file, FACET, min(AT_ONCE, count - first))["corners"]
            return
        found = FACET_TEXT.finditer(head + file.read())
    # A part has the 32-bit numbers of a binary file, whatever digits the text prints.
    while some := [facet.groups() for facet in islice(found, AT_ONCE)]:
        yield np.array(some, np.float64).astype(np.float32).astype(np.float64).reshape(-1, 3, 3)

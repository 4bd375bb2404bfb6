"""What the size of a part says of its unit: a part of a few beads, round in inches, or over an axis."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ebamcheck.mesh.inspection import Inspection
from ebamcheck.result import Check
from ebamcheck.settings.base import UNITS_MM
from ebamcheck.settings.config import Config

FEW_BEADS = 3.0
"""A part of fewer beads than this in its greatest extent is no part of this process, or its unit is another."""

INCH_MM = UNITS_MM["in"]

INCH_PARTS = 16
"""Extents in drawings in inches are whole sixteenths."""

ROUND_MM = 0.5
"""Extents in drawings in millimetres are mostly whole halves; of sixteenths of an inch hardly one is."""

MOST_BODIES = 8
"""Bodies that are told one by one."""

ROUNDING = 2e-6
"""Of an extent: coordinates of single precision on both sides of it."""


def suspicions(found: Inspection, config: Config) -> Iterator[Check]:
    """What the size of the part and its file say of its unit."""
    for note in found.notes:
        yield Check.finding(
            "warning", "mesh-oddity", note, found.name, remedy="look at the file and its unit"
        )
    largest, few_mm = max(found.size_mm), FEW_BEADS * config.process.bead_width_mm
    size = sizes(found.size_mm)
    if largest < few_mm:
        yield Check.finding(
            "warning",
            "part-under-beads",
            f"the part is {size} mm, read as {found.units}: its largest extent is under {FEW_BEADS:g} beads",
            "part.units",
            largest,
            few_mm,
            "mm",
            f"check the unit of the file (--units){_in_other_units(found, config)}",
        )
    # Of a file in inches that is what one expects.
    if found.units not in ("in", "ft") and round_in_inches(found.size_mm):
        inches = sizes(np.array(found.size_mm) / INCH_MM)
        yield Check.finding(
            "warning",
            "part-round-in-inches",
            f"the part is {size} mm, which is {inches} in: round in inches and not in millimetres",
            "part.units",
            remedy="check that the file was not converted twice",
        )
    yield from _beyond_travel(found, config)


def of_bodies(found: Inspection) -> Iterator[Check]:
    """How the bodies of a part lie to each other, and what is made of them."""
    lost = [relation for relation in found.relations if relation.lost]
    for relation in lost[:MOST_BODIES]:
        code = "body-doubled" if relation.kind == "doubled" else "body-in-body"
        remedy = (
            "delete one of the two in the model"
            if relation.kind == "doubled"
            else "turn its facets over in the model if it is a cavity, else delete it"
        )
        yield Check.finding("warning", code, relation.text, f"body {relation.body}", remedy=remedy)
    if len(lost) > MOST_BODIES:
        more = f"{len(lost) - MOST_BODIES} or more further bodies lie in others of the same sense, or are doubled"
        yield Check.finding("warning", "body-in-body", more, remedy="`ebamcheck inspect` lists them")
    rest = [relation.text for relation in found.relations if not relation.lost]
    if rest:
        more = f"; and {len(rest) - MOST_BODIES} more" if len(rest) > MOST_BODIES else ""
        yield Check.finding("note", "bodies-related", "; ".join(rest[:MOST_BODIES]) + more)
    if not found.union_known:
        yield Check.finding(
            "warning",
            "bodies-related",
            f"bodies may overlap, and the volume of {found.volume_mm3:.6g} mm3 is the sum of all of them",
            remedy="unite them in the model",
        )


def sizes(size: np.typing.ArrayLike) -> str:
    """Extents as text.

    Examples
    --------
    >>> sizes([100.0, 50.8, 25.4])
    '100 x 50.8 x 25.4'
    """
    return " x ".join(f"{extent:.6g}" for extent in np.asarray(size, np.float64).tolist())


def round_in_inches(size_mm: tuple[float, float, float]) -> bool:
    """Whether every extent is whole sixteenths of an inch, and not every one whole halves of a millimetre."""
    size = np.array(size_mm)

    def whole(unit_mm: float) -> bool:
        return bool((np.abs(size - unit_mm * np.round(size / unit_mm)) <= ROUNDING * size).all())

    return bool((size > 0.0).all()) and whole(INCH_MM / INCH_PARTS) and not whole(ROUND_MM)


def _in_other_units(found: Inspection, config: Config) -> str:
    """What a small part would be in inches, or in metres where it is small in inches, too; of numbers read as millimetres."""
    if found.units != "mm":
        return ""
    few_mm = FEW_BEADS * config.process.bead_width_mm
    unit, name = ("in", "inches") if INCH_MM * max(found.size_mm) >= few_mm else ("m", "metres")
    return f": in {name} it would be {sizes(UNITS_MM[unit] * np.array(found.size_mm))} mm"


def _beyond_travel(found: Inspection, config: Config) -> Iterator[Check]:
    machine = config.machine
    for axis, extent, low, high in zip(
        "XYZ", found.size_mm, machine.travel_min_mm, machine.travel_max_mm, strict=True
    ):
        if extent > high - low:
            yield Check.finding(
                "warning",
                "part-beyond-travel",
                f"the part is {extent:.6g} mm along {axis}, read as {found.units}; the axis travels {high - low:g} mm",
                f"machine.travel_max_mm {axis}",
                extent,
                high - low,
                "mm",
                "check the unit of the file (--units), or turn the part",
            )

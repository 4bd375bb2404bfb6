"""What can be seen of part and settings before anything is sliced: room on the machine, settings that exclude each other, and the
unit of the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ebamcheck.errors import EbamcheckError
from ebamcheck.kernels import Bools, Floats
from ebamcheck.mesh.bodies import windings
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.mesh.part import Part
from ebamcheck.preflight.workload import RUN
from ebamcheck.result import Check
from ebamcheck.settings.base import UNITS_MM
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut
from ebamcheck.settings.process_window import outside_window, unusual_layers

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

# Where in a zone a point is looked at, beside its middle, in shares of its extents: powers of the plastic number
OFF_MIDDLE = (0.7548776662e-5, 0.5698402910e-5)
ROUNDING_MM = 1e-6  # placed boxes are rounded to about this


def room_checks(part: Part, config: Config, layers_mm: float) -> Iterator[Check]:
    """Check travel, base plate and keep-outs; `layers_mm` is the height of all layers together."""
    yield from _travel(part, config, layers_mm)
    machine = config.machine
    if machine.base_plate_min_mm is not None and machine.base_plate_max_mm is not None:
        yield _plate(part, machine.base_plate_min_mm, machine.base_plate_max_mm)
    for zone in config.process.keep_out:
        yield _keep_out(part, zone)


def _travel(part: Part, config: Config, layers_mm: float) -> Iterator[Check]:
    """The axes carry the tool along the middles of the contour beads, and over the top of the part at the end."""
    machine = config.machine
    inset = config.contour_offset_mm
    # Of what is thinner than two insets the bead runs along the middle.
    low, high = part.bounds
    inset_mm = np.minimum(inset, 0.5 * (high - low))
    needs = [(low[k] + inset_mm[k], high[k] - inset_mm[k]) for k in range(2)]
    needs.append((0.0, layers_mm + machine.safe_height_mm))
    for axis, (least, greatest), limit_low, limit_high in zip(
        "XYZ", needs, machine.travel_min_mm, machine.travel_max_mm, strict=True
    ):
        name = f"travel {axis}"
        below, above = limit_low - least, greatest - limit_high
        if axis == "Z":
            below = 0.0  # Z begins on the base plate, which a machine can reach
        over = max(below, above)
        span = f"{axis} needs {least:.6g} to {greatest:.6g} mm of {limit_low:g} to {limit_high:g} mm"
        if over <= ROUNDING_MM:
            yield Check.preflight(name, "pass", span, float(greatest), limit_high, "mm")
            continue
        which, figure, limit = "travel_max_mm", greatest, limit_high
        if above <= below:
            which, figure, limit = "travel_min_mm", least, limit_low
        remedy = _room_remedy(axis, greatest - least, limit_high - limit_low, config)
        text = f"{span}: {over:.6g} mm beyond machine.{which}"
        yield Check.preflight(name, "fault", text, float(figure), limit, "mm", remedy, (RUN,))


def _room_remedy(axis: str, needed_mm: float, there_mm: float, config: Config) -> str:
    machine = config.machine
    if axis == "Z":
        return "lay it down (--direction), or check the unit of the file (--units)"
    if needed_mm <= there_mm:
        x, y, _ = (0.5 * (a + b) for a, b in zip(machine.travel_min_mm, machine.travel_max_mm, strict=True))
        return f"place it, such as in the middle of the travel: --place {x:g},{y:g} (part.place_at_mm)"
    return "turn it (--rotate, --direction), or check the unit of the file (--units)"


def _plate(part: Part, low: tuple[float, float], high: tuple[float, float]) -> Check:
    box = part.bounds[:, :2]
    over = float(max((np.array(low) - box[0]).max(), (box[1] - np.array(high)).max()))
    said = (
        f"the part takes X {box[0, 0]:.6g} to {box[1, 0]:.6g}, Y {box[0, 1]:.6g} to {box[1, 1]:.6g} mm; the base plate "
        f"has X {low[0]:g} to {high[0]:g}, Y {low[1]:g} to {high[1]:g} mm"
    )
    if over <= ROUNDING_MM:
        return Check.preflight("base plate", "pass", said, -over, 0.0, "mm")
    middle = ",".join(f"{0.5 * (a + b):g}" for a, b in zip(low, high, strict=True))
    remedy = f"place it, such as in the middle: --place {middle}, or turn it (--rotate)"
    text = f"{said}: {over:.6g} mm beside it"
    return Check.preflight("base plate", "fault", text, over, 0.0, "mm", remedy, (RUN,))


def _keep_out(part: Part, zone: KeepOut) -> Check:
    """Check that the part keeps out of a zone: no facet of it there, and the zone not within the metal."""
    name = f"keep-out {zone.name}"
    import shapely

    outline = shapely.make_valid(shapely.Polygon(zone.outline_mm))
    away = float(shapely.distance(outline, shapely.box(*part.bounds[:, :2].ravel())))
    if away > 0.0:
        return Check.preflight(name, "pass", f"the part's box keeps {away:.4g} mm from it", away, 0.0, "mm")
    if not enters(part, zone, outline):
        return Check.preflight(name, "pass", "the part keeps out of it", 0.0, 0.0, "mm")
    remedy = "place the part elsewhere (--place, --rotate), or move the clamp (process.keep_out)"
    text = f"the part reaches into it (Z {zone.z_mm[0]:g} to {zone.z_mm[1]:g} mm)"
    return Check.preflight(name, "fault", text, remedy=remedy, stops=(RUN,))


def enters(part: Part, zone: KeepOut, outline: BaseGeometry) -> bool:
    """Whether a part, standing on Z 0, has metal in a zone."""
    import shapely

    corners: Floats = part.triangles
    z = corners[:, :, 2] - float(part.bounds[0, 2])
    x0, y0, x1, y1 = outline.bounds
    (left, low), (right, high) = corners[:, :, :2].min(axis=1).T, corners[:, :, :2].max(axis=1).T
    near: Bools = (left <= x1) & (right >= x0) & (low <= y1) & (high >= y0)
    there = near & (z.min(axis=1) < zone.z_mm[1]) & (z.max(axis=1) > zone.z_mm[0])
    if there.any():
        shapely.prepare(outline)
        facet = np.repeat(np.arange(there.sum()), 3)
        corners_of = shapely.multipoints(corners[there, :, :2].reshape(-1, 2), indices=facet)
        if bool(shapely.intersects(outline, shapely.convex_hull(corners_of)).any()):
            return True
    # No facet in the zone: it is wholly within the metal, or wholly outside of it.
    middle = shapely.point_on_surface(outline)
    # Off the middle by shares that no drawing has: on the edge of two facets neither would count.
    x, y = float(middle.x) + OFF_MIDDLE[0] * (x1 - x0), float(middle.y) + OFF_MIDDLE[1] * (y1 - y0)
    point = np.array([[x, y, max(zone.z_mm[0], 0.0) + float(part.bounds[0, 2])]])
    facets = np.flatnonzero(near)
    return bool(windings(point, corners, np.zeros(facets.size, np.int64), facets)[0] > 0)


# -- settings that cannot work together ------------------------------------------------------------

FEW_BEADS_ACROSS = 2.0  # cells narrower than this many beads are all ends and starts


def sense_checks(config: Config) -> Iterator[Check]:
    """Check layer height, wire and energy against the process window, and what else excludes itself."""
    window = [replace(found, name="process window", stops=(RUN,)) for found in outside_window(config)]
    layer, bead = config.layer_height_mm, config.process.bead_height_mm
    of_bead = f"{layer / bead:.3g} of the height of one bead"
    said = f"layers of {layer:.4g} mm, {of_bead}; within the process window"
    yield from window or [Check.preflight("process window", "pass", said, layer / bead, None, "of the bead")]
    yield from (replace(found, name="layer height") for found in unusual_layers(config))
    yield _control(config)
    yield _feed(config)
    yield from _cells(config)
    yield from _temperatures(config)


def _control(config: Config) -> Check:
    # What writes programs is loaded where it is asked for: the rest of a preflight needs none of it.
    from ebamcheck.nc.control import control
    from ebamcheck.nc.templates import usable_templates

    name = config.machine.control
    try:
        if not control(name).is_read:
            text = f"machine.control {name!r} is a simulator's case, which is not read back and so never validated"
            remedy = "run for a control, then `ebamcheck post` for the simulator"
            return Check.preflight("control", "fault", text, remedy=remedy, stops=(RUN,))
        templates = usable_templates(config, name)
    except EbamcheckError as error:
        remedy = "mend that setting of the machine; `ebamcheck config` shows the default ones"
        return Check.preflight("control", "fault", str(error), remedy=remedy, stops=(RUN,))
    return Check.preflight("control", "pass", f"{name}, with {len(templates)} templates that make blocks")


def _feed(config: Config) -> Check:
    machine, speed = config.machine, config.process.travel_speed_mm_s
    axes = config.kinematics.axis_speed_mm_s
    limits = (
        (machine.feed_min_mm_s, "machine.feed_min_mm_s", "under", speed < machine.feed_min_mm_s),
        (machine.feed_max_mm_s, "machine.feed_max_mm_s", "over", speed > machine.feed_max_mm_s),
        (max(axes[:2]), "kinematics.axis_speed_mm_s", "over", speed > max(axes[:2])),
    )
    for limit, name, how, broken in limits:
        if broken:
            text = f"process.travel_speed_mm_s {speed:g} is {how} {name} {limit:g}"
            remedy = "change the travel speed, with wire and current, or the limit"
            return Check.preflight("feed", "fault", text, speed, limit, "mm/s", remedy, (RUN,))
    return Check.preflight("feed", "pass", f"beads at {speed:g} mm/s", speed, machine.feed_max_mm_s, "mm/s")


def _cells(config: Config) -> Iterator[Check]:
    side, bead = config.scan.hexagon_side_mm, config.process.bead_width_mm
    if side is None or config.scan.partition == "whole":
        return
    width, least = 3.0**0.5 * side, FEW_BEADS_ACROSS * bead
    text = f"cells of scan.hexagon_side_mm {side:g} are {width:.4g} mm wide, beads {bead:g} mm"
    if width >= least:
        yield Check.preflight("cells", "pass", text, width, least, "mm")
        return
    remedy = "give a larger side, or leave it out: it is planned then"
    yield Check.preflight("cells", "warning", text, width, least, "mm", remedy)


def _temperatures(config: Config) -> Iterator[Check]:
    material, process = config.material, config.process
    order = (material.solidus_k, material.liquidus_k, material.boiling_k)
    if not order[0] <= order[1] < order[2]:
        text = f"solidus, liquidus and boiling point are {order[0]:g}, {order[1]:g} and {order[2]:g} K"
        yield Check.preflight("material", "fault", text, remedy="give them in rising order", stops=(RUN,))
    limit = process.interpass_limit_k or material.interpass_limit_k
    if process.interpass != "off" and limit <= process.ambient_temperature_k:
        ambient_k, remedy = process.ambient_temperature_k, "raise process.interpass_limit_k"
        text = f"no bead may be entered over {limit:g} K, and the chamber has {ambient_k:g} K"
        yield Check.preflight("interpass limit", "fault", text, limit, ambient_k, "K", remedy, (RUN,))


# -- the unit of the file --------------------------------------------------------------------------

FEW_BEADS = (
    3.0  # a part of fewer beads than this in its greatest extent is no part of this process, or its unit is another
)
INCH_MM = UNITS_MM["in"]
INCH_PARTS = 16  # extents in drawings in inches are whole sixteenths
ROUND_MM = 0.5  # extents in mm are mostly whole halves; of sixteenths of an inch hardly one is
MOST_BODIES = 8  # bodies that are told one by one
ROUNDING = 2e-6  # of an extent: coordinates of single precision on both sides of it


def suspicions(found: Inspection, config: Config) -> Iterator[Check]:
    """What the size of the part and its file say of its unit."""
    remedy = "look at the file and its unit"
    for note in found.notes:
        yield Check.finding("warning", "mesh-oddity", note, found.name, remedy=remedy)
    largest, few_mm = max(found.size_mm), FEW_BEADS * config.process.bead_width_mm
    size = sizes(found.size_mm)
    if largest < few_mm:
        read = f"the part is {size} mm, read as {found.units}"
        text = f"{read}: its largest extent is under {FEW_BEADS:g} beads"
        remedy = f"check the unit of the file (--units){_in_other_units(found, config)}"
        yield Check.finding("warning", "part-under-beads", text, "part.units", largest, few_mm, "mm", remedy)
    # Of a file in inches that is what one expects.
    if found.units not in ("in", "ft") and round_in_inches(found.size_mm):
        inches = sizes(np.array(found.size_mm) / INCH_MM)
        text = f"the part is {size} mm, which is {inches} in: round in inches and not in millimetres"
        remedy = "check that the file was not converted twice"
        yield Check.finding("warning", "part-round-in-inches", text, "part.units", remedy=remedy)
    yield from _beyond_travel(found, config)


def of_bodies(found: Inspection) -> Iterator[Check]:
    """How the bodies of a part lie to each other, and what is made of them."""
    lost = [relation for relation in found.relations if relation.lost]
    for relation in lost[:MOST_BODIES]:
        code, remedy = "body-in-body", "turn its facets over in the model if it is a cavity, else delete it"
        if relation.kind == "doubled":
            code, remedy = "body-doubled", "delete one of the two in the model"
        yield Check.finding("warning", code, relation.text, f"body {relation.body}", remedy=remedy)
    if len(lost) > MOST_BODIES:
        more = f"{len(lost) - MOST_BODIES} or more further bodies lie in others of the same sense, or are doubled"
        yield Check.finding("warning", "body-in-body", more, remedy="`ebamcheck inspect` lists them")
    rest = [relation.text for relation in found.relations if not relation.lost]
    if rest:
        more = f"; and {len(rest) - MOST_BODIES} more" if len(rest) > MOST_BODIES else ""
        yield Check.finding("note", "bodies-related", "; ".join(rest[:MOST_BODIES]) + more)
    if not found.union_known:
        text = f"bodies may overlap, and the volume of {found.volume_mm3:.6g} mm3 is the sum of all of them"
        yield Check.finding("warning", "bodies-related", text, remedy="unite them in the model")


def sizes(size: np.typing.ArrayLike) -> str:
    """Extents as text.

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
    for axis, extent, low, high in zip("XYZ", found.size_mm, machine.travel_min_mm, machine.travel_max_mm, strict=True):
        if extent > high - low:
            text = (
                f"the part is {extent:.6g} mm along {axis}, read as {found.units}; the axis travels {high - low:g} mm"
            )
            measured = f"machine.travel_max_mm {axis}", extent, high - low, "mm"
            remedy = "check the unit of the file (--units), or turn the part"
            yield Check.finding("warning", "part-beyond-travel", text, *measured, remedy)

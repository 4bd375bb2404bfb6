"""Whether a part has room on the machine: within the travel, on the base plate, beside what stands there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.preflight.workload import RUN
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

OFF_MIDDLE = (0.7548776662e-5, 0.5698402910e-5)
"""Where in a zone a point is looked at, beside its middle, in shares of its extents: powers of the plastic number."""

ROUNDING_MM = 1e-6
"""Placed boxes are rounded to about this."""


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
        which, figure, limit = (
            ("travel_max_mm", greatest, limit_high) if above > below else ("travel_min_mm", least, limit_low)
        )
        yield Check.preflight(
            name,
            "fault",
            f"{span}: {over:.6g} mm beyond machine.{which}",
            float(figure),
            limit,
            "mm",
            _room_remedy(axis, greatest - least, limit_high - limit_low, config),
            (RUN,),
        )


def _room_remedy(axis: str, needed_mm: float, there_mm: float, config: Config) -> str:
    """Say how a part gets within the travel: by a place, a turn, or another unit or machine."""
    machine = config.machine
    if axis == "Z":
        return "lay it down (--direction), or check the unit of the file (--units)"
    if needed_mm <= there_mm:
        x, y = (
            0.5 * (a + b) for a, b in zip(machine.travel_min_mm[:2], machine.travel_max_mm[:2], strict=True)
        )
        return f"place it, such as in the middle of the travel: --place {x:g},{y:g} (part.place_at_mm)"
    return "turn it (--rotate, --direction), or check the unit of the file (--units)"


def _plate(part: Part, low: tuple[float, float], high: tuple[float, float]) -> Check:
    """Check that the part's box lies on the base plate."""
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
    return Check.preflight(
        name,
        "fault",
        f"the part reaches into it (Z {zone.z_mm[0]:g} to {zone.z_mm[1]:g} mm)",
        remedy="place the part elsewhere (--place, --rotate), or move the clamp (process.keep_out)",
        stops=(RUN,),
    )


def enters(part: Part, zone: KeepOut, outline: BaseGeometry) -> bool:
    """Whether a part, standing on Z 0, has metal in a zone."""
    import shapely

    corners: Floats = part.triangles
    z = corners[:, :, 2] - float(part.bounds[0, 2])
    near = _box_meets(corners, outline)
    there = near & (z.min(axis=1) < zone.z_mm[1]) & (z.max(axis=1) > zone.z_mm[0])
    if there.any():
        shapely.prepare(outline)
        shadows = shapely.convex_hull(
            shapely.multipoints(
                corners[there, :, :2].reshape(-1, 2), indices=np.repeat(np.arange(there.sum()), 3)
            )
        )
        if bool(shapely.intersects(outline, shadows).any()):
            return True
    # No facet in the zone: it is wholly within the metal, or wholly outside of it.
    point, (x0, y0, x1, y1) = shapely.point_on_surface(outline), outline.bounds
    # Off the middle by shares that no drawing has: on the edge of two facets neither would count.
    x, y = float(point.x) + OFF_MIDDLE[0] * (x1 - x0), float(point.y) + OFF_MIDDLE[1] * (y1 - y0)
    return _winding(corners[near], z[near], x, y, max(zone.z_mm[0], 0.0)) > 0


def _box_meets(corners: Floats, outline: BaseGeometry) -> Bools:
    """Facets whose box, seen from above, meets that of an outline (F,)."""
    x0, y0, x1, y1 = outline.bounds
    low, high = corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)
    found: Bools = (low[:, 0] <= x1) & (high[:, 0] >= x0) & (low[:, 1] <= y1) & (high[:, 1] >= y0)
    return found


def _winding(corners: Floats, z: Floats, x: float, y: float, height: float) -> int:
    """Winding number at a point: facets over it that face up, less those that face down."""
    a, b, c = (corners[:, k, :2] for k in range(3))

    def side(p: Floats, q: Floats) -> Floats:
        found: Floats = (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])
        return found

    s = np.stack([side(b, c), side(c, a), side(a, b)], axis=1)
    whole = s.sum(axis=1)
    over = ((s > 0.0).all(axis=1) | (s < 0.0).all(axis=1)) & (whole != 0.0)
    at = (s[over] * z[over]).sum(axis=1) / whole[over]
    return int(np.sign(whole[over])[at > height].sum())

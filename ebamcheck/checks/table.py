"""Checks of a tilt table and of a part that is turned between layers.

From the text alone, with the rotary axes of the profile: where and when the table turns, what the frame makes of the program, and
that both are taken back. From the mesh: what was laid before, seen along the new direction, may rise beside a layer or over it: no
layer may be laid into it, and neither beam and wire nor the head, a cylinder over the tip, may meet it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy import ndimage
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import count_check, event_faults, limit_check, row_faults, worst_check
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import rigid_motion
from ebamcheck.nc.motions import RAPID, NCProgram, TableColumns
from ebamcheck.nc.table import SAME_PLACE_MM, table_at
from ebamcheck.nc.templates import NO_HEIGHT, carried_corners
from ebamcheck.nc.timeline import AXIS_EVENT, Kind
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

NAMES = ("table limits", "table turns", "table height", "frame", "frame taken back")
STEP_DEG = 1.0  # Steps of a turn: at 500 mm they lie 9 mm apart, and 0.02 mm over the chord
PLACE_MM = 2e-3  # Tolerance of heights, which a program rounds to its decimals, at their coarsest
LIMIT_DEG = 1e-6  # Rounding of a position
STEP_MM = 1.0  # Distance of places on what stands; a larger part has about MOST_PLACES of them
MOST_PLACES = 4_000_000
LEAST_MM2 = 1.0  # Overlap of a section with what stands that is no more than its border
FAR_MM = 1e6
SAME_MM = 1e-6  # Largest difference between the places of a part in two mountings that count as the same


def tilt_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check what table and frame do; nothing for a program without either, of a part that is not turned."""
    full = nc.machine
    if full is None or full.table is None:
        if config.part.on_table is None:
            return []
        what = "the part is to be turned (part.on_table), and the program turns no table and sets no frame"
        return [Check("frame", False, 1.0, 0.0, "faults", nc.beginning, what)]
    table, axes = full.table, config.machine.rotary
    kept = np.flatnonzero(~table.apart)
    low, high = np.array([a.min_deg for a in axes]), np.array([a.max_deg for a in axes])
    over = np.maximum(low - table.positions_deg, table.positions_deg - high)[table.after]
    worst = over.max(axis=1, initial=-np.inf)
    limits = worst_check(NAMES[0], full, np.arange(len(full)), worst, LIMIT_DEG, "deg", "")
    axis = axes[int(np.argmax(over[int(np.argmax(worst))]))].name if len(full) else ""
    room = -limits.value if limits.passed else limits.value
    return [
        replace(limits, limit=0.0, text=f"{room:g} deg of {axis} {'left' if limits.passed else 'beyond its limits'}"),
        count_check(NAMES[1], list(_turns(full, table)), "one axis at a time, beam and wire commanded off"),
        _height(full, table, config),
        worst_check(NAMES[3], full, kept, table.off_mm[kept], SAME_PLACE_MM, "mm", "table and frame put the path beside its place on the part"),
        count_check(NAMES[4], list(_taken_back(full, table)), "no frame and the table at 0 after each layer, and beside it"),
    ]  # fmt: skip


def _turns(full: NCProgram, table: TableColumns) -> Iterator[tuple[str, str]]:
    """Turns under beam or wire, at feed, of several axes at once, or while the tool moves; axes that are not commanded before a
    frame."""
    e = full.events
    for row in np.flatnonzero(table.before != table.after).tolist():
        where, now = full.where(row), table.positions_deg[table.after[row]]
        was = table.positions_deg[table.before[row]]
        if full.beam[row] or full.wire[row]:
            yield where, f"the table turns with the {'beam' if full.beam[row] else 'wire'} on"
        if full.kind[row] != RAPID:
            yield where, "the table turns at feed in place of a rapid"
        if (now != was).sum() > 1:
            names = " and ".join(np.array(table.axes)[now != was])
            yield where, f"{names} turn in one block: the way between is not known"
        if not np.array_equal(full.start[row], full.end[row], equal_nan=True):
            yield where, "X, Y or Z move while the table turns"
        before = e.chosen((e.file == full.file[row]) & (e.row <= row))
        switches = (Kind.BEAM_ON, Kind.BEAM_OFF, "beam"), (Kind.WIRE_START, Kind.WIRE_STOP, "wire")
        for on, off, what in switches:
            if not before.since(before.kind == off, before.kind == on)[-1]:
                yield where, f"the table turns before the {what} is commanded off in the same subprogram"
    # An axis that is not commanded stands where the layer below left it, or a break.
    for file in np.unique(full.file[table.frame != 0]).tolist():
        row = int(np.flatnonzero((full.file == file) & (table.frame != 0))[0])
        known = e.chosen((e.file == file) & (e.row <= row)).name
        for axis in table.axes:
            if AXIS_EVENT + axis not in known:
                what = f"{axis} is not commanded before the frame: the table may stand otherwise there"
                yield full.where(row), what


def _height(full: NCProgram, table: TableColumns, config: Config) -> Check:
    """Check the tip's clearance over all that the table carries: while it turns, and on ways beside a layer."""
    if config.part.on_table is None:
        return Check(NAMES[2], True, 0.0, 0.0, "mm", "", "no part is said to stand on the table")
    corners = carried_corners(config)
    turns = set(zip(table.before.tolist(), table.after.tolist(), strict=True))
    at = table.positions_deg
    highest = max((_swept(corners, at[a], at[b], config) for a, b in turns), default=0.0)
    least = highest + config.machine.clearance_mm
    # The first way of a program rises from a height that nobody knows; the first one in a frame crosses what the turned table carries.
    enters = np.append(False, (table.frame[1:] != table.frame[:-1]) & (table.frame[1:] != 0))[: len(full)]
    rows = np.flatnonzero(table.apart | (enters & (full.kind == RAPID)))
    start, end = full.start[rows], full.end[rows]
    turned = (table.before != table.after)[rows]
    level = (start[:, :2] == end[:, :2]).all(axis=1) | np.isnan(end[:, :2]).all(axis=1)
    low = np.where(level & ~turned, end[:, 2], np.fmin(start[:, 2], end[:, 2]))
    # One that moves aside on its way up from there may meet anything.
    aside = np.isnan(start[:, 2]) & ~level
    short = least - np.where(np.isnan(end[:, 2]) | aside, -np.inf, low)
    found = worst_check(NAMES[2], full, rows, short, PLACE_MM, "mm", "")
    text = f"the table turns, and the tool is on its way, {-found.value:.4g} mm and more over the least height of Z {least:.6g} mm"
    if not found.passed:
        worst = int(np.argmax(np.nan_to_num(short, nan=np.inf)))
        what = "the tool moves aside from a height that is not known" if aside[worst] else "the tool is on its way"
        what = "the table turns" if turned[worst] else what
        z = np.fmin(start[worst, 2], end[worst, 2])
        text = f"{what} at Z {z:g} mm: all that the table carries comes to Z {highest:.6g} mm as it turns, {config.machine.clearance_mm:g} mm are to be kept"
    return replace(found, limit=0.0, text=text)


def _swept(corners: Floats, start: Floats, end: Floats, config: Config) -> float:
    """Highest Z of corners on the table while it turns from positions to others, step by step."""
    steps = max(int(np.ceil(np.abs(end - start).max(initial=0.0) / STEP_DEG)), 1)
    ups = (table_at(config.machine.rotary, start + (end - start) * (k / steps))[2] for k in range(steps + 1))
    return max(float((corners @ up[:3] + up[3]).max()) for up in ups)


def _taken_back(full: NCProgram, table: TableColumns) -> Iterator[tuple[str, str]]:
    """Files that end with a frame in force or the table turned, and motions of the main program with either."""
    turned, framed = (table.positions_deg[table.after] != 0.0).any(axis=1), table.frame != 0
    for file in np.unique(full.file).tolist():
        row = int(np.flatnonzero(full.file == file)[-1])
        for ends, what in ((framed, "its frame in force"), (turned, "the table turned")):
            if ends[row]:
                yield full.where(row), f"the subprogram ends with {what}"
    what = "the main program moves with a frame or the table turned"
    yield from row_faults(full, (framed | turned) & (full.file == 0), what)
    what = "the first motion after a frame is to give X, Y and Z, and gives no {said}"
    yield from event_faults(full, (full.events.kind == Kind.FRAME_LACKS, what))
    beads = full.beam & ~framed & turned
    yield from row_faults(full, beads, "a bead without a frame, on a table that is turned")
    changes = np.flatnonzero(np.diff(table.frame) != 0) + 1
    lit = changes[full.beam[changes] | full.beam[changes - 1]]
    yield from row_faults(full, lit, "the frame changes under the beam")


@dataclass(frozen=True, eq=False)
class Stands:
    """What stands of a part that is turned."""

    turn: Floats  # (3, 3) and (3,): a place p of the part as it was built lies at p @ turn + shift now
    shift: Floats
    built_mm: float  # Height over the plate up to which it was built
    tops: Floats  # (rows, columns) highest Z over the cells of a grid, -inf over none
    corner: Floats  # X and Y of the grid's first cell
    step_mm: float  # Side of a cell
    parts: tuple[Part, Part]  # The part as it was built, and as it is turned

    @property
    def up(self) -> tuple[Floats, float]:
        """Build direction n of the layers before, and offset d, as the part lies now: a place p lies n . p - d over the plate."""
        n = self.turn[2]
        return n, float(n @ self.shift)


def stands_of(before: Part, now: Part, built_mm: float, config: Config) -> Stands:
    """What stands of a part that was built up to a height, as it was built `before` and is turned `now`; InputError if they are not
    of one file."""
    turn, shift = rigid_motion(before, now)
    corners = before.vertices[before.faces]
    level = float(before.bounds[0, 2])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area_mm2 = float(0.5 * np.linalg.norm(across, axis=1).sum())
    step_mm = max(STEP_MM, float(np.sqrt(area_mm2 / MOST_PLACES)))
    surface, z_mm = _places(corners, step_mm), level + built_mm
    # On the top of what was built: within the shadow of the part, which holds its section there, as exact as the mesh.
    (x0, y0, lowest), (x1, y1, highest) = before.bounds.tolist()
    x, y = np.meshgrid(np.arange(x0, x1 + step_mm, step_mm), np.arange(y0, y1 + step_mm, step_mm))
    flat = np.column_stack([x.reshape(-1), y.reshape(-1)])
    inside = slice_part(before, [min(max(z_mm, lowest + 1e-6), highest - 1e-6)]).section(0)
    flat = flat[shapely.contains_xy(inside, flat[:, 0], flat[:, 1])] if not inside.is_empty else flat[:0]
    cap = np.column_stack([flat, np.full(len(flat), z_mm)])
    # The base plate: that of the settings, else one as wide as the part.
    px, py = zip(config.machine.base_plate_min_mm or (x0, y0), config.machine.base_plate_max_mm or (x1, y1), strict=True)  # fmt: skip
    box = np.array([(x, y, z) for z in (level - config.process.base_plate_mm, level) for y in py for x in px])
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    sides = np.array([box[[q[0], *pair]] for q in quads for pair in ((q[1], q[2]), (q[2], q[3]))])
    standing = np.vstack([surface[surface[:, 2] <= z_mm], cap, _places(sides, step_mm)])
    places = standing @ turn + shift
    corner = places[:, :2].min(axis=0) - step_mm
    cell = np.floor((places[:, :2] - corner) / step_mm).astype(np.int64)
    tops = np.full(cell.max(axis=0)[::-1] + 2, -np.inf)
    np.maximum.at(tops, (cell[:, 1], cell[:, 0]), places[:, 2])
    return Stands(turn, shift - turn[2] * level, built_mm, tops, corner, step_mm, (before, now))


def _places(corners: Floats, step_mm: float) -> Floats:
    """Places on triangles (F, 3, 3), none of them further than a step from the next: (m, 3)."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    count = np.maximum(np.ceil(longest / step_mm).astype(np.int64), 1)
    found = []
    for n in np.unique(count).tolist():
        i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
        inside = i + j <= n
        weight = np.stack([n - i - j, i, j], axis=1)[inside] / n
        found.append(np.einsum("pk,fkc->fpc", weight, corners[count == n]).reshape(-1, 3))
    return np.concatenate(found) if found else np.zeros((0, 3))


def turned_checks(nc: NCProgram, section: BaseGeometry, cut_mm: float, stands: Stands, config: Config) -> list[Check]:
    """Checks of a layer of a turned part, its section at the absolute height `cut_mm`: nothing is laid into what stands, or meets
    it."""
    n, d = stands.up
    # Area of the section on the built side of the plane up to which the part was built.
    inside = shapely.intersection(section, _half_plane(n[:2], float(stands.built_mm + d - n[2] * cut_mm)))
    area, text, at = float(inside.area), "the layer lies beside what stands already", tuple[float, ...]()
    if area > LEAST_MM2:
        x, y = at = shapely.point_on_surface(inside).coords[0]
        text = f"{area:.1f} mm2 of the section stand already, at ({x:.1f}, {y:.1f}): what was built reaches {stands.built_mm:g} mm along the direction before"
    return [
        *mounting_checks(*stands.parts, config, stands.built_mm),
        *_swings(nc, stands.parts[0], config),
        limit_check("standing metal", area, LEAST_MM2, "mm2", text, "", 0 if at else None, at),
        *_meets(nc, cut_mm, stands, config),
    ]


def mounting_checks(before: Part, now: Part, config: Config, built_mm: float | None = None) -> list[Check]:
    """Whether the part stands on a tilt table as the settings say, corner by corner of its mesh; nothing where none turns it.
    The height `built_mm` up to which it was built, where it is known, is that of the settings."""
    said = config.part.on_table
    if said is None:
        return []
    was, is_now = (part.vertices - [0.0, 0.0, part.vertices[:, 2].min()] for part in (before, now))
    off = [np.inf]
    if was.shape == is_now.shape:
        off = [np.abs(was @ np.array(said.turn) + np.array(said.shift_mm) - is_now).max()]
    # A corner of the box that nobody has counts for the height at which the table may turn.
    off += [np.abs(was.min(axis=0) - said.low_mm).max(), np.abs(was.max(axis=0) - said.high_mm).max()]
    off += [] if built_mm is None else [abs(built_mm - said.built_mm)]
    off_mm = float(np.max(off))
    text = f"part.on_table places the part {off_mm:.3g} mm beside where its mesh stands"
    return [limit_check("mounting", off_mm, SAME_MM, "mm", text, now.name)]


def _swings(nc: NCProgram, before: Part, config: Config) -> list[Check]:
    """The tip over part, base plate and clamps, corner by corner, wherever the table turns; nothing where the program turns
    none."""
    # The check `table height` has the same of boxes by which the program was written, too.
    full, machine = nc.machine, config.machine
    if full is None or full.table is None:
        return []
    table, places = full.table, before.vertices - [0.0, 0.0, before.vertices[:, 2].min()]
    low, high = config.machine.base_plate_min_mm, config.machine.base_plate_max_mm
    (x0, y0), (x1, y1) = low or places[:, :2].min(axis=0), high or places[:, :2].max(axis=0)
    others = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (-config.process.base_plate_mm, 0.0)]
    for zone in config.process.keep_out:
        others += [(x, y, z) for x, y in zone.outline_mm for z in zone.z_mm if zone.z_mm != NO_HEIGHT]
    places = np.vstack([places, np.array(others, np.float64)])
    least, worst = np.inf, 0
    for row in np.flatnonzero(table.before != table.after).tolist():
        start, end = table.positions_deg[table.before[row]], table.positions_deg[table.after[row]]
        highest = _swept(places, start, end, config)
        room = float(np.nan_to_num(full.end[row, 2], nan=-FAR_MM)) - highest
        least, worst = min((least, worst), (room, row))
    name, short = "table over what stands", machine.clearance_mm - least
    if short <= PLACE_MM:
        text = f"{least:.4g} mm and more over all that the table carries while it turns"
        return [Check(name, True, short, 0.0, "mm", "", text)]
    text = f"the tip stands {least:.3f} mm over what the table carries as it turns, {machine.clearance_mm:g} mm are to be kept"
    return [Check(name, False, short, 0.0, "mm", full.where(worst), text)]


def _half_plane(normal: Floats, most: float) -> BaseGeometry:
    """Places p with n . p <= most, as a polygon that is large enough."""
    size = float(np.hypot(*normal))
    if size < 1e-12:
        return shapely.box(-FAR_MM, -FAR_MM, FAR_MM, FAR_MM) if most >= 0.0 else shapely.Polygon()
    unit = normal / size
    along = np.array([-unit[1], unit[0]])
    foot = unit * (most / size)
    corners = [foot + FAR_MM * along, foot - FAR_MM * along]
    corners += [corners[1] - FAR_MM * unit, corners[0] - FAR_MM * unit]
    return shapely.Polygon(corners)


def _meets(nc: NCProgram, cut_mm: float, stands: Stands, config: Config) -> list[Check]:
    """Beam and wire, and the head, against the highest that stands around each place of the path."""
    machine, process = config.machine, config.process
    bottom_mm = cut_mm - 0.5 * config.layer_height_mm - config.base_mm
    rows = np.flatnonzero(np.isfinite(nc.start).all(axis=1) & np.isfinite(nc.end).all(axis=1))
    if not rows.size:
        return []
    row, places = nc.samples(rows, stands.step_mm)
    first = np.concatenate([nc.start[rows, :2], places])
    of = np.concatenate([rows, row])
    # A move that changes its height is held to the lower of its ends all along.
    tip = bottom_mm + np.minimum(nc.start[of, 2], nc.end[of, 2])
    checks = []
    for name, reach_mm, over_mm, what in (
        ("beam over what stands", 0.5 * process.bead_width_mm, 0.0, "beam and wire meet"),
        ("head over what stands", machine.head_radius_mm, machine.head_above_tip_mm, "the head meets"),
    ):
        into = _highest(first, reach_mm + stands.step_mm, stands) - (tip + over_mm)
        worst = int(np.argmax(into))
        value = float(max(into[worst], -FAR_MM))
        x, y = first[worst].tolist()
        if value <= 0.0:
            text = f"{-value:.3g} mm over all that stands" if value > -FAR_MM else "nothing stands there"
            checks.append(Check(name, True, value, 0.0, "mm", "", text))
        else:
            where = nc.where(int(of[worst]))
            text = (
                f"{what} what stands, base plate and part as they are turned, {value:.2f} mm deep at ({x:.1f}, {y:.1f})"
            )
            checks.append(Check(name, False, value, 0.0, "mm", where, text, 0, x, y))
    return checks


def _highest(places: Floats, reach_mm: float, stands: Stands) -> Floats:
    """Highest Z of what stands within a distance of places (n, 2); -inf where nothing does."""
    cells = int(np.ceil(reach_mm / stands.step_mm))
    tops = np.pad(stands.tops, cells, constant_values=-np.inf)
    y, x = np.mgrid[-cells : cells + 1, -cells : cells + 1]
    disc = np.hypot(x, y) * stands.step_mm <= reach_mm + stands.step_mm
    spread = ndimage.maximum_filter(tops, footprint=disc, mode="constant", cval=-np.inf)
    at = np.floor((places - stands.corner) / stands.step_mm).astype(np.int64) + cells
    inside = ((at >= 0) & (at < np.array(spread.shape)[::-1])).all(axis=1)
    found = np.full(len(places), -np.inf)
    found[inside] = spread[at[inside, 1], at[inside, 0]]
    return found

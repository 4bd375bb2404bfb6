"""Blocks that turn a tilt table for a layer and set its frame, and those that take both back.

Positions of the axes follow in closed form (second subproblem of Paden and Kahan); the tip is over all that the table carries.
Frames by Siemens NC Programming manual 12/2019, 2.12: TRANS takes every frame back and shifts, AROT turns counter-clockwise about
the zero in force."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.nc.conventions import comment
from ebamcheck.nc.templates import carried_corners
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import RotaryAxis
from ebamcheck.writing.blocks import BlockFormat

PARALLEL = 1e-12  # Sine of the angle between directions that are one
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Tilt:
    """A table that is turned for a layer."""

    positions_deg: tuple[float, ...]  # Of the rotary axes, as they are printed
    zero_mm: Floats  # Zero of the part's coordinates in the work offset, and their turn about the vertical
    turn_deg: float
    up_mm: float  # Z in the work offset at which the table may turn

    def before(self, off: Sequence[str], first: Floats, config: Config, form: BlockFormat) -> list[str]:
        """Blocks that turn the table and set the frame; then the tool stands over the place `first` of the layer."""
        x, y = form.value(first[0]), form.value(first[1])
        zero = " ".join(f"{axis}{form.value(v)}" for axis, v in zip("XYZ", self.zero_mm, strict=True))
        positions = zip(config.machine.rotary, self.positions_deg, strict=True)
        return [
            *off,
            f"G0 Z{form.value(self.up_mm)}",
            comment("TABLE TURNED"),
            *(f"G0 {_word(axis, form.value(at))}" for axis, at in positions),
            f"TRANS {zero}",
            f"AROT Z{form.value(self.turn_deg)}",
            f"G0 X{x} Y{y} Z{self._above(form)}",
        ]

    def after(self, off: Sequence[str], config: Config, form: BlockFormat) -> list[str]:
        """Blocks that take the frame back and turn the table back, the last axis first."""
        x, y = config.machine.park_position_mm
        return [
            *off,
            f"G0 Z{self._above(form)}",
            comment("TABLE TURNED BACK"),
            "TRANS",
            f"G0 X{form.value(x)} Y{form.value(y)} Z{form.value(self.up_mm)}",
            *(f"G0 {_word(axis, form.value(0.0))}" for axis in reversed(config.machine.rotary)),
        ]

    def _above(self, form: BlockFormat) -> str:
        """Z within the frame of the height at which the table turns."""
        return form.value(self.up_mm - self.zero_mm[2])


def _word(axis: RotaryAxis, value: str) -> str:
    return f"{axis.name}{value}" if len(axis.name) == 1 else f"{axis.name}={value}"


def tilt_of(config: Config, form: BlockFormat) -> Tilt | None:
    """How the table is turned for the part of the settings, None where nothing is; SettingsError where limits or height leave no
    way."""
    stands = config.part.on_table
    if stands is None:
        return None
    turn, shift = np.array(stands.turn, np.float64), np.array(stands.shift_mm, np.float64)
    axes = config.machine.rotary
    # What points up in the program, on the table.
    found = positions_of(turn[:, 2], axes)
    positions = tuple(round(value, form.decimals) + 0.0 for value in found)
    table, moved = table_motion(axes, positions)
    # A place p of the program lies at turn @ (p - shift) on the table.
    whole = table @ turn
    zero = form.rounded(moved - whole @ shift)
    turn_deg = round(math.degrees(math.atan2(whole[1, 0], whole[0, 0])), form.decimals)
    return Tilt(positions, zero, turn_deg, _up_mm(config, positions, form))


def positions_of(direction: Floats, axes: Sequence[RotaryAxis]) -> tuple[float, ...]:
    """Positions, degrees, that turn a direction of the table up: the ones nearest to 0 of those within the limits.

    >>> tilting = RotaryAxis(name="A", axis=(1, 0, 0), point_mm=(0, 0, 0))
    >>> positions_of(np.array([0.0, 1.0, 0.0]), [tilting])
    (90.0,)
    """
    unit = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    ways = [_within(turns, axes) for turns in _turns(unit, [_line(axis)[0] for axis in axes])]
    known = [way for way in ways if way is not None]
    if not known:
        limits = ", ".join(f"{a.name} {a.min_deg:g} .. {a.max_deg:g} deg" for a in axes)
        place = ", ".join(f"{value:.6g}" for value in unit + 0.0)
        raise SettingsError(f"machine.rotary: the table cannot turn the direction ({place}) up with {limits}")
    return min(known, key=lambda way: (max(map(abs, way)), sum(map(abs, way)), way))


def _turns(unit: Floats, lines: Sequence[Floats]) -> list[tuple[float, ...]]:
    """Turns about the lines, radians, counter-clockwise, that take a direction up together; none where there are none."""
    if len(lines) == 1:
        return [(_turn(unit, UP, lines[0]),)] if abs(lines[0] @ (unit - UP)) < PARALLEL else []
    outer, inner = lines
    across = np.cross(outer, inner)
    size = float(across @ across)
    if size < PARALLEL:
        return [(_turn(unit, UP, outer), 0.0)] if abs(outer @ (unit - UP)) < PARALLEL else []
    # What the inner turn leaves, v, has the parts of the direction along the inner line and of the vertical along the outer one.
    both, a, b = float(outer @ inner), float(outer @ UP), float(inner @ unit)
    one, two = (a - both * b) / size, (b - both * a) / size
    rest = 1.0 - (one * one + two * two + 2.0 * one * two * both)
    if rest < -PARALLEL:
        return []
    rise = math.sqrt(max(rest, 0.0) / size)
    between = [one * outer + two * inner + sign * rise * across for sign in ((1.0, -1.0) if rise else (1.0,))]
    return [(_turn(v, UP, outer), _turn(unit, v, inner)) for v in between]


def _turn(start: Floats, end: Floats, line: Floats) -> float:
    """Turn about a line that takes one direction to another; 0 where both lie along it."""
    a, b = start - line * (line @ start), end - line * (line @ end)
    if np.linalg.norm(a) < 1e-9 or np.linalg.norm(b) < 1e-9:
        return 0.0
    return math.atan2(float(line @ np.cross(a, b)), float(a @ b))


def _within(turns: tuple[float, ...], axes: Sequence[RotaryAxis]) -> tuple[float, ...] | None:
    """Positions of the axes for these turns, each the nearest to 0 within its limits; None where one has none."""
    found = []
    for turn, axis in zip(turns, axes, strict=True):
        position = axis.sign * math.degrees(turn)
        rounds = (position + 360.0 * k for k in range(-101, 102))
        room = [p for p in rounds if axis.min_deg - PARALLEL <= p <= axis.max_deg + PARALLEL]
        if not room:
            return None
        found.append(min(room, key=lambda p: (round(abs(p), 9), -p)) + 0.0)
    return tuple(found)


def _line(axis: RotaryAxis) -> tuple[Floats, Floats]:
    """Unit direction of a rotary axis, and a place on it."""
    direction = np.array(axis.axis, np.float64)
    return direction / np.linalg.norm(direction), np.array(axis.point_mm, np.float64)


def _rotation(line: Floats, angle_rad: float) -> Floats:
    """Matrix of a turn about a unit vector, by its quaternion."""
    w, (x, y, z) = math.cos(0.5 * angle_rad), line * math.sin(0.5 * angle_rad)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def table_motion(axes: Sequence[RotaryAxis], positions_deg: Sequence[float]) -> tuple[Floats, Floats]:
    """Turn and shift of the table: a place p on it lies at turn @ p + shift in the work offset."""
    turn, shift = np.eye(3), np.zeros(3)
    for axis, position in zip(reversed(axes), reversed(positions_deg), strict=True):
        line, point = _line(axis)
        own = _rotation(line, math.radians(axis.sign * position))
        turn, shift = own @ turn, own @ (shift - point) + point
    return turn, shift


def _up_mm(config: Config, positions_deg: tuple[float, ...], form: BlockFormat) -> float:
    """Z over all places that anything on the table comes to while one axis turns after the other, by the safe height."""
    axes, corners = config.machine.rotary, carried_corners(config)
    highest = float(corners[:, 2].max())
    for i, axis in enumerate(axes):
        outer, moved = table_motion(axes[:i], positions_deg[:i])
        highest = max(highest, _highest(corners, axis, positions_deg[i], outer[2], float(moved[2])))
    up_mm = float(np.ceil((highest + config.machine.safe_height_mm) * 1000.0) / 1000.0)
    limit = config.machine.travel_max_mm[2]
    if up_mm > limit:
        what = f"the table turns below Z {up_mm:g} mm (all that it carries, and machine.safe_height_mm)"
        raise SettingsError(f"machine.rotary: {what}, and machine.travel_max_mm ends at {limit:g} mm")
    return float(form.value(up_mm))


def _highest(corners: Floats, axis: RotaryAxis, position_deg: float, row: Floats, shift: float) -> float:
    """Highest Z of corners while an axis turns from 0: Z is c + a cos t + b sin t, carried by what has turned before."""
    line, point = _line(axis)
    from_point = corners - point
    along = np.outer(from_point @ line, line)
    a, b = (from_point - along) @ row, np.cross(line, from_point) @ row
    c = (along + point) @ row + shift
    end = math.radians(axis.sign * position_deg)
    low, high = min(0.0, end), max(0.0, end)
    top = np.arctan2(b, a)
    # The first of the tops at or after the lower end.
    top = low + np.mod(top - low, 2.0 * math.pi)
    at = np.where(top <= high, np.hypot(a, b), -np.inf)
    ends = [a * math.cos(t) + b * math.sin(t) for t in (low, high)]
    return float((c + np.maximum(at, np.maximum(*ends))).max())

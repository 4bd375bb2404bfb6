"""The feed of one layer: that of the process, or as much slower or faster as its real height asks of wire and beam.

Wire goes with feed times height, v_wire A = v b h. Within the limits of the wire the feed stays, and the wire follows the height.
A layer that would take more wire than the feeder has, or than the beam melts, is laid slower; one that would take less than
the feeder's least is laid faster: within the windows of feed, travel and line energy. Feed and wire change by the same factor, so
that a bead by itself stays as high as it was, and limits of layer height over bead height mean the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from ebamcheck.heat.melting import entry_limit_k, melted_mm3_s
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.feed_along import speed_window
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s, wire_area_mm2
from ebamcheck.writing.wire import MOST_MENDED

LOCAL = (1.0 - MOST_MENDED, 1.0 + MOST_MENDED)
"""Least and greatest local height of a layer over its height, on a surface that was measured. The limits of a wire feed lie
several times as far apart, so that one feed for the layer leaves the wire room to follow the local height all along."""

EVEN = (1.0, 1.0)
"""Least and greatest metal along a bead over that of the layer's height, on a surface that is taken as level."""

CONTOURS = 1.25
"""Wire of a bead along a contour over that of the layer, about: it lays the rim outside of it, too."""

PARTS = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Powers of the room that is wanted, tried in turn."""

SHARE_DIGITS = 4
"""Decimals of a changed feed over that of the process."""

HALVINGS = 50


def speed_share(config: Config, thickness_mm: float, room: tuple[float, float] = EVEN) -> float | None:
    """Return the feed of a layer over that of the process: the nearest to 1 within every limit; None: there is none.

    Parameters
    ----------
    room
        Least and greatest metal along the beads over that of the layer's height, for which the wire is to have room.

    Examples
    --------
    >>> speed_share(Config(), 1.7)
    1.0
    >>> speed_share(Config().changed(process={"wire_speed_max_mm_s": 30.0}), 1.7)
    0.8213
    """
    process = config.process
    wire = nominal_wire_speed_mm_s(config, thickness_mm)
    low, high = speed_window(config)
    low = max(low, process.wire_speed_min_mm_s / (wire * room[0]))
    high = min(high, process.wire_speed_max_mm_s / (wire * room[1]))
    metal_mm3_s = wire * wire_area_mm2(config)
    high = min(high, process.power_w / (metal_mm3_s * process.metal_energy_j_mm3[0]))
    low = max(low, process.power_w / (metal_mm3_s * process.metal_energy_j_mm3[1]))
    high = min(high, melted_mm3_s(config) / metal_mm3_s)
    if low > high:
        return None
    if low <= 1.0 <= high:
        return 1.0
    grid = 10.0**SHARE_DIGITS
    share = math.ceil(low * grid) / grid if low > 1.0 else math.floor(high * grid) / grid
    return share if low <= share <= high else min(max(1.0, low), high)


def at_speed(config: Config, share: float) -> Config:
    """Return the settings of a layer that is laid at a share of the feed of the process."""
    if share == 1.0:
        return config
    process = config.process
    changes = {
        "travel_speed_mm_s": process.travel_speed_mm_s * share,
        "wire_speed_mm_s": process.wire_speed_mm_s * share,
    }
    return config.model_copy(update={"process": process.model_copy(update=changes)})


def layer_share(config: Config, thickness_mm: float, mapped: bool = False) -> float:
    """Return the feed of a layer over that of the process; 1 where no feed is within every limit: the gates tell of it.

    The feed of the process stays where the wire has room, at it, for the beads along contours, too; on a surface that was
    measured, `mapped`, for the local height besides. Where no feed leaves that much room, as much of it as one leaves.
    """
    least, most = LOCAL if mapped else EVEN
    room = (least, most * CONTOURS)
    found = (speed_share(config, thickness_mm, (room[0] ** part, room[1] ** part)) for part in PARTS)
    return next((share for share in found if share is not None), 1.0)


def at_layer_feed(config: Config, thickness_mm: float, mapped: bool = False, along: bool = True) -> Config:
    """Return the settings of a layer of a height with its feed, by :func:`layer_share`.

    Where no feed leaves the wire room for the local height of a surface that was measured, the feed follows `along` the path, too.
    """
    laid = at_speed(config, layer_share(config, thickness_mm, mapped))
    if not (mapped and along) or has_room(laid, thickness_mm):
        return laid
    return laid.model_copy(update={"process": laid.process.model_copy(update={"feed_along_path": True})})


def has_room(config: Config, thickness_mm: float) -> bool:
    """Whether the wire can follow the local height of a measured surface at the feed of the settings, along contours, too."""
    wire = nominal_wire_speed_mm_s(config, thickness_mm)
    process = config.process
    return (
        wire * LOCAL[0] >= process.wire_speed_min_mm_s
        and wire * LOCAL[1] * CONTOURS <= process.wire_speed_max_mm_s
    )


def farthest_mm(config: Config, from_mm: float, to_mm: float) -> float:
    """Layer height nearest to `to_mm`, on the way from one that can be laid, for which there is a feed."""
    if speed_share(config, to_mm) is not None:
        return to_mm
    good, bad = from_mm, to_mm
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if speed_share(config, middle) is not None else (good, middle)
    return good


ROOM_K = 10.0
"""Room under the limit beside what was found over it: with other waits and power beads are entered at other moments."""

MOST_K = 150.0
"""More than this no plan is to aim lower."""


class Judged(Protocol):
    """A layer that was made and judged."""

    @property
    def passed(self) -> bool:
        """Whether every gate is open."""

    @property
    def gates(self) -> tuple[Check, ...]:
        """What was judged."""


_Made = TypeVar("_Made", bound=Judged)


def with_feed_along(
    make: Callable[[Config, float], _Made], config: Config, alone: Callable[[], Config]
) -> _Made:
    """Make a layer by its settings; where the feed follows along the path and a gate shuts, cooler, and then by the wire alone.

    Parameters
    ----------
    make
        Makes it by settings and by how far its plan aims under the limit of the heat, K.
    alone
        Settings by which the wire follows alone, as far as it goes.
    """
    made = make(config, 0.0)
    if made.passed or not config.process.feed_along_path:
        return made
    over_k = too_warm_k(made.gates)
    if over_k > 0.0:
        made = make(config, over_k)
    return made if made.passed else make(alone(), 0.0)


def too_warm_k(gates: Sequence[Check]) -> float:
    """How far a layer is over the limit of the heat, of which that is all that is wrong; else 0."""
    shut = [gate for gate in gates if not gate.passed]
    if len(shut) != 1 or shut[0].name != "heat":
        return 0.0
    over_k = shut[0].value - shut[0].limit
    return over_k if 0.0 < over_k <= MOST_K else 0.0


def aimed_lower(config: Config, by_k: float) -> Config:
    """Settings of a plan that aims under the limit of the heat; the layer itself is judged by the limit."""
    if by_k <= 0.0:
        return config
    limit_k = entry_limit_k(config) - by_k - ROOM_K
    return config.model_copy(
        update={"process": config.process.model_copy(update={"interpass_limit_k": limit_k})}
    )

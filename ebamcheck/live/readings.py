"""Measured heights, surfaces and temperatures as they come in, and what is wrong with those that are not used.

Nothing is converted, clipped or guessed: a height is used as it is or refused with a code and a reason, and what was
published stays.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.live.height_map import MapCells, Refused, figures_of, in_cells, read_map
from ebamcheck.metal import Surface
from ebamcheck.settings.config import Config

LONGEST_LINE = 4096
"""Bytes of a line; a reading takes a hundred."""

UNIT = "mm"

ABSURD = 0.75
"""Share of a layer's height by which it may come out higher or lower than planned: beyond it is no bead but a fault."""

ALIKE = 0.35
"""Share of a layer by which a value converted from another unit may miss the plan and yet tell that it is that unit."""


@dataclass(frozen=True)
class Warmth:
    """Mean temperature of the surface, K, and the time after the layer at which it was read."""

    surface_k: float
    after_s: float


@dataclass(frozen=True)
class Reading:
    """A height that was measured when so many layers were done; the map of which it is the mean, and the temperature, if there are."""

    done: int
    height_mm: float
    cells: MapCells | None = field(default=None, compare=False)
    map_sha256: str = ""
    warmth: Warmth | None = None

    @classmethod
    def of_map(cls, done: int, mean_mm: float, cells: MapCells) -> Reading:
        """Return the reading of a map."""
        return cls(done, mean_mm, cells, cells.sha256)

    def entry(self) -> dict[str, Any]:
        """Line of the journal."""
        values: dict[str, Any] = {"kind": "height", "done": self.done, "height_mm": self.height_mm}
        if self.warmth is not None:
            values |= {"surface_k": self.warmth.surface_k, "after_s": self.warmth.after_s}
        return values if self.cells is None else {**values, "map": self.cells.entry()}

    @classmethod
    def of_entry(cls, entry: dict[str, Any]) -> Reading:
        """Take it back from a line of the journal."""
        found = cls(int(entry["done"]), float(entry["height_mm"]))
        if "map" in entry:
            found = cls.of_map(found.done, found.height_mm, MapCells.of_entry(entry["map"]))
        return replace(found, warmth=warmth_of(entry))


def parsed(line: bytes) -> dict[str, Any]:
    """Return a line as a JSON object."""
    if len(line) > LONGEST_LINE:
        raise Refused("unreadable", f"a line of more than {LONGEST_LINE} bytes")
    if not line.strip():
        raise Refused("unreadable", "the line is empty")
    try:
        found = json.loads(line.decode("utf-8"), object_pairs_hook=_once)
    except KeyError as error:
        raise Refused("unreadable", f"{error.args[0]!r:.40} is in the line twice") from None
    except (ValueError, RecursionError):
        raise Refused("unreadable", "the line is no JSON") from None
    if not isinstance(found, dict):
        raise Refused("unreadable", "the line is no JSON object")
    return found


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object whose keys are there once: which of two values was meant, nobody knows."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise KeyError(key)
        found[key] = value
    return found


def reading_of(message: dict[str, Any]) -> Reading:
    """Return the reading of a message, by its types alone."""
    unit = message.get("unit", UNIT)
    if unit != UNIT:
        raise Refused("unit", f"unit {unit!r:.20}: heights are in mm and are not converted")
    done = done_of(message)
    height = message.get("height_mm")
    if height is None:
        raise Refused("missing", "`height_mm` is missing")
    if isinstance(height, bool) or not isinstance(height, int | float):
        raise Refused("not-a-number", f"height_mm {height!r:.20}: is not a number")
    try:
        height_mm = float(height)
    except OverflowError:
        height_mm = math.inf
    if not math.isfinite(height_mm):
        raise Refused("not-a-number", f"height_mm {height_mm}: is not finite")
    return Reading(done, height_mm)


def map_reading(
    message: dict[str, Any], surface: Surface | None, config: Config, last: Reading | None = None
) -> Reading:
    """Read the map of a message; its mean, where there is metal, is the height of the reading.

    One that was used for the `last` reading, and comes again, is that reading.
    """
    done = done_of(message)
    if message.get("unit", UNIT) != UNIT:
        raise Refused("unit", "the unit of a map is height_map.unit_mm of its frame")
    if message.get("height_mm") is not None:
        raise Refused("map", "give `height_mm` or `height_map`: the mean of a map is its height")
    name = message["height_map"]
    if not isinstance(name, str) or not name or "\x00" in name:
        raise Refused("map", f"height_map {name!r:.40}: give the name of a file")
    if surface is None:
        raise Refused("map", "nothing is known of what stands")
    try:
        cells = in_cells(read_map(Path(name), config.height_map), surface)
        if last is not None and (last.done, last.map_sha256) == (done, cells.sha256):
            return replace(last, warmth=None)
        figures = figures_of(cells, surface, config)
    except Refused:
        raise
    except InputError as error:
        raise Refused("map", str(error)) from None
    except MemoryError:
        raise Refused("map", f"{name:.80}: is too large for the memory of this machine") from None
    return Reading.of_map(done, figures.mean_mm, cells)


def warmth_of(message: dict[str, Any]) -> Warmth | None:
    """Return the temperature of a message, None where it has none."""
    if message.get("surface_k") is None:
        return None
    values = []
    for name, unit in (("surface_k", "kelvins"), ("after_s", "seconds since the layer was done")):
        value = message.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise Refused("temperature", f"{name} {value!r:.20}: give a finite number of {unit}")
        values.append(float(value))
    return Warmth(*values)


def done_of(message: dict[str, Any]) -> int:
    """Return how many layers are done, by a message."""
    done = message.get("done")
    if done is None:
        raise Refused("missing", "`done`, the number of layers that are done, is missing")
    if not isinstance(done, int) or isinstance(done, bool) or done < 0:
        raise Refused("counter", f"done {done!r:.20}: give the number of layers that are done")
    return done


def check_height(reading: Reading, base_mm: float, top_mm: float) -> None:
    """Refuse a height that a layer that was laid from `base_mm` to `top_mm` cannot have."""
    height, planned = reading.height_mm, top_mm - base_mm
    room = ABSURD * planned
    if abs(height - top_mm) <= room:
        return
    for factor, unit in ((25.4, "inches"), (1000.0, "metres"), (1.0 / 1000.0, "micrometres")):
        if abs(height * factor - top_mm) <= min(ALIKE * planned, room):
            raise Refused(
                "unit", f"height_mm {height:g} would be the layer's height in {unit}: heights are in mm"
            )
    if height <= base_mm:
        raise Refused(
            "decreasing", f"height_mm {height:g} is not over {base_mm:.3f}, on which the layer was laid"
        )
    raise Refused(
        "absurd",
        f"height_mm {height:g} is {_shown(abs(height - top_mm))} mm off the plan, {top_mm:.3f}: over {room:.3f}",
    )


def _shown(length_mm: float) -> str:
    """Return a length to a micrometre; one that no machine has, to a few digits."""
    return f"{length_mm:.3f}" if length_mm < 1e6 else f"{length_mm:.4g}"

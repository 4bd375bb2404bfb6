"""A measured surface as it comes in: a file that a message names becomes a reading, or a refusal with the place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.live.height_map import UnevenLayer, figures_of, in_cells
from ebamcheck.live.map_files import read_map
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.live.readings import UNIT, Reading, Refusal, done_of
from ebamcheck.settings.config import Config


def map_reading(
    message: dict[str, Any], metal: MetalSoFar, config: Config, last: Reading | None = None
) -> Reading | Refusal:
    """Read the map of a message; its mean, where there is metal, is the height of the reading.

    One that was used for the `last` reading, and comes again, is that reading.
    """
    done = done_of(message)
    if isinstance(done, Refusal):
        return done
    if message.get("unit", UNIT) != UNIT:
        return Refusal("unit", "the unit of a map is height_map.unit_mm of its frame")
    if message.get("height_mm") is not None:
        return Refusal("map", "give `height_mm` or `height_map`: the mean of a map is its height")
    name = message["height_map"]
    if not isinstance(name, str) or not name or "\x00" in name:
        return Refusal("map", f"height_map {name!r:.40}: give the name of a file")
    if metal.surface is None:
        return Refusal("map", "nothing is known of what stands")
    try:
        cells = in_cells(read_map(Path(name), config.height_map), metal.surface)
        if last is not None and (last.done, last.map_sha256) == (done, cells.sha256):
            return replace(last, warmth=None)
        figures = figures_of(cells, metal.surface, config)
    except UnevenLayer as error:
        return Refusal(error.code, str(error))
    except InputError as error:
        return Refusal("map", str(error))
    except MemoryError:
        return Refusal("map", f"{name:.80}: is too large for the memory of this machine")
    return Reading.of_map(done, figures.mean_mm, cells)

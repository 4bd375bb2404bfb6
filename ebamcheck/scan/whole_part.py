"""Order and heat of a whole part: each layer begins with what the layers below have left.

Contour beads, and the time and heat that they take, are not part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.config import Config
from ebamcheck.heat import carried
from ebamcheck.heat.model import HeatModel
from ebamcheck.kernels import run_blocks
from ebamcheck.rings import Floats
from ebamcheck.scan.driving import clocked, entered
from ebamcheck.scan.order import LayerIslands, scan_order
from ebamcheck.scan.planning import lay_islands

AHEAD = 8
"""Layers that are laid out and whose modes are found side by side, before they are ordered one after the other."""

WHOLE_PART = {
    "layer": "index of the layer",
    "height_mm": "its height over the base plate",
    "islands": "islands",
    "body_mean_k": "mean temperature rise of the body under it when it begins",
    "entry_max_k": "greatest mean temperature rise of an island when the beam enters it",
    "entry_sd_k": "standard deviation of it over the islands",
    "travel_mm": "jumps between islands",
    "time_s": "time of the layer",
    "stored_j": "heat in the body at its end",
}
"""Columns of a row of :func:`scan_part` and what they are."""


def scan_part(
    sections: Sequence[BaseGeometry],
    heights_mm: Floats,
    profile: Config,
    order: str,
    seed: int,
    pause_s: float = 0.0,
) -> Iterator[dict[str, Any]]:
    """Order all layers of a part from below, with the heat carried from each to the next.

    Parameters
    ----------
    sections
        Valid sections of the layers.
    heights_mm
        (L,) their heights over the base plate, rising.
    pause_s
        Time between two layers.

    Yields
    ------
    dict
        One row a layer as :data:`WHOLE_PART` names them, as soon as it is done.
    """
    left: tuple[HeatModel, Floats] | None = None
    for first in range(0, len(sections), AHEAD):
        block = range(first, min(first + AHEAD, len(sections)))
        for layer, islands in zip(block, _laid(sections, heights_mm, profile, seed, block), strict=True):
            if left is not None:
                islands = replace_before(islands, left)
            row, left = _scanned(layer, islands, order, left, pause_s)
            yield row


def _laid(
    sections: Sequence[BaseGeometry], heights_mm: Floats, profile: Config, seed: int, block: range
) -> list[LayerIslands]:
    """Divide layers into islands and find their modes, on all threads."""

    def work(start: int, stop: int) -> list[LayerIslands]:
        done = []
        for layer in block[start:stop]:
            laid = lay_islands(sections[layer], profile, layer, float(heights_mm[layer]))
            islands = laid.choices(profile, seed)
            if len(islands):
                _ = islands.cold_heat
            done.append(islands)
        return done

    return [islands for part in run_blocks(work, len(block)) for islands in part]


def replace_before(islands: LayerIslands, left: tuple[HeatModel, Floats]) -> LayerIslands:
    """Let a layer begin with the heat that another one left: its model, and amplitudes."""
    model, amplitudes = left
    after = replace(islands, before=lambda new: carried(model, amplitudes, new))
    if len(islands):
        # The modes are found already; only the beginning is another one.
        vars(after)["cold_heat"] = islands.cold_heat
    return after


def _scanned(
    layer: int,
    islands: LayerIslands,
    order: str,
    left: tuple[HeatModel, Floats] | None,
    pause_s: float,
) -> tuple[dict[str, Any], tuple[HeatModel, Floats] | None]:
    """Order one layer and drive it: its row, and what it leaves. A layer without islands leaves what it found."""
    place = {"layer": layer, "height_mm": islands.height_mm, "islands": len(islands)}
    if not len(islands):
        return {**dict.fromkeys(WHOLE_PART, np.nan), **place, "travel_mm": 0.0, "time_s": 0.0}, left
    heat, drive = islands.heat, islands.driven
    found = scan_order(order, islands)
    start_s, end_s, travel = clocked(
        found, drive.entry, drive.leave, drive.time_s, islands.profile.machine.rapid_mm_s
    )
    model = heat.model
    volume_mm3 = islands.section.area * model.depth.depth_mm
    entry_k, state = entered(heat, found, start_s, end_s)
    row = {
        **place,
        "body_mean_k": model.stored_j(heat.start_k) / (model.medium.heat_capacity_j_mm3k * volume_mm3),
        "entry_max_k": float(entry_k.max()),
        "entry_sd_k": float(entry_k.std()),
        "travel_mm": float(travel),
        "time_s": float(end_s.max()),
        "stored_j": model.stored_j(state),
    }
    return row, (model, model.after(state, pause_s))

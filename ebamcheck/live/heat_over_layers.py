"""The heat of a build over all of its layers, from their texts and the waits between them alone.

The server plans each layer on the heat that it has worked out for those below; were that lost from one layer to the next, each
would be cool by itself and all would melt. So the texts are followed once more, one after the other, by the second balance
(:mod:`ebamcheck.program.checking.heat_again`), which shares no code with the server's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.checking.heat_again import BeadHeat, entries_k, highest_entry_k, may_differ_k
from ebamcheck.program.checking.interpass_checks import within_range
from ebamcheck.program.checking.text_heat import sections_of_text, text_beads
from ebamcheck.program.checking.verification import read_checked
from ebamcheck.program.reading.roles import by_height, by_shape
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class LayerText:
    """What the text of one layer says of its heat: section, height, settings, and of each bead (P,) the time with the beam off before it, its
    own time, s, and the heat that the part takes up, J."""

    section: BaseGeometry
    height_mm: float
    config: Config
    off_s: Floats
    time_s: Floats
    heat_j: Floats


def layer_text(program: Path, paper: Mapping[str, Any], config: Config) -> LayerText | None:
    """Read one layer, whose certificate tells the wait before it; None where its text does not say how warm it makes the part.

    A text that cannot be read says nothing, and one that preheats has its temperatures judged where it is made. On a surface
    that was measured it begins with other heat than that of the texts below.
    """
    height_mm, wait_s = config.layer_height_mm, paper.get("wait_s")
    if not isinstance(wait_s, int | float) or "temperature" in paper:
        return None
    text, _ = read_checked(program, config)
    if text is None:
        return None
    text = by_shape(by_height(text, np.array([config.base_mm + height_mm])))
    beads = text_beads(text, config)
    if beads.scans or not len(beads):
        return None
    off_s = beads.move_s + beads.wait_s
    off_s[0] += wait_s
    section = sections_of_text(text, config, None)[0]
    return LayerText(
        section, height_mm, config, off_s, beads.time_s, beads.energy_j * config.material.absorptivity
    )


def too_warm(layers: Sequence[LayerText]) -> dict[int, str]:
    """Layers of a build from the plate up that a bead enters above the limit, and how warm it is, in words.

    The limit has what two balances may differ by on top.
    """
    if not layers:
        return {}
    config = layers[0].config
    counts = [layer.off_s.size for layer in layers]
    off_s, time_s, heat_j = (
        np.concatenate([getattr(layer, name) for layer in layers]) for name in ("off_s", "time_s", "heat_j")
    )
    beads = BeadHeat(np.repeat(np.arange(len(layers)), counts), off_s, time_s, heat_j)
    heights_mm = np.array([layer.height_mm for layer in layers])
    bed_k = entries_k(beads, [layer.section for layer in layers], heights_mm, config)
    first = np.cumsum([0, *counts[:-1]])
    entered_k = bed_k[first] if config.process.interpass_at == "layer" else np.maximum.reduceat(bed_k, first)
    most_k = highest_entry_k(config) + may_differ_k(config)
    return {
        k: f"heat over all layers: a bead of it is entered at {said_k:.0f} K{mark} by the texts so far; the limit is {most_k:.0f} K"
        for k, (said_k, mark) in enumerate(within_range(value_k, config) for value_k in entered_k.tolist())
        if not entered_k[k] <= most_k
    }

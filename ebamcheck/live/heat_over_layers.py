"""The heat of a build over all of its layers, from their texts and the waits between them alone.

The server plans each layer on the heat that it has worked out for those below; were that lost from one layer to the next, each
would be cool by itself and all would melt. So the texts are followed once more, one after the other, by the second balance
(:mod:`ebamcheck.program.checking.heat_again`), which shares no code with the server's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.checking.heat_again import BeadHeat, FollowedHeat, highest_entry_k, may_differ_k
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


def heated(heat: FollowedHeat | None, layer: LayerText) -> tuple[str, FollowedHeat]:
    """Lay one more layer on the heat of those below, None on the bare plate.

    Returns
    -------
    why, heat
        Why it is too warm, in words: a bead is entered above the limit, with what two balances may differ by on top; empty where
        none is. And the heat when the layer is done.
    """
    config = layer.config
    beads = BeadHeat(np.zeros(layer.off_s.size, np.int64), layer.off_s, layer.time_s, layer.heat_j)
    bed_k, after = (heat or FollowedHeat(config)).with_layer(beads, layer.section, layer.height_mm)
    entered_k = float(bed_k[0] if config.process.interpass_at == "layer" else bed_k.max())
    most_k = highest_entry_k(config) + may_differ_k(config)
    if entered_k <= most_k:
        return "", after
    said_k, mark = within_range(entered_k, config)
    said = f"a bead of it is entered at {said_k:.0f} K{mark} by the texts so far; the limit is {most_k:.0f} K"
    return f"heat over all layers: {said}", after

"""What is looked at once more when a layer is released, or a build is said to be done: by `verify`, and by the server before it tells anybody.

A gate that judges a layer says nothing of what is told beside it: the wait before it, the file that is called, the end of the build.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ebamcheck.checks.heat_again import FollowedHeat
from ebamcheck.json_values import sha256_of_file
from ebamcheck.live.heat_so_far import heated, layer_text
from ebamcheck.settings.config import Config

SAID = ("layer", "base_mm", "thickness_mm", "travel_speed_mm_s", "wait_s", "layer_s")
"""What a control is told of a layer that stands in its certificate, too."""


def current_off(
    place: Path, program: Path, current: Mapping[str, Any], paper: Mapping[str, Any]
) -> list[str]:
    """What a control is told of a layer that is not so; empty where all is.

    Parameters
    ----------
    place, program
        Folder of the layer's program, and file that the control is told to call.
    current, paper
        What it is told, and the certificate.
    """
    inside = program.parent == place and program.is_file()
    wanted: dict[str, Any] = {key: paper.get(key) for key in SAID}
    wanted |= {"name": place.parent.name, "sha256": sha256_of_file(program) if inside else None}
    return [key for key, value in wanted.items() if value is None or current.get(key) != value]


class Followed:
    """Heat of a build, as the server follows it again before it releases the next layer.

    The gates judge the wait that was planned; here it is that which is told. Heat that was measured, or put in by a scan, is not in the
    texts: above a layer that has such, nothing is said.
    """

    def __init__(self) -> None:
        self._heat: FollowedHeat | None = None
        self._after: FollowedHeat | None = None
        self._known = True

    def too_warm(self, program: Path, paper: Mapping[str, Any], config: Config) -> str:
        """Why a layer is entered too warm by its text, its wait and the texts of those below; empty where it is not."""
        text = layer_text(program, paper, config) if self._known else None
        why, self._after = ("", None) if text is None else heated(self._heat, text)
        return why

    def take(self) -> None:
        """Let the layer that was judged last be the uppermost."""
        self._heat, self._after, self._known = self._after, None, self._after is not None


def ended_early(height_mm: float, at_mm: float, config: Config) -> str:
    """Why a build that is said to be done at a height is not; empty where it is.

    What is left may be no layer any more: less than the process can lay, by `process.layer_over_bead` and the least speed of the wire.
    """
    process = config.process
    wire_mm3_s = process.wire_speed_min_mm_s * math.pi * process.wire_diameter_mm**2 / 4.0
    by_wire_mm = wire_mm3_s / (process.travel_speed_mm_s * process.bead_width_mm * process.bead_spacing)
    least_mm = max(process.layer_over_bead[0] * process.bead_height_mm, by_wire_mm)
    if height_mm - at_mm < least_mm:
        return ""
    return f"the build is said to be done at {at_mm:.3f} mm, the part is {height_mm:.3f} mm high"

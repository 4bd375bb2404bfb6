"""A build followed by the texts of its layers: heat and metal of each on those below, as `verify` does, and the server before a release.

The gates judge the wait that was planned; here it is that which is told. Heat that was measured, or put in by a scan, and a surface
that was measured are not in the texts: above a layer that has such, nothing is said.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.heat_again import BeadHeat, FollowedHeat, highest_entry_k, may_differ_k
from ebamcheck.checks.interpass_checks import within_range
from ebamcheck.checks.text_heat import sections_of_text, text_beads
from ebamcheck.errors import EbamcheckError
from ebamcheck.layers.heights import cut_heights
from ebamcheck.live.before import Before, metal_checks
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import read_part
from ebamcheck.nc.roles import by_height, by_shape
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.choice import witness_backend
from ebamcheck.program.verification import read_checked
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

SAME = 1e-3
"""Share by which sums of a certificate may differ from those worked out anew: by far less for another slicer, by far more where those of
a layer are missing."""


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

    A text that cannot be read says nothing, and one that preheats has its temperatures judged where it is made.
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
    heat_j = beads.energy_j * config.material.absorptivity
    return LayerText(section, height_mm, config, off_s, beads.time_s, heat_j)


class FollowedLayers:
    """Heat of a build, layer by layer: one is judged on those that were taken before it."""

    def __init__(self) -> None:
        self._heat: FollowedHeat | None = None
        self._after: FollowedHeat | None = None
        self._known = True

    def too_warm(self, program: Path, paper: Mapping[str, Any], config: Config) -> str:
        """Why a bead is entered above the limit, with what two balances may differ by on top; empty where none is."""
        text = layer_text(program, paper, config) if self._known else None
        self._after = None
        if text is None:
            return ""
        beads = BeadHeat(np.zeros(text.off_s.size, np.int64), text.off_s, text.time_s, text.heat_j)
        below = self._heat or FollowedHeat(text.config)
        bed_k, self._after = below.with_layer(beads, text.section, text.height_mm)
        entered_k = float(bed_k[0] if text.config.process.interpass_at == "layer" else bed_k.max())
        most_k = highest_entry_k(text.config) + may_differ_k(text.config)
        if entered_k <= most_k:
            return ""
        said_k, mark = within_range(entered_k, text.config)
        return f"heat over all layers: a bead of it is entered at {said_k:.0f} K{mark} by the texts so far; the limit is {most_k:.0f} K"

    def take(self) -> None:
        """Let the layer that was judged last be the uppermost."""
        self._heat, self._after, self._known = self._after, None, self._after is not None


class FollowedMetal:
    """Metal of a build, from the plate up."""

    def __init__(self, part: Path) -> None:
        self._file, self._known = part, True
        self._placed: Part | None = None
        self._before: Before | None = None

    def wrong_with(self, program: Path, paper: Mapping[str, Any], config: Config) -> str:
        """Lay one more layer; what is wrong with it, empty where nothing is."""
        said = self._laid(program, paper, config) if self._known else None
        self._known = said is not None
        return said or ""

    def _laid(self, program: Path, paper: Mapping[str, Any], config: Config) -> str | None:
        """What is wrong with one more layer; None where what lies above cannot be told."""
        text, _ = read_checked(program, config)
        if text is None or "height_map" in paper:
            return None
        part = self._placed = self._placed or read_part(self._file, config.part)[0]
        try:
            section = slice_part(part, cut_heights(part, config), witness_backend(str(paper["primary"])))
            told = paper["metal_so_far"]
        except (EbamcheckError, KeyError, TypeError, ValueError):
            return None
        before = self._before or Before.plate(part, config)
        text = by_height(text, np.array([config.base_mm + config.layer_height_mm]))
        checks, self._before = metal_checks(text, section, before.measured(), config)
        assert self._before.below is not None
        wrong = [f"metal over all layers: {check.in_words()}" for check in checks if not check.passed]
        if not _same(told, asdict(self._before.below)):
            wrong.append("metal over all layers: its certificate has other sums of it than the texts so far")
        return "; ".join(wrong)


def _same(told: Any, worked_out: dict[str, Any]) -> bool:
    """Whether sums over layers, as a certificate has them, are those worked out."""
    try:
        pairs = [
            (np.asarray(told[name], np.float64), np.asarray(value)) for name, value in worked_out.items()
        ]
        return all(np.allclose(said, found, rtol=SAME, atol=SAME) for said, found in pairs)
    except (KeyError, TypeError, ValueError):
        return False

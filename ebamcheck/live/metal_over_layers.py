"""The metal of a build over all of its layers, from their texts and sections of the part alone.

A layer by itself is held to the limits of a single layer, on a level surface. What lies over many of them, sums, means, and the surface
that they come to, is judged when it is made, on what the server knows of those below; here that is worked out anew, and held
against what the certificates have of it.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.errors import EbamcheckError
from ebamcheck.live.metal_checks import metal_checks
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.choice import witness_backend
from ebamcheck.pipeline.placement import cut_heights
from ebamcheck.program.checking.verification import read_checked
from ebamcheck.program.reading.roles import by_height
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

SAME = 1e-3
"""Share by which sums of a certificate may differ from those worked out anew: by far less for another slicer, by far more where those of
a layer are missing."""


class MetalAgain:
    """Metal of a build, followed from the plate up."""

    def __init__(self, part: Part, config: Config) -> None:
        self._part = part
        self._so_far = MetalSoFar.none(part, config)

    def with_layer(self, program: Path, paper: dict[str, Any], config: Config) -> str | None:
        """Lay one more layer; what is wrong with it, empty where nothing is, or None where what lies above cannot be told."""
        text, _ = read_checked(program, config)
        # What a map has measured is not what the texts come to.
        if text is None or "height_map" in paper:
            return None
        try:
            witness = witness_backend(str(paper["primary"]))
            section = slice_part(self._part, cut_heights(self._part, config), witness)
            told = paper["metal_so_far"]
        except (EbamcheckError, KeyError, TypeError, ValueError):
            return None
        text = by_height(text, np.array([config.base_mm + config.layer_height_mm]))
        checks, self._so_far = metal_checks(text, section, self._so_far.measured(), config)
        wrong = [f"metal over all layers: {check.in_words()}" for check in checks if not check.passed]
        if not _same(told, asdict(self._so_far.below)):
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

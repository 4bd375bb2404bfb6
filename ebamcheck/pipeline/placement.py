"""The part as a job cuts it: read, mended where that is asked for, turned and placed, and the heights of its cuts."""

from __future__ import annotations

from pathlib import Path

from ebamcheck.layers.cuts import cut_heights as cut_heights
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import read_part
from ebamcheck.settings.config import Config


def placed_part(path: str | Path, config: Config) -> tuple[Part, int, int]:
    """Read the part, mend it if asked to, turn and place it; with the facets turned over, and all that there are."""
    part, turned = read_part(path, config.part)
    return part, turned, len(part.faces)

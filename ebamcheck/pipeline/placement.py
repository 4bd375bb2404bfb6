"""The part as a job cuts it: read, mended where that is asked for, turned, and the heights of its cuts."""

from __future__ import annotations

from pathlib import Path

from ebamcheck.errors import SettingsError
from ebamcheck.layers.heights import checked_heights, is_rising, layer_heights
from ebamcheck.mesh import files as mesh_files
from ebamcheck.mesh import inspection
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config


def placed_part(path: str | Path, config: Config) -> tuple[Part, int, int]:
    """Read the part, mend it if asked to, and turn it; with the facets turned over, and all that there are."""
    part, turned = mesh_files.load(path, config.part.units), 0
    if config.part.fix_orientation:
        part, turned = inspection.fix_orientation(part)
    return part.along(config.part.direction), turned, len(part.faces)


def cut_heights(part: Part, config: Config) -> Floats:
    """Heights of the cuts that the settings ask for, (L,) mm.

    Raises
    ------
    SettingsError
        If given heights do not rise.
    """
    if not config.layers.heights_mm:
        return layer_heights(part, config.layer_height_mm)
    heights = checked_heights(config.layers.heights_mm)
    if not is_rising(heights):
        raise SettingsError("layers.heights_mm must rise from layer to layer: sort them and drop repeats")
    return heights

"""The part as a job cuts it: read, mended where that is asked for, turned and placed, and the heights of its cuts."""

from __future__ import annotations

from pathlib import Path

from ebamcheck.layers.heights import cut_heights as cut_heights
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart, read_part
from ebamcheck.settings.config import Config
from ebamcheck.settings.slicing import PartSettings


def placed_part(path: str | Path, config: Config) -> tuple[Part, int, int]:
    """Read the part, mend it if asked to, turn and place it; with the facets turned over, and all that there are."""
    part, turned = read_part(path, config.part)
    return part, turned, len(part.faces)


def as_placed(part: Part, settings: PartSettings) -> PartSettings:
    """Return the settings with the direction that a part has been turned by.

    A plate is not turned: the direction of its settings is that of the parts which name none.
    """
    return (
        settings if isinstance(part, PlatePart) else settings.model_copy(update={"direction": part.direction})
    )

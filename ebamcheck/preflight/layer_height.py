"""Layer height of a run that sets none: that of a bead, or the nearest with which layers have the solid's metal.

A level face within a layer moves to one of its borders, so that metal is added or lacks there. A layer height of which the
height of the face is a whole number leaves it where it is.
"""

from __future__ import annotations

from typing import NamedTuple

from ebamcheck.layers.layer_rule import nearest_fitting, share_off
from ebamcheck.mesh.part import Part
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

NAME = "layer height"


class ChosenHeight(NamedTuple):
    """What the layers of a run are to be as high as, and why."""

    config: Config
    """Settings with the layer height that was chosen."""
    check: Check
    fitted: bool
    """Whether that is another height than a bead's."""


def chosen_height(part: Part, sound: bool, config: Config) -> ChosenHeight:
    """Settings of a run with a layer height that fits the part, where they leave it open: layer height, listed heights or a base are kept.

    Of a mesh that is not `sound`, and so encloses no volume, nothing is known.
    """
    bead_mm, limit = config.layer_height_mm, config.process.mass_tolerance
    if config.layers.layer_height_mm is not None or config.layers.heights_mm or config.base_mm > 0.0:
        return _kept(config, f"{bead_mm:g} mm, as set" if not config.layers.heights_mm else "as listed")
    if not (sound and config.layers.fit_height):
        return _kept(config, f"{bead_mm:g} mm, that of a bead")
    share = share_off(part, config)
    if share <= limit:
        text = f"{bead_mm:g} mm, that of a bead: layers are off by {100.0 * share:.2f} % of the solid's metal"
        return ChosenHeight(config, Check.preflight(NAME, "pass", text, share, limit, "of the part"), False)
    found = nearest_fitting(part, config)
    if found is None:
        text = (
            f"layers of {bead_mm:g} mm, or of any other height near that, add {100.0 * share:.2f} % to the metal of the solid or "
            "leave as much out: level faces of the part lie within layers"
        )
        remedy = "list the layers (layers.heights_mm), or move the faces"
        return ChosenHeight(
            config, Check.preflight(NAME, "warning", text, share, limit, "of the part", remedy), False
        )
    text = (
        f"layers of {found.height_mm:g} mm in place of a bead's {bead_mm:g} mm, which would be off by {100.0 * share:.2f} % of the "
        f"solid's metal, since level faces lie within such layers; these are off by {100.0 * found.share:.2f} %"
    )
    fitting = config.changed(layers={"layer_height_mm": found.height_mm})
    return ChosenHeight(fitting, Check.preflight(NAME, "pass", text, found.share, limit, "of the part"), True)


def _kept(config: Config, text: str) -> ChosenHeight:
    check = Check.preflight(NAME, "pass", text, config.layer_height_mm, None, "mm")
    return ChosenHeight(config, check, False)

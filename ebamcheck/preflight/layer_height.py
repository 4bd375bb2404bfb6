"""Layer height of a run that sets none: that of a bead, or the nearest with which layers have the solid's metal.

A level face within a layer moves to one of its borders, so that metal is added or lacks there. A layer height of which the
height of the face is a whole number leaves it where it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.layer_rule import layer_rule, level_faces, moved_mm3, section_areas
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.plates import PlatePart
from ebamcheck.mesh.volumes import volumes_between
from ebamcheck.numeric.rings import Floats
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import outside_window, unusual_layers

NAME = "layer height"

OTHER_HEIGHTS = 0.25
"""How far a layer height that is proposed may lie beside a bead's: what wire and feed can be changed for."""

HEIGHTS_TRIED = 40
"""Layer heights that are tried for a proposal, the nearest first."""

SURELY_OFF = 2.0
"""A layer height whose level faces move more than this times the tolerance is not looked at any further."""

HEIGHT_DECIMALS = 4
"""Decimals of a layer height that is proposed, mm."""


class NearHeight(NamedTuple):
    """A layer height with which the layers have the metal of the solid."""

    height_mm: float
    share: float
    """Metal added or left out, whichever is more, over that of the solid."""


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


def share_off(part: Part, config: Config) -> float:
    """Metal that uniform layers add or leave out, over the solid's: the greatest of all parts of a plate."""
    cuts, borders = _uniform(part, config.layer_height_mm)
    return max(_share_of(mesh, cuts, borders, config) for mesh in _meshes(part))


def nearest_fitting(part: Part, config: Config) -> NearHeight | None:
    """Layer height nearest to that of the settings with which no part is off by more than `process.mass_tolerance`."""
    (bottom, top), spot_mm2 = part.bounds[:, 2].tolist(), config.process.bead_width_mm**2
    meshes, limit = _meshes(part), config.process.mass_tolerance
    faces = [level_faces(mesh, spot_mm2) for mesh in meshes]
    levels = {round(face.z_mm - bottom, 6) for some in faces for face in some}
    for height in _near_heights([*levels, top - bottom], config):
        cuts, borders = _uniform(part, height)
        # Most heights fail by their level faces alone, which takes no look at the mesh.
        moved = max(
            moved_mm3(some, cuts, borders, config.process.machining_allowance_mm) / max(mesh.volume, 1e-9)
            for mesh, some in zip(meshes, faces, strict=True)
        )
        if moved > SURELY_OFF * limit:
            continue
        other = config.changed(layers={"layer_height_mm": height})
        share = max(_share_of(mesh, cuts, borders, other) for mesh in meshes)
        if share <= limit:
            return NearHeight(height, share)
    return None


def _uniform(part: Part, height_mm: float) -> tuple[Floats, Floats]:
    """Cuts (L,) and borders (L + 1,) of uniform layers of a part, mm."""
    cuts = layer_heights(part, height_mm)
    borders = np.asarray(float(part.bounds[0, 2]) + height_mm * np.arange(len(cuts) + 1), np.float64)
    return cuts, borders


def _kept(config: Config, text: str) -> ChosenHeight:
    check = Check.preflight(NAME, "pass", text, config.layer_height_mm, None, "mm")
    return ChosenHeight(config, check, False)


def _meshes(part: Part) -> Sequence[Part]:
    if not isinstance(part, PlatePart):
        return [part]
    return [part.member(member) for member in part.members]


def _share_of(mesh: Part, cuts: Floats, borders: Floats, config: Config) -> float:
    process = config.process
    top = max(float(mesh.bounds[1, 2]), float(borders[-1])) + 1.0
    volumes = volumes_between(mesh, np.append(borders, top))
    areas, spot_mm2 = section_areas(mesh, cuts), process.bead_width_mm**2
    rule = layer_rule(mesh, cuts, borders, areas, volumes, spot_mm2, process.machining_allowance_mm)
    return rule.share


def _near_heights(levels: list[float], config: Config) -> Iterator[float]:
    """Layer heights of which a level over the bottom has a whole number, the nearest first, within the process window."""
    now = config.layer_height_mm
    tried = {
        round(z_mm / count, HEIGHT_DECIMALS)
        for z_mm in levels
        for count in range(
            max(1, int(z_mm / now / (1.0 + OTHER_HEIGHTS))), int(z_mm / now * (1.0 + OTHER_HEIGHTS)) + 2
        )
    }
    near = sorted((h for h in tried if abs(h / now - 1.0) <= OTHER_HEIGHTS), key=lambda h: (abs(h - now), h))
    for height in near[:HEIGHTS_TRIED]:
        other = config.changed(layers={"layer_height_mm": height})
        if not any(outside_window(other)) and not any(unusual_layers(other)):
            yield height

"""Whether the layers of a program have the metal of the solid: what their sections alone cannot tell.

A program's metal is held against sections times heights of layers. These may themselves be more or less than the part:
a level face within a layer moves to one of its borders. That is held against the volume of the mesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ebamcheck.checks.checks import Check
from ebamcheck.checks.metal_rules import SOLID, of_deposit
from ebamcheck.layers.layer_rule import LEVEL_MM, LayerRule, layer_rule, section_areas
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.plates import PlatePart
from ebamcheck.mesh.volumes import volumes_between
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.between_cuts import between_check
from ebamcheck.pipeline.mesh_sections import heights_check, sections_check
from ebamcheck.pipeline.part_file import file_check
from ebamcheck.preflight.layer_height import nearest_fitting
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.writing.inputs import deposition_heights

SAME_AREA = 1e-3
"""Share of the greatest section by which those of the mesh and of a slicer differ only where bodies overlap, or it is open."""

CUTS_OF_A_LAYER = 16
"""Sections from which the volume of a layer is summed where the mesh has none of its own: bodies that overlap."""

CUTS_AT_ONCE = 512
"""Sections that are held at once for that."""


class Solid(NamedTuple):
    """The check of the layers against the solid, and where they are furthest off."""

    check: Check
    z_mm: float
    """Height in the part of the gravest level face of a check that fails; NaN without one."""

    def tells_of(self, z_mm: float) -> bool:
        """Whether the check has told that the metal is off at that height of the part."""
        return abs(self.z_mm - z_mm) <= LEVEL_MM


def solid_check(part: Part, layers: Layers, config: Config) -> Solid:
    """Check that the layers neither add to the solid nor leave out of it more than `process.mass_tolerance`.

    Parameters
    ----------
    part
        The part as placed; of a plate each part is held to the limit by itself.
    layers
        Its sections at the cuts of the program, from below.
    """
    limit, cuts = config.process.mass_tolerance, np.asarray(layers.heights)
    if not len(cuts) or not layers.areas().any():
        return Solid(Check(SOLID, False, np.inf, limit, "of the part", "", "no layer has metal"), np.nan)
    if len(cuts) == 1 and _of_some_layers(config):
        # A layer that is made alone, at a height that was measured, is what that height makes it.
        text = "one layer of the part says nothing of the solid"
        return Solid(Check(SOLID, True, 0.0, limit, "of the part", "", text), np.nan)
    borders = layer_borders(part, cuts, config)
    parts = [(mesh, areas, name) for mesh, areas, name in _parts(part, layers)]
    found = [_rule(mesh, cuts, borders, areas, config) for mesh, areas, _ in parts]
    k = int(np.argmax([rule.share for rule in found]))
    rule, text = found[k], _summed(found[k], parts[k][2])
    if rule.share <= limit:
        return Solid(Check(SOLID, True, rule.share, limit, "of the part", "", text), np.nan)
    layer, z_mm = None, np.nan
    if rule.faces:
        z_mm = rule.faces[0].z_mm
        layer = min(int(np.searchsorted(borders, z_mm, side="right")) - 1, len(cuts) - 1)
        text += f", most {_face(rule)}"
    if not any(_overlap(mesh, cuts, areas) for mesh, areas, _ in parts):
        text += _proposed(part, config)
    return Solid(Check(SOLID, False, rule.share, limit, "of the part", "", text, layer), z_mm)


def of_mesh(part: Part, layers: Layers, config: Config) -> list[Check]:
    """Checks of the sections and heights of the layers against the mesh; parameters as of :func:`solid_check`."""
    return [
        sections_check(part, layers, config),
        between_check(part, layers, config),
        heights_check(part, np.asarray(layers.heights), config),
        file_check(part, config),
    ]


def with_solid(checks: list[Check], part: Part, layers: Layers, config: Config) -> list[Check]:
    """Add the checks against the mesh to those of a program whose metal was looked at; to others they would say nothing of them."""
    if not of_deposit(checks):
        return checks
    return [*checks, solid_check(part, layers, config).check, *of_mesh(part, layers, config)]


def layer_borders(part: Part, cuts: Floats, config: Config) -> Floats:
    """Heights (L + 1,) in the part between which the layers stand, mm."""
    z_of = deposition_heights(cuts, config.layer_height_mm, config.base_mm) - config.base_mm
    bottom = float(part.bounds[0, 2])
    if config.base_mm > 0.0 or cuts[0] >= bottom + z_of[0]:
        # What the layers lie on, or listed heights leave out below them, is no part of the program.
        bottom = float(cuts[0]) - 0.5 * float(z_of[0])
    return np.concatenate([[bottom], bottom + z_of])


def _of_some_layers(config: Config) -> bool:
    """Whether the settings list the layers, or begin on what stands: they need not be all of the part."""
    return config.base_mm > 0.0 or bool(config.layers.heights_mm)


def _parts(part: Part, layers: Layers) -> Iterator[tuple[Part, Floats, str]]:
    """Each part by itself, with the areas of its sections and how it is named."""
    if not isinstance(part, PlatePart) or len(part.members) < 2:
        yield part, layers.areas(), ""
        return
    for member in part.members:
        mesh = part.member(member)
        yield mesh, slice_part(mesh, layers.heights).areas(), f" of {member.name}"


def _rule(part: Part, cuts: Floats, borders: Floats, areas: Floats, config: Config) -> LayerRule:
    process = config.process
    heights = np.append(borders, max(float(part.bounds[1, 2]), float(borders[-1])) + 1.0)
    summed = _summed_volumes if _overlap(part, cuts, areas) else volumes_between
    volumes = summed(part, heights)
    if _of_some_layers(config):
        volumes[-1] = 0.0  # Nor are these layers said to be the rest of the part.
    spot_mm2 = process.bead_width_mm**2
    return layer_rule(part, cuts, borders, areas, volumes, spot_mm2, process.machining_allowance_mm)


def _overlap(part: Part, cuts: Floats, areas: Floats) -> bool:
    """Whether the mesh encloses something else than its sections do."""
    if (np.diff(cuts) <= 0.0).any():
        return True
    most = max(float(areas.max(initial=0.0)), 1e-9)
    return bool((np.abs(section_areas(part, cuts) - areas) > SAME_AREA * most).any())


def _summed_volumes(part: Part, borders: Floats) -> Floats:
    """Volume between heights (n + 1,), (n,) mm3, from many sections."""
    steps = (np.arange(CUTS_OF_A_LAYER) + 0.5) / CUTS_OF_A_LAYER
    heights = (borders[:-1, None] + np.diff(borders)[:, None] * steps).ravel()
    areas = [
        slice_part(part, heights[k : k + CUTS_AT_ONCE]).areas() for k in range(0, heights.size, CUTS_AT_ONCE)
    ]
    mean = np.concatenate(areas).reshape(-1, CUTS_OF_A_LAYER).mean(axis=1)
    return np.asarray(mean * np.diff(borders), np.float64)


def _summed(rule: LayerRule, named: str) -> str:
    whole = max(rule.solid_mm3, 1e-9)
    return (
        f"layers of one section each add {100.0 * rule.added_mm3 / whole:.2f} % to the metal of the solid{named} "
        f"and leave {100.0 * rule.lacking_mm3 / whole:.2f} % of it out"
    )


def _face(rule: LayerRule) -> str:
    """The gravest face in words."""
    face = rule.faces[0]
    does = "goes beyond" if face.added_mm > 0.0 else "ends before"
    share = 100.0 * face.area_mm2 * abs(face.added_mm) / max(rule.solid_mm3, 1e-9)
    return f"at the level face of {face.area_mm2:.0f} mm2 at z = {face.z_mm:.3f} mm of the part: it lies within a layer, and the metal {does} it by {abs(face.added_mm):.2f} mm, {share:.2f} %"


def _proposed(part: Part, config: Config) -> str:
    """A layer height with which the part passes, in words; empty where none was found near the one that is set."""
    found = None if _of_some_layers(config) else nearest_fitting(part, config)
    if found is None:
        return ""
    return f"; layers of {found.height_mm:g} mm (layers.layer_height_mm) leave {100.0 * found.share:.2f} %"

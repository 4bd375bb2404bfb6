"""Checks of one layer against mesh and metal, before it is released: those that `verify` makes of its program, too."""

from __future__ import annotations

from ebamcheck.layers.stack import Layers
from ebamcheck.live.metal_checks import metal_checks
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.mesh_sections import layer_check, sections_check
from ebamcheck.program import Check
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config


def mesh_and_metal(
    program: NCProgram, part: Part, witness: Layers, stands: MetalSoFar | None, config: Config
) -> tuple[list[Check], MetalSoFar]:
    """Whether a layer is cut where it comes to lie, its section is that of the mesh, and its metal that of the section.

    Parameters and result as of :func:`ebamcheck.live.metal_checks.metal_checks`.
    """
    checks, now = metal_checks(program, witness, stands, config)
    height = layer_check(part, float(witness.heights[0]), config.base_mm, config.layer_height_mm)
    return [*checks, height, sections_check(part, witness, config)], now

"""Metal of a layer judged on what stands, and by its text alone; and whether wire and cathode last for it."""

from __future__ import annotations

from dataclasses import replace

from ebamcheck.layers.stack import Layers
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.program import Check
from ebamcheck.program.checking.consumables import FRESH, consumed, spent_after
from ebamcheck.program.checking.deposit import deposit
from ebamcheck.program.checking.deposit_checks import deposit_checks
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.program.toolpath.inputs import deposition_heights
from ebamcheck.settings.config import Config


def metal_checks(
    program: NCProgram, witness: Layers, stands: MetalSoFar | None, config: Config
) -> tuple[list[Check], MetalSoFar]:
    """Checks of a layer's metal on what stands, and what stands with it.

    Sums and means count from the plate up, by the limits of a whole part; the layer, and the surface that all layers so far
    come to, by those of a single one. The layer has to pass by its text alone, too, as anybody can judge it: on a level surface,
    of which nothing is known. Spool and cathode have to last for it with what the layers below took of them.
    """
    z_of = deposition_heights(witness.heights, config.layer_height_mm, config.base_mm)
    known = stands or MetalSoFar()
    found = deposit(program, witness, z_of, config, stands=known.surface)
    checks = deposit_checks(program, found, config, None if stands is None else stands.below)
    if known.below.layers:
        by_itself = found if known.surface is None else deposit(program, witness, z_of, config)
        checks += [
            replace(check, text=f"by its text alone: {check.text}")
            for check in deposit_checks(program, by_itself, config)
            if not check.passed
        ]
    used = consumed(program, config, known.spent)
    if known.spent != FRESH:
        checks += [one.check() for one in used]
    return checks, known.with_layer(found.layers, found.surface, spent_after(used), config)

"""Blocks of a preheating subprogram: the beam out of focus, without wire, back and forth over plate or layer, then a wait."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.nc.comments import comment
from ebamcheck.nc.numbers import plain
from ebamcheck.nc.safe_end import safe_end_mm
from ebamcheck.nc.templates import ProcessValues
from ebamcheck.numeric.rings import Ints
from ebamcheck.scan.heat.preheating import pass_lines
from ebamcheck.scan.plan.preheated import scanned
from ebamcheck.settings.config import Config
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.inputs import ScanColumns
from ebamcheck.writing.layer_text import pause_blocks
from ebamcheck.writing.safe_states import Templates


def preheat_passes(plan: ScanColumns) -> Ints:
    """Passes (L,) before each layer of a plan; none of one that knows nothing of preheating."""
    metrics = getattr(plan, "metrics", {})
    if "preheat_passes" not in metrics:
        return np.zeros(len(plan.heights), np.int64)
    return np.asarray(metrics["preheat_passes"], np.int64)


def preheat_blocks(
    plan: ScanColumns,
    k: int,
    bottom_mm: float,
    passes: int,
    values: ProcessValues,
    after: ProcessValues,
    config: Config,
    form: BlockFormat,
    templates: Templates,
    entry: Sequence[str],
) -> list[str]:
    """Blocks of the scan before layer `k`, whose bottom lies at `bottom_mm`.

    `entry` are the modes that hold in it, `values` those of beads at full power, and `after` those with which the beam is left.
    Within the subprogram of its layer (``preheat.scan_in``) the focus is the last that is taken back, since it tells where the scan
    ends.
    """
    settings = config.preheat
    assert plan.sections is not None
    region = scanned(list(plan.sections), k, bottom_mm, config, getattr(plan, "under", None)).region
    share = settings.current_ma / config.process.current_ma
    low = values.at(share, 1.0)
    wide, sharp = replace(low, defocus=settings.defocus), replace(values, defocus=0.0)

    def filled(name: str, given: ProcessValues) -> list[str]:
        return given.fill(name, templates[name])

    on, off = filled("beam_on", low), filled("beam_off", low)
    lines = [
        comment(f"PREHEATING BEFORE LAYER {k + 1}, {passes} PASSES"),
        *entry,
        *filled("wire_stop", low), *off, *filled("set_focus", wide), *filled("set_beam", low),
        f"G0 Z{form.value(safe_end_mm(bottom_mm, config))}",
    ]  # fmt: skip
    feed = f" F{plain(60.0 * settings.speed_mm_s)}"
    for number in range(passes):
        lines.append(comment(f"PASS {number + 1}"))
        ways, joined = pass_lines(region, config, number)
        for n, way in enumerate(form.rounded(ways)):
            if joined[n]:
                lines.append(f"G1 X{form.value(way[0])} Y{form.value(way[1])}")
            else:
                lines += off if n else []
                lines += [f"G0 X{form.value(way[0])} Y{form.value(way[1])}", *on]
            lines.append(f"G1 X{form.value(way[2])} Y{form.value(way[3])}{'' if joined[n] else feed}")
        lines += off if len(ways) else []
    ends = [*filled("set_beam", after), *filled("set_focus", sharp)]
    soak = pause_blocks(values, templates, settings.soak_s)
    return [*lines, *ends, *soak] if settings.scan_in == "own" else [*lines, *soak, *ends]

"""Blocks of a preheating subprogram: the beam out of focus, without wire, back and forth over plate or layer, then a wait."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.heat.melting import entry_limit_k
from ebamcheck.numeric.rings import Ints
from ebamcheck.program.language.comments import comment
from ebamcheck.program.language.control import control
from ebamcheck.program.language.numbers import plain
from ebamcheck.program.language.safe_end import safe_end_mm
from ebamcheck.program.language.templates import ProcessValues
from ebamcheck.program.toolpath.inputs import ScanColumns
from ebamcheck.program.writing.blocks import BlockFormat
from ebamcheck.program.writing.layer_text import pause_blocks
from ebamcheck.program.writing.safe_states import Templates
from ebamcheck.scan.filling.preheat_lines import pass_lines
from ebamcheck.scan.plan.preheated import scanned
from ebamcheck.settings.config import Config


def checked_preheating(config: Config) -> None:
    """Refuse preheating that this machine cannot do, or that would be none.

    Raises
    ------
    SettingsError
        That names the setting, and what to do.
    """
    settings, machine, process = config.preheat, config.machine, config.process
    if settings.when == "off":
        return
    why = ""
    if not control(machine.control).subprogram_suffix:
        why = (
            f"machine.control {machine.control!r} has programs of one file: a scan is a subprogram of its own"
        )
    elif not machine.set_focus:
        why = 'machine.set_focus is empty: give the block that sets the focus, such as "H5={defocus} ; focus"'
    elif settings.defocus == 0.0:
        why = "preheat.defocus is 0, the focus of the beads: give the value at which the beam is preheat.spot_mm wide"
    elif settings.current_ma > process.current_max_ma:
        why = f"preheat.current_ma {settings.current_ma:g} is over process.current_max_ma {process.current_max_ma:g}"
    elif not machine.feed_min_mm_s <= settings.speed_mm_s <= machine.feed_max_mm_s:
        why = (
            f"preheat.speed_mm_s {settings.speed_mm_s:g} is not within machine.feed_min_mm_s and feed_max_mm_s, "
            f"{machine.feed_min_mm_s:g} .. {machine.feed_max_mm_s:g}"
        )
    elif settings.when == "layers" and process.layer_pause_s > 0.0:
        why = "process.layer_pause_s lets layers cool that preheat.when = 'layers' heats: use one of them"
    elif settings.target_k + settings.over_k > entry_limit_k(config):
        why = (
            f"preheat.target_k + over_k is {settings.target_k + settings.over_k:g} K, over {entry_limit_k(config):g} K at which no bead "
            "may be entered"
        )
    elif config.base_mm > 0.0:
        why = "the program begins on what stands (layers.base_mm): its preheating is not part of it"
    if why:
        raise SettingsError(f"preheat.when is {settings.when!r}: {why}")


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
    config: Config,
    form: BlockFormat,
    templates: Templates,
    entry: Sequence[str],
) -> list[str]:
    """Blocks of the scan before layer `k`, whose bottom lies at `bottom_mm`; `entry` are the modes that hold in it."""
    settings = config.preheat
    assert plan.sections is not None
    region = scanned(list(plan.sections), k, bottom_mm, config).region
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
    return [
        *lines,
        *filled("set_beam", values),
        *filled("set_focus", sharp),
        *pause_blocks(values, templates, settings.soak_s),
    ]

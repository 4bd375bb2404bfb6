"""Findings on part, slicers and machine profile that no gate covers."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from ebamcheck.comparison.doubt import doubted_layers
from ebamcheck.findings import Finding, at_layer
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.nc.control import control
from ebamcheck.preflight.suspicions import of_bodies, suspicions
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.settings.process_window import wire_speed_mm_s
from ebamcheck.slicers.isolation import Outcome


def turned_over(turned: int, facets: int) -> Finding:
    """Facets that `part.fix_orientation` has turned over."""
    return Finding(
        "warning",
        "facets-turned-over",
        f"{turned} of {facets} facets were turned over",
        "part.fix_orientation",
        float(turned),
        0.0,
        "facets",
        "look at the sections, or mend the model",
    )


def fitted_layers(text: str) -> Finding:
    """A layer height that a run chose for the part."""
    return Finding("note", "layer-height-fitted", text, "layers.fit_height")


def unavailable(outcome: Outcome) -> Finding:
    """A slicer that this machine cannot run."""
    return Finding(
        "note",
        "backend-unavailable",
        f"backend {outcome.name} is not available: {outcome.why}",
        "slicing.backends",
    )


def lost(outcome: Outcome) -> Finding:
    """A slicer that did not come to its end."""
    text = f"backend {outcome.name} {outcome.failure}: {outcome.why}"
    return Finding("warning", "backend-lost", text, outcome.name)


def of_doubt(pairs: pd.DataFrame, config: Config) -> Iterator[Finding]:
    """Layers on which slicers agree only because one of them declares doubt."""
    for a, b, layers, depth_mm, added_mm in doubted_layers(pairs):
        yield Finding(
            "warning",
            "declared-doubt",
            f"{a} and {b} agree on {len(layers)} layers only within places that one of them declares doubtful: they are "
            f"{depth_mm:.3g} mm apart, {added_mm:.3g} mm are declared",
            f"layers {', '.join(str(k + 1) for k in layers[:5])}{' ...' if len(layers) > 5 else ''}",
            depth_mm,
            config.comparison.doubt_mm,
            "mm",
            "mend thin facets of the mesh there, or forbid it (comparison.doubt_mm = 0)",
        )


def of_set_aside(pairs: pd.DataFrame) -> Iterator[Finding]:
    """Rings and holes that one slicer of a pair has and the other lacks, where both agree without what is thin."""
    if not len(pairs) or not len(rows := pairs[pairs["set_aside"] > 0]):
        return
    first, most = rows.sort_values("layer", kind="stable").iloc[0], int(rows["set_aside"].max())
    names = sorted({f"{a} and {b}" for a, b in zip(rows["a"], rows["b"], strict=True)})
    yield Finding(
        "note",
        "thin-set-aside",
        f"{'; '.join(names)}: on {rows['layer'].nunique()} layers they agree once up to {most} rings or holes are set aside "
        f"that only one of them has, of gaps and walls thinner than {2.0 * rows['limit_mm'].max():.3g} mm",
        at_layer(int(first["layer"]), first["height_mm"]),
        float(most),
        None,
        "rings",
        "join bodies that nearly touch in the model, or move them apart",
    )


# -- the part ----------------------------------------------------------------------------------------


def of_part(found: Inspection, config: Config) -> Iterator[Finding]:
    """What bodies, size and file of the part tell."""
    yield from of_bodies(found)
    yield from suspicions(found, config)


# -- the profile -------------------------------------------------------------------------------------


def placeholder_codes(config: Config) -> list[str]:
    """Templates of beam and wire that this process uses and that are the default ones of the control."""
    machine, process = config.machine, config.process
    used = ["beam_on", "beam_off", "set_beam", "wire_start", "wire_stop", "set_wire"]
    used += ["set_power"] if process.ramps_beam or process.interpass in ("power", "both") else []
    used += ["wire_retract"] if process.wire_retract_mm > 0.0 else []
    stock = control(machine.control).templates
    return [
        name
        for name in used
        if getattr(machine, name) in (MachineSettings.model_fields[name].default, stock.get(name, ()))
        and getattr(machine, name)
    ]


def of_profile(config: Config) -> Iterator[Finding]:
    """Codes that stand for those of the machine's maker, where a table has to stand, and what the wire feeder has to do by itself."""
    names = placeholder_codes(config)
    if names:
        yield Finding(
            "warning",
            "placeholder-codes",
            f"the codes of beam and wire are those of the default profile, {len(names)} of them",
            ", ".join(f"machine.{name}" for name in names),
            float(len(names)),
            0.0,
            "templates",
            "set the machine maker's codes",
        )
    if axes := [axis.name for axis in config.machine.rotary if config.part.on_table is None]:
        yield Finding(
            "warning",
            "table-as-it-stands",
            f"the program does not command {' and '.join(axes)}: what was proved holds while the table stands at 0, which a layer on a "
            "turned part that was broken off may have left otherwise",
            "machine.rotary",
            float(len(axes)),
            0.0,
            "axes",
            "bring the table to 0 before the program is started",
        )
    process = config.process
    if process.wire_retract_mm > 0.0:
        wire_mm_s = wire_speed_mm_s(config, process.bead_width_mm, config.layer_height_mm)
        bare_mm = process.wire_retract_mm / wire_mm_s * process.travel_speed_mm_s
        yield Finding(
            "warning",
            "wire-drawn-back",
            f"{process.wire_retract_mm:g} mm of wire are drawn back at the end of each bead, and no block feeds them forward again: "
            f"unless the feeder does it at the next start, {bare_mm:.3g} mm of every bead have no metal",
            "process.wire_retract_mm",
            bare_mm,
            0.0,
            "mm",
            "make sure that the feeder does, or have it done by the codes of machine.wire_start",
        )

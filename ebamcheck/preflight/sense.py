"""Settings that cannot work together, whatever the part is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ebamcheck.errors import EbamcheckError
from ebamcheck.preflight.workload import RUN
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import outside_window, unusual_layers

FEW_BEADS_ACROSS = 2.0
"""Cells narrower than this many beads are all ends and starts."""


def sense_checks(config: Config) -> Iterator[Check]:
    """Check layer height, wire and energy against the process window, and what else excludes itself."""
    window = [replace(found, name="process window", stops=(RUN,)) for found in outside_window(config)]
    layer, bead = config.layer_height_mm, config.process.bead_height_mm
    said = (
        f"layers of {layer:.4g} mm, {layer / bead:.3g} of the height of one bead; within the process window"
    )
    yield from window or [Check.preflight("process window", "pass", said, layer / bead, None, "of the bead")]
    yield from (replace(found, name="layer height") for found in unusual_layers(config))
    yield _control(config)
    yield _feed(config)
    yield from _cells(config)
    yield from _temperatures(config)


def _control(config: Config) -> Check:
    """There must be such a control, its programs must be read back, and its templates must make blocks."""
    # What writes programs is loaded where it is asked for: the rest of a preflight needs none of it.
    from ebamcheck.nc.control import control
    from ebamcheck.nc.templates import usable_templates

    name = config.machine.control
    try:
        if not control(name).is_read:
            text = f"machine.control {name!r} is a simulator's case, which is not read back and so never validated"
            remedy = "run for a control, then `ebamcheck post` for the simulator"
            return Check.preflight("control", "fault", text, remedy=remedy, stops=(RUN,))
        templates = usable_templates(config, name)
    except EbamcheckError as error:
        remedy = "mend that setting of the machine; `ebamcheck config` shows the default ones"
        return Check.preflight("control", "fault", str(error), remedy=remedy, stops=(RUN,))
    return Check.preflight("control", "pass", f"{name}, with {len(templates)} templates that make blocks")


def _feed(config: Config) -> Check:
    """The axes must be able to drive the travel speed."""
    machine, speed = config.machine, config.process.travel_speed_mm_s
    axes = config.kinematics.axis_speed_mm_s
    limits = (
        (machine.feed_min_mm_s, "machine.feed_min_mm_s", "under", speed < machine.feed_min_mm_s),
        (machine.feed_max_mm_s, "machine.feed_max_mm_s", "over", speed > machine.feed_max_mm_s),
        (max(axes[:2]), "kinematics.axis_speed_mm_s", "over", speed > max(axes[:2])),
    )
    for limit, name, how, broken in limits:
        if broken:
            text = f"process.travel_speed_mm_s {speed:g} is {how} {name} {limit:g}"
            remedy = "change the travel speed, with wire and current, or the limit"
            return Check.preflight("feed", "fault", text, speed, limit, "mm/s", remedy, (RUN,))
    return Check.preflight("feed", "pass", f"beads at {speed:g} mm/s", speed, machine.feed_max_mm_s, "mm/s")


def _cells(config: Config) -> Iterator[Check]:
    """A cell must hold a few beads."""
    side, bead = config.scan.hexagon_side_mm, config.process.bead_width_mm
    if side is None or config.scan.partition == "whole":
        return
    width, least = 3.0**0.5 * side, FEW_BEADS_ACROSS * bead
    text = f"cells of scan.hexagon_side_mm {side:g} are {width:.4g} mm wide, beads {bead:g} mm"
    if width >= least:
        yield Check.preflight("cells", "pass", text, width, least, "mm")
        return
    remedy = "give a larger side, or leave it out: it is planned then"
    yield Check.preflight("cells", "warning", text, width, least, "mm", remedy)


def _temperatures(config: Config) -> Iterator[Check]:
    """Temperatures of the material rise, and the chamber is colder than what a bead may be entered at."""
    material, process = config.material, config.process
    order = (material.solidus_k, material.liquidus_k, material.boiling_k)
    if not order[0] <= order[1] < order[2]:
        text = f"solidus, liquidus and boiling point are {order[0]:g}, {order[1]:g} and {order[2]:g} K"
        yield Check.preflight("material", "fault", text, remedy="give them in rising order", stops=(RUN,))
    limit = process.interpass_limit_k or material.interpass_limit_k
    if process.interpass != "off" and limit <= process.ambient_temperature_k:
        yield Check.preflight(
            "interpass limit",
            "fault",
            f"no bead may be entered over {limit:g} K, and the chamber has {process.ambient_temperature_k:g} K",
            limit,
            process.ambient_temperature_k,
            "K",
            "raise process.interpass_limit_k",
            (RUN,),
        )

"""The table of rules: every group of checks with what it needs to know, the gate that it shuts, and what to do where one fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ebamcheck.checks import checks as do
from ebamcheck.checks.bead_checks import coverage_check, gaps_check, line_checks, repeated_blocks
from ebamcheck.checks.bead_end_checks import bead_end_checks, end_gaps_check, ramp_check
from ebamcheck.checks.checks import checks_of
from ebamcheck.checks.clearance import clearance_checks
from ebamcheck.checks.consumables import consumables_checks
from ebamcheck.checks.interpass_checks import heat_checks, wait_check
from ebamcheck.checks.matching import matching_checks
from ebamcheck.checks.mesh_checks import of_mesh, solid_check
from ebamcheck.checks.metal_rules import bead_wire_check, deposit_checks, overfill_check
from ebamcheck.checks.path_checks import closure_check, contour_checks, hatch_checks, layer_checks
from ebamcheck.checks.preheating import preheat_checks
from ebamcheck.checks.process_checks import process_checks
from ebamcheck.checks.section_check import section_checks
from ebamcheck.checks.state_checks import released_checks, state_checks, wait_height_check
from ebamcheck.checks.subject import Subject
from ebamcheck.checks.table import tilt_checks
from ebamcheck.checks.text_checks import header_checks, text_checks, words_check
from ebamcheck.checks.value_checks import increment_check, value_check, window_check, wire_check
from ebamcheck.kernels import Floats
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.nc.motions import NCProgram
from ebamcheck.plugins import registry
from ebamcheck.result import Check, Place


@dataclass(frozen=True)
class Rule:
    """Checks that are made together."""

    make: Callable[[Subject], Sequence[Check]]  # Makes them of a subject
    # Their names, and what to do where one fails; nothing where that follows from its text.
    checks: Mapping[str, str]
    # What has to be known of the subject, or asked for (knows); the program alone is always known.
    needs: tuple[str, ...] = ()
    gate: str = "program"  # Gate that they shut

    def applies(self, subject: Subject) -> bool:
        """Whether all is known that it needs."""
        return all(subject.knows(need) for need in self.needs)


def _each(remedy: str, *names: str) -> dict[str, str]:
    return dict.fromkeys(names, remedy)


def _plugged(subject: Subject) -> list[Check]:
    """Make the checks of all plugins, functions of program and settings; one that raises or returns no check is a failed check of
    its name."""
    checks: list[Check] = []
    for name in registry.names(registry.CHECKS):
        try:
            found = registry.plugin(registry.CHECKS, name)(subject.nc, subject.config)
            own = [found] if isinstance(found, Check) else list(found)
            if not all(isinstance(check, Check) for check in own):
                raise TypeError("it returned what is no Check")
        except Exception as error:
            text = f"plugin {name!r} of {registry.CHECKS}: {type(error).__name__}: {error}"
            remedy = "tell those who make the plugin, or remove it"
            own = [Check(name, False, 1.0, 0.0, "", subject.nc.files[0].name, text, remedy=remedy)]
        figures = "{0.value:.6g} {0.unit}, the limit is {0.limit:.6g}"
        checks += [one if one.text else replace(one, text=figures.format(one)) for one in own]
    return checks


def _mesh(subject: Subject) -> list[Check]:
    assert subject.part is not None
    given = subject.part, subject.witness, subject.config
    return [solid_check(*given).check, *of_mesh(*given)]


# All checks of a program, in the order of a record.
# fmt: off
RULES = (
    Rule(lambda s: text_checks(s.nc, s.config, s.sha256), _each(
        do.AGAIN, "encoding", "line ends", "block length", "names and headers", "block numbers", "end of program", "subprograms", "unchanged",
    )),
    Rule(lambda s: header_checks(s.nc, s.config, s.truth, s.heights), {
        **_each(do.AGAIN, "status", "header"),
        "size on the control": "write fewer blocks (machine.curve_form, machine.line_tolerance_mm), or raise machine.program_limit_mb",
    }),
    Rule(lambda s: state_checks(s.nc, s.config), {
        **_each(do.PROFILE, "modes", "smoothing", "start state"), "order of events": do.AGAIN, "safe end": do.PROFILE,
        "feed": "set the feed within machine.feed_min_mm_s and machine.feed_max_mm_s (process.travel_speed_mm_s)",
        **_each(do.AGAIN, "start of path", "spline blocks", "polynomial blocks"),
        "travel": "move the part (part.direction, the work offset), or set the machine's travel (machine.travel_max_mm)",
        **_each(do.PROFILE, "beam", "wire"), "turns": do.AGAIN,
    }),
    Rule(lambda s: [wire_check(s.nc, s.config, s.path), *bead_end_checks(s.nc, s.config, s.shares)], {
        **_each(do.WINDOW, "mass balance", "power"), "overlap of contours": do.AGAIN, "wire retract": do.PROFILE, "parts of hatch lines": do.AGAIN,
    }),
    Rule(lambda s: [
        closure_check(s.nc, s.curves), repeated_blocks(s.nc), words_check(s.nc), increment_check(s.nc, s.config), ramp_check(s.nc, s.config),
        window_check(s.nc, s.config), value_check(s.nc, s.config), *process_checks(s.nc, s.config),
    ], {
        **_each(do.AGAIN, "contours close", "repeated blocks", "words of motions"),
        "increments": "make the program again for this profile (ebamcheck run), whose increments are machine.*_increment_*",
        "ramps in time": "change the length of the ramp (process.ramp_up_mm, process.crater_fill_mm) or its window",
        **_each(do.WINDOW, "process window", "process values"),
        "seams": "spread the seams (process.seam_shift_mm), or lower process.least_seam_distance_mm",
        "overhang": "build in another direction (part.direction), support it in the model, or, for a slope within a bead's width, set the "
        "angle that your process can build (process.largest_overhang_deg)",
        "travel sectors": "turn the hatch (scan.first_angle_deg), or widen process.travel_sectors_deg",
        "keep-out zones": "move the part away from the places of process.keep_out, or turn it (part.direction)",
    }),
    Rule(lambda s: [wait_check(s.nc, s.config, s.waits), wait_height_check(s.nc, s.config)], {
        "layer pause": do.COOL, "waits over the part": do.AGAIN,
    }),
    Rule(lambda s: consumables_checks(s.nc, s.config), {
        "wire on the spool": "begin with a fuller spool (machine.spool_kg), or stop before layers (machine.optional_stop) to put on another",
        "life of the cathode": "begin with a new cathode (machine.cathode_h), or stop before layers (machine.optional_stop) to put in another",
    }),
    Rule(lambda s: heat_checks(s.nc, s.config, s.sections, s.before, s.witness_sections), {
        "melting power": "make the program again; where it has the full power already, raise process.current_ma, or lay less metal in a second "
        "(process.travel_speed_mm_s, layers.layer_height_mm)",
        "interpass temperature": do.COOL,
        "least entry temperature": "shorten the wait (make the program again), preheat (preheat.when), or lower process.least_entry_temperature_k",
        "balance of the heat": do.MISTAKE,
    }, needs=("heat",), gate="heat"),
    Rule(lambda s: preheat_checks(s.nc, s.config, s.sections, s.before, s.under), {
        **_each(do.AGAIN, "preheat calls", "preheat state", "preheat path", "preheat lines", "preheat count"),
        "preheat temperature": "more passes or current (preheat.most_passes, preheat.current_ma), a shorter wait (preheat.soak_s), or a lower target_k",
        "preheat overheating": "fewer passes (preheat.passes), less current (preheat.current_ma), or a greater preheat.over_k",
        "preheat evenness": "a narrower preheat.spacing_mm, preheat.pattern 'crossed', a longer preheat.soak_s, or a greater evenness_k",
        "preheat melting": "a wider beam (preheat.spot_mm, preheat.defocus), less current (preheat.current_ma), or more speed (preheat.speed_mm_s)",
        "preheat balance": do.MISTAKE,
    }),
    Rule(lambda s: [*tilt_checks(s.nc, s.config), *released_checks(s.nc, s.config)], {
        **_each("", "table limits", "table turns", "table height", "frame", "frame taken back"), "layer by itself": do.AGAIN,
    }),
    Rule(lambda s: clearance_checks(s.nc, s.z_of, s.config, s.layers), {
        "collision": "raise machine.safe_height_mm and machine.clearance_mm, or move what stands in the way (process.keep_out)",
        "clearance": "raise machine.safe_height_mm and machine.clearance_mm",
        "support": "build in another direction (part.direction), or support the overhang in the model",
    }),
    Rule(_plugged, {}),
    Rule(lambda s: layer_checks(s.nc, s.z_of, s.filled), {
        "layer count": do.AGAIN, **_each(do.LEVEL, "layer heights", "flat layers"),
    }, needs=("heights",)),
    Rule(lambda s: matching_checks(s.nc, s.match) if s.match else [], _each(do.AGAIN, "beads as planned", "hatch path"), needs=("match",)),
    Rule(contour_checks, _each(do.AGAIN, "contour rings", "contour path"), needs=("curves",)),
    Rule(hatch_checks, _each(do.AGAIN, "islands", "hatch vectors"), needs=("plan",)),
    Rule(section_checks, {"section": do.FIT, "beads inside": do.COARSE, "smooth section": do.FIT}, needs=("layers",)),
    Rule(lambda s: deposit_checks(s.nc, s.deposit, s.config), {
        **_each(do.HATCH, "metal", "metal of layers"), **_each(do.COARSE, "metal outside", "reach of metal"), "holes": do.HOLE,
        "narrow features": f"fill or widen it in the model, set a least width under it (process.least_hole_mm, least_wall_mm), or {do.NARROWER}",
        **_each(do.HATCH, "height inside", "height at edges", "height of layers", "height of zones", "surface"),
    }, needs=("metal", "layers"), gate="deposit"),
    Rule(lambda s: [] if s.match else [overfill_check(s.nc, s.z_of, s.config, s.witness)], {"metal laid once": ""}, needs=("layers",)),
    Rule(line_checks, {
        "hatch spacing": do.HATCH, "lines laid once": do.AGAIN, **_each(do.HATCH, "hatch lines", "crossings"),
    }, needs=("beads", "heights")),
    Rule(coverage_check, {"coverage": do.HATCH}, needs=("beads", "layers")),
    Rule(gaps_check, {"gaps": do.HATCH}, needs=("beads", "layers")),
    Rule(lambda s: [bead_wire_check(s.nc, s.deposit, s.config)], {
        "wire of beads": f"where a wall or a hole is narrower than two beads, {do.COARSE}; else {do.AGAIN}",
    }, needs=("beads", "layers")),
    Rule(lambda s: [end_gaps_check(s.nc, s.config, s.witness)], {
        "ends of beads": f"{do.HATCH}; a text that was edited by hand is made again (ebamcheck run)",
    }, needs=("beads", "layers")),
    Rule(_mesh, {
        "metal of the solid": do.LEVELS, "sections of the mesh": do.OFF_MESH, "between the cuts": do.FLAT,
        **_each(do.MISTAKE, "layers of the part", "part of the file"),
    }, needs=("part", "metal", "layers"), gate="deposit"),
)
# fmt: on
# What to do, by name of the check that fails.
REMEDIES: Mapping[str, str] = {
    "readable": do.AGAIN,
    **{name: remedy for rule in RULES for name, remedy in rule.checks.items() if remedy},
}


def checks_on(subject: Subject, gate: str = "") -> list[Check]:
    """Make every check for which enough is known of a subject, or those of one gate; in the order of the table."""
    rules = [rule for rule in RULES if rule.applies(subject) and gate in ("", rule.gate)]
    if not gate:
        # Worked out here once, and not by several threads.
        _ = subject.nc, subject.shares, subject.sections, subject.witness_sections
    return checks_of([partial(rule.make, subject) for rule in rules])


def names_of(gate: str) -> tuple[str, ...]:
    """Names of the checks that shut a gate, in their order."""
    return tuple(name for rule in RULES if rule.gate == gate for name in rule.checks)


def of_gate(checks: Iterable[Check], gate: str) -> list[Check]:
    """Those of some checks that shut a gate; a check without a row of its own, such as that of a plugin, shuts `program`."""
    gates = {name: rule.gate for rule in RULES for name in rule.checks}
    return [check for check in checks if gates.get(check.name, "program") == gate]


def with_remedies(
    checks: Sequence[Check], nc: NCProgram, cut_mm: Floats, first_layer_mm: float, base_mm: float = 0.0
) -> list[Check]:
    """Checks of which those that fail tell remedy, layer, and its heights in part and program.
    The cuts (L,) mm are in the part; an only layer is `first_layer_mm` high, and the lowest lies on Z `base_mm`."""
    deposit_mm = deposition_heights(cut_mm, first_layer_mm, base_mm)
    found = []
    for check in checks:
        if check.passed:
            found.append(check)
            continue
        layer = check.layer if check.layer is not None else layer_of(nc, check.at)
        place = ""
        if layer is not None and layer < len(cut_mm):
            place = str(Place(layer=layer, cut_mm=float(cut_mm[layer]), z_mm=float(deposit_mm[layer])))
        remedy = check.remedy or REMEDIES.get(check.name, do.OTHERWISE)
        found.append(replace(check, layer=layer, place=place, remedy=remedy))
    return found


def layer_of(nc: NCProgram, place: Place) -> int | None:
    """Layer of a line of a program, from 0; None where it lies in none."""
    numbers = [k for k, file in enumerate(nc.files) if file.name == place.file]
    if not numbers or not place.line:
        return None
    rows = np.flatnonzero((nc.file == numbers[0]) & (nc.layer >= 0))
    if not rows.size:
        return None
    after = rows[nc.line[rows] >= place.line]
    return int(nc.layer[after[0] if after.size else rows[-1]])

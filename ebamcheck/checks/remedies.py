"""What to do about a check that fails, and where it is: layer as the program names it, heights in part and program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ebamcheck.checks.checks import Check
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats
from ebamcheck.result import Place
from ebamcheck.writing.inputs import deposition_heights

AGAIN = (
    "make the program again (ebamcheck run); a text that was edited by hand is checked with ebamcheck verify"
)
PROFILE = "set the machine's own codes in the templates (ebamcheck config, section machine)"
PLACE = "move the part (part.direction, the work offset), or set the machine's travel (machine.travel_max_mm)"
NARROWER = (
    "use a narrower bead (process.bead_width_mm, with layers.layer_height_mm as it is and a process.current_ma that goes with "
    "the square of the width)"
)
COARSE = f"allow for machining (process.machining_allowance_mm), {NARROWER}, or build in another direction (part.direction)"
TOO_THIN = (
    "allow for machining (process.machining_allowance_mm), make the wall thicker in the model, or build in another direction "
    "(part.direction)"
)
"""Of a wall that no bead of the process is narrow enough for."""
FIT = "fit more closely (curves.tolerance_mm, curves.method), or export the mesh more finely"
HATCH = "change the spacing (process.bead_spacing), the side of the cells (scan.hexagon_side_mm) or scan.gap_width"
HOLE = f"machine the hole afterwards and close it in the model, or {NARROWER}"
NARROW = f"fill or widen it in the model, set a least width under it (process.least_hole_mm, least_wall_mm), or {NARROWER}"
FLAT = (
    "machine it afterwards and close it in the model, or lay thinner layers (layers.layer_height_mm), build in another direction "
    "(part.direction), or set a least width under it (process.least_hole_mm, least_wall_mm)"
)
LEVELS = (
    "choose layers.layer_height_mm so that level faces fall on borders of layers, move those faces in the model, or, for metal "
    "that is too much, allow for machining (process.machining_allowance_mm)"
)
COOL = 'wait and lower the power (process.interpass = "both"), or raise process.interpass_limit_k'
MISTAKE = "no setting mends it: this program has a mistake in reading, slicing, layers or heat model; report it with the part"
OFF_MESH = (
    f"mend the mesh, or the slicer, where the gate input or agreement is shut; where both are open, {MISTAKE}"
)
WINDOW = "bring wire, feed, power and layer height into the process window (section process)"

REMEDIES: Mapping[str, str] = {
    **dict.fromkeys(
        (
            "encoding", "line ends", "block length", "names and headers", "block numbers", "end of program",
            "subprograms", "unchanged", "status", "header", "readable", "order of events", "repeated blocks",
            "spline blocks", "polynomial blocks", "contours close", "layer count", "beads as planned", "hatch path",
            "contour rings", "contour path", "islands", "hatch vectors", "lines laid once", "turns",
            "parts of hatch lines", "overlap of contours", "start of path", "words of motions", "waits over the part",
            "layer by itself",
        ),
        AGAIN,
    ),
    "increments": "make the program again for this profile (ebamcheck run), whose increments are machine.*_increment_*",
    "ramps in time": "change the length of the ramp (process.ramp_up_mm, process.crater_fill_mm) or its window",
    **dict.fromkeys(("modes", "smoothing", "start state", "safe end", "beam", "wire", "wire retract"), PROFILE),
    **dict.fromkeys(("process window", "process values", "mass balance", "power"), WINDOW),
    **dict.fromkeys(("section", "smooth section"), FIT),
    **dict.fromkeys(("beads inside", "metal outside", "reach of metal"), COARSE),
    "holes": HOLE,
    "ends of beads": f"{HATCH}; a text that was edited by hand is made again (ebamcheck run)",
    "narrow features": NARROW,
    "wire of beads": f"where a wall or a hole is narrower than two beads, {COARSE}; else {AGAIN}",
    **dict.fromkeys(
        (
            "coverage", "gaps", "hatch spacing", "hatch lines", "crossings", "metal", "metal of layers", "height inside", "height at edges",
            "height of layers", "height of zones", "surface",
        ),
        HATCH,
    ),
    "metal of the solid": LEVELS,
    "sections of the mesh": OFF_MESH,
    "between the cuts": FLAT,
    "layers of the part": MISTAKE,
    "balance of the heat": MISTAKE,
    "preheat balance": MISTAKE,
    "part of the file": MISTAKE,
    **dict.fromkeys(("layer pause", "interpass temperature"), COOL),
    "melting power": "make the program again; where it has the full power already, raise process.current_ma, or lay less metal in a second "
    "(process.travel_speed_mm_s, layers.layer_height_mm)",
    "least entry temperature": "shorten the wait (make the program again), preheat (preheat.when), or lower process.least_entry_temperature_k",
    **dict.fromkeys(("layer heights", "flat layers"), "give layers of one height (layers.layer_height_mm), then " + AGAIN),
    **dict.fromkeys(("preheat calls", "preheat state", "preheat path", "preheat count", "preheat lines"), AGAIN),
    "preheat temperature": "more passes or current (preheat.most_passes, preheat.current_ma), a shorter wait (preheat.soak_s), or a lower target_k",
    "preheat overheating": "fewer passes (preheat.passes), less current (preheat.current_ma), or a greater preheat.over_k",
    "preheat evenness": "a narrower preheat.spacing_mm, preheat.pattern 'crossed', a longer preheat.soak_s, or a greater evenness_k",
    "preheat melting": "a wider beam (preheat.spot_mm, preheat.defocus), less current (preheat.current_ma), or more speed (preheat.speed_mm_s)",
    "size on the control": "write fewer blocks (machine.curve_form, machine.line_tolerance_mm), or raise machine.program_limit_mb",
    "wire on the spool": "begin with a fuller spool (machine.spool_kg), or stop before layers (machine.optional_stop) to put on another",
    "life of the cathode": "begin with a new cathode (machine.cathode_h), or stop before layers (machine.optional_stop) to put in another",
    "feed": "set the feed within machine.feed_min_mm_s and machine.feed_max_mm_s (process.travel_speed_mm_s)",
    "travel": PLACE,
    "travel sectors": "turn the hatch (scan.first_angle_deg), or widen process.travel_sectors_deg",
    "keep-out zones": "move the part away from the places of process.keep_out, or turn it (part.direction)",
    "collision": "raise machine.safe_height_mm and machine.clearance_mm, or move what stands in the way (process.keep_out)",
    "clearance": "raise machine.safe_height_mm and machine.clearance_mm",
    "support": "build in another direction (part.direction), or support the overhang in the model",
    "overhang": "build in another direction (part.direction), support it in the model, or, for a slope within a bead's width, set the angle that your process can build (process.largest_overhang_deg)",
    "seams": "spread the seams (process.seam_shift_mm), or lower process.least_seam_distance_mm",
}  # fmt: skip
"""By name of the check."""

OTHERWISE = "look at that line of the program, and at the settings that the text names"
"""Of a check that a plugin brought."""


def told(
    checks: Sequence[Check], nc: NCProgram, cut_mm: Floats, first_layer_mm: float, base_mm: float = 0.0
) -> list[Check]:
    """Checks of which those that fail tell remedy, layer, and heights in part and program.

    Parameters
    ----------
    checks, nc
        Checks of a program, and the program as it was read.
    cut_mm
        (L,) heights of the cuts in the part, mm.
    first_layer_mm
        Height of the only layer where there is no second.
    base_mm
        Z of what the lowest layer lies on.
    """
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
        found.append(
            replace(
                check, layer=layer, place=place, remedy=check.remedy or REMEDIES.get(check.name, OTHERWISE)
            )
        )
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

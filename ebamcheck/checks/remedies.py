"""What to do about a check that fails: texts that several checks, and findings, have in common."""

from __future__ import annotations

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
# Of a wall that no bead of the process is narrow enough for.
TOO_THIN = (
    "allow for machining (process.machining_allowance_mm), make the wall thicker in the model, or build in another direction "
    "(part.direction)"
)
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
MELT = (
    "make the program again; where it has the full power already, raise process.current_ma, or lay less metal in a second "
    "(process.travel_speed_mm_s, layers.layer_height_mm)"
)
WARMER = "shorten the wait (make the program again), preheat (preheat.when), or lower process.least_entry_temperature_k"
HOTTER = "more passes or current (preheat.most_passes, preheat.current_ma), a shorter wait (preheat.soak_s), or a lower target_k"
CALMER = "fewer passes (preheat.passes), less current (preheat.current_ma), or a greater preheat.over_k"
EVENER = "a narrower preheat.spacing_mm, preheat.pattern 'crossed', a longer preheat.soak_s, or a greater evenness_k"
WIDER = "a wider beam (preheat.spot_mm, preheat.defocus), less current (preheat.current_ma), or more speed (preheat.speed_mm_s)"
OVERHANG = (
    "build in another direction (part.direction), support it in the model, or, for a slope within a bead's width, set the angle "
    "that your process can build (process.largest_overhang_deg)"
)
SHORTER = (
    "write fewer blocks (machine.curve_form, machine.line_tolerance_mm), or raise machine.program_limit_mb"
)
FEED = "set the feed within machine.feed_min_mm_s and machine.feed_max_mm_s (process.travel_speed_mm_s)"
STEPS = "make the program again for this profile (ebamcheck run), whose increments are machine.*_increment_*"
RAMPS = "change the length of the ramp (process.ramp_up_mm, process.crater_fill_mm) or its window"
SEAMS = "spread the seams (process.seam_shift_mm), or lower process.least_seam_distance_mm"
SECTORS = "turn the hatch (scan.first_angle_deg), or widen process.travel_sectors_deg"
AWAY = "move the part away from the places of process.keep_out, or turn it (part.direction)"
SPOOL = "begin with a fuller spool (machine.spool_kg), or stop before layers (machine.optional_stop) to put on another"
CATHODE = "begin with a new cathode (machine.cathode_h), or stop before layers (machine.optional_stop) to put in another"
HIGHER_OR_AWAY = (
    "raise machine.safe_height_mm and machine.clearance_mm, or move what stands in the way (process.keep_out)"
)
HIGHER = "raise machine.safe_height_mm and machine.clearance_mm"
SUPPORT = "build in another direction (part.direction), or support the overhang in the model"
WIRE = f"where a wall or a hole is narrower than two beads, {COARSE}; else {AGAIN}"
ENDS = f"{HATCH}; a text that was edited by hand is made again (ebamcheck run)"
LEVEL = f"give layers of one height (layers.layer_height_mm), then {AGAIN}"
# Of a check that a plugin brought.
OTHERWISE = "look at that line of the program, and at the settings that the text names"

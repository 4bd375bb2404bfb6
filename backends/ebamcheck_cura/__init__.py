"""The program CuraEngine as a slicer: an independent check, read from the G-code of its surface mode.

It works in whole micrometres and merges vertices within 30 um, so the part is magnified as far as its 64-bit products allow.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, labels_of
from ebamcheck.errors import BackendMissing
from ebamcheck.layers.even_odd import INSIDE_RULE, directed_by_nesting
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.scratch import scratch_folder
from ebamcheck.slicers.outside.lattices import (
    Lattice,
    LatticeStack,
    Placement,
    Program,
    ProgramSettings,
    coordinate_rounding_mm,
    height_rounding_mm,
    scale_to,
)

PROGRAM = Program(
    name="CuraEngine",
    command="CuraEngine",
    variable="EBAMCHECK_CURAENGINE",
    package="cura-engine cura",
    version_arguments=("help",),
    version_pattern=r"version (\d+\.\d+\S*)",
)

# Environment variable with the folder of Cura's definitions, if it is none of the usual ones
DEFINITIONS = "EBAMCHECK_CURA_DEFINITIONS"
USUAL_DEFINITIONS = ("/usr/share/cura/resources/definitions", "/usr/local/share/cura/resources/definitions")
PRINTER = "fdmprinter.def.json"
EXTRUDER = "fdmextruder.def.json"

UNIT = 1e-3  # CuraEngine's unit of length, a micrometre, mm
# Larger side of the part as CuraEngine gets it, mm, or half of it. From 1.5 million units on its test for collinear points overflows
WORKING_SIZE = 2.0**20 * UNIT
# Largest height of the part as CuraEngine gets it, in its units: the product with a side stays within 64 bits
TALLEST = 2**28
# Distance within which CuraEngine merges vertices (`vertex_meld_distance` in its source), in its units
MERGE_UNITS = 30.0
# Rounding to whole units (1), and the distance within which points of a path are merged or collinear (5), in its units
OTHER_UNITS = 6.0


class Cura:
    """Contours by CuraEngine: paths have no direction, so a part whose shells cross is refused; open ones stay open."""

    name: ClassVar[str] = "cura"
    summary: ClassVar[str] = "witness: the program CuraEngine (surface mode); no crossing shells"
    exact: ClassVar[bool] = False
    priority: ClassVar[int] = -30
    coplanar_rule: ClassVar[CoplanarRule] = "undefined"
    inside_rule: ClassVar[str] = INSIDE_RULE
    Settings: ClassVar[type[BackendSettings]] = ProgramSettings

    def probe(self) -> Probe:
        """Whether CuraEngine and Cura's definitions are installed, and the version."""
        answer = PROGRAM.probe()
        try:
            if answer.available:
                definitions()
            return answer
        except BackendMissing as missing:
            hint = f"apt install cura, or name the folder in {DEFINITIONS}"
            return Probe(False, why=str(missing), hint=hint)

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of coordinates to 32 bits and to whole units, and the merging of vertices, mm."""
        units = MERGE_UNITS + OTHER_UNITS
        return 2.0 * coordinate_rounding_mm(part) + units * UNIT / scale_to(part, WORKING_SIZE)

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of heights to 32 bits and to whole units, and the merging of vertices, mm."""
        units = MERGE_UNITS + OTHER_UNITS
        return height_rounding_mm(part) + units * 8.0 * float(part.size[2]) / TALLEST

    def prepare(self, part: Part, settings: BackendSettings) -> LatticeStack:
        """Look for the program; it runs when heights are known."""
        own = ProgramSettings.own(settings, self.name)
        PROGRAM.path()
        cut = partial(_cut, part, own, definitions())
        return LatticeStack(part, labels_of(part, self.name, own.model_dump()), cut)


def definitions() -> Path:
    """Folder of Cura's definitions; raises :class:`BackendMissing` where there is none."""
    named = os.environ.get(DEFINITIONS)
    for folder in map(Path, (named,) if named else USUAL_DEFINITIONS):
        if (folder / PRINTER).is_file() and (folder / EXTRUDER).is_file():
            return folder
    raise BackendMissing(
        f"Cura's definitions ({PRINTER}, {EXTRUDER}) are not in {named or USUAL_DEFINITIONS[0]}"
    )


def _cut(part: Part, settings: ProgramSettings, definitions: Path, lattice: Lattice) -> Layers:
    """Run CuraEngine on a part for the planes of a lattice."""
    from ebamcheck_cura.gcode import read_paths

    placement = Placement(part, lattice, scale_to(part, WORKING_SIZE), 1.0)
    layer_units = 2 ** max(1, (TALLEST // placement.layer_count).bit_length() - 1)
    placement = replace(placement, layer=layer_units * UNIT)
    with scratch_folder() as folder:
        write_triangles(placement.triangles(), folder / "part.stl")
        said = PROGRAM.run(_arguments(placement.layer, definitions), folder, settings.time_limit_s)
        file = folder / "part.gcode"
        if not file.exists():
            raise PROGRAM.failed(f"wrote no G-code for part {part.name!r}", said)
        paths = read_paths(file.read_bytes())
    return directed_by_nesting(placement.layers(paths), Cura().error_bound_mm(part, settings), Cura.name)


def _arguments(layer: float, folder: Path) -> list[str]:
    """Command line: one path along every contour, nothing else, nothing simplified, closed or left out."""
    settings: dict[str, object] = {
        "layer_height": layer,
        "layer_height_0": layer,
        "slicing_tolerance": "middle",
        "magic_mesh_surface_mode": "surface",
        "machine_center_is_zero": "true",
        "center_object": "false",
        "remove_empty_first_layers": "false",
        "meshfix_union_all": "false",
        "meshfix_union_all_remove_holes": "false",
        "meshfix_extensive_stitching": "false",
        "meshfix_keep_open_polygons": "false",
        "meshfix_maximum_resolution": UNIT,
        "meshfix_maximum_deviation": UNIT,
        "meshfix_maximum_travel_resolution": UNIT,
        "minimum_polygon_circumference": 0,
        "xy_offset": 0,
        "xy_offset_layer_0": 0,
        "hole_xy_offset": 0,
        "wall_line_count": 1,
        "wall_0_inset": 0,
        "wall_0_wipe_dist": 0,
        "top_layers": 0,
        "bottom_layers": 0,
        "infill_line_distance": 0,
        "adhesion_type": "none",
        "support_enable": "false",
        "prime_blob_enable": "false",
        "retraction_enable": "false",
        "retraction_combing": "off",
        "machine_end_gcode": ";End of Gcode",
    }
    chosen = [word for key, value in settings.items() for word in ("-s", f"{key}={value}")]
    return ["slice", "-j", str(folder / PRINTER), *chosen, "-l", "part.stl", "-o", "part.gcode"]

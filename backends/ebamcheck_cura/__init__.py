"""The program CuraEngine as a slicer: an independent check, read from the G-code of its surface mode.

It works in whole micrometres and merges vertices within 30 um, so the part is magnified as far as its 64-bit products allow.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Probe, labels_of
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.kernels import Floats
from ebamcheck.layers.even_odd import INSIDE_RULE, directed_by_nesting
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.scratch import scratch_folder
from ebamcheck.slicers.outside import lattices
from ebamcheck.slicers.outside.lattices import Lattice, LatticeStack, Placement, Program, ProgramSettings

PROGRAM = Program(
    name="CuraEngine", command="CuraEngine", variable="EBAMCHECK_CURAENGINE", package="cura-engine cura",
    version_arguments=("help",), version_pattern=r"version (\d+\.\d+\S*)",
)  # fmt: skip

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
        return 2.0 * lattices.coordinate_rounding_mm(part) + units * UNIT / lattices.scale_to(part, WORKING_SIZE)

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of heights to 32 bits and to whole units, and the merging of vertices, mm."""
        units = MERGE_UNITS + OTHER_UNITS
        return lattices.height_rounding_mm(part) + units * 8.0 * float(part.size[2]) / TALLEST

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
    raise BackendMissing(f"Cura's definitions ({PRINTER}, {EXTRUDER}) are not in {named or USUAL_DEFINITIONS[0]}")


def _cut(part: Part, settings: ProgramSettings, definitions: Path, lattice: Lattice) -> Layers:
    """Run CuraEngine on a part for the planes of a lattice."""
    placement = Placement(part, lattice, lattices.scale_to(part, WORKING_SIZE), 1.0)
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


# -- Paths in the G-code of the surface mode ---------------------------------------------------------------------
#
# A path begins where a travel (``G0``) ends and follows the moves with extrusion (``G1``); a move without X and Y stays in place. A
# path that returns to its start is a ring; if no travel follows, another path begins there.

END_WORD = b";End of Gcode"

_NUMBER = rb"(-?[\d.]+)"
_BLOCK = re.compile(
    rb"^(?:;LAYER:(-?\d+)|G([01]) (?=(?:[^\n]*? )??X" + _NUMBER + rb")(?=(?:[^\n]*? )??Y" + _NUMBER + rb"))",
    re.M,
)


def read_paths(text: bytes) -> dict[int, list[Floats]]:
    """Layer as CuraEngine counts to its paths (n, 2) in mm; :class:`BackendFailed` where the text is truncated."""
    if END_WORD not in text[-200:]:
        raise BackendFailed("what CuraEngine wrote is cut: its end code is missing")
    start = text.find(b";LAYER:")
    blocks = np.array(_BLOCK.findall(text, max(start, 0)) if start >= 0 else [], dtype="S").reshape(-1, 4)
    if not len(blocks):
        return {}
    is_layer, is_move = blocks[:, 0] != b"", blocks[:, 1] == b"1"
    # Where each block ends: a layer's comment stays at the place of the block before it.
    places = np.zeros((len(blocks), 2))
    places[~is_layer] = blocks[~is_layer, 2:].astype(np.float64)
    latest = np.maximum.accumulate(np.where(is_layer, 0, np.arange(len(blocks))))
    places = places[latest]
    # A run of moves begins at the place of a layer's comment or of a travel; each return to that place ends a path.
    first = np.maximum.accumulate(np.where(is_move, 0, np.arange(len(blocks))))
    moved = np.flatnonzero(is_move[1:] & (places[1:] != places[:-1]).any(axis=1)) + 1
    if not moved.size:
        return {}
    run_start = places[first[moved]]
    closes = (places[moved] == run_start).all(axis=1)
    begins = np.diff(first[moved], prepend=-1) != 0
    begins[1:] |= closes[:-1]
    at = np.arange(len(moved)) + np.cumsum(begins)
    points = np.empty((len(moved) + np.count_nonzero(begins), 2))
    points[at], points[at[begins] - 1] = places[moved], run_start[begins]
    layers = blocks[is_layer, 0].astype(np.int64)[np.cumsum(is_layer)[moved[begins]] - 1]
    found: dict[int, list[Floats]] = {}
    for layer, path in zip(layers.tolist(), np.split(points, at[begins][1:] - 1), strict=True):
        found.setdefault(layer, []).append(path)
    return found

"""What the record of a plate says of each of its parts: file, place, size, and the metal that the program lays for it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely

from ebamcheck.checks.consumables import KG_MM3
from ebamcheck.checks.text_heat import motion_seconds
from ebamcheck.json_values import plain
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

SAME_MASS = 1e-9  # Of the greater mass: sums in another order


def plate_record(part: Part, config: Config, program: NCProgram | None = None) -> list[dict[str, Any]]:
    """One entry a part of a plate, with its wire and layers where the program is known; none where there is but one part."""
    if not isinstance(part, PlatePart):
        return []
    laid = _laid(part, program, config) if program is not None else [{}] * len(part.members)
    records = []
    for member, of_program in zip(part.members, laid, strict=True):
        mesh = part.member(member)
        found = inspect(mesh)
        records.append(
            {
                "name": member.name,
                "source": member.source,
                "sha256": member.sha256,
                "mesh_sha256": mesh.sha256,
                "units": member.units,
                "units_from": member.units_from,
                "direction": list(member.direction),
                "place_at_mm": list(member.place_at_mm),
                "rotate_deg": member.rotate_deg,
                "lower_mm": mesh.bounds[0].tolist(),
                "upper_mm": mesh.bounds[1].tolist(),
                "verdict": found.verdict,
                "volume_mm3": mesh.volume,
                "part_kg": mesh.volume * KG_MM3 * config.material.density_kg_m3,
                **of_program,
            }
        )
    return records


def member_of(part: PlatePart, points: Floats) -> Ints:
    """Part (N,) to which each of (N, 2) points belongs: the one whose convex outline is nearest."""
    tree = shapely.STRtree(np.array(part.outlines(), object))
    found: Ints = np.asarray(tree.nearest(shapely.points(points)), np.int64)
    return found


def _laid(part: PlatePart, nc: NCProgram, config: Config) -> list[dict[str, Any]]:
    """Mass and layers of the metal that a program lays for each part."""
    seconds = motion_seconds(nc, config)
    rows = np.flatnonzero(nc.wire & nc.deposit & (nc.layer >= 0))
    count = len(part.members)
    if not rows.size:
        return [{"wire_kg": 0.0, "layers": 0}] * count
    # Parts keep apart and their outlines are convex, so that the middle of a chord lies in the outline of its part.
    owner = member_of(part, 0.5 * (nc.start[rows, :2] + nc.end[rows, :2]))
    wire_mm = seconds[rows] * np.nan_to_num(nc.wire_mm_s[rows])
    area_mm2 = math.pi * config.process.wire_diameter_mm**2 / 4.0
    mass_kg = np.bincount(owner, wire_mm, count) * area_mm2 * KG_MM3 * config.material.density_kg_m3
    layers = [len(np.unique(nc.layer[rows[owner == k]])) for k in range(count)]
    return [{"wire_kg": float(mass_kg[k]), "layers": layers[k]} for k in range(count)]


def plate_checks(
    part: Part,
    config: Config,
    program: NCProgram | None,
    recorded: Sequence[Mapping[str, Any]] | None,
    where: str,
) -> list[Check]:
    """Work the entries of a plate out again and hold them against a record; none for a single part."""
    found = plate_record(part, config, program)
    if not found and not recorded:
        return []
    recorded = recorded or []
    faults = (
        []
        if len(found) == len(recorded)
        else [f"{len(recorded)} parts are recorded, the plate has {len(found)}"]
    )
    for entry, said in zip(found, recorded, strict=False):
        faults += [
            f"{entry['name']}: {key} is recorded as {said.get(key)!r}, found {value!r}"
            for key, value in plain(entry).items()
            if not _same(said.get(key), value)
        ]
    text = faults[0] if faults else f"file, place and mass of {len(found)} parts are those recorded"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return [Check("plate", not faults, float(len(faults)), 0.0, "faults", where, text + more)]


def _same(said: Any, found: Any) -> bool:
    if isinstance(found, float) and isinstance(said, int | float):
        return math.isclose(said, found, rel_tol=SAME_MASS, abs_tol=1e-12)
    return bool(said == found)

"""What a build uses up, layer by layer: the wire on the spool and the life of the gun's cathode; also a program's summary, and the
record of a plate's parts.

Wire that ends within a bead leaves a hole under a beam that burns on; a cathode that fails opens the chamber over a hot part. Both
can be replaced at a stop before a layer, if the program has such stops (``machine.optional_stop``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely

from ebamcheck.checks.interpass_checks import motion_seconds
from ebamcheck.json_values import plain
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.timeline import PAUSE
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

SPOOL, CATHODE = "wire on the spool", "life of the cathode"  # Names of the checks
# Of each: words, unit and setting, and what is done before a layer for which it does not last.
WORDS = {
    SPOOL: ("kg of wire, a spool holds", "kg", "machine.spool_kg", "on a new spool"),
    CATHODE: ("h with the beam on, a cathode lasts", "h", "machine.cathode_h", "in a new cathode"),
}
KG_MM3 = 1e-9  # Cubic metres in a cubic millimetre, for densities in kg/m3
HOUR_S = 3600.0
SAME_MASS = 1e-9  # Of the greater mass: sums in another order
TOLD_LAYERS = 6  # Layers that a text names; of more the number


@dataclass(frozen=True)
class Spent:
    """Use of the current spool and cathode by the layers below, and what was put on new before the last of them."""

    wire_kg: float = 0.0
    beam_h: float = 0.0
    new: tuple[str, ...] = ()

    def to_do(self) -> list[str]:
        """What the operator has to do before the last layer, in words."""
        return [f"put {WORDS[name][3]} before this layer" for name in self.new]


@dataclass(frozen=True)
class Consumed:
    """Use of one consumable by a program, and the layers, from 0, before which a new one is needed. It runs out in layer `ends_in`,
    at ``FILE:line`` `where`, unless that is None; `spent` of the first one was used before the program, `in_use` of the last one is
    used when the program is done."""

    name: str
    holds: float
    total: float
    changes: tuple[int, ...]
    ends_in: int | None
    where: str
    spent: float
    in_use: float

    @property
    def unit(self) -> str:
        """Unit of the amounts."""
        return WORDS[self.name][1]

    def check(self) -> Check:
        """Whether what is there lasts from each stop to the next."""
        what, unit, setting, _ = WORDS[self.name]
        by = "layer" if self.spent > 0.0 else "build"
        text = f"the {by} takes {self.total:.4g} {what} {self.holds:g} {unit} ({setting})"
        if self.spent > 0.0:
            text += f", of which the layers below took {self.spent:.4g} {unit}"
        if self.changes:
            text += f"; a new one before layer{'s' if len(self.changes) > 1 else ''} {self.layers()}"
        if self.ends_in is not None:
            text += f"; it ends in layer {self.ends_in + 1}"
        used, lasts = self.spent + self.total, self.ends_in is None
        return Check(self.name, lasts, used, self.holds, unit, self.where, text, self.ends_in)

    def layers(self) -> str:
        """Layers before which a new one is put on, by their numbers in the program."""
        named, more = [str(k + 1) for k in self.changes], len(self.changes) - TOLD_LAYERS
        return ", ".join(named[:TOLD_LAYERS]) + (f" and {more} more" if more > 0 else "")


FRESH = Spent()  # Nothing: a program from the plate up begins with a full spool and a new cathode


def spent_after(found: Sequence[Consumed]) -> Spent:
    """Use of spool and cathode when a program is done; zero for one whose capacity the profile does not give."""
    in_use = {one.name: one.in_use for one in found}
    new = tuple(one.name for one in found if one.changes)
    return Spent(in_use.get(SPOOL, 0.0), in_use.get(CATHODE, 0.0), new)


def consumables_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check that spool and cathode last, each where the profile says how much it holds."""
    return [found.check() for found in consumed(nc, config)]


def consumed(nc: NCProgram, config: Config, spent: Spent = FRESH) -> list[Consumed]:
    """Use by a program of each consumable whose capacity the profile gives.
    With a stop before each layer a new one may be put on before the first, too, if layers below have used the one that is there."""
    machine, found, time_s = config.machine, [], motion_seconds(nc, config)
    before = np.zeros(max(len(nc.layer_files), 1))
    if machine.spool_kg is not None:
        kg_mm = math.pi * config.process.wire_diameter_mm**2 / 4.0 * KG_MM3 * config.material.density_kg_m3
        feeds = nc.wire & (nc.wire_mm_s > 0.0)
        # A motion that never ends, for it has no feed, uses up nothing where no wire runs.
        wire_kg = kg_mm * np.where(feeds, time_s, 0.0) * np.where(feeds, nc.wire_mm_s, 0.0)
        found.append(_used(nc, config, (wire_kg, before), machine.spool_kg, SPOOL, spent.wire_kg))
    if machine.cathode_h is not None:
        beam_h, scan = np.where(nc.beam, time_s, 0.0) / HOUR_S, nc.preheating
        scans_h = before.copy()
        if scan is not None:
            layer, scan_s = np.clip(scan.layer, 0, before.size - 1), motion_seconds(scan, config)
            np.add.at(scans_h, layer, np.where(scan.beam, scan_s, 0.0) / HOUR_S)
        found.append(_used(nc, config, (beam_h, scans_h), machine.cathode_h, CATHODE, spent.beam_h))
    return found


def lasting(checks: Sequence[Check], config: Config, spent: Spent) -> tuple[list[Check], Spent]:
    """Check that spool and cathode last for a layer after those below; `checks` are its own as a program by itself."""
    machine, by_name, found = config.machine, {check.name: check for check in checks}, []
    for name, holds, used in (
        (SPOOL, machine.spool_kg, spent.wire_kg),
        (CATHODE, machine.cathode_h, spent.beam_h),
    ):
        if holds is not None and (alone := by_name.get(name)) is not None:
            changes, ends_in, in_use = _changes([alone.value], holds, machine.optional_stop, used)
            found.append(Consumed(name, holds, alone.value, changes, ends_in, alone.where, used, in_use))
    return [one.check() for one in found], spent_after(found)


def _used(
    nc: NCProgram, config: Config, amounts: tuple[Floats, Floats], holds: float, name: str, spent: float
) -> Consumed:
    """What is used up by motions (B,) and before layers (L,), and where a new one is needed or missing."""
    # An unknown time counts as infinite.
    by_motion, before = amounts
    # A motion between layers is of that before, one before all of the first.
    layer, count = np.maximum.accumulate(np.maximum(nc.layer, 0)).astype(np.int64), before.size
    used = np.where(np.isnan(by_motion), np.inf, by_motion)
    in_layer = before + np.bincount(layer, used, minlength=count)
    changes, ends_in, in_use = _changes(in_layer.tolist(), holds, config.machine.optional_stop, spent)
    where = ""
    if ends_in is not None:
        first = changes[-1] if changes else 0
        since = np.where(layer >= first, used, 0.0).cumsum() + before[first : ends_in + 1].sum()
        since += 0.0 if changes else spent
        rows = np.flatnonzero((layer == ends_in) & (since > holds))
        where = nc.where(int(rows[0])) if rows.size else ""
    return Consumed(name, holds, float(in_layer.sum()), changes, ends_in, where, spent, in_use)


def _changes(
    in_layer: Sequence[float], holds: float, stops: bool, spent: float = 0.0
) -> tuple[tuple[int, ...], int | None, float]:
    """Layers before which a new one is put on, as late as possible; the layer in which it runs out nevertheless; and how much of
    the last is used.

    >>> _changes([3.0, 3.0, 2.0, 4.0], 6.0, stops=True), _changes([3.0, 3.0, 2.0, 4.0], 6.0, stops=False)
    (((2,), None, 6.0), ((), 2, 8.0))
    """
    changes: list[int] = []
    used = spent
    for k, amount in enumerate(in_layer):
        if used + amount > holds and stops and used > 0.0:
            changes.append(k)
            used = 0.0
        used += amount
        if used > holds:
            return tuple(changes), k, used
    return tuple(changes), None, used


def program_summary(nc: NCProgram, config: Config) -> pd.DataFrame:
    """One row a layer: file, Z, motions, lengths (turns are hatch), times of constant feed, waits before and within it, and wire.
    A wait is of the layer of the metal after it; what no metal follows is of the last layer that has any."""
    count, inside, length = len(nc.layer_files), nc.layer >= 0, np.nan_to_num(nc.lengths)
    time = motion_seconds(nc, config)
    area_m2 = math.pi * (config.process.wire_diameter_mm * 1e-3) ** 2 / 4.0
    paused, laid, pause_s = nc.events.named(PAUSE), np.flatnonzero(nc.deposit & inside), np.zeros(count)
    if laid.size:
        following = np.searchsorted(laid, nc.events.row[paused])
        layer = nc.layer[laid[np.minimum(following, laid.size - 1)]]
        pause_s = np.bincount(layer, nc.events.value[paused], minlength=count).astype(np.float64)

    def total(values: Floats, which: Bools | bool = True) -> Floats:
        chosen = inside & which
        return np.bincount(nc.layer[chosen], values[chosen], minlength=count).astype(np.float64)

    wire_mm = total(np.where(nc.wire & nc.deposit, time * np.nan_to_num(nc.wire_mm_s), 0.0))
    return pd.DataFrame(
        {
            "layer": np.arange(count), "file": nc.layer_files, "z_mm": nc.layer_heights,
            "motions": np.bincount(nc.layer[inside], minlength=count),
            "contour_mm": total(length, nc.deposit & (nc.ring >= 0)),
            "hatch_mm": total(length, nc.deposit & (nc.island >= 0)), "travel_mm": total(length, ~nc.deposit),
            "deposit_s": total(time, nc.deposit), "travel_s": total(time, ~nc.deposit), "pause_s": pause_s,
            "wire_mm": wire_mm, "wire_kg": wire_mm * 1e-3 * area_m2 * config.material.density_kg_m3,
        }
    )  # fmt: skip


def plate_record(part: Part, config: Config, program: NCProgram | None = None) -> list[dict[str, Any]]:
    """One entry a part of a plate, with its wire and layers where the program is known; none where there is but one part."""
    if not isinstance(part, PlatePart):
        return []
    laid = _laid(part, program, config) if program is not None else [{}] * len(part.members)
    records = []
    for member, of_program in zip(part.members, laid, strict=True):
        mesh = part.member(member)
        # fmt: off
        records.append({
            "name": member.name, "source": member.source, "sha256": member.sha256, "mesh_sha256": mesh.sha256,
            "units": member.units, "units_from": member.units_from, "direction": list(member.direction),
            "place_at_mm": list(member.place_at_mm), "rotate_deg": member.rotate_deg,
            "lower_mm": mesh.bounds[0].tolist(), "upper_mm": mesh.bounds[1].tolist(), "verdict": inspect(mesh).verdict,
            "volume_mm3": mesh.volume, "part_kg": mesh.volume * KG_MM3 * config.material.density_kg_m3, **of_program,
        })
        # fmt: on
    return records


def member_of(part: PlatePart, points: Floats) -> Ints:
    """Part (N,) to which each of (N, 2) points belongs: the one whose convex outline is nearest."""
    tree = shapely.STRtree(np.array(part.outlines(), object))
    found: Ints = np.asarray(tree.nearest(shapely.points(points)), np.int64)
    return found


def _laid(part: PlatePart, nc: NCProgram, config: Config) -> list[dict[str, Any]]:
    """Mass and layers of the metal that a program lays for each part."""
    rows, count = np.flatnonzero(nc.wire & nc.deposit & (nc.layer >= 0)), len(part.members)
    if not rows.size:
        return [{"wire_kg": 0.0, "layers": 0}] * count
    # Parts keep apart and their outlines are convex, so that the middle of a chord lies in the outline of its part.
    owner = member_of(part, 0.5 * (nc.start[rows, :2] + nc.end[rows, :2]))
    wire_mm = motion_seconds(nc, config)[rows] * np.nan_to_num(nc.wire_mm_s[rows])
    area_mm2 = math.pi * config.process.wire_diameter_mm**2 / 4.0
    mass_kg = np.bincount(owner, wire_mm, count) * area_mm2 * KG_MM3 * config.material.density_kg_m3
    layers = [len(np.unique(nc.layer[rows[owner == k]])) for k in range(count)]
    return [{"wire_kg": float(kg), "layers": n} for kg, n in zip(mass_kg, layers, strict=True)]


def plate_checks(
    part: Part, config: Config, program: NCProgram | None, recorded: Sequence[Mapping[str, Any]] | None, where: str,
) -> list[Check]:  # fmt: skip
    """Work the entries of a plate out again and hold them against a record; none for a single part."""
    found = plate_record(part, config, program)
    if not found and not recorded:
        return []
    recorded = recorded or []
    alike = len(found) == len(recorded)
    faults = [] if alike else [f"{len(recorded)} parts are recorded, the plate has {len(found)}"]
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

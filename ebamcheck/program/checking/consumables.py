"""Checks of what a build uses up: the wire on the spool and the life of the gun's cathode, where the profile tells them.

Wire that ends within a bead leaves a hole under a beam that burns on; a cathode that fails opens the chamber over a hot part. Both
can be replaced at a stop before a layer, if the program has such stops (``machine.optional_stop``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.program.checking.checks import Check
from ebamcheck.program.checking.text_heat import motion_seconds
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

SPOOL, CATHODE = "wire on the spool", "life of the cathode"
"""Names of the checks."""

KG_MM3 = 1e-9
"""Cubic metres in a cubic millimetre, for densities in kg/m3."""

HOUR_S = 3600.0

TOLD_LAYERS = 6
"""Layers that a text names; of more the number."""


@dataclass(frozen=True)
class Consumed:
    """What a program uses up of one thing, and before which layers a new one is needed.

    Parameters
    ----------
    name
        Name of the check.
    what
        Of which the build takes so much, such as ``kg of wire``.
    holder
        Words for what holds it, such as ``a spool holds``.
    unit
        Unit of the figures.
    setting
        Setting that tells how much one holds.
    holds
        How much one holds.
    total
        How much the program uses.
    changes
        Layers, from 0, before which a new one is put on.
    ends_in
        Layer in which it ends before a stop; None where it lasts.
    where
        ``FILE:line`` of the motion in which it ends.
    """

    name: str
    what: str
    holder: str
    unit: str
    setting: str
    holds: float
    total: float
    changes: tuple[int, ...]
    ends_in: int | None
    where: str

    def check(self) -> Check:
        """Whether what is there lasts from each stop to the next."""
        text = f"the build takes {self.total:.4g} {self.what}, {self.holder} {self.holds:g} {self.unit} ({self.setting})"
        if self.changes:
            text += f"; a new one before layer{'s' if len(self.changes) > 1 else ''} {self.layers()}"
        if self.ends_in is not None:
            text += f"; it ends in layer {self.ends_in + 1}"
        lasts = self.ends_in is None
        return Check(self.name, lasts, self.total, self.holds, self.unit, self.where, text, self.ends_in)

    def layers(self) -> str:
        """Layers before which a new one is put on, by their numbers in the program."""
        named = [str(k + 1) for k in self.changes]
        return ", ".join(named[:TOLD_LAYERS]) + (
            f" and {len(named) - TOLD_LAYERS} more" if named[TOLD_LAYERS:] else ""
        )


def consumables_checks(nc: NCProgram, config: Config) -> list[Check]:
    """Check that spool and cathode last, each where the profile says how much it holds."""
    return [found.check() for found in consumed(nc, config)]


def consumed(nc: NCProgram, config: Config) -> list[Consumed]:
    """What a program uses up of the things of which the profile says how much they hold."""
    machine, found = config.machine, []
    if machine.spool_kg is not None:
        area_mm2 = math.pi * config.process.wire_diameter_mm**2 / 4.0
        kg_mm = area_mm2 * KG_MM3 * config.material.density_kg_m3
        feeds = nc.wire & (nc.wire_mm_s > 0.0)
        # A motion that never ends, for it has no feed, uses up nothing where no wire runs.
        wire_kg = (
            kg_mm * np.where(feeds, motion_seconds(nc, config), 0.0) * np.where(feeds, nc.wire_mm_s, 0.0)
        )
        none = np.zeros(max(len(nc.layer_files), 1))
        said = SPOOL, "kg of wire", "a spool holds", "kg", "machine.spool_kg"
        found.append(_used(nc, config, wire_kg, none, machine.spool_kg, said))
    if machine.cathode_h is not None:
        beam_h = np.where(nc.beam, motion_seconds(nc, config), 0.0) / HOUR_S
        said = CATHODE, "h with the beam on", "a cathode lasts", "h", "machine.cathode_h"
        found.append(_used(nc, config, beam_h, _preheating_h(nc, config), machine.cathode_h, said))
    return found


def _preheating_h(nc: NCProgram, config: Config) -> Floats:
    """Time under beam of the preheating before each layer, (L,) h; of one layer at least."""
    result = np.zeros(max(len(nc.layer_files), 1))
    if nc.preheating is not None:
        scan = nc.preheating
        layer = np.clip(scan.layer, 0, result.size - 1)
        np.add.at(result, layer, np.where(scan.beam, motion_seconds(scan, config), 0.0) / HOUR_S)
    return result


def _used(
    nc: NCProgram,
    config: Config,
    by_motion: Floats,
    before: Floats,
    holds: float,
    said: tuple[str, str, str, str, str],
) -> Consumed:
    """What is used up by motions (B,) and before layers (L,), and where a new one is needed or missing.

    `said` are name, words, unit and setting of :class:`Consumed`, in its order. A time that nobody knows is endless.
    """
    layer, count = _layer_of(nc), before.size
    used = np.where(np.isnan(by_motion), np.inf, by_motion)
    in_layer = before + np.bincount(layer, used, minlength=count)
    changes, ends_in = _changes(in_layer.tolist(), holds, config.machine.optional_stop)
    where = ""
    if ends_in is not None:
        first = changes[-1] if changes else 0
        since = np.where(layer >= first, used, 0.0).cumsum() + before[first : ends_in + 1].sum()
        rows = np.flatnonzero((layer == ends_in) & (since > holds))
        where = nc.where(int(rows[0])) if rows.size else ""
    return Consumed(*said, holds, float(in_layer.sum()), changes, ends_in, where)


def _changes(in_layer: Sequence[float], holds: float, stops: bool) -> tuple[tuple[int, ...], int | None]:
    """Layers before which a new one is put on, as late as may be, and the layer in which it ends nevertheless.

    Examples
    --------
    >>> _changes([3.0, 3.0, 2.0, 4.0], 6.0, stops=True)
    ((2,), None)
    >>> _changes([3.0, 3.0, 2.0, 4.0], 6.0, stops=False)
    ((), 2)
    """
    changes: list[int] = []
    left = holds
    for k, amount in enumerate(in_layer):
        if amount > left and stops and k > 0:
            changes.append(k)
            left = holds
        if amount > left:
            return tuple(changes), k
        left -= amount
    return tuple(changes), None


def _layer_of(nc: NCProgram) -> Ints:
    """Layer of each motion (B,); of one between layers that before it, of one before all the first."""
    return np.maximum.accumulate(np.maximum(nc.layer, 0)).astype(np.int64)

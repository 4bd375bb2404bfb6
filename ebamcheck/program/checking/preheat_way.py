"""What the beam does in the preheating subprograms of a program, by its text: its way, piece by piece, before each layer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.balance import HeatColumn
from ebamcheck.program.reading.motions import RAPID, NCProgram
from ebamcheck.program.reading.timeline import Kind
from ebamcheck.scan.heat.preheating import BeamWay, SurfaceHeat, bare_plate
from ebamcheck.scan.plan.preheated import Scanned, scanned, surface_heat
from ebamcheck.settings.config import Config

LONGEST_S = 86400.0
"""A motion or a wait of a scan is simulated for a day at most, and not at all where its feed or its time is negative."""


def scans_of(nc: NCProgram, config: Config) -> dict[int, BeamWay]:
    """Way of the beam before each layer that is preheated, by its index, with waits as pieces that stand still."""
    scans = nc.preheating
    if scans is None:
        return {}
    speed = np.where(scans.kind == RAPID, config.machine.rapid_mm_s, scans.feed_mm_min / 60.0)
    length = np.nan_to_num(scans.lengths)
    with np.errstate(divide="ignore", invalid="ignore"):
        time_s = np.nan_to_num(np.where(length > 0.0, length / speed, 0.0), posinf=0.0)
    time_s = np.clip(time_s, 0.0, LONGEST_S)
    power_w = np.where(scans.beam, np.nan_to_num(scans.power_w), 0.0)
    start, end = np.nan_to_num(scans.start[:, :2]), np.nan_to_num(scans.end[:, :2])
    waits = scans.events.chosen(scans.events.kind == Kind.WAIT)
    layer_of_file = dict(zip(scans.file.tolist(), scans.layer.tolist(), strict=True))
    found = {}
    for layer in np.unique(scans.layer).tolist():
        rows = np.flatnonzero(scans.layer == layer)
        own = np.array([layer_of_file.get(file) == layer for file in waits.file.tolist()], np.bool_)
        at = np.searchsorted(rows, waits.row[own])
        here = end[rows[np.maximum(at - 1, 0)]]
        pause_s = np.clip(waits.value[own], 0.0, LONGEST_S)
        found[int(layer)] = BeamWay(
            np.insert(start[rows], at, here, axis=0),
            np.insert(end[rows], at, here, axis=0),
            np.insert(time_s[rows], at, pause_s),
            np.insert(power_w[rows], at, 0.0),
        )
    return found


def scanned_heat(
    way: BeamWay,
    sections: list[BaseGeometry],
    k: int,
    z_mm: float,
    column: HeatColumn | None,
    config: Config,
    under: BaseGeometry | None = None,
) -> tuple[SurfaceHeat, Scanned] | None:
    """Heat of what is scanned before layer `k` when the beam has gone its way; None where there is nothing to scan.

    `column` is that of what stands, which is not changed; None: the bare plate. `under` is the section of what the lowest layer lies
    on, where that is no plate.
    """
    on = scanned(sections, k, z_mm, config, under)
    if on.region.is_empty or on.body.is_empty:
        return None
    heat = surface_heat(on, bare_plate(on.body, config) if column is None else column.copy(), config)
    heat.simulate(way)
    return heat, on


def begun_column(scans: Mapping[int, BeamWay], lowest: BaseGeometry | None, config: Config) -> HeatColumn:
    """Return the column with which a program begins on the plate: as its text preheats it, cold without."""
    column = HeatColumn(config)
    if config.base_mm == 0.0 and 0 in scans and lowest is not None and not lowest.is_empty:
        found = scanned_heat(scans[0], [lowest], 0, 0.0, None, config)
        if found is not None:
            column.warm_plate = found[0].content_under_region()
    return column

"""Preheating in a plan: how often the plate, or what stands, is scanned before a layer, and the heat that is in it then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.part_heat import PartHeat
from ebamcheck.heat.preheating import (
    BeamWay,
    SurfaceHeat,
    bare_plate,
    layer_region,
    pass_lines,
    plate_of,
    plate_region,
)
from ebamcheck.kernels import Bools, Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import AIM_K, LEAST_REST_S


@dataclass(frozen=True, eq=False)
class Scanned:
    """What is scanned before a layer: the body that takes the heat, the region, and Z of its surface over the plate."""

    body: BaseGeometry
    region: BaseGeometry
    z_mm: float


def scanned(
    sections: Sequence[BaseGeometry], k: int, z_mm: float, config: Config, under: BaseGeometry | None = None
) -> Scanned:
    """Return what is scanned before layer `k`, whose bottom lies at `z_mm`; `sections` (L,) are those of the layers.

    `under` is the section of what the lowest layer lies on; None: the base plate.
    """
    if k == 0 and under is not None:
        return Scanned(under, layer_region(under, z_mm, config), z_mm)
    if k == 0:
        return Scanned(plate_of(sections[0], config), plate_region(sections[0], config), 0.0)
    return Scanned(sections[k - 1], layer_region(sections[k - 1], z_mm, config), z_mm)


def asked_for(k: int, config: Config) -> bool:
    """Whether the settings ask for a scan before a layer of a program, if it is cold."""
    on_plate = k == 0 and config.base_mm == 0.0
    return config.preheat.when == "layers" or (config.preheat.when == "plate" and on_plate)


def preheated(
    part: PartHeat,
    sections: Sequence[BaseGeometry],
    k: int,
    z_mm: float,
    config: Config,
    under: BaseGeometry | None = None,
) -> tuple[PartHeat, int]:
    """Preheat what layer `k` lies on, if the settings ask for it; the heat then, and the passes.

    `z_mm`: Z over the plate of the bottom of the layer; `under`: section of what the lowest layer lies on; None: the base
    plate.
    """
    if not asked_for(k, config) or sections[k].area <= 0.0:
        return part, 0
    on, bare = scanned(sections, k, z_mm, config, under), k == 0 and under is None
    if on.region.is_empty or not (bare or is_cold(part.column, config)):
        return part, 0
    column = bare_plate(on.body, config) if bare else part.column.copy()
    depth_mm = config.process.base_plate_mm + on.z_mm
    body = SurfaceHeat(column, on.body, on.region, depth_mm, config)
    heat, passes, time_s = _simulated(body, on.region, config)
    after = part.copy()
    if bare:
        after.column = HeatColumn(config)
        after.column.warm_plate = heat.content_under_region()
    else:
        after.column = heat.column
        after.field.age(time_s)
    return after, passes


def is_cold(column: HeatColumn, config: Config) -> bool:
    """Whether what stands is colder than the target once its surface has had as long to even out as after a scan."""
    rested = column.copy()
    rested.advance(max(config.preheat.soak_s, LEAST_REST_S))
    return rested.surface_k < config.preheat.target_k


def _simulated(heat: SurfaceHeat, region: BaseGeometry, config: Config) -> tuple[SurfaceHeat, int, float]:
    """Scan until the target is reached when the soak is over, or as often as the settings say."""
    settings, time_s, n = config.preheat, 0.0, 0
    here: Floats | None = None
    while True:
        way = pass_way(*pass_lines(region, config, n), config, here)
        here = way.end[-1] if way.time_s.size else None
        heat.simulate(way)
        time_s, n = time_s + float(way.time_s.sum()), n + 1
        if settings.passes is not None and n < settings.passes:
            continue
        soaked = heat.copy()
        soaked.rest(settings.soak_s)
        if (
            n >= (settings.passes or settings.most_passes)
            or soaked.read().mean_k >= settings.target_k + AIM_K
        ):
            return soaked, n, time_s + settings.soak_s


def pass_way(lines: Floats, joined: Bools, config: Config, here: Floats | None = None) -> BeamWay:
    """Way of the beam in a pass: its lines, what joins them under the beam, and travel between the others, and from `here`."""
    settings = config.preheat
    full_w = settings.current_ma * config.process.voltage_kv
    rows: list[tuple[Floats, Floats, float, float]] = []
    if here is not None and len(lines):
        rows.append(
            (here, lines[0, :2], float(np.hypot(*(lines[0, :2] - here))) / config.machine.rapid_mm_s, 0.0)
        )
    for n, line in enumerate(lines):
        if n:
            before = lines[n - 1]
            length = float(np.hypot(*(line[:2] - before[2:])))
            speed, power_w = (settings.speed_mm_s, full_w) if joined[n] else (config.machine.rapid_mm_s, 0.0)
            rows.append((before[2:], line[:2], length / speed, power_w))
        length = float(np.hypot(*(line[2:] - line[:2])))
        rows.append((line[:2], line[2:], length / settings.speed_mm_s, full_w))
    return BeamWay(
        np.array([row[0] for row in rows], np.float64).reshape(-1, 2),
        np.array([row[1] for row in rows], np.float64).reshape(-1, 2),
        np.array([row[2] for row in rows], np.float64),
        np.array([row[3] for row in rows], np.float64),
    )

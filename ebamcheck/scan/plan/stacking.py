"""Ordered layers become one plan, and are measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.backend import Progress
from ebamcheck.geometry.regions import layer_section
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.scan.filling.schedule import follows
from ebamcheck.scan.islands import clipping as cells
from ebamcheck.scan.order.entries import jumps_mm
from ebamcheck.scan.order.orders import needs_heat
from ebamcheck.scan.plan.columns import LINE_COLUMNS, METRICS, ScanPlan
from ebamcheck.scan.plan.whole_part import OrderedLayer, PowerOf, Stack, ordered_layers
from ebamcheck.settings.config import Config

# Metrics that the heat model of a layer gives; NaN where it was not asked
HEAT = ("body_mean_k", "entry_max_k", "wait_s", "ring_wait_s", "power_share", "enter_k", "leave_k")


def stack_plans(planned: Sequence[OrderedLayer], config: Config, order: str, seed: int) -> ScanPlan:
    """Join layers into one plan and measure it."""
    base = np.cumsum([0] + [len(p.laid.islands) for p in planned])
    islands = _joined([p.laid.islands for p in planned], np.zeros(0, object))
    by_layer = list(zip(planned, base[:-1], strict=True))
    start, end = (_joined([getattr(p.lines, at) for p in planned], np.zeros((0, 2))) for at in ("start", "end"))
    x, y = (end - start).T
    lines = np.column_stack([start, end, np.degrees(np.arctan2(y, x)) % 360.0])
    vectors = pd.DataFrame(lines, columns=list(LINE_COLUMNS))
    vectors.insert(0, "island", _joined([p.lines.island + b for p, b in by_layer], np.zeros(0, np.int64)))

    def waits_s(name: str) -> Floats:
        waits = [np.zeros(len(p.order)) if p.heat is None else getattr(p.heat, name) for p in planned]
        return _joined(waits, np.zeros(0))

    plan = ScanPlan(
        heights=np.array([p.laid.height_mm for p in planned], np.float64),
        contours=cells.column([p.laid.regions.contour for p in planned]),
        sections=cells.column([p.laid.regions.section for p in planned]),
        islands=islands,
        # A plan of one layer is layer 0 of its own stack, whatever its index in the part.
        island_layer=np.repeat(np.arange(len(planned)), np.diff(base)).astype(np.int64),
        island_kind=_joined([p.laid.kind for p in planned], np.zeros(0, np.str_)),
        island_area_mm2=np.asarray(shapely.area(islands), np.float64),
        island_centroid=_joined([p.laid.centroid for p in planned], np.zeros((0, 2))),
        neighbours=_joined([p.laid.neighbours + b for p, b in by_layer], np.zeros((0, 2), np.int64)),
        border_mm=_joined([p.laid.border_mm for p in planned], np.zeros(0)),
        order=_joined([p.order + b for p, b in by_layer], np.zeros(0, np.int64)),
        vectors=vectors,
        metrics=pd.DataFrame(columns=list(METRICS)),
        settings={
            "order": order,
            "seed": seed,
            "scan": config.scan.model_dump(mode="json", exclude={"order", "seed"}),
            "bead_width_mm": config.process.bead_width_mm,
            "bead_spacing": config.process.bead_spacing,
            "travel_speed_mm_s": config.process.travel_speed_mm_s,
            "rapid_mm_s": config.machine.rapid_mm_s,
        },
        island_wait_s=waits_s("island_wait_s"),
        inner_wait_s=waits_s("inner_wait_s"),
    )
    return replace(plan, metrics=_measured(plan, planned, config))


def _joined(columns: Sequence[NDArray[Any]], empty: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate(columns) if columns else empty


def _measured(plan: ScanPlan, planned: Sequence[OrderedLayer], config: Config) -> pd.DataFrame:
    """One row a layer, as :data:`METRICS` says."""
    simulated = simulate_order(plan, config)
    end = np.full(len(plan.islands), np.nan)
    end[simulated["island"]] = simulated["end_s"]
    interval = np.abs(end[plan.neighbours[:, 0]] - end[plan.neighbours[:, 1]])
    pair_layer = plan.island_layer[plan.neighbours[:, 0]]
    of_layer = simulated["layer"].to_numpy()

    def total(values: pd.Series) -> Floats:
        return np.bincount(of_layer, values.to_numpy(np.float64), minlength=len(planned)).astype(np.float64)

    length, turn = total(simulated["length_mm"]), total(simulated["turn_mm"])
    travel = total(simulated["travel_mm"] + simulated["inner_travel_mm"])
    spread = [interval[pair_layer == k] for k in range(len(planned))]
    spread = [values[np.isfinite(values)] for values in spread]
    area = np.array([p.laid.regions.section.area for p in planned], np.float64)
    contour = np.array([p.laid.regions.contour.length for p in planned], np.float64)
    laid_mm2 = (contour + length + turn) * config.process.hatch_spacing_mm
    values: dict[str, Any] = {
        "layer": [p.laid.layer for p in planned],
        "height_mm": plan.heights,
        "side_mm": [p.laid.side_mm for p in planned],
        "islands": [len(p.laid.islands) for p in planned],
        "area_mm2": area,
        "covered_fraction": [p.laid.covered for p in planned],
        "widest_gap_mm": [p.laid.widest_gap_mm for p in planned],
        "laid_share": np.divide(laid_mm2, area, out=np.zeros_like(area), where=area > 0),
        "contour_length_mm": contour,
        "hatch_length_mm": length,
        "turn_length_mm": turn,
        "travel_mm": travel,
        "starts": total(simulated["starts"]).astype(np.int64),
        "time_s": (length + turn) / config.process.travel_speed_mm_s + travel / config.machine.rapid_mm_s,
        "interval_p10_s": [float(np.quantile(v, 0.1)) if v.size else math.nan for v in spread],
        "interval_min_s": [float(v.min()) if v.size else math.nan for v in spread],
        **{name: [math.nan if p.heat is None else p.heat.figures[name] for p in planned] for name in HEAT},
    }
    if config.preheat.when != "off":
        values["preheat_passes"] = [0 if p.heat is None else p.heat.preheat_passes for p in planned]
    return pd.DataFrame(values, columns=[*METRICS, *(name for name in values if name not in METRICS)])


def plan_scan(
    polygons: BaseGeometry | Iterable[BaseGeometry],
    config: Config | None = None,
    order: str | None = None,
    seed: int | None = None,
    layer: int = 0,
    height_mm: float = 0.0,
) -> ScanPlan:
    """Plan one layer: divide it into islands, fill them and put them in order.

    Parameters
    ----------
    polygons
        Solid regions of the layer as shapely geometries, mm; overlapping ones unite, invalid ones are
        made valid. No polygon gives a plan without islands.
    config, order, seed
        Settings, the default ones if None; name of the order (an entry point of ``ebamcheck.orders``) and seed of its
        random choices, those of the settings if None.
    layer, height_mm
        Index of the layer, which turns and shifts hatch and cells, and seeds the start; its height over the base plate.

    Returns
    -------
    ScanPlan
        Islands, their order, hatch lines in mm, and metrics, as of a stack of one layer.

    Raises
    ------
    SettingsError, GeometryError
        If the order is unknown, or the hexagons are far too small for the layer; if a coordinate is not finite.

    Examples
    --------
    >>> import shapely
    >>> plan = plan_scan(shapely.box(0, 0, 200, 80))
    >>> sorted(plan.order.tolist()) == list(range(len(plan.islands)))
    True
    """
    config = config or Config()
    name, number = order or config.scan.order, config.scan.seed if seed is None else seed
    stack = Stack([layer_section(polygons)], np.array([height_mm], np.float64), [layer])
    asked = needs_heat(name)
    planned = ordered_layers(stack, config, name, number, asked and config.scan.carry_heat, asked)
    return stack_plans(list(planned), config, name, number)


def plan_stack(
    layers: Layers,
    config: Config | None = None,
    progress: Progress | None = None,
    order: str | None = None,
    seed: int | None = None,
    power_of: PowerOf | None = None,
    contours: Sequence[BaseGeometry] | None = None,
) -> ScanPlan:
    """Plan a stack of layers, each as :func:`plan_scan` does, on all threads; open paths bound no region and are not filled.

    An order that asks the heat model begins each layer with the heat that those under it have left, unless `scan.carry_heat` is
    off. Whatever the order, each layer is simulated for its power and waits, unless `process.interpass` is off. `power_of` gives
    the power along beads by their wire (:func:`ebamcheck.pipeline.stages.power_by_wire`); without it each has that of its layer.
    `contours` are the regions of the contour beads, if known."""
    config = config or Config()
    name, number = order or config.scan.order, config.scan.seed if seed is None else seed
    # Layers are cut at half their height: the part stands on the plate half a layer under the lowest cut.
    plate_mm = float(layers.heights.min(initial=np.inf)) - 0.5 * config.layer_height_mm
    sections = [layers.section(k) for k in range(len(layers))]
    stack = Stack(sections, layers.heights, range(len(layers)), plate_mm, contours)
    carry = config.scan.carry_heat and needs_heat(name)
    simulated = config.process.interpass != "off" or config.preheat.when != "off"
    planned = []
    for done in ordered_layers(stack, config, name, number, carry, simulated, power_of):
        planned.append(done)
        if progress is not None:
            progress(1)
    return stack_plans(planned, config, name, number)


def scheduled(plan: ScanPlan, config: Config) -> pd.DataFrame:
    """Lines of a plan with their `length_mm`, turn and jump before each with the beam on and off, `turn_mm` and `jump_mm`, whether
    each begins a `new_layer`, and when it is driven, `begin_s` and `end_s`, every layer from time 0."""
    table = plan.vectors
    island = table["island"].to_numpy()
    start, end = table[["x0", "y0"]].to_numpy(), table[["x1", "y1"]].to_numpy()
    length = np.hypot(*(end - start).T)
    new_layer = np.diff(plan.island_layer[island], prepend=-1) != 0
    option = jumps_mm(start, end, new_layer)
    on = follows(island, start, end, config.process.hatch_spacing_mm)
    turn, jump = np.where(on, option, 0.0), np.where(on, 0.0, option)
    laying = length / config.process.travel_speed_mm_s
    to_it = turn / config.process.travel_speed_mm_s + jump / config.machine.rapid_mm_s
    total = np.cumsum(laying + to_it)
    group = np.cumsum(new_layer) - 1
    offset = (total - laying)[new_layer][group] if len(length) else total
    driven = {"length_mm": length, "turn_mm": turn, "jump_mm": jump, "new_layer": new_layer}
    return table.assign(**driven, begin_s=total - offset - laying, end_s=total - offset)


def simulate_order(plan: ScanPlan, config: Config) -> pd.DataFrame:
    """Simulate a plan: lines and turns at travel speed, jumps at rapid speed, every layer from time 0, without contour beads and
    pauses.

    One row an island, in scan order: `island`, `layer`, `rank` in its layer, `start_s` (beam on its first line), `end_s`,
    `travel_mm` (jump before it), `inner_travel_mm` (jumps between its lines), `length_mm` of them, `turn_mm` of the turns between,
    `starts` of the wire; NaN times without lines."""
    driven = {str(name): values.to_numpy() for name, values in scheduled(plan, config).items()}
    island, jump = driven["island"], driven["jump_mm"]
    first, last = (np.flatnonzero(np.diff(island, **side) != 0) for side in ({"prepend": -1}, {"append": -1}))
    count, order = len(plan.order), plan.order
    start_s, end_s, before = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)
    start_s[island[first]], end_s[island[first]] = driven["begin_s"][first], driven["end_s"][last]
    before[island[first]] = jump[first]
    inner = jump.copy()
    inner[first] = 0.0

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(island, values, minlength=count)[order], np.float64)

    return pd.DataFrame(
        {
            "island": order,
            "layer": plan.island_layer[order],
            "rank": np.arange(count) - np.searchsorted(plan.island_layer, plan.island_layer[order]),
            "start_s": start_s[order],
            "end_s": end_s[order],
            "travel_mm": before[order],
            "inner_travel_mm": total(inner),
            "length_mm": total(driven["length_mm"]),
            "turn_mm": total(driven["turn_mm"]),
            "starts": total((jump > 0) | driven["new_layer"]).astype(np.int64),
        }
    )

"""Plan layers: section -> islands and their lines -> order -> path."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.backend import Progress
from ebamcheck.geometry.regions import layer_section
from ebamcheck.layers.stack import Layers
from ebamcheck.scan.order.orders import needs_heat
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.stacking import in_order, stack_plans
from ebamcheck.scan.plan.whole_part import PowerOf, Stack, ordered_layers
from ebamcheck.settings.config import Config


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
    config
        Settings; the default ones if None.
    order, seed
        Name of the order (see :data:`ebamcheck.scan.ORDERS`) and seed of its random choices; those of
        the settings if None.
    layer
        Index of the layer, which turns and shifts the hatch and the cells, and seeds the start.
    height_mm
        Its height over the base plate.

    Returns
    -------
    ScanPlan
        Islands, their order, hatch lines in mm, and metrics, as of a stack of one layer.

    Raises
    ------
    SettingsError
        If the order is unknown, or the hexagons are far too small for the layer.
    GeometryError
        If a coordinate is not finite.

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
    carry = asked and config.scan.carry_heat
    planned = ordered_layers(stack, config, name, number, carry=carry, simulated=asked)
    return stack_plans([in_order(done) for done in planned], config, name, number)


def plan_stack(
    layers: Layers,
    config: Config | None = None,
    progress: Progress | None = None,
    order: str | None = None,
    seed: int | None = None,
    power_of: PowerOf | None = None,
) -> ScanPlan:
    """Plan a stack of layers, each as :func:`plan_scan` does, on all threads.

    An order that asks the heat model begins each layer with the heat that those under it have left, unless
    `scan.carry_heat` is off. Whatever the order, each layer is simulated with that heat for its power and waits, unless
    `process.interpass` is off.

    Parameters
    ----------
    layers
        Contours; open paths bound no region and are not filled.
    progress
        Called with the number of layers done since the last call.
    config, order, seed
        As for :func:`plan_scan`.
    power_of
        Gives the power along beads by the wire that they get, see :func:`ebamcheck.pipeline.stages.power_by_wire`;
        None: the heat is worked out as if each bead had the power of its layer.
    """
    config = config or Config()
    name, number = order or config.scan.order, config.scan.seed if seed is None else seed
    # Layers are cut at half their height: the part stands on the plate half a layer under the lowest cut.
    plate_mm = float(layers.heights.min(initial=np.inf)) - 0.5 * config.layer_height_mm
    sections = [layers.section(k) for k in range(len(layers))]
    stack = Stack(sections, layers.heights, range(len(layers)), plate_mm)
    carry = config.scan.carry_heat and needs_heat(name)
    simulated = config.process.interpass != "off" or config.preheat.when != "off"
    planned = []
    for done in ordered_layers(stack, config, name, number, carry, simulated, power_of):
        planned.append(in_order(done))
        if progress is not None:
            progress(1)
    return stack_plans(planned, config, name, number)

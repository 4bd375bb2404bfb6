"""A second opinion on the heat of plans: the nonlinear referee, and whether it ranks islands as the linear model does."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.heat.referee import Referee, Verdict, judged, referee
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.comparing import OrderResult
from ebamcheck.scan.plan.laying import LaidLayer
from ebamcheck.scan.plan.times import beam_lines, simulate_order
from ebamcheck.settings.config import Config

CELLS_PER_ISLAND = 4.0
"""Cells of the referee across an island."""


OPINION = {
    "referee_max_k": "greatest mean temperature rise of an island at entry, by the referee",
    "referee_point_max_k": "greatest temperature rise of the spot where the beam enters an island, by the referee",
    "referee_tau": "Kendall's rank correlation of the islands' rises at entry, linear model against referee",
}
"""Figures of a second opinion and what they are."""


def second_opinion(model: Referee, result: OrderResult, config: Config) -> dict[str, float]:
    """Simulate a compared order on the referee as well.

    Parameters
    ----------
    model
        Referee of the layer, from :func:`referee_of`.
    result
        The order as the linear model drove it.
    config
        Settings of both.

    Returns
    -------
    dict
        Figures as :data:`OPINION` names them, K; the correlation is NaN where fewer than two islands are warmed before
        they are entered.
    """
    # Half a second to load, for those who compare orders.
    from scipy.stats import kendalltau

    islands_k, spots_k = refereed_entries(model, result.plan, config)
    warmed = (result.rank > 0) & np.isfinite(islands_k)
    enough = int(warmed.sum()) > 1
    tau = float(kendalltau(result.entry_k[warmed], islands_k[warmed]).statistic) if enough else math.nan
    return {
        "referee_max_k": float(np.nanmax(islands_k)),
        "referee_point_max_k": float(np.nanmax(spots_k)),
        "referee_tau": tau,
    }


def referee_of(laid: LaidLayer, config: Config, cells_per_island: float = CELLS_PER_ISLAND) -> Referee:
    """Set up the referee of a layer that has islands."""
    section = laid.regions.section
    width_mm = math.sqrt(section.area / len(laid.islands))
    return referee(section, config, laid.height_mm, width_mm / cells_per_island)


def refereed_entries(model: Referee, plan: ScanPlan, config: Config) -> tuple[Floats, Floats]:
    """Temperature rise of each island, and of a spot as wide as a bead where the beam enters it, (I,) K; NaN without lines."""
    first = plan.vectors.drop_duplicates("island")
    island = first["island"].to_numpy()
    spots = shapely.buffer(
        shapely.points(first[["x0", "y0"]].to_numpy(np.float64)), 0.5 * config.process.bead_width_mm
    )
    entered_s, count = _entered_s(plan, config), len(plan.islands)
    read = np.concatenate([plan.islands, spots])
    entry_k = _simulated(model, plan, config, read, np.concatenate([entered_s, entered_s[island]])).entry_k
    point_k = np.full(count, np.nan)
    point_k[island] = entry_k[count:]
    return entry_k[:count], point_k


def _entered_s(plan: ScanPlan, config: Config) -> Floats:
    """Time at which each island of a plan is entered, (I,); 0 for those without lines."""
    simulated = simulate_order(plan, config).sort_values("island")
    return np.asarray(simulated["start_s"].fillna(0.0).to_numpy(np.float64), np.float64)


def _simulated(
    model: Referee, plan: ScanPlan, config: Config, read: NDArray[np.object_], entered_s: Floats
) -> Verdict:
    """Simulate a plan of one layer from cold and read the temperatures of polygons, each at its time."""
    ends, begin_s, end_s = beam_lines(plan, config)
    return judged(
        model,
        model.cold(),
        ends,
        begin_s,
        end_s,
        config.process.power_w * config.material.absorptivity,
        read,
        entered_s,
        float(end_s[-1]) if len(end_s) else 0.0,
    )

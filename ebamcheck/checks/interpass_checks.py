"""Checks of what keeps the part cool: waits and power of each layer, and how hot it is where a bead is entered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.bead_end_checks import ramp_power
from ebamcheck.checks.checks import PRINTED, VALUE_SHARE, count_check, event_faults
from ebamcheck.checks.heat_again import MODELS_K, BeadHeat, entries_k, highest_entry_k, may_differ_k
from ebamcheck.checks.text_heat import TextBeads, sections_of_text, text_beads, text_bed_k, text_shapes
from ebamcheck.checks.value_checks import melting_check, own_shares
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.medium import scheduled_share
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.conventions import power_slack_w
from ebamcheck.nc.inputs import Interpass
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.timeline import Kind
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

INTERPASS, AGAIN = "interpass temperature", "balance of the heat"  # Names of two checks
# Share of the limit's rise, and kelvins below it, under which a layer has room for more power, and the step of the power: the balance of
# a text, which knows one temperature a section, and the plan differ by less (by 64 K at most, of 50 parts and settings).
ROOM, ROOM_K, PERCENT = 0.85, 80.0, 0.01
OVER_RANGE = "over the model's range: metal would boil"  # Of a figure clipped to the boiling point
COLD = "least entry temperature"  # Name of the check
# Share of the rise over the chamber that a wait leaves at least, of that of the limit, or of the bead before where that is less. Plans
# wait for the hottest place of a section, so that its mean is lower: 0.66 of the limit's rise at least, of eleven sections and settings,
# 0.82 in the demo part. There, two minutes too many leave 0.66 to 0.70, five leave 0.51 to 0.56.
WARM_SHARE = 0.6


def wait_check(nc: NCProgram, config: Config, heat: Interpass | None) -> Check:
    """Check the waits before layers, contours, islands and further beads: exactly those of the plan; without one the least between layers."""
    beads = text_beads(nc, config)
    least_s = config.process.layer_pause_s
    first = beads.enters_layer & (np.arange(len(beads)) > 0)
    faults = [(nc.where_event(event), what) for event, what in beads.stray]
    events, longest_s = nc.events, config.process.longest_wait_s
    out = (events.kind == Kind.WAIT) & ~((events.value >= 0.0) & (events.value <= longest_s))
    what = f"waits {{value:g}} s, a wait is from 0 to {longest_s:g} s (process.longest_wait_s)"
    faults += event_faults(nc, (out, what))
    if heat is None:
        wanted = np.where(first, least_s, 0.0)
        bad = beads.wait_s < wanted - PRINTED
        if config.process.interpass in ("off", "power"):
            bad |= beads.wait_s > wanted + PRINTED
    else:
        wanted = np.where(beads.ring >= 0, _of(heat.ring_wait_s, beads.layer), 0.0)
        inner = beads.island >= 0
        wanted[inner] = _of(heat.island_wait_s, beads.island[inner])
        wanted[beads.inner] = _of(heat.inner_wait_s, beads.island[beads.inner])
        wanted[first] = _of(heat.wait_s, beads.layer[first]) + np.where(inner, wanted, 0.0)[first]
        wanted[:1] = np.where(inner, wanted, 0.0)[:1]
        bad = np.abs(beads.wait_s - wanted) > PRINTED
    for n in np.flatnonzero(bad).tolist():
        what = f"waits {beads.wait_s[n]:g} s before {beads.named(n)} in place of {wanted[n]:g} s"
        faults.append((nc.where(int(beads.row[n])), what))
    within = float(beads.wait_s[~first].sum())
    good = f"waits {beads.wait_s[first].sum():.6g} s between layers and {within:.6g} s within them"
    return count_check("layer pause", faults, good)


def heat_checks(
    nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None, before: HeatColumn | None = None,
    witness: Sequence[BaseGeometry] | None = None,
) -> list[Check]:  # fmt: skip
    """Check that the power of each layer melts its wire, and the temperature at which beads are entered.

    Without `sections` those count that the contours enclose; `witness` are those of the second balance. On a part that is half built, heat
    `before` the program has to be known: nothing in its text tells how warm the part is."""
    known = sections_of_text(nc, config, sections)
    beads, shapes = text_beads(nc, config), text_shapes(nc, config, known)
    melting = melting_check(nc, config, ramp_power(nc, np.flatnonzero(nc.deposit), config)[1] > 0.0)
    if before is None and config.base_mm > 0.0:
        return [melting]
    bed_k, _ = text_bed_k(beads, config, shapes, before, known[0] if known else None)
    checked = beads.enters_layer if config.process.interpass_at == "layer" else np.ones(len(beads), np.bool_)
    entries = _entries(nc, beads, bed_k, checked, config)
    checks = [melting, entries, cold_check(nc, beads, bed_k, checked, config)]
    own = sections_of_text(nc, config, witness or sections)
    if before is None and not beads.scans and own:
        checks.append(_again(nc, beads, own, config))
    return checks


def layer_shares(nc: NCProgram, config: Config) -> Floats:
    """Share of the power in each layer, (L,): that of its strongest motion whose own wire asks for less; NaN where it lays nothing.

    Where every bead has the power that its own wire needs, the least of them; ramps tell only where there is nothing else."""
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    share = nc.power_w[rows] / config.process.power_w
    slack = power_slack_w(config.machine, config.process.voltage_kv, config.process.current_ma)
    own = own_shares(nc, rows, config) * (1.0 + VALUE_SHARE) + slack / config.process.power_w
    along, step = ramp_power(nc, rows, config)
    count, layer = len(nc.layer_files), nc.layer[rows]
    shares, on_ramps, least = np.full(count, -np.inf), np.full(count, -np.inf), np.full(count, np.inf)
    plain = ~(share <= own)
    np.fmax.at(shares, layer[plain & (step == 0.0)], share[plain & (step == 0.0)])
    np.fmax.at(on_ramps, layer[plain], share[plain] / along[plain])
    np.fmin.at(least, layer, share)
    shares = np.where(np.isinf(shares), on_ramps, shares)
    shares = np.where(np.isinf(shares), least, shares)
    return np.where(np.isinf(shares), np.nan, shares)


def scheduled_shares(heights: ArrayLike | None, config: Config) -> Floats | None:
    """Share of the power of each layer, (L,), of cuts at `heights` (L,), where the settings have a table of it; None where the heat decides."""
    cuts = np.asarray(() if heights is None else heights, np.float64)
    if isinstance(config.process.power_schedule, str) or not cuts.size:
        return None
    plate_mm = float(cuts.min()) - 0.5 * config.layer_height_mm
    return np.array([scheduled_share(config, float(z) - plate_mm) for z in cuts], np.float64)


def shares_of_text(nc: NCProgram, config: Config, sections: Sequence[BaseGeometry] | None) -> Floats:
    """Share of the power that each layer is to have where no plan is known, (L,): its own, but full where nothing asks for less.

    Power is taken back only where a bead would else be entered above the limit."""
    shares = np.minimum(layer_shares(nc, config), 1.0)
    # How warm it is what stands under a program, its text does not tell: only the melting of the wire is left to check.
    if config.process.power_schedule != "taper" or config.base_mm > 0.0:
        return shares
    if config.process.interpass not in ("power", "both"):
        return np.where(np.isnan(shares), np.nan, 1.0)
    beads = text_beads(nc, config)
    if not len(beads) or not np.isfinite(beads.time_s).all():
        return shares
    known = sections_of_text(nc, config, sections)
    bed_k, _ = text_bed_k(beads, config, text_shapes(nc, config, known), lowest=known[0] if known else None)
    hottest_k = np.full(shares.size, -np.inf)
    np.maximum.at(hottest_k, beads.layer, bed_k - config.process.ambient_temperature_k)
    rise_k = highest_entry_k(config) - config.process.ambient_temperature_k
    allowed_k = min(ROOM * rise_k, rise_k - ROOM_K)
    # The balance spreads heat over all of a section. Pieces that do not touch, as parts of a plate, keep theirs: the least of them that
    # is no mere spot may be as much hotter as it is smaller, but takes no more than its share of the layer's.
    for k, section in enumerate(known):
        pieces = shapely.area(shapely.get_parts(section))
        pieces = pieces[pieces >= config.process.bead_width_mm**2]
        hottest_k[k] *= min(pieces.sum() / pieces.min(), pieces.size) if pieces.size else 1.0
    # What lies below does not get hotter with the layer's own power: all of it counts as if it did.
    with np.errstate(divide="ignore", invalid="ignore"):
        could_have_more = hottest_k * (shares + PERCENT) / shares < allowed_k
    return np.where(could_have_more, 1.0, shares)


def _of(values: Floats, number: Ints) -> Floats:
    """Values (n,) of layers or islands by their number; 0 for those that the plan does not know."""
    known = (number >= 0) & (number < values.size)
    result = np.zeros(number.size)
    result[known] = values[number[known]]
    return result


def _entries(nc: NCProgram, beads: TextBeads, bed_k: Floats, checked: Bools, config: Config) -> Check:
    """Temperature of the surface when a bead is entered, by the balance, against the limit."""
    limit_k = highest_entry_k(config)
    if not checked.any():
        return Check(INTERPASS, True, 0.0, limit_k, "K", "", "nothing is laid")
    rows = np.flatnonzero(checked)
    worst = int(rows[np.argmax(bed_k[rows])])
    figure_k, mark = within_range(float(bed_k[worst]), config)
    over = int((bed_k[rows] > limit_k).sum())
    text = (
        f"surface at {figure_k:.0f} K{mark} when {beads.named(worst)} is entered, by the balance of the heat"
    )
    if over:
        text += f"; {over} of {rows.size} entries are over {limit_k:.0f} K"
    return Check(INTERPASS, not over, figure_k, limit_k, "K", nc.where(int(beads.row[worst])), text)


def _again(nc: NCProgram, beads: TextBeads, sections: Sequence[BaseGeometry], config: Config) -> Check:
    """The same temperature by a second balance, against the limit and what two of them may differ by."""
    ambient_k, limit_k = config.process.ambient_temperature_k, highest_entry_k(config)
    most_k = limit_k + may_differ_k(config)
    heat_j = beads.energy_j * config.material.absorptivity
    heat = BeadHeat(beads.layer, beads.move_s + beads.wait_s, beads.time_s, heat_j)
    if not len(beads):
        return Check(AGAIN, True, 0.0, most_k, "K", "", "nothing is laid")
    steps = np.diff(nc.layer_heights, prepend=config.base_mm)
    bed_k = entries_k(heat, sections, np.where(steps > 0.0, steps, config.layer_height_mm), config)
    if config.process.interpass_at == "layer":
        bed_k = np.where(beads.enters_layer, bed_k, ambient_k)
    bead = int(np.argmax(bed_k))
    figure_k, mark = within_range(float(bed_k[bead]), config)
    text = (
        f"surface at {figure_k:.0f} K{mark} when {beads.named(bead)} is entered, by a second balance of the heat; "
        f"{limit_k:.0f} K is the limit, and {most_k - limit_k:.0f} K more is what balances may differ by"
    )
    where = nc.where(int(beads.row[bead]))
    return Check(AGAIN, bool(bed_k[bead] <= most_k), figure_k, most_k, "K", where, text)


def within_range(temperature_k: float, config: Config) -> tuple[float, str]:
    """Temperature clipped to the boiling point, and the mark of one that was over it."""
    boiling_k = config.material.boiling_k
    return (temperature_k, "") if temperature_k <= boiling_k else (boiling_k, f" ({OVER_RANGE})")


def least_entries_k(beads: TextBeads, bed_k: Floats, config: Config) -> Floats:
    """Least temperature at which each bead may be entered, (P,) K: the one that is set, else by its wait; -inf where there is none.

    A bead that is waited for longer than `process.layer_pause_s`, without preheating, may be as cold as :data:`WARM_SHARE` allows, or as two
    balances of the heat differ."""
    process = config.process
    if process.least_entry_temperature_k is not None:
        return np.full(len(beads), process.least_entry_temperature_k)
    ambient_k = process.ambient_temperature_k
    before_k = np.concatenate([[ambient_k], bed_k[:-1]])[: len(beads)]
    warm_k = np.minimum(before_k, highest_entry_k(config)) - ambient_k
    least_k = ambient_k + np.minimum(WARM_SHARE * warm_k, warm_k - MODELS_K)
    asked_s = np.where(beads.enters_layer, process.layer_pause_s, 0.0)
    preheated = beads.enters_layer & np.isin(beads.layer, list(beads.scans))
    waited = (beads.wait_s > asked_s + PRINTED) & ~preheated
    return np.where(waited, least_k, -np.inf)


def cold_check(nc: NCProgram, beads: TextBeads, bed_k: Floats, checked: Bools, config: Config) -> Check:
    """Temperature of the surface when beads are entered, by the balance of the text, against the least, where it is to be `checked` (P,).

    What waits longer is entered colder than the power is tapered for, and fuses worse with what lies under it."""
    least_k = np.where(checked, least_entries_k(beads, bed_k, config), -np.inf)
    if not np.isfinite(least_k).any():
        return Check(COLD, True, 0.0, 0.0, "K", "", "no bead is waited for longer than the settings ask")
    over_k = bed_k - least_k
    worst, under = int(np.argmin(over_k)), int((over_k < 0.0).sum())
    text = (
        f"surface at {bed_k[worst]:.0f} K when {beads.named(worst)} is entered after a wait of {beads.wait_s[worst]:g} s; "
        f"{least_k[worst]:.0f} K is the least"
    )
    if under:
        text += f"; {under} of {len(beads)} entries are under theirs"
    where = nc.where(int(beads.row[worst]))
    return Check(COLD, not under, float(bed_k[worst]), float(least_k[worst]), "K", where, text)

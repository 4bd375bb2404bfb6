"""Whether waits leave the metal warm enough: the lower end of the window of entry temperatures.

Power and waits are planned for metal that is entered near the limit. What waits longer is entered colder than the power is
tapered for, and fuses worse with what lies under it.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.program.checking.checks import Check
from ebamcheck.program.checking.heat_again import MODELS_K, highest_entry_k
from ebamcheck.program.checking.text_heat import TextBeads
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

COLD = "least entry temperature"
"""Name of the check."""

WARM_SHARE = 0.6
"""Share of the rise over the chamber that a wait leaves at least, of that of the limit, or of the bead before where that is less.
Plans wait for the hottest place of a section, so that its mean is lower: 0.66 of the limit's rise at least, of eleven sections and
settings, 0.82 in the demo part. There, two minutes too many leave 0.66 to 0.70, five leave 0.51 to 0.56."""

WAITED_S = 1e-6
"""A wait that is longer than the settings ask for by less is theirs: decimals of a process value."""


def least_entries_k(beads: TextBeads, bed_k: Floats, config: Config) -> Floats:
    """Least temperature at which each bead may be entered, (P,) K; -inf where there is none.

    Where `process.least_entry_temperature_k` is set, that. Else a bead that is waited for longer than `process.layer_pause_s` asks,
    and that no preheating comes before, may not be colder than :data:`WARM_SHARE` allows; two balances of the heat may
    differ by :data:`~ebamcheck.program.checking.heat_again.MODELS_K`, so that by so much any wait may cool.
    """
    process = config.process
    if process.least_entry_temperature_k is not None:
        return np.full(len(beads), process.least_entry_temperature_k)
    ambient_k = process.ambient_temperature_k
    before_k = np.concatenate([[ambient_k], bed_k[:-1]])[: len(beads)]
    warm_k = np.minimum(before_k, highest_entry_k(config)) - ambient_k
    least_k = ambient_k + np.minimum(WARM_SHARE * warm_k, warm_k - MODELS_K)
    return np.where(_waited(beads, config), least_k, -np.inf)


def _waited(beads: TextBeads, config: Config) -> Bools:
    """Which beads (P,) are waited for longer than the settings ask, with no preheating after the wait."""
    asked_s = np.where(beads.enters_layer, config.process.layer_pause_s, 0.0)
    preheated = beads.enters_layer & np.isin(beads.layer, list(beads.scans))
    return np.asarray((beads.wait_s > asked_s + WAITED_S) & ~preheated)


def cold_check(nc: NCProgram, beads: TextBeads, bed_k: Floats, checked: Bools, config: Config) -> Check:
    """Temperature of the surface when beads are entered, by the balance of the text, against the least.

    Parameters
    ----------
    bed_k
        (P,) of each bead.
    checked
        (P,) beads for which the window of entry temperatures holds.
    """
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

"""The beads of one layer on a heat column, in sequence: each follows a time with the beam off, and heats the layer.

One kernel goes through all beads of a layer: a part has tens of thousands, and a call from Python for each would take longer
than the steps themselves.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.heat.marching import FEW_STEPS, SHORT_S, STEPS, ColumnFields, march
from ebamcheck.heat.waiting import bed_temperature_k, cooled
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

BeadTimes = tuple[Floats, Floats, Floats]
"""Time with the beam off before each bead, s, its own time, s, and the energy that the layer takes up in it, J; (n,) each."""

ABSORBED, BASE, RADIATED = range(3)
"""Totals of a column, J: heat taken up, passed to the table, and radiated."""


@kernel
def driven(
    content: Floats,
    fields: ColumnFields,
    under: int,
    top: int,
    beads: BeadTimes,
    limit_k: float,
    longest_s: float,
    counted: Floats,
) -> tuple[Floats, Floats]:
    """Drive beads; `content` and `counted` (3,) go from their first to their last state.

    Parameters
    ----------
    content, fields, under, top
        As :func:`~ebamcheck.heat.waiting.cooled` has them.
    limit_k
        Temperature of what a bead lies on above which it is waited for; endless for no waits.
    longest_s
        After a longer wait for one bead the rest is left out.

    Returns
    -------
    (n,) temperature of what each bead lies on when the beam comes to it, K, and how long it is waited for, s.
    """
    off_s, time_s, energy_j = beads
    bed_k, waits_s = np.full(len(off_s), np.nan), np.zeros(len(off_s))
    for n in range(len(off_s)):
        _aged(content, fields, top, off_s[n], 0.0, counted)
        bed_k[n] = bed_temperature_k(content, fields, under, top)
        if bed_k[n] > limit_k:
            waits_s[n], gone = cooled(content, fields, under, top, limit_k, longest_s)
            counted[BASE] += gone[0]
            counted[RADIATED] += gone[1]
            if waits_s[n] > longest_s:
                break
        _aged(content, fields, top, time_s[n], energy_j[n], counted)
    return bed_k, waits_s


@kernel
def _aged(
    content: Floats, fields: ColumnFields, top: int, duration_s: float, energy_j: float, counted: Floats
) -> None:
    """Let a time go by, in which the cells from `top` up take up heat; none where it is no time."""
    if duration_s <= 0.0:
        return
    steps = FEW_STEPS if duration_s <= SHORT_S else STEPS
    gone = march(content, fields, top, np.true_divide(energy_j, duration_s), duration_s, steps)
    counted[ABSORBED] += energy_j
    counted[BASE] += gone[0]
    counted[RADIATED] += gone[1]

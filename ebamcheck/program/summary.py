"""Totals of a program: what each layer takes of path, time and wire."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from ebamcheck.config import Config
from ebamcheck.program.motions import NCProgram
from ebamcheck.program.text_heat import PAUSE, motion_seconds
from ebamcheck.rings import Floats


def layer_pauses_s(nc: NCProgram) -> Floats:
    """Time that the program waits within each layer, and after it before the next, (L,) s."""
    paused = np.array([name == PAUSE for name in nc.events.name], np.bool_)
    # An event stands after as many motions as its row says: the last of them in a layer tells which.
    known = np.concatenate([[-1], np.maximum.accumulate(nc.layer)])
    after = known[nc.events.row[paused]]
    seconds = np.where(after >= 0, nc.events.value[paused], 0.0)
    count = len(nc.layer_files)
    return np.bincount(np.maximum(after, 0), seconds, minlength=count).astype(np.float64)[:count]


def program_summary(nc: NCProgram, config: Config) -> pd.DataFrame:
    """One row a layer: blocks, lengths, times and wire.

    Times are those of constant feed: lengths over feed, rapids over ``machine.rapid_mm_s``; ramps of the
    axes come on top.

    Returns
    -------
    DataFrame
        Columns `layer`, `file`, `z_mm`, `motions`, `contour_mm`, `hatch_mm` (turns included), `travel_mm`,
        `deposit_s`, `travel_s`, `pause_s` (the waits within it and after it), `wire_mm`, `wire_kg`.
    """
    process = config.process
    count = len(nc.layer_files)
    inside = nc.layer >= 0
    length = np.nan_to_num(nc.lengths)
    time = motion_seconds(nc, config)
    wire = np.where(nc.wire & nc.deposit, time * np.nan_to_num(nc.wire_mm_s), 0.0)
    area_m2 = math.pi * (process.wire_diameter_mm * 1e-3) ** 2 / 4.0

    def total(values: np.typing.NDArray[np.float64], which: np.typing.NDArray[np.bool_]) -> object:
        chosen = inside & which
        return np.bincount(nc.layer[chosen], values[chosen], minlength=count).astype(np.float64)

    always = np.ones(len(nc), np.bool_)
    wire_mm = np.asarray(total(wire, always))
    return pd.DataFrame(
        {
            "layer": np.arange(count),
            "file": nc.layer_files,
            "z_mm": nc.layer_heights,
            "motions": np.bincount(nc.layer[inside], minlength=count),
            "contour_mm": total(length, nc.deposit & (nc.ring >= 0)),
            "hatch_mm": total(length, nc.deposit & (nc.island >= 0)),
            "travel_mm": total(length, ~nc.deposit),
            "deposit_s": total(time, nc.deposit),
            "travel_s": total(time, ~nc.deposit),
            "pause_s": layer_pauses_s(nc),
            "wire_mm": wire_mm,
            "wire_kg": wire_mm * 1e-3 * area_m2 * config.material.density_kg_m3,
        }
    )

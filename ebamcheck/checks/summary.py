"""Totals of a program: what each layer takes of path, time and wire."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from ebamcheck.checks.text_heat import motion_seconds
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.timeline import PAUSE
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config


def layer_pauses_s(nc: NCProgram) -> Floats:
    """Time that the program waits before each layer and within it, (L,) s: a wait is of the layer of the metal after it.

    What no metal follows is of the last layer that has any.
    """
    paused = nc.events.named(PAUSE)
    laid = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    count = len(nc.layer_files)
    if not laid.size:
        return np.zeros(count)
    following = np.searchsorted(laid, nc.events.row[paused])
    layer = nc.layer[laid[np.minimum(following, laid.size - 1)]]
    return np.bincount(layer, nc.events.value[paused], minlength=count).astype(np.float64)


def program_summary(nc: NCProgram, config: Config) -> pd.DataFrame:
    """One row a layer: blocks, lengths, times and wire.

    Times are those of constant feed: lengths over feed, rapids over ``machine.rapid_mm_s``; ramps of the
    axes come on top.

    Returns
    -------
    DataFrame
        Columns `layer`, `file`, `z_mm`, `motions`, `contour_mm`, `hatch_mm` (turns included), `travel_mm`,
        `deposit_s`, `travel_s`, `pause_s` (the waits before it and within it), `wire_mm`, `wire_kg`.
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

"""Check of the wire of every bead: against what the plan asks for, or against what the machine can lay."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.checks.checks import Check, worst_check
from ebamcheck.checks.metal import bead_sections_mm2
from ebamcheck.heat.melting import width_limits_mm
from ebamcheck.nc.increments import increments_of
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_parts import path_points
from ebamcheck.writing.cuts import segment_lengths
from ebamcheck.writing.tracks import Toolpath

NAME = "mass balance"

WIRE_TOLERANCE = 0.01
"""Metal of a bead over what is asked for: the decimals of wire speed and feed, and nothing else."""

NEAR_MM = 0.2
"""Wire changes between blocks, whose ends are rounded, and which other curve forms place elsewhere by so much."""


def wire_check(nc: NCProgram, config: Config, path: Toolpath | None) -> Check:
    """Check the metal that each motion lays: wire speed times its section over the feed, against what it is to be.

    With the path that was planned, every bead has its own width; without it, the limits of the wire feed and of the pool
    hold.
    """
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    bead_mm2 = bead_sections_mm2(nc, config)[rows]
    if path is None:
        return _within_limits(nc, rows, bead_mm2, config)
    wanted = _wanted_mm2(nc, rows, path)
    if wanted is None:
        text = "beads of the program are not those of the plan: their wire cannot be compared"
        where = nc.where(int(rows[0])) if rows.size else f"{nc.files[0].name}:1"
        return Check(NAME, False, math.inf, WIRE_TOLERANCE, "of the bead", where, text)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(bead_mm2[:, None] / wanted - 1.0).min(axis=1) - _rounded(nc, rows, config)
    off = np.maximum(off, 0.0)
    return worst_check(NAME, nc, rows, off, WIRE_TOLERANCE, "of the bead", "metal of beads against the plan")


def _within_limits(nc: NCProgram, rows: Ints, bead_mm2: Floats, config: Config) -> Check:
    """Check the beads of layers whose height the program tells: those over a layer with beads, and the lowest."""
    thickness = np.diff(nc.layer_heights, prepend=config.base_mm)[nc.layer[rows]]
    known = np.isfinite(thickness)
    rows, width, thickness = (
        rows[known],
        (bead_mm2 / np.where(known, thickness, 1.0))[known],
        thickness[known],
    )
    steps, step = np.unique(thickness, return_inverse=True)
    limits = np.array([width_limits_mm(config, float(h)) for h in steps]).reshape(-1, 2)[step]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.maximum(limits[:, 0] / width, width / limits[:, 1]) - 1.0 - _rounded(nc, rows, config)
    off = np.maximum(off, 0.0)
    what = "metal of beads beyond what wire feed and pool allow"
    return worst_check(NAME, nc, rows, off, WIRE_TOLERANCE, "of the bead", what)


def _rounded(nc: NCProgram, rows: Ints, config: Config) -> Floats:
    """Share of its metal by which each motion may be off for the increments of wire and feed, (n,): half a step of each."""
    steps = increments_of(config.machine)
    with np.errstate(divide="ignore", invalid="ignore"):
        wire = steps.get("wire_mm_s", 0.0) / nc.wire_mm_s[rows]
        feed = steps.get("feed_mm_min", 0.0) / nc.feed_mm_min[rows]
    return np.asarray(0.5 * np.nan_to_num(wire + feed, posinf=0.0), np.float64)


def _wanted_mm2(nc: NCProgram, rows: Ints, path: Toolpath) -> Floats | None:
    """Sections that the plan asks for at and just beside the middle of each motion, (n, 3) mm2; None where beads differ."""
    planned = segment_lengths(path.kind, path_points(path))
    ends = np.cumsum(planned)
    bounds = np.concatenate([[0.0], ends])[
        path.track_starts[np.concatenate([[True], np.diff(path.track_starts) > 0])]
    ]
    height = np.repeat(path.thickness, np.diff(path.layer_starts))[np.diff(path.track_starts) > 0]
    beads = nc.beads.among(rows)
    middle, whole = beads.middles(nc.lengths[rows])
    if whole.size != bounds.size - 1:
        return None
    # Forms of curves differ in length by their tolerance: places are compared as shares of the bead.
    scale = np.diff(bounds) / np.maximum(whole, np.finfo(float).tiny)
    track = beads.bead
    at = bounds[:-1][track] + middle * scale[track]
    beside = np.stack([at - NEAR_MM, at, at + NEAR_MM], axis=1)
    beside = np.clip(beside, bounds[:-1][track][:, None] + 1e-9, bounds[1:][track][:, None] - 1e-9)
    segment = np.minimum(np.searchsorted(ends, beside), ends.size - 1)
    return np.asarray(path.width[segment] * height[track][:, None], np.float64)

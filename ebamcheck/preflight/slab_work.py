"""Whether a part is checked in slabs, in how many, and what that takes."""

from __future__ import annotations

import math
import os
from pathlib import Path

from ebamcheck.mesh.slabs import facet_count, is_binary_stl
from ebamcheck.preflight.workload import (
    BASE_MB,
    COMPARE_S,
    FACET_MB,
    HOUSE_SLICERS,
    METHOD_MB,
    POINT_MB,
    SLICE_S,
    START_S,
    Workload,
    machine_memory_mb,
)
from ebamcheck.settings.config import Config

FACETS_A_SLAB = 4_000_000
"""Facets of a slab at most where the settings do not say how many slabs there are."""

MOST_SLABS = 10_000
"""As many as the settings allow."""

COLUMNS_MB = 1.3e-5
"""Memory of what is held of every facet of the file: two heights and, mostly once, its number."""


def wanted_slabs(path: Path, config: Config) -> int:
    """Slabs in which a part is checked; 1: whole, as a part is that fits into memory."""
    if config.slicing.slabs is not None:
        return config.slicing.slabs
    if not is_binary_stl(path):
        return 1
    facets, side_by_side = facet_count(path), _side_by_side(config)
    limit_mb = config.work.most_memory_mb or machine_memory_mb()
    if (
        BASE_MB + side_by_side * (METHOD_MB + FACET_MB * facets) <= limit_mb
        and METHOD_MB + FACET_MB * facets <= config.slicing.memory_limit_mb
    ):
        return 1
    # Of what is left of the memory a half: a slab has the facets that span it besides its own.
    room_mb = min(
        (limit_mb - BASE_MB - COLUMNS_MB * facets - side_by_side * METHOD_MB) / (side_by_side + 1),
        config.slicing.memory_limit_mb - METHOD_MB,
    )
    facets_a_slab = min(0.5 * room_mb / FACET_MB, FACETS_A_SLAB)
    return min(math.ceil(facets / facets_a_slab), MOST_SLABS) if facets_a_slab >= 1.0 else 1


def slab_workload(
    facets: int, most_facets: int, layers: int, points: int, slabs: int, config: Config
) -> Workload:
    """Estimate what a check in slabs makes and takes.

    `facets` and `most_facets` are those of the file and of its largest slab, `points` those of one exact contour of all layers.
    """
    methods = _methods(config)
    at_once = min(points, config.slicing.block_points)
    return Workload(
        layers=layers,
        points=points,
        islands=0,
        bead_mm=0.0,
        time_s=START_S * slabs + points * (SLICE_S * methods + COMPARE_S * methods * (methods - 1) / 2),
        memory_mb=BASE_MB
        + COLUMNS_MB * facets
        + FACET_MB * most_facets
        + _side_by_side(config) * (METHOD_MB + FACET_MB * most_facets)
        + POINT_MB * at_once * methods,
    )


def _methods(config: Config) -> int:
    named = len({*config.slicing.backends, *config.slicing.witnesses})
    return named if config.slicing.backends else HOUSE_SLICERS + named


def _side_by_side(config: Config) -> int:
    return min(_methods(config), config.slicing.processes or os.cpu_count() or 1)

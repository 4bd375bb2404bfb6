"""Settings of how much work a job may be."""

from __future__ import annotations

from typing import Annotated

from ebamcheck.settings.base import Between, Section

Count = Annotated[int, Between(1, 10**12)]
"""Number of things that a job makes."""


class WorkSettings(Section):
    """How much work a job may be without a question: it is estimated before it begins, and `--yes` lets it go on."""

    most_layers: Count = 20_000
    """Layers; the thinnest ones of wire are some tenths of a millimetre."""
    most_points: Count = 1_000_000_000
    """Points of the contours of all layers, as an exact slicer finds them."""
    most_islands: Count = 500_000
    """Islands of all layers."""
    most_time_s: Annotated[float, Between(0.001, 1e8)] = 6 * 3600.0
    """Time of the whole job on this machine, as estimated; it is right within a factor of three or so."""
    most_memory_mb: Annotated[float, Between(1.0, 1e8)] | None = None
    """Memory of the whole job, of 10^6 bytes, as estimated; None: that of this machine."""

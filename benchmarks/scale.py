"""Beyond memory: ten million facets and ten thousand layers, under a watch that ends what grows too large."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

from benchmarks.ladder import Note
from benchmarks.parts import even_file, facets_in
from benchmarks.target_tasks import check_command
from ebamcheck_models import LADDER

FACETS, LAYERS = 10_000_000, 10_000
QUICK_FACETS, QUICK_LAYERS = 100_000, 200
STOP_MB = 16_000.0
"""Twice what is allowed: beyond it there is nothing to learn, and the machine has other uses."""

LIMIT_S = 6.0 * 3600.0


def measure_scale(quick: bool, extra: Sequence[str], note: Note) -> list[dict[str, Any]]:
    """Run ``ebamcheck check`` once on a part of that size.

    Parameters
    ----------
    quick
        A small part instead.
    extra
        Further arguments of the command: a file of settings, say.
    """
    facets, layers = (QUICK_FACETS, QUICK_LAYERS) if quick else (FACETS, LAYERS)
    note(f"scale: making a part of {facets:,} facets")
    stl = even_file(facets)
    note(f"scale: {facets_in(stl):,} facets, {layers:,} layers")
    layer_mm = LADDER.height_mm / layers
    answer = check_command(stl, layer_mm, LIMIT_S, STOP_MB, extra)
    command = shlex.join(["ebamcheck", "check", stl.name, "--layer-height", f"{layer_mm:.6g}", *extra])
    return [{**answer, "facets": facets_in(stl), "wanted_layers": layers, "command": command}]

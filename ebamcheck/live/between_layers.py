"""What a server does between its layers, when nobody waits for it: tables are written, and memory is given back.

A server holds half a million objects that stay as long as it runs. Python looks for cycles that nobody holds any more among all of
them at once, for a quarter of a second, and not before a quarter more have come: some hundred layers leave tens of kilobytes each
meanwhile, and the search comes in the middle of one. What stays is therefore set aside once it is loaded, and what a layer leaves
is collected after it.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping
from typing import Any

from ebamcheck.live.building import Building

SETTLED = 3
"""Layers after which all that stays is loaded: kernels and modules come with the first that need them."""

WORK = ("published", "released", "kept", "done", "built")
"""Answers after which a layer's work is done."""


class BetweenLayers:
    """What is done after each answer of a build."""

    def __init__(self, building: Building) -> None:
        self._building, self._layers = building, 0

    def __call__(self, answer: Mapping[str, Any]) -> None:
        """Do it; the answer was sent already."""
        self._building.heights.write(ended=self._building.finished)
        if answer.get("answer") not in WORK:
            return
        gc.collect()
        self._layers += 1
        if self._layers <= SETTLED:
            gc.freeze()

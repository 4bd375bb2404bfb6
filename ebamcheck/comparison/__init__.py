"""Comparison of stacks of layers: differences layer by layer, agreement, consensus, and outliers with likely causes."""

from __future__ import annotations

from ebamcheck.comparison.consensus import Comparison, compare_all
from ebamcheck.comparison.naming import Disagreement
from ebamcheck.comparison.pairwise import FACE_ON_PLANE, GENERIC, VERTEX_ON_PLANE, compare, layer_classes

__all__ = [
    "FACE_ON_PLANE",
    "GENERIC",
    "VERTEX_ON_PLANE",
    "Comparison",
    "Disagreement",
    "compare",
    "compare_all",
    "layer_classes",
]

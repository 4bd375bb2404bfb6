"""Slicer by ray casting with Embree: rays in the plane of each layer, with exact crossings."""

from __future__ import annotations

from ebamcheck_embree.slicer import Embree

__all__ = ["Embree"]

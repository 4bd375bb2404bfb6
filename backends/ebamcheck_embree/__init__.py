"""Slicer by ray casting with Embree: in-plane rays with exact crossings, or vertical rays for all layers."""

from __future__ import annotations

from ebamcheck_embree.slicer import Embree

__all__ = ["Embree"]

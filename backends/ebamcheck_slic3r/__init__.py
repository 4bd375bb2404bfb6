"""Slicer by the program Slic3r: an outside witness whose slices are exact."""

from __future__ import annotations

from ebamcheck_slic3r.slicer import Slic3r

__all__ = ["Slic3r"]

"""The program Slic3r as a slicer: an independent check whose slices are exact."""

from __future__ import annotations

from ebamcheck_slic3r.slicer import Slic3r

__all__ = ["Slic3r"]

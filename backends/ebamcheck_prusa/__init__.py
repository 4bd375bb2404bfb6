"""Slicer by the program PrusaSlicer: an outside witness, read from the pixel images of its SL1 archives."""

from __future__ import annotations

from ebamcheck_prusa.slicer import Prusa

__all__ = ["Prusa"]

"""The program PrusaSlicer as a slicer: an independent check, read from the pixel images of its SL1 archives."""

from __future__ import annotations

from ebamcheck_prusa.slicer import Prusa

__all__ = ["Prusa"]

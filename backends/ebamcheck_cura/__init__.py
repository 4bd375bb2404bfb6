"""The program CuraEngine as a slicer: an independent check, read from the G-code of its surface mode."""

from __future__ import annotations

from ebamcheck_cura.slicer import Cura

__all__ = ["Cura"]

"""manifold3d as a slicer: an exact plane cut, in double precision, of meshes that bound a solid."""

from __future__ import annotations

from ebamcheck_manifold.cut import ManifoldCut

__all__ = ["ManifoldCut"]

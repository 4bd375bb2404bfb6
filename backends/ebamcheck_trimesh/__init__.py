"""trimesh's ``section_multiplane`` as a slicer: a slow, simple check that is always installed."""

from __future__ import annotations

from ebamcheck_trimesh.sections import TrimeshSections

__all__ = ["TrimeshSections"]

"""Slicer by trimesh's ``section_multiplane``: a slow and plain witness that is always there."""

from __future__ import annotations

from ebamcheck_trimesh.sections import TrimeshSections

__all__ = ["TrimeshSections"]

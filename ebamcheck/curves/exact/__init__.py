"""Exact surfaces: cylinders, cones, spheres, tori and other quadrics that a mesh stands for, told from its vertices."""

from ebamcheck.curves.exact.finding import ExactSurfaces, exact_surfaces, no_surfaces

__all__ = ["ExactSurfaces", "exact_surfaces", "no_surfaces"]

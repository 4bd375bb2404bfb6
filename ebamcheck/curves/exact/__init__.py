"""Exact surfaces: cylinders, cones, spheres, tori and other quadrics, recognised from the vertices of a mesh."""

from ebamcheck.curves.exact.finding import ExactSurfaces, exact_surfaces, no_surfaces

__all__ = ["ExactSurfaces", "exact_surfaces", "no_surfaces"]

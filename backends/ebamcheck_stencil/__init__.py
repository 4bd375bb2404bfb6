"""The paper's GPU slicer: a signed count of forward and reverse facets along the ray of each pixel; OpenGL loads when it is
used."""

from ebamcheck_stencil.slicer import Stencil

__all__ = ["Stencil"]

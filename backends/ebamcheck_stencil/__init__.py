"""The paper's GPU slicer: a signed count of forward and reverse facets along the ray of each pixel.

The graphics libraries load when a part is prepared or the machine is probed, not on import.
"""

from ebamcheck_stencil.slicer import Stencil

__all__ = ["Stencil"]

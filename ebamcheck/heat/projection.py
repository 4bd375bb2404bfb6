"""Projection of heat onto the next layer: amplitudes of the old body's modes become those of the new one's.

The new body is the old one with a cold layer on top. Each model extrudes its own section, so heat outside the
new section is dropped, and places outside the old section start cold.
"""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.heat.depth import DepthModes
from ebamcheck.heat.model import HeatModel
from ebamcheck.heat.modes import ContourModes
from ebamcheck.numeric.rings import Floats


def carried(old: HeatModel, amplitudes: Floats, new: HeatModel) -> Floats:
    """Project a temperature field onto the modes of a higher body.

    Parameters
    ----------
    old, new
        Models in contour modes, on the same base.
    amplitudes
        (K, N) of the old one.

    Returns
    -------
    array
        (K', N') amplitudes of the new model: the least-squares approximation of the field by its modes.
    """
    if not (isinstance(old.plane, ContourModes) and isinstance(new.plane, ContourModes)):
        raise TypeError("heat is carried between modes of contours only")
    across = overlap_of_sections(old.plane, new.plane)
    return np.asarray(across @ amplitudes @ overlap_of_depths(old.depth, new.depth).T, np.float64)


def overlap_of_sections(old: ContourModes, new: ContourModes) -> Floats:
    """Integrals (K', K) of new times old modes over the intersection of the sections."""
    row, column = np.nonzero(new.grid.number >= 0)
    centres = new.grid.origin + (np.column_stack([column, row]) + 0.5) * new.grid.step
    return np.asarray(new.values.T @ (new.grid.area_mm2[:, None] * old.at(centres)), np.float64)


def overlap_of_depths(old: DepthModes, new: DepthModes) -> Floats:
    """Integrals (N', N) of new times old modes over the old depth; both are counted from the base upwards."""
    height = min(old.depth_mm, new.depth_mm)
    less = np.subtract.outer(new.wave_number, old.wave_number)
    more = np.add.outer(new.wave_number, old.wave_number)
    # Half the sum or difference of two sines over their wave numbers; sinc is also right where these vanish.
    close, far = (height * np.sinc(wave * height / math.pi) for wave in (less, more))
    product = 0.5 * (close - far if old.cooled else close + far)
    return np.asarray(np.multiply.outer(new.scale, old.scale) * product, np.float64)

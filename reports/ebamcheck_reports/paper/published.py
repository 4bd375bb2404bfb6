"""What the paper says, with the arithmetic that follows from it, and how much of its work is done again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

LAYER_HEIGHT_MM, PIXEL_MM = 0.2, 0.1  # Layer thickness and pixel (section 2.2)
# Time of the largest file, as the abstract and as section 5.1 give it
SLICING_S, SLICING_TEXT_S = 89.0, 89.99
FACETS, LAYERS = 1_483_132, 4488  # Facets of the largest file and its layers (abstract)
DEVICE = "Intel(R) UHD Graphics 630, 128 MB"  # What computed it (section 5.1)
# Tolerances of the eleven files as printed (section 5.1): 0.4 stands before 0.8
TOLERANCES_MM = (1.0, 0.4, 0.8, 0.08, 0.06, 0.04, 0.01, 0.006, 0.004, 0.002, 0.001)
# Sizes of the eleven files (section 5.1); they rise all the way
SIZES_MB = (0.23, 0.30, 0.46, 0.91, 1.14, 1.80, 5.88, 9.04, 23.65, 48.05, 70.73)
# Critical angle, layer of the bunny, and the curve parts found in it (section 3.2)
CORNER_ANGLE_DEG, CURVE_LAYER, CURVE_PARTS = 140.0, 118, 5
CLAIMED_REDUCTION = 0.342  # Reduction of the error by the fit (abstract, section 5.2)


class ErrorRange(NamedTuple):
    """Least and greatest polar error, mm; positive where there is metal too much."""

    low_mm: float
    high_mm: float

    @property
    def width_mm(self) -> float:
        """Greatest less least error."""
        return self.high_mm - self.low_mm

    @property
    def largest_mm(self) -> float:
        """Greatest magnitude."""
        return max(abs(self.low_mm), abs(self.high_mm))


POLYLINE_ERROR = ErrorRange(-0.2125, 0.1137)
FIT_ERROR = ErrorRange(-0.0810, 0.0955)  # Error ranges of the sliced and of the fitted data (section 5.2)


def reduction(before: float, after: float) -> float:
    """How much smaller a figure became, as a fraction of 1.

    >>> reduction(0.2, 0.05)
    0.75
    """
    return 1.0 - after / before


def published_reductions() -> dict[str, float]:
    """Reductions that the paper's two ranges give, by what is compared.

    >>> {name: round(100 * value, 1) for name, value in published_reductions().items()}
    {'range': 45.9, 'max': 55.1, 'low_end': 61.9, 'high_end': 16.0}
    """
    return {
        "range": reduction(POLYLINE_ERROR.width_mm, FIT_ERROR.width_mm),
        "max": reduction(POLYLINE_ERROR.largest_mm, FIT_ERROR.largest_mm),
        "low_end": reduction(-POLYLINE_ERROR.low_mm, -FIT_ERROR.low_mm),
        "high_end": reduction(POLYLINE_ERROR.high_mm, FIT_ERROR.high_mm),
    }


def tolerances_by_size() -> tuple[float, ...]:
    """Tolerances in the order of the file sizes: from coarse to fine, 0.4 and 0.8 changed over.

    >>> tolerances_by_size()[:4]
    (1.0, 0.8, 0.4, 0.08)
    """
    return tuple(sorted(TOLERANCES_MM, reverse=True))


# -- how much is done again ------------------------------------------------------------------------

Note = Callable[[str], None]  # Callback for progress, with one line of text


@dataclass(frozen=True)
class Effort:
    """Counts that decide how long the command takes: the finest tolerance that is sliced, every how manieth layer is
    timed, layers on which the paper's own method is timed, and layers of each model on which the fit is measured."""

    name: str
    finest_mm: float
    layer_step: int
    literal_layers: int
    polar_layers: int

    @property
    def tolerances_mm(self) -> tuple[float, ...]:
        """Tolerances to be sliced, from coarse to fine."""
        return tuple(t for t in tolerances_by_size() if t >= self.finest_mm)


# About a minute on two cores: the sizes up to some 40,000 facets
QUICK = Effort("quick", finest_mm=0.04, layer_step=8, literal_layers=6, polar_layers=24)
# All eleven sizes and all 4488 layers
FULL = Effort("full", finest_mm=0.001, layer_step=1, literal_layers=24, polar_layers=200)

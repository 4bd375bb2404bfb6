"""The surface that a part has while it is built: what the layers so far have laid too much or too little.

A place stays molten while the beam is within a bead width of it, and levels over that distance with the molten metal around it;
none flows over the border. A place that a bead could have reached and that none did stays where it was, a layer deeper than it
should be."""

from __future__ import annotations

import copy

import numpy as np
from scipy import ndimage

from ebamcheck.kernels import Bools, Floats
from ebamcheck.metal.target import REACHED, Target, border_distance, cell_mm, moved_to_neighbours

# Standard deviation, over the bead width, of the spot over which the surface is read: that of a disc as wide as the bead
SPOT_BEADS = 0.25
HALF = 0.5  # share of a cell in the section from which on it counts as inside
FILM = 0.25  # height of metal over that of the layer from which on a bead has reached a place: its flank is thinner
MENDED = 0.3  # share of what lies too high or too low under a layer that is mended by it, where that is worked out and not measured


def bead_centres(inside: Bools, bead_cells: float) -> Bools:
    """Cells (rows, columns) of a section, at least one beside it is none, on which the middle of a bead so many cells wide keeps
    within the border.

    >>> int(bead_centres(np.pad(np.ones((8, 9), bool), 1), 6.0).sum())
    20
    """
    return np.asarray(border_distance(inside) >= 0.5 * bead_cells, np.bool_)


def reachable(inside: Bools, bead_cells: float) -> Bools:
    """Cells of a section that some bead inside of it builds: all but those that only flanks reach, and walls under a bead.

    >>> reachable(np.pad(np.ones((8, 9), bool), 1), 6.0)[1:-1, 1:-1].sum(axis=1)
    array([5, 7, 9, 9, 9, 9, 7, 5])
    """
    centres = bead_centres(inside, bead_cells)
    if not centres.any():
        return centres
    # Up to so far from its line, a bead is at least half as high as in its middle.
    return np.asarray(inside & (border_distance(~centres) <= 0.5**0.5 * 0.5 * bead_cells), np.bool_)


class Surface:
    """The surface over one grid for all layers of a part."""

    def __init__(self, bounds: Floats, bead_width_mm: float) -> None:
        """Lay cells over `bounds` (x0, y0, x1, y1), mm, with room for beads beside it; nothing is built yet."""
        self.step_mm = cell_mm(bounds, bead_width_mm)
        margin_mm = 2.0 * bead_width_mm
        low = np.floor((bounds[:2] - margin_mm) / self.step_mm) - 1.0
        high = np.ceil((bounds[2:] + margin_mm) / self.step_mm)
        columns, rows = (high - low + 1.0).astype(np.int64).tolist()
        self._corner = low.astype(np.int64)
        self._over_mm: Floats = np.zeros((rows, columns))
        self._share: Floats = np.zeros((rows, columns))
        self._bead = bead_width_mm / self.step_mm
        self.mended = MENDED
        self.mapped = False

    @property
    def corner(self) -> tuple[int, int]:
        """Column and row of the grid's first cell, counted from the origin of the part."""
        return int(self._corner[0]), int(self._corner[1])

    @property
    def share(self) -> Floats:
        """(rows, columns) share of each cell that the last layer has of metal."""
        return self._share

    def with_map(self, over_mm: Floats) -> Surface:
        """The surface as uneven as it was measured: heights (rows, columns) over the measured one of the layer; cells without metal
        do not count."""
        made = self.copy()
        made._over_mm = np.where(self._share > 0.0, over_mm, 0.0)
        made.mapped = True
        return made

    def mending(self, share: float) -> Surface:
        """Return the same surface, of which a layer is to mend another share."""
        made = self.copy()
        made.mended = share
        return made

    def copy(self) -> Surface:
        """Return the same surface, on which can be built by itself."""
        return copy.copy(self)

    def measured(self) -> Surface:
        """Return the surface of a part whose height was measured: uneven as it was, and on average at that height."""
        made, metal = self.copy(), self._share.sum()
        if metal > 0.0 and not self.mapped:
            mean_mm = float((self._share * self._over_mm).sum() / metal)
            made._over_mm = np.where(self._share > 0.0, self._over_mm - mean_mm, 0.0)
        return made

    def over_mm(self, target: Target) -> Floats:
        """Height of the surface over that of the last layer in the cells of a layer, the mean over the spot of a bead; 0 without
        metal."""
        if not target.share.size:
            return np.zeros_like(target.share)
        at = self._window(target)
        height, share = _spread(self._over_mm[at], self._share[at], SPOT_BEADS * self._bead)
        metal = self._share[at] > 0.0
        return np.asarray(np.divide(height, share, out=np.zeros_like(share), where=metal), np.float64)

    def add(self, target: Target, laid_mm: Floats, thickness_mm: float) -> None:
        """Build a layer that is to have a height, of metal as high as (rows, columns) in the cells of `target`."""
        over, built = np.zeros_like(self._over_mm), np.zeros_like(self._share)
        if target.share.size:
            at, inside = self._window(target), target.share >= HALF
            metal = inside & ((laid_mm >= REACHED * thickness_mm) | reachable(inside, self._bead))
            before = np.where(self._share[at] > 0.0, self._over_mm[at], 0.0)
            fields = target.share, laid_mm - thickness_mm * target.share
            share, excess = (_with_rims(field, target.share, metal) for field in fields)
            raised = before + np.divide(excess, share, out=np.zeros_like(share), where=metal)
            built[at] = share
            over[at] = levelled(raised, share, self._bead)
        # What is left of a map is worked out and no longer measured.
        self._over_mm, self._share, self.mapped, self.mended = over, built, False, MENDED

    def _window(self, target: Target) -> tuple[slice, slice]:
        """Where the cells of a layer lie in the grid."""
        column, row = (np.round(target.origin / self.step_mm).astype(np.int64) - self._corner).tolist()
        return slice(row, row + target.share.shape[0]), slice(column, column + target.share.shape[1])


def _with_rims(field: Floats, share: Floats, metal: Bools) -> Floats:
    """A field (rows, columns) on the cells of metal alone, each with that of the nearest cells under :data:`HALF`: no rim loses
    area or metal."""
    result = np.where(metal, field, 0.0)
    moved_to_neighbours(result, field, (share > 0.0) & (share < HALF), metal)
    return result


def levelled(height: Floats, share: Floats, bead_cells: float) -> Floats:
    """Heights of molten metal (rows, columns) when it has levelled over a bead width, without flowing over the border; 0 where the
    share of metal is 0."""
    # The standard deviation of a disc of one bead width's radius.
    flown, weight = _spread(height, share, 0.5 * bead_cells)
    return np.asarray(np.where(share > 0.0, flown + (1.0 - weight) * height, 0.0), np.float64)


def _spread(height: Floats, share: Floats, sigma: float) -> tuple[Floats, Floats]:
    """Heights times shares, and shares, spread by a Gaussian."""
    both = ndimage.gaussian_filter(np.stack([height * share, share]), (0.0, sigma, sigma), mode="constant")
    return both[0], both[1]

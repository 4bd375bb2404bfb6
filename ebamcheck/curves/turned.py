"""Rings of fitted contours turned over: the same curves, driven the other way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ebamcheck.curves.columns import Curves
from ebamcheck.kernels import Bools, Floats, Ints


def turned_over(curves: Curves, rings: Bools) -> Curves:
    """Turn the direction of some rings (R,); each starts where it did, and every curve stays the same.

    Examples
    --------
    >>> from ebamcheck.curves import fit
    >>> from ebamcheck.slicers.slicing import slice_part
    >>> from ebamcheck_models import MODELS
    >>> curves = fit(slice_part(MODELS["cube"].tessellate(0.1), [3.0]))
    >>> turned = turned_over(curves, np.array([True]))
    >>> bool((turned.control[0] == curves.control[0]).all()), bool((turned.control[1] == curves.control[-2]).all())
    (True, True)
    """
    pieces = rings[curves.piece_ring]
    order = _mirrored(curves.ring_starts, rings)
    turned = pieces[order]
    control, control_starts = _columns(curves.control, curves.control_starts, order, turned)
    knots, knot_starts = _columns(curves.knots, curves.knot_starts, order, turned)
    sizes = np.diff(knot_starts)
    some = sizes > 0
    # Knots count from the other end; what was the last one is the first now.
    last = np.repeat(knots[knot_starts[:-1][some]], sizes[some])
    knots = np.where(np.repeat(turned, sizes), last - knots, knots)
    return replace(
        curves,
        kind=curves.kind[order],
        control=control,
        control_starts=control_starts,
        knots=knots,
        knot_starts=knot_starts,
    )


def _mirrored(starts: Ints, which: Bools) -> Ints:
    """Rows of groups that follow each other, the other way round in some of them."""
    rows = np.arange(int(starts[-1]))
    sizes = np.diff(starts)
    return np.asarray(
        np.where(np.repeat(which, sizes), np.repeat(starts[:-1] + starts[1:] - 1, sizes) - rows, rows),
        np.int64,
    )


def _columns(values: Floats, starts: Ints, order: Ints, turned: Bools) -> tuple[Floats, Ints]:
    """Values of groups in another order of these, the other way round in some, and where each group begins."""
    sizes = np.diff(starts)[order]
    begins = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    rows = np.repeat(starts[:-1][order] - begins[:-1], sizes) + np.arange(int(begins[-1]))
    return values[rows[_mirrored(begins, turned)]], begins

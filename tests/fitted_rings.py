"""Rings of closed form, and fits of single rings, for the tests of the curves."""

from __future__ import annotations

from functools import partial

import numpy as np

from ebamcheck.curves import SPLINE, Curves, fit
from ebamcheck.layers.stack import Layers, from_rings

paper_fit = partial(fit, method="paper")

EXACT_MM = 1e-9
SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]


def circle(count: int, radius: float = 20.0, phase: float = 0.1) -> np.ndarray:
    t = phase + np.arange(count) * (2 * np.pi / count)
    return radius * np.column_stack([np.cos(t), np.sin(t)])


def wavy(count: int = 90) -> np.ndarray:
    t = np.arange(count) * (2 * np.pi / count) + 0.02 * np.sin(7 * np.arange(count))
    r = 30 + 3 * np.sin(5 * t) + 1.0 * np.cos(8 * t)
    return np.column_stack([r * np.cos(t), r * np.sin(t)])


def stadium(arc: int = 24, side: float = 40.0, radius: float = 8.0, extra: int = 0) -> np.ndarray:
    """Two half circles and two straight sides, tangent to each other."""
    t = np.linspace(-np.pi / 2, np.pi / 2, arc + 1)
    cap = radius * np.column_stack([np.cos(t), np.sin(t)])
    shift = np.array([side / 2, 0])
    along = np.linspace(0, 1, extra + 2)[1:-1, None]
    right, left = cap + shift, -cap - shift
    return np.vstack(
        [right, right[-1] + along * (left[0] - right[-1]), left, left[-1] + along * (right[0] - left[-1])]
    )


def one(ring: object, **settings: object) -> Curves:
    return paper_fit(from_rings([1.0], [[ring]]), **settings)


def path(points: object, **settings: object) -> Curves:
    return paper_fit(from_rings([1.0], [[]], [[points]]), **settings)


def raw(ring: np.ndarray, closed: bool = True) -> Layers:
    """A ring as it stands, without the canonical start point."""
    n = np.array([0, len(ring)])
    return Layers(np.zeros(1), np.asarray(ring, float), n, np.array([0, 1]), np.array([closed]))


def splines(curves: Curves) -> list[int]:
    return np.flatnonzero(curves.kind == SPLINE).tolist()


def same_set(a: np.ndarray, b: np.ndarray, tolerance: float = EXACT_MM) -> bool:
    """Whether every point of each set is one of the other."""
    d = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    return bool(d.min(axis=0).max() < tolerance and d.min(axis=1).max() < tolerance)


def stack() -> Layers:
    """Rings with corners, without, with straight runs, holes, an open path and an empty layer."""
    hole = circle(40, 5.0)[::-1]
    half = np.vstack([circle(24, 10.0, 0.0)[:13], [(0.0, 0.0)]])
    return from_rings(
        [0.5, 1.0, 1.5, 2.0],
        [[wavy(), hole], [], [SQUARE, stadium() + 60.0], [half]],
        [[], [], [], [wavy()[:20] + 100.0]],
        part="p" * 8,
        backend="b",
    )

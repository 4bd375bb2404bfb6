"""Independence: an agreement is evidence if the two methods are independent and their error bounds are narrow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from math import inf

import numpy as np
from numpy.typing import NDArray

Bounds = Mapping[str, tuple[float, float]]
"""Error bound and height bound of each method, mm."""


@dataclass(frozen=True)
class EvidenceRule:
    """Conditions under which an agreement counts.

    Parameters
    ----------
    largest_error_mm, largest_height_mm
        Largest bounds of a method whose agreement is evidence: one with a greater bound agrees with too much.
    kin
        Pairs of names that are not independent: one is derived from the other, or both are the same code.
    """

    largest_error_mm: float = inf
    largest_height_mm: float = inf
    kin: frozenset[frozenset[str]] = frozenset()

    def without_weight(self, bounds: Bounds) -> dict[str, str]:
        """Methods whose agreement is no evidence, with the reason in one line."""
        found = {}
        for name, (error_mm, height_mm) in bounds.items():
            if not error_mm <= self.largest_error_mm:
                found[name] = f"its bound of {error_mm:.3g} mm is over {self.largest_error_mm:.3g} mm"
            elif not height_mm <= self.largest_height_mm:
                found[name] = (
                    f"its height bound of {height_mm:.3g} mm is over {self.largest_height_mm:.3g} mm"
                )
        return found

    def counts(self, a: str, b: str, without_weight: Mapping[str, str]) -> bool:
        """Whether an agreement of two methods is evidence."""
        return not {a, b} & set(without_weight) and frozenset((a, b)) not in self.kin


def best_pair(
    members: tuple[int, ...], count: int, good: NDArray[np.bool_], limits_mm: NDArray[np.float64]
) -> tuple[int, int] | None:
    """The two methods on which a consensus rests: those whose agreement, of all that are evidence, has the least limit.

    Parameters
    ----------
    members
        Indices of the methods of the consensus.
    count
        Number of all methods.
    good, limits_mm
        (P,) for each pair of methods, in the order of ``combinations(range(count), 2)``: whether it agrees and is
        evidence, and within how much.
    """
    inside = set(members)
    pairs = [
        (float(limit), pair)
        for pair, ok, limit in zip(combinations(range(count), 2), good, limits_mm, strict=True)
        if ok and inside.issuperset(pair)
    ]
    return min(pairs)[1] if pairs else None

"""Joining of the comparisons of consecutive parts of a stack into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ebamcheck.comparison.consensus import Comparison
from ebamcheck.comparison.disagreement import EMPTY, OUTLIER, UNDECIDED


def shifted(comparison: Comparison, first: int) -> Comparison:
    """The same comparison with its layers numbered from `first`."""
    pairs = comparison.pairs
    return replace(
        comparison,
        pairs=pairs.assign(layer=pairs["layer"] + first) if len(pairs) else pairs,
        layers=comparison.layers.assign(layer=comparison.layers["layer"] + first),
        findings=[replace(finding, layer=finding.layer + first) for finding in comparison.findings],
    )


def joined(comparisons: Sequence[Comparison]) -> Comparison:
    """Join comparisons of consecutive layers into one, with consecutive layer numbers.

    Parameters
    ----------
    comparisons
        At least one, from the lowest layers to the highest. A backend that is not in all of them has no figures in the
        whole; its pairs are those of the layers where it was.
    """
    layers = pd.concat([one.layers for one in comparisons], ignore_index=True)
    names = [name for name in comparisons[0].stacks if all(name in one.stacks for one in comparisons)]
    stacks = {name: pd.concat([one.stacks[name] for one in comparisons], ignore_index=True) for name in names}
    compared = sum(one.compared_layers for one in comparisons)
    return Comparison(
        pairs=_by_pair([one.pairs for one in comparisons if len(one.pairs)]),
        layers=layers,
        stacks=stacks,
        findings=[finding for one in comparisons for finding in one.findings],
        passed=compared > 0 and not layers["verdict"].isin([OUTLIER, UNDECIDED, EMPTY]).any(),
        compared_layers=compared,
        without_weight={name: why for one in comparisons for name, why in one.without_weight.items()},
    )


def _by_pair(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Rows of all tables, pair after pair and by layer in each."""
    if not tables:
        return pd.DataFrame()
    rows = pd.concat(tables, ignore_index=True)
    pair, _ = pd.factorize(pd.MultiIndex.from_frame(rows[["a", "b"]]))
    return rows.iloc[np.lexsort((rows["layer"].to_numpy(), pair))].reset_index(drop=True)

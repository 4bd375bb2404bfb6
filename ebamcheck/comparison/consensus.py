"""Consensus: which slicers agree on each layer, which are outliers, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import inf

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ebamcheck.comparison.doubt import allow_doubt
from ebamcheck.comparison.naming import (
    AGREE,
    EMPTY,
    NOT_COMPARED,
    OUTLIER,
    UNDECIDED,
    Disagreement,
    named_findings,
)
from ebamcheck.comparison.pairwise import (
    GENERIC,
    Pair,
    check_comparable,
    layer_classes,
    measure_stacks,
    table,
)
from ebamcheck.comparison.sources import LayerSource, blocks_of, contour_figures
from ebamcheck.layers.heights import crossing_counts
from ebamcheck.mesh.part import Part
from ebamcheck.settings.stages import ComparisonSettings

Bounds = Mapping[str, tuple[float, float]]  # error bound and height bound of each method, mm


@dataclass(frozen=True)
class EvidenceRule:
    """Conditions under which an agreement counts."""

    largest_error_mm: float = inf
    largest_height_mm: float = inf
    """Largest bounds of a method whose agreement is evidence: one with a greater bound agrees with too much."""
    kin: frozenset[frozenset[str]] = frozenset()
    """Pairs of names that are not independent: one is derived from the other, or both are the same code."""

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

    For each pair of methods (P,), in the order of ``combinations(range(count), 2)``, `good` tells whether it agrees and is
    evidence, and `limits_mm` within how much.
    """
    inside = set(members)
    pairs = [
        (float(limit), pair)
        for pair, ok, limit in zip(combinations(range(count), 2), good, limits_mm, strict=True)
        if ok and inside.issuperset(pair)
    ]
    return min(pairs)[1] if pairs else None


HALF_OPEN = "half-open"

EVERY_AGREEMENT = EvidenceRule()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of the comparison of all stacks."""

    pairs: pd.DataFrame
    """One row per pair and layer: ``a``, ``b``, the columns of :func:`ebamcheck.comparison.compare`, ``gated``,
    ``evidence`` (whether an agreement of the two counts)."""
    layers: pd.DataFrame
    """One row per layer: ``layer``, ``height_mm``, ``class``, ``consensus`` (names joined by commas), ``verdict``,
    ``rests_on`` (the two names of the consensus that agree within the narrowest limit)."""
    stacks: Mapping[str, pd.DataFrame]
    """By backend, one row per layer: ``area_mm2``, ``rings``, ``outer_rings``, ``open_paths``, ``points``."""
    findings: list[Disagreement]
    passed: bool
    """Whether at least one layer was compared, and none has an outlier, is undecided, or is empty although the part is not."""
    compared_layers: int
    """Number of layers on which at least one gated pair that is evidence had regions to compare."""
    without_weight: Mapping[str, str] = field(default_factory=dict)
    """Backends whose agreement is no evidence, with the reason."""


def compare_all(
    stacks: Mapping[str, LayerSource],
    part: Part,
    bounds: Mapping[str, tuple[float, float]],
    exact: Mapping[str, bool],
    rules: Mapping[str, str],
    settings: ComparisonSettings | None = None,
    progress: Callable[[int], None] | None = None,
    borders: NDArray[np.int64] | None = None,
    evidence: EvidenceRule = EVERY_AGREEMENT,
) -> Comparison:
    """Compare all stacks, of the same part at the same heights, pairwise and find on each layer who agrees with whom.

    By backend: `bounds` are its error and height bounds, mm; `exact` whether its contours are those of the mesh to rounding;
    `rules` its coplanar rule (layers that are not generic are gated only between ``half-open`` ones). `borders` are blocks of
    layers, two of which are in memory at a time, and `evidence` says which agreements count; a disagreement always does.

    The consensus of a layer is the largest set of backends in which every gated pair agrees and each has a gated agreement that
    is evidence; the others are outliers. With two such sets of one size, or none, the layer is undecided. A layer that is empty
    in all stacks although facets cross its plane is ``empty``; one without a gated pair that is evidence is ``not-compared``.
    """
    settings = settings or ComparisonSettings()
    names = list(stacks)
    if names:
        check_comparable(stacks)
    heights = stacks[names[0]].heights if names else np.zeros(0)
    margins = {n: _margin(settings, bounds[n][1]) for n in names}
    classes = _classes(part, heights, {margins[n] for n in names} | {0.0})
    overall = classes[max(margins.values(), default=0.0)]
    couples = _couples(names, bounds, exact, settings)
    weightless = evidence.without_weight({n: bounds[n] for n in names})
    margin = [max(margins[names[pair.a]], margins[names[pair.b]]) for pair in couples]
    tables, figures = _measured(stacks, couples, [classes[m] for m in margin], part, progress, borders)
    for pair, rows in zip(couples, tables, strict=True):
        a, b = names[pair.a], names[pair.b]
        gated = np.asarray(rows["class"] == GENERIC) | (rules[a] == HALF_OPEN and rules[b] == HALF_OPEN)
        rows.insert(0, "b", b)
        rows.insert(0, "a", a)
        rows["gated"] = gated
        rows["evidence"] = evidence.counts(a, b, weightless)
    allow_doubt(list(stacks.values()), couples, tables, settings.doubt_mm)
    pairs = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    vanished = _vanished(figures, part, heights)
    consensus, verdicts, pairs_of = _verdicts(names, tables, vanished)
    layers = pd.DataFrame(
        {
            "layer": np.arange(heights.size),
            "height_mm": heights,
            "class": overall.astype(object),
            "consensus": [",".join(names[i] for i in members) for members in consensus],
            "verdict": verdicts,
            "rests_on": [",".join(names[i] for i in pair) for pair in pairs_of],
        }
    )
    findings = list(named_findings(part, stacks, tables, heights, consensus, verdicts))
    compared = _compared(tables, heights.size)
    passed = compared > 0 and not {OUTLIER, UNDECIDED, EMPTY} & set(verdicts)
    return Comparison(
        pairs, layers, dict(zip(names, figures, strict=True)), findings, passed, compared, weightless
    )


def _margin(settings: ComparisonSettings, height_bound_mm: float) -> float:
    return height_bound_mm if settings.plane_margin_mm is None else settings.plane_margin_mm


def _classes(part: Part, heights: NDArray[np.float64], margins: set[float]) -> dict[float, NDArray[np.str_]]:
    """Layer classes for each margin in use."""
    return {margin: layer_classes(part, heights, margin) for margin in margins}


def _couples(
    names: list[str],
    bounds: Mapping[str, tuple[float, float]],
    exact: Mapping[str, bool],
    settings: ComparisonSettings,
) -> list[Pair]:
    """Every pair of stacks with its limit."""
    return [
        Pair(i, j, bounds[names[i]][0] + bounds[names[j]][0] + settings.tolerance_mm,
             bool(exact[names[i]]), bool(exact[names[j]]))
        for i, j in combinations(range(len(names)), 2)
    ]  # fmt: skip


def _measured(
    stacks: Mapping[str, LayerSource],
    couples: list[Pair],
    classes: list[NDArray[np.str_]],
    part: Part,
    progress: Callable[[int], None] | None,
    borders: NDArray[np.int64] | None,
) -> tuple[list[pd.DataFrame], list[pd.DataFrame]]:
    """Table of each pair, and figures of each stack, in one pass over the layers."""
    # Coordinates from the part's middle lose no digits to a far origin, and the middle is the same for every block.
    x, y, _ = part.bounds.mean(axis=0).tolist()
    tables: list[list[pd.DataFrame]] = [[] for _ in couples]
    figures: list[list[pd.DataFrame]] = [[] for _ in stacks]
    for first, block in blocks_of(list(stacks.values()), borders):
        found = measure_stacks(block, couples, (x, y), progress)
        for p, pair in enumerate(couples):
            a, b = block[pair.a], block[pair.b]
            rows = table(a, b, found[p], pair.limit_mm, classes[p][first : first + len(a)], (x, y))
            tables[p].append(rows.assign(layer=rows["layer"] + first))
        for column, layers in zip(figures, block, strict=True):
            column.append(contour_figures(layers))
    return [pd.concat(rows, ignore_index=True) for rows in tables], [
        pd.concat(rows, ignore_index=True) for rows in figures
    ]


def _vanished(figures: list[pd.DataFrame], part: Part, heights: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Layers that are empty in all stacks although facets cross their planes."""
    empty = np.ones(heights.size, np.bool_)
    for stack in figures:
        empty &= stack["outer_rings"].to_numpy() == 0
    return empty & (crossing_counts(part, heights) > 0)


def _compared(tables: list[pd.DataFrame], count: int) -> int:
    """Number of layers on which a gated pair that is evidence had a region to compare."""
    compared = np.zeros(count, np.bool_)
    for rows in tables:
        compared |= (rows["gated"] & rows["evidence"]).to_numpy() & (
            (rows["rings_a"] + rows["rings_b"]).to_numpy() > 0
        )
    return int(compared.sum())


def _verdicts(
    names: list[str], tables: list[pd.DataFrame], vanished: NDArray[np.bool_]
) -> tuple[list[tuple[int, ...]], list[str], list[tuple[int, ...]]]:
    """Consensus (indices into `names`), verdict, and the two backends that it rests on, of each layer."""
    couples = list(combinations(range(len(names)), 2))

    def marks(column: str) -> NDArray[np.bool_]:
        found = [rows[column].to_numpy() for rows in tables]
        return np.array(found, np.bool_).reshape(len(couples), vanished.size)

    gated, agrees, counts = marks("gated"), marks("agrees"), marks("evidence")
    limits = np.array([rows["limit_mm"].max() for rows in tables])
    # Few patterns of agreement occur: each is solved once.
    solved: dict[bytes, tuple[tuple[int, ...], str, tuple[int, ...]]] = {}
    found: list[tuple[tuple[int, ...], str, tuple[int, ...]]] = []
    for layer, is_vanished in enumerate(vanished):
        if is_vanished or not couples:
            found.append(((), EMPTY if is_vanished and couples else NOT_COMPARED, ()))
            continue
        pattern = gated[:, layer].tobytes() + agrees[:, layer].tobytes()
        if pattern not in solved:
            members, verdict = agreement(couples, gated[:, layer], agrees[:, layer], counts[:, layer])
            good = gated[:, layer] & agrees[:, layer] & counts[:, layer]
            solved[pattern] = members, verdict, best_pair(members, len(names), good, limits) or ()
        found.append(solved[pattern])
    return [f[0] for f in found], [f[1] for f in found], [f[2] for f in found]


def agreement(
    couples: list[tuple[int, int]],
    gated: NDArray[np.bool_],
    agrees: NDArray[np.bool_],
    counts: NDArray[np.bool_] | None = None,
) -> tuple[tuple[int, ...], str]:
    """Largest consistent set of one layer and its verdict, by trying every set of backends.

    Only agreements that are evidence count (`counts`; None: all); every disagreement counts.
    """
    counted = np.ones_like(gated) if counts is None else counts
    friends = {c for c, g in zip(couples, gated & agrees & counted, strict=True) if g}
    foes = {c for c, g, ok in zip(couples, gated, agrees, strict=True) if g and not ok}
    candidates = sorted({i for couple in friends | foes for i in couple})
    if not candidates:
        return (), NOT_COMPARED
    for size in range(len(candidates), 1, -1):
        largest = [
            members
            for members in combinations(candidates, size)
            if not foes & set(combinations(members, 2))
            and all(any(tuple(sorted((i, j))) in friends for j in members if j != i) for i in members)
        ]
        if len(largest) == 1:
            return largest[0], AGREE if size == len(candidates) else OUTLIER
        if largest:
            return (), UNDECIDED
    return (), UNDECIDED


# -- Joining of the comparisons of consecutive parts of a stack into one ---------------------------------------


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
    """Join comparisons of consecutive layers into one, from the lowest to the highest, with consecutive layer numbers.

    A backend that is not in all of them has no figures in the whole; its pairs are those of the layers where it was.
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

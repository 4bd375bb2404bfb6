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
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.heights import crossing_counts
from ebamcheck.mesh.part import Part
from ebamcheck.settings.stages import ComparisonSettings

Bounds = Mapping[str, tuple[float, float]]  # error bound and height bound of each method, mm


@dataclass(frozen=True)
class EvidenceRule:
    """Conditions under which an agreement counts."""

    # Largest bounds of a method whose agreement is evidence: one with a greater bound agrees with too much
    largest_error_mm: float = inf
    largest_height_mm: float = inf
    # Pairs of names that are not independent: one is derived from the other, or both are the same code
    kin: frozenset[frozenset[str]] = frozenset()

    def without_weight(self, bounds: Bounds) -> dict[str, str]:
        """Methods whose agreement is no evidence, with the reason in one line."""
        reasons: dict[str, str] = {}
        for name, both in bounds.items():
            limits = self.largest_error_mm, self.largest_height_mm
            for what, bound_mm, most_mm in zip(("bound", "height bound"), both, limits, strict=True):
                if not bound_mm <= most_mm:
                    reasons.setdefault(name, f"its {what} of {bound_mm:.3g} mm is over {most_mm:.3g} mm")
        return reasons

    def counts(self, a: str, b: str, without_weight: Mapping[str, str]) -> bool:
        """Whether an agreement of two methods is evidence."""
        return not {a, b} & set(without_weight) and frozenset((a, b)) not in self.kin


def best_pair(members: tuple[int, ...], count: int, good: Bools, limits_mm: Floats) -> tuple[int, int] | None:
    """The two methods on which a consensus rests: of the agreements that are evidence, theirs has the least limit.

    For each pair of methods (P,), in the order of ``combinations(range(count), 2)``, `good` tells whether it agrees and is
    evidence, and `limits_mm` within how much.
    """
    couples = zip(limits_mm.tolist(), combinations(range(count), 2), good, strict=True)
    pairs = [(limit, pair) for limit, pair, ok in couples if ok and set(members).issuperset(pair)]
    return min(pairs)[1] if pairs else None


HALF_OPEN = "half-open"
EVERY_AGREEMENT = EvidenceRule()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of the comparison of all stacks."""

    # One row per pair and layer: `a`, `b`, the columns of `compare`, `gated`, `evidence` (whether an agreement of the two counts)
    pairs: pd.DataFrame
    # One row per layer: `layer`, `height_mm`, `class`, `consensus` (names joined by commas), `verdict`, `rests_on` (the two names of
    # the consensus that agree within the narrowest limit)
    layers: pd.DataFrame
    stacks: Mapping[str, pd.DataFrame]  # by backend, the columns of `contour_figures`, one row per layer
    findings: list[Disagreement]
    passed: bool  # whether a layer was compared, and none has an outlier, is undecided, or is empty although the part is not
    compared_layers: int  # layers on which at least one gated pair that is evidence had regions to compare
    without_weight: Mapping[str, str] = field(default_factory=dict)  # why a backend is no evidence


def compare_all(
    stacks: Mapping[str, LayerSource], part: Part, bounds: Bounds, exact: Mapping[str, bool],
    rules: Mapping[str, str], settings: ComparisonSettings | None = None,
    progress: Callable[[int], None] | None = None, borders: Ints | None = None,
    evidence: EvidenceRule = EVERY_AGREEMENT,
) -> Comparison:  # fmt: skip
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
    given_mm = settings.plane_margin_mm
    margins = {n: bounds[n][1] if given_mm is None else given_mm for n in names}
    classes = {m: layer_classes(part, heights, m) for m in {*margins.values(), 0.0}}
    couples = [
        Pair(i, j, bounds[a][0] + bounds[b][0] + settings.tolerance_mm, bool(exact[a]), bool(exact[b]))
        for (i, a), (j, b) in combinations(enumerate(names), 2)
    ]
    weightless = evidence.without_weight({n: bounds[n] for n in names})
    of_pairs = [classes[max(margins[names[pair.a]], margins[names[pair.b]])] for pair in couples]
    tables, figures = _measured(stacks, couples, of_pairs, part, progress, borders)
    compared, empty = np.zeros(heights.size, np.bool_), crossing_counts(part, heights) > 0
    for pair, rows in zip(couples, tables, strict=True):
        a, b = names[pair.a], names[pair.b]
        rows.insert(0, "b", b)
        rows.insert(0, "a", a)
        rows["gated"] = (rows["class"] == GENERIC) | (rules[a] == HALF_OPEN and rules[b] == HALF_OPEN)
        rows["evidence"] = evidence.counts(a, b, weightless)
        compared |= (rows["gated"] & rows["evidence"] & (rows["rings_a"] + rows["rings_b"] > 0)).to_numpy()
    for stack in figures:
        empty &= stack["outer_rings"].to_numpy() == 0
    allow_doubt(list(stacks.values()), couples, tables, settings.doubt_mm)
    consensus, verdicts, best_pairs = _verdicts(len(names), tables, empty)
    layers = pd.DataFrame(
        {
            "layer": np.arange(heights.size),
            "height_mm": heights,
            "class": classes[max(margins.values(), default=0.0)].astype(object),
            "consensus": [",".join(names[i] for i in members) for members in consensus],
            "verdict": verdicts,
            "rests_on": [",".join(names[i] for i in pair) for pair in best_pairs],
        }
    )
    return Comparison(
        pairs=pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(),
        layers=layers,
        stacks=dict(zip(names, figures, strict=True)),
        findings=list(named_findings(part, stacks, tables, heights, consensus, verdicts)),
        passed=bool(compared.any()) and not {OUTLIER, UNDECIDED, EMPTY} & set(verdicts),
        compared_layers=int(compared.sum()),
        without_weight=weightless,
    )


def _measured(
    stacks: Mapping[str, LayerSource], couples: list[Pair], classes: list[NDArray[np.str_]], part: Part,
    progress: Callable[[int], None] | None, borders: Ints | None,
) -> tuple[list[pd.DataFrame], list[pd.DataFrame]]:  # fmt: skip
    """Table of each pair, and figures of each stack, in one pass over the layers."""
    # Coordinates from the part's middle lose no digits to a far origin, and the middle is the same for every block.
    x, y, _ = part.bounds.mean(axis=0).tolist()
    tables: list[list[pd.DataFrame]] = [[] for _ in couples]
    figures: list[list[pd.DataFrame]] = [[] for _ in stacks]
    for first, block in blocks_of(list(stacks.values()), borders):
        measures = measure_stacks(block, couples, (x, y), progress)
        for p, pair in enumerate(couples):
            a, b = block[pair.a], block[pair.b]
            rows = table(a, b, measures[p], pair.limit_mm, classes[p][first : first + len(a)], (x, y))
            tables[p].append(rows.assign(layer=rows["layer"] + first))
        for column, layers in zip(figures, block, strict=True):
            column.append(contour_figures(layers))
    of_pairs, of_stacks = ([pd.concat(rows, ignore_index=True) for rows in every] for every in (tables, figures))
    return of_pairs, of_stacks


def _verdicts(
    count: int, tables: list[pd.DataFrame], empty: Bools
) -> tuple[list[tuple[int, ...]], list[str], list[tuple[int, ...]]]:
    """Consensus (indices of backends), verdict, and the two backends that it rests on, of each layer; `empty` ones lack sections."""
    couples = list(combinations(range(count), 2))
    gated, agrees, counts = (
        np.array([rows[column] for rows in tables], np.bool_).reshape(len(couples), empty.size).T
        for column in ("gated", "agrees", "evidence")
    )
    limits = np.array([rows["limit_mm"].max() for rows in tables])

    def judged(layer: int) -> tuple[tuple[int, ...], str, tuple[int, ...]]:
        if empty[layer] or not couples:
            return (), EMPTY if couples else NOT_COMPARED, ()
        members, verdict = agreement(couples, gated[layer], agrees[layer], counts[layer])
        good = gated[layer] & agrees[layer] & counts[layer]
        return members, verdict, best_pair(members, count, good, limits) or ()

    # Few patterns of agreement occur: each is solved once.
    patterns = [row.tobytes() for row in np.column_stack([empty, gated, agrees])]
    layer_of = {pattern: layer for layer, pattern in enumerate(patterns)}
    solved = {pattern: judged(layer) for pattern, layer in layer_of.items()}
    results = [solved[pattern] for pattern in patterns]
    return [r[0] for r in results], [r[1] for r in results], [r[2] for r in results]


def agreement(
    couples: list[tuple[int, int]], gated: Bools, agrees: Bools, counts: Bools | None = None
) -> tuple[tuple[int, ...], str]:
    """Largest consistent set of one layer and its verdict, by trying every set of backends.

    Only agreements that are evidence count (`counts`; None: all); every disagreement counts.
    """
    good = gated & agrees if counts is None else gated & agrees & counts
    friends = {couple for couple, ok in zip(couples, good, strict=True) if ok}
    foes = {couple for couple, ok in zip(couples, gated & ~agrees, strict=True) if ok}
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
    tables = [one.pairs for one in comparisons if len(one.pairs)]
    pairs = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    if tables:  # pair after pair, and by layer in each
        pair, _ = pd.factorize(pd.MultiIndex.from_frame(pairs[["a", "b"]]))
        pairs = pairs.iloc[np.lexsort((pairs["layer"].to_numpy(), pair))].reset_index(drop=True)
    return Comparison(
        pairs=pairs,
        layers=layers,
        stacks=stacks,
        findings=[finding for one in comparisons for finding in one.findings],
        passed=compared > 0 and not layers["verdict"].isin([OUTLIER, UNDECIDED, EMPTY]).any(),
        compared_layers=compared,
        without_weight={name: why for one in comparisons for name, why in one.without_weight.items()},
    )

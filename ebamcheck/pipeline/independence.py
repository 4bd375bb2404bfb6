"""Evidence of a run: which slicers are independent, and on which two of them each layer rests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Any

from ebamcheck.comparison import Comparison
from ebamcheck.comparison.independence import EvidenceRule
from ebamcheck.plugins import registry
from ebamcheck.result import Check
from ebamcheck.settings.config import Config


def evidence_rule(config: Config, names: Iterable[str]) -> EvidenceRule:
    """Which agreements of these slicers count: see ``comparison.evidence_share``."""
    share = config.comparison.evidence_share
    kin = [pair for pair in combinations(names, 2) if registry.one_method(*pair)]
    return EvidenceRule(
        share * config.process.bead_width_mm, share * config.layer_height_mm, frozenset(map(frozenset, kin))
    )


def no_evidence(comparison: Comparison) -> Iterator[Check]:
    """Slicers that ran and prove nothing."""
    for name, why in comparison.without_weight.items():
        yield Check.finding(
            "warning",
            "no-evidence",
            f"agreement with {name} proves nothing: {why}, the share comparison.evidence_share of bead or layer",
            name,
            remedy=f"give {name} settings of a narrower bound, or run without it",
        )


def not_counted(comparison: Comparison) -> list[str]:
    """Slicers and pairs whose agreement counts for nothing, and why, in short."""
    said = [f"{name} is no evidence: {why}" for name, why in comparison.without_weight.items()]
    if len(comparison.pairs):
        one = comparison.pairs[~comparison.pairs["evidence"]][["a", "b"]].drop_duplicates()
        said += [
            f"{a} and {b} are one method"
            for a, b in one.itertuples(index=False)
            if not {a, b} & set(comparison.without_weight)
        ]
    return said


def evidence_records(comparison: Comparison) -> list[dict[str, Any]]:
    """Runs of layers that rest on the same two slicers: their names, first and last layer; none where there are none."""
    found: list[dict[str, Any]] = []
    for layer, names in enumerate(comparison.layers["rests_on"]):
        methods = names.split(",") if names else []
        if found and found[-1]["methods"] == methods:
            found[-1]["last_layer"] = layer
        else:
            found.append({"methods": methods, "first_layer": layer, "last_layer": layer})
    return found


def resting(comparison: Comparison) -> str:
    """On which two slicers the layers rest, in short."""
    counts = Counter(str(names) for names in comparison.layers["rests_on"] if names)
    if len(counts) == 1 and counts.total() == len(comparison.layers):
        return f"every one rests on {_named(*counts)}"
    parts = [f"{_named(names)} ({count})" for names, count in counts.most_common()]
    return f"evidence of {', '.join(parts)}" if parts else ""


def _named(pair: str) -> str:
    return " and ".join(pair.split(","))

"""Naming of disagreements: each gets its place, its likely cause and a remedy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ebamcheck.comparison import place_causes as local
from ebamcheck.comparison import whole_causes as systematic
from ebamcheck.comparison.diagnosis import cause_of, diagnose
from ebamcheck.comparison.outline import outline
from ebamcheck.comparison.pairwise import GENERIC
from ebamcheck.comparison.place_causes import MeshFlaws, Place, declared_doubt, likely_cause
from ebamcheck.comparison.sheets import Reader
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.comparison.whole_causes import Cause
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Differing:
    """A slicer that differs from another on a layer, with the figures of the pair."""

    layer: int
    backend: str
    against: str
    columns: Columns
    is_second: bool  # whether the slicer that differs is the second one of the pair


def named_findings(
    part: Part,
    stacks: Mapping[str, LayerSource],
    tables: list[pd.DataFrame],
    heights: Floats,
    consensus: list[tuple[int, ...]],
    verdicts: list[str],
) -> Iterator[Disagreement]:
    """Every disagreement on the layers on which not all slicers agree, in the order of layers.

    `tables` has the figures of each pair of stacks, in the order of their combinations; `consensus` the members of the
    consensus of each layer, as indices of `stacks`.
    """
    flaws, names = MeshFlaws(part), list(stacks)
    columns = [{name: rows[name].to_numpy() for name in rows.columns} for rows in tables]
    pairs: dict[tuple[str, str], list[Differing]] = {}
    every = list(_differing(names, columns, consensus, verdicts))
    for one in every:
        pairs.setdefault((one.backend, one.against), []).append(one)
    causes = {key: _diagnosed(pair, stacks, heights, flaws) for key, pair in pairs.items()}
    namer = _Namer(flaws, stacks)
    findings = [namer.named(one, causes[one.backend, one.against]) for one in every]
    findings += [
        _empty_finding(flaws, names, layer, float(heights[layer]), columns)
        for layer, verdict in enumerate(verdicts)
        if verdict == EMPTY
    ]
    return iter(sorted(findings, key=lambda f: f.layer))


def _differing(
    names: list[str], tables: list[Columns], consensus: list[tuple[int, ...]], verdicts: list[str]
) -> Iterator[Differing]:
    """Every slicer that differs from another one, layer by layer."""
    for layer, (members, verdict) in enumerate(zip(consensus, verdicts, strict=True)):
        if verdict not in (OUTLIER, UNDECIDED):
            continue
        for (i, j), columns in zip(combinations(range(len(names)), 2), tables, strict=True):
            if not columns["gated"][layer] or columns["agrees"][layer]:
                continue
            if members and i not in members and j not in members:
                continue  # two outliers: each is named against the consensus
            backend, against = (j, i) if i in members else (i, j)
            yield Differing(layer, names[backend], names[against], columns, i in members)


def _diagnosed(
    pair: Sequence[Differing], stacks: Mapping[str, LayerSource], heights: Floats, flaws: MeshFlaws
) -> tuple[Cause, ...]:
    """Find the systematic causes of a pair; none where planes pass through vertices only, which is then the common cause.

    Layers with open paths are left out: their common cause is a mesh that is not closed.
    """
    columns, order = pair[0].columns, ("b", "a") if pair[0].is_second else ("a", "b")
    open_paths = columns["open_a"] + columns["open_b"]
    closed = np.array([one.layer for one in pair if not open_paths[one.layer]], np.int64)
    if not (columns["class"][closed] == GENERIC).any():
        return ()
    areas = np.array([columns[f"area_{which}_mm2"] for which in order])
    rings = np.array([columns[f"rings_{which}"] for which in order])
    x, y, _ = flaws.part.bounds.mean(axis=0).tolist()
    a, b = stacks[pair[0].backend], stacks[pair[0].against]
    return diagnose(a, b, closed, heights, areas, rings, flaws, (x, y))


class _Namer:
    """Names disagreements; reads the layers of both slicers if the mesh shows no cause."""

    def __init__(self, flaws: MeshFlaws, stacks: Mapping[str, LayerSource]) -> None:
        self._flaws = flaws
        self._declared = {name: stack.settings for name, stack in stacks.items()}
        self._readers = {name: Reader(stack) for name, stack in stacks.items()}

    def named(self, differing: Differing, causes: tuple[Cause, ...]) -> Disagreement:
        """Name one disagreement of a pair."""
        layer, backends = differing.layer, (differing.backend, differing.against)
        row = {name: values[layer] for name, values in differing.columns.items()}
        depth, limit, x_mm, y_mm, height_mm = (
            float(row[name]) for name in ("depth_mm", "limit_mm", "depth_x_mm", "depth_y_mm", "height_mm")
        )
        rings, holes = (abs(int(row[f"{name}_a"]) - int(row[f"{name}_b"])) for name in ("rings", "holes"))
        metric = ("depth", depth, limit) if depth > limit else ("topology", float(rings or holes), 0.0)
        has_open = bool(row["open_a"] + row["open_b"] > 0)
        place = Place(x_mm, y_mm, height_mm, depth, limit, str(row["class"]), has_open)
        declared = [self._declared[name] for name in backends]
        finding = (layer, height_mm, *backends, *metric, x_mm, y_mm)
        cause = cause_of(causes, layer)
        if cause is not None and not (place.known and declared_doubt(place, declared)):
            size = cause.size, cause.unit, cause.share
            return Disagreement(*finding, cause.kind, cause.in_words(), *size, remedy(cause.kind, *backends))

        def contours() -> list[Floats]:
            return [outline(self._readers[n].layer(layer), 0, (0.0, 0.0)).segments for n in backends]

        likely = likely_cause(self._flaws, place, declared, contours)
        return Disagreement(*finding, likely, likely, remedy=remedy(likely, *backends))


def _empty_finding(
    flaws: MeshFlaws, names: list[str], layer: int, height_mm: float, tables: list[Columns]
) -> Disagreement:
    """Name a layer that is empty in all stacks although facets of the part cross it; the value is the area."""
    x, y = flaws.place(height_mm)
    has_open = any(bool(columns["open_a"][layer] + columns["open_b"][layer] > 0) for columns in tables)
    extent, layer_class = float(np.linalg.norm(flaws.part.size)), str(tables[0]["class"][layer])
    cause = likely_cause(flaws, Place(x, y, height_mm, extent, 0.0, layer_class, has_open))
    backends = ",".join(names)
    finding = (layer, height_mm, backends, "part", "empty", 0.0, 0.0, x, y, cause, cause)
    return Disagreement(*finding, remedy=remedy(cause, backends, "part"))


# -- Remedies for a disagreement, by its cause: a setting, another slicer, another direction, or a repair of the part

LEAVE_OUT = "leave {backend} out (--backends), and tell those who make it"
SETTINGS = "look at the settings of {backend} (slicing.settings.{backend})"
MEND = "mend the mesh at this place, or slice by a method that does not need it whole"

# Remedies by cause; for a cause that a slicer declares in its own words it is `DECLARED`
REMEDIES: Mapping[str, str] = {
    local.COPLANAR_FACE: "shift the layers a little (layers.layer_height_mm, layers.heights_mm), or turn the part (part.direction)",
    local.VERTEX: "shift the layers a little (layers.layer_height_mm, layers.heights_mm)",
    local.OPEN_EDGE: MEND,
    local.NON_MANIFOLD: MEND,
    local.ORIENTATION: "turn the facets (--fix-orientation), or mend the mesh",
    local.OVERLAP: "unite the bodies in the model, or leave out the one of both slicers with another inside rule (ebamcheck backends)",
    local.SELF_INTERSECTION: MEND,
    local.TOUCHING: "unite the bodies in the model, or move them apart",
    local.OPEN_PATH: MEND,
    local.OPEN_SURFACE: MEND,
    local.THIN: "make the wall thicker in the model, or sample more finely (slicing.settings.{backend})",
    local.THIN_GAP: "make the gap wider in the model, or sample more finely (slicing.settings.{backend})",
    local.SHALLOW: "shift the layers a little (layers.heights_mm), or turn the part (part.direction)",
    local.UNKNOWN_CAUSE: "look at the layer in the report, and slice with a third method that shows which of both is wrong",
    systematic.OFFSET: SETTINGS + " for a compensation of bead or pixel, else " + LEAVE_OUT,
    systematic.TRANSLATION: SETTINGS + " for an origin or a bed, else " + LEAVE_OUT,
    systematic.HEIGHT: SETTINGS + " for the height within a layer at which it cuts, else " + LEAVE_OUT,
    systematic.SCALE: SETTINGS + " for a scale or a compensation of shrinkage, else " + LEAVE_OUT,
    systematic.UNIT: "check the unit of the file (--units), then " + SETTINGS,
    systematic.ROTATION: "check part.direction, then " + SETTINGS,
    systematic.MIRROR: SETTINGS + " for the side from which layers are seen, else " + LEAVE_OUT,
    systematic.MISSING_OUTER: SETTINGS + " for a least area of islands, else " + LEAVE_OUT,
    systematic.MISSING_HOLE: SETTINGS + " for a least area of holes, else " + LEAVE_OUT,
    systematic.EXTRA_OUTER: SETTINGS + " for supports, skirts or rafts, else " + LEAVE_OUT,
    systematic.EXTRA_HOLE: SETTINGS + " for its inside rule, else " + LEAVE_OUT,
    systematic.NESTING: LEAVE_OUT,
    systematic.ORIENTATION: LEAVE_OUT,
    systematic.WINDING_RULE: "unite the bodies in the model, or " + LEAVE_OUT,
    systematic.QUANTISATION: SETTINGS + " for the decimals or the grid of its coordinates, else " + LEAVE_OUT,
    systematic.DROPPED: SETTINGS + " for a least area or a first layer, else " + LEAVE_OUT,
    systematic.DUPLICATED: SETTINGS + " for its layer height, else " + LEAVE_OUT,
    systematic.SHIFTED: SETTINGS + " for its first layer, else " + LEAVE_OUT,
}  # fmt: skip

DECLARED = "trust {against} here and leave {backend} out (--backends), or mend the mesh at this place"


def remedy(cause: str, backend: str, against: str) -> str:
    """Remedy for a disagreement of one slicer with another, without a full stop.

    Examples
    --------
    >>> remedy("open path", "pixels", "planecut")
    'mend the mesh at this place, or slice by a method that does not need it whole'
    """
    return REMEDIES.get(cause, DECLARED).format(backend=backend, against=against)


# Verdicts on a layer
AGREE, OUTLIER, UNDECIDED, NOT_COMPARED, EMPTY = "agree", "outlier", "undecided", "not-compared", "empty"


@dataclass(frozen=True)
class Disagreement:
    """One disagreement on one layer."""

    layer: int
    height_mm: float
    backend: str  # the outlier; on an undecided layer, either of the two
    against: str  # the backend it was compared with, or `part` for a layer that came out empty
    metric: str  # "depth", "topology" (numbers of outer rings and holes) or "empty"
    value: float
    limit: float
    x_mm: float
    y_mm: float
    cause: str  # kind of the likely cause: "translation", "open edge", "unknown"
    cause_text: str = ""  # the cause with its size and the share of the difference that it explains, if known
    cause_size: float | None = None  # fitted size of the cause, in `cause_unit`; None if it has none
    cause_unit: str = ""
    cause_share: float | None = None  # share of the difference that the cause explains, 0 .. 1
    remedy: str = ""  # without a full stop

    @property
    def excess(self) -> float:
        """Severity: the value over its limit; a finding without a limit is the most severe."""
        return self.value / self.limit if self.limit > 0.0 else math.inf


def worst_of(findings: Sequence[Disagreement]) -> Disagreement | None:
    """The most severe finding: the largest excess, then the lowest layer; None if there is none."""
    return max(findings, key=lambda f: (f.excess, -f.layer), default=None)

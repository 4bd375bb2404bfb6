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
from ebamcheck.comparison.diagnosis import Differing, cause_of, diagnose
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
class Told:
    """A slicer that differs from another on a layer, with the figures of the pair."""

    layer: int
    backend: str
    against: str
    columns: Columns
    is_second: bool
    """Whether the slicer that differs is the second one of the pair."""


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
    every = list(_disagreeing(names, columns, consensus, verdicts))
    pairs: dict[tuple[str, str], list[Told]] = {}
    for told in every:
        pairs.setdefault((told.backend, told.against), []).append(told)
    x, y, _ = part.bounds.mean(axis=0).tolist()
    causes = {key: _diagnosed(pair, stacks, heights, flaws, (x, y)) for key, pair in pairs.items()}
    namer = _Namer(flaws, stacks)
    found = [namer.named(told, causes[told.backend, told.against]) for told in every]
    found += [
        _empty_finding(flaws, names, layer, float(heights[layer]), columns)
        for layer, verdict in enumerate(verdicts)
        if verdict == EMPTY
    ]
    return iter(sorted(found, key=lambda f: f.layer))


def _disagreeing(
    names: list[str],
    columns: list[dict[str, NDArray[Any]]],
    consensus: list[tuple[int, ...]],
    verdicts: list[str],
) -> Iterator[Told]:
    """Every slicer that differs from another one, layer by layer."""
    couples = list(combinations(range(len(names)), 2))
    for layer, verdict in enumerate(verdicts):
        if verdict not in (OUTLIER, UNDECIDED):
            continue
        members = consensus[layer]
        for (i, j), column in zip(couples, columns, strict=True):
            if not column["gated"][layer] or column["agrees"][layer]:
                continue
            if members and i not in members and j not in members:
                continue  # two outliers: each is named against the consensus
            is_second = i in members
            backend, against = (j, i) if is_second else (i, j)
            yield Told(layer, names[backend], names[against], column, is_second)


def _diagnosed(
    pair: Sequence[Told],
    stacks: Mapping[str, LayerSource],
    heights: Floats,
    flaws: MeshFlaws,
    origin_mm: tuple[float, float],
) -> tuple[Cause, ...]:
    """Find the systematic causes of a pair; none where planes pass through vertices only, which is then the common cause.

    Layers with open paths are left out: their common cause is a mesh that is not closed.
    """
    columns = pair[0].columns
    open_paths = columns["open_a"] + columns["open_b"]
    closed = np.array([told.layer for told in pair if not open_paths[told.layer]], np.int64)
    if not (columns["class"][closed] == GENERIC).any():
        return ()
    order = ("b", "a") if pair[0].is_second else ("a", "b")
    found = Differing(
        closed,
        heights,
        np.array([columns[f"area_{which}_mm2"] for which in order]),
        np.array([columns[f"rings_{which}"] for which in order]),
    )
    return diagnose(stacks[pair[0].backend], stacks[pair[0].against], found, flaws, origin_mm)


class _Namer:
    """Names disagreements; reads the layers of both slicers if the mesh shows no cause."""

    def __init__(self, flaws: MeshFlaws, stacks: Mapping[str, LayerSource]) -> None:
        self._flaws = flaws
        self._declared = {name: stack.settings for name, stack in stacks.items()}
        self._readers = {name: Reader(stack) for name, stack in stacks.items()}

    def named(self, told: Told, causes: tuple[Cause, ...]) -> Disagreement:
        """Name one disagreement of a pair."""
        row = {name: values[told.layer] for name, values in told.columns.items()}
        backends = (told.backend, told.against)
        depth, limit = float(row["depth_mm"]), float(row["limit_mm"])
        rings = abs(int(row["rings_a"]) - int(row["rings_b"])) or abs(
            int(row["holes_a"]) - int(row["holes_b"])
        )
        metric = ("depth", depth, limit) if depth > limit else ("topology", float(rings), 0.0)
        x_mm, y_mm, height_mm = (float(row[name]) for name in ("depth_x_mm", "depth_y_mm", "height_mm"))
        place = Place(
            x_mm, y_mm, height_mm, depth, limit, str(row["class"]), bool(row["open_a"] + row["open_b"] > 0)
        )
        declared = [self._declared[name] for name in backends]
        finding = (told.layer, height_mm, *backends, *metric, x_mm, y_mm)
        cause = cause_of(causes, told.layer)
        if cause is not None and not (place.known and declared_doubt(place, declared)):
            return Disagreement(
                *finding, cause.kind, cause.in_words(), cause.size, cause.unit, cause.share,
                remedy(cause.kind, *backends),
            )  # fmt: skip
        likely = likely_cause(
            self._flaws, place, declared, lambda: [self._segments(name, told.layer) for name in backends]
        )
        return Disagreement(*finding, likely, likely, remedy=remedy(likely, *backends))

    def _segments(self, name: str, layer: int) -> Floats:
        return outline(self._readers[name].layer(layer), 0, (0.0, 0.0)).segments


def _empty_finding(
    flaws: MeshFlaws, names: list[str], layer: int, height_mm: float, columns: list[dict[str, NDArray[Any]]]
) -> Disagreement:
    """Name a layer that is empty in all stacks although facets of the part cross it; the value is the area."""
    x, y = flaws.place(height_mm)
    column = columns[0]
    open_paths = any(bool(c["open_a"][layer] + c["open_b"][layer] > 0) for c in columns)
    extent = float(np.linalg.norm(flaws.part.size))
    place = Place(x, y, height_mm, extent, 0.0, str(column["class"][layer]), open_paths)
    cause = likely_cause(flaws, place)
    backends = ",".join(names)
    return Disagreement(
        layer, height_mm, backends, "part", "empty", 0.0, 0.0, x, y, cause, cause,
        remedy=remedy(cause, backends, "part"),
    )  # fmt: skip


# -- Remedies for a disagreement, by its cause: a setting, another slicer, another direction, or a repair of
# the part.


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
    backend: str
    """The outlier; on an undecided layer, either of the two."""
    against: str
    """The backend it was compared with, or ``part`` for a layer that came out empty."""
    metric: str
    """``depth``, ``topology`` (numbers of outer rings and holes) or ``empty``."""
    value: float
    limit: float
    x_mm: float
    y_mm: float
    cause: str
    """Kind of the likely cause: ``translation``, ``open edge``, ``unknown``."""
    cause_text: str = ""
    """Description of the cause, with its size and the share of the difference that it explains, if known."""
    cause_size: float | None = None
    """Fitted size of the cause, in `cause_unit`; None if it has none."""
    cause_unit: str = ""
    cause_share: float | None = None
    """Share of the difference between the two slicers that the cause explains, 0 .. 1."""
    remedy: str = ""
    """What to do about it, without a full stop."""

    @property
    def excess(self) -> float:
        """Severity: the value over its limit; a finding without a limit is the most severe."""
        return self.value / self.limit if self.limit > 0.0 else math.inf


def worst_of(findings: Sequence[Disagreement]) -> Disagreement | None:
    """The most severe finding: the largest excess, then the lowest layer; None if there is none."""
    return max(findings, key=lambda f: (f.excess, -f.layer), default=None)

"""Disagreements of slicers by name: each with its place, its systematic or likely cause, and a remedy."""

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
from ebamcheck.comparison.fit_causes import ENOUGH, LEAST, contour_causes, other_rule, wrong_unit
from ebamcheck.comparison.outline import outline
from ebamcheck.comparison.pairwise import GENERIC
from ebamcheck.comparison.place_causes import MeshFlaws, Place, declared_doubt, likely_cause
from ebamcheck.comparison.sources import LayerSource, Reader
from ebamcheck.comparison.whole_causes import Cause, Sheet, layer_causes, ring_causes, sample, total_mm2
from ebamcheck.kernels import Floats, Ints
from ebamcheck.mesh.part import Part

Columns = Mapping[str, NDArray[Any]]
Readers = tuple[Reader, Reader]  # of the slicer that differs, and of the other


def named_findings(
    part: Part, stacks: Mapping[str, LayerSource], tables: list[pd.DataFrame], heights: Floats,
    consensus: list[tuple[int, ...]], verdicts: list[str],
) -> Iterator[Disagreement]:  # fmt: skip
    """Every disagreement on the layers on which not all slicers agree, in the order of layers.

    `tables` has the figures of each pair of stacks, in the order of their combinations; `consensus` the members of the
    consensus of each layer, as indices of `stacks`.
    """
    flaws, names, readers = MeshFlaws(part), list(stacks), [Reader(stack) for stack in stacks.values()]
    columns = [{name: rows[name].to_numpy() for name in rows.columns} for rows in tables]
    findings: list[tuple[int, int, Disagreement]] = []  # with layer and pair, by which they are sorted
    differing: dict[tuple[int, int, int], list[int]] = {}  # layers by pair, slicer that differs, and the other
    for layer, (members, verdict) in enumerate(zip(consensus, verdicts, strict=True)):
        if verdict == EMPTY:
            findings.append((layer, 0, _empty_finding(flaws, names, layer, float(heights[layer]), columns)))
        if verdict not in (OUTLIER, UNDECIDED):
            continue
        for p, (i, j) in enumerate(combinations(range(len(names)), 2)):
            if not columns[p]["gated"][layer] or columns[p]["agrees"][layer]:
                continue
            if members and i not in members and j not in members:
                continue  # two outliers: each is named against the consensus
            backend, against = (j, i) if i in members else (i, j)
            differing.setdefault((p, backend, against), []).append(layer)
    for (p, backend, against), layers in differing.items():
        pair, both = (names[backend], names[against]), (readers[backend], readers[against])
        order = ("b", "a") if backend > against else ("a", "b")
        causes = _diagnosed(columns[p], order, layers, heights, both, flaws)
        findings += [(k, p, _named(columns[p], k, pair, both, causes, flaws)) for k in layers]
    return iter([finding for _, _, finding in sorted(findings, key=lambda found: found[:2])])


def _diagnosed(
    columns: Columns, order: tuple[str, str], layers: list[int], heights: Floats, readers: Readers, flaws: MeshFlaws
) -> tuple[Cause, ...]:  # fmt: skip
    """Systematic causes of a pair; none where planes pass through vertices only, which is then the common cause.

    Layers with open paths are left out: their common cause is a mesh that is not closed. `order` names the columns of both.
    """
    open_paths = columns["open_a"] + columns["open_b"]
    closed = np.array([layer for layer in layers if not open_paths[layer]], np.int64)
    if not (columns["class"][closed] == GENERIC).any():
        return ()
    areas = np.array([columns[f"area_{which}_mm2"] for which in order])
    rings = np.array([columns[f"rings_{which}"] for which in order])
    return diagnose(readers, closed, heights, areas, rings, flaws)


def _named(
    columns: Columns, layer: int, backends: tuple[str, str], readers: Readers, causes: tuple[Cause, ...],
    flaws: MeshFlaws,
) -> Disagreement:  # fmt: skip
    """Name one disagreement of a pair; the layers of both are read if the mesh shows no cause."""
    row = {name: values[layer] for name, values in columns.items()}
    depth, limit, x_mm, y_mm, height_mm = (
        float(row[name]) for name in ("depth_mm", "limit_mm", "depth_x_mm", "depth_y_mm", "height_mm")
    )
    rings, holes = (abs(int(row[f"{name}_a"]) - int(row[f"{name}_b"])) for name in ("rings", "holes"))
    metric = ("depth", depth, limit) if depth > limit else ("topology", float(rings or holes), 0.0)
    has_open = bool(row["open_a"] + row["open_b"] > 0)
    place = Place(x_mm, y_mm, height_mm, depth, limit, str(row["class"]), has_open)
    declared = [reader.source.settings for reader in readers]
    finding = (layer, height_mm, *backends, *metric, x_mm, y_mm)
    # The cause that explains most, of those that affect the layer.
    cause = next((c for c in causes if c.layers is None or layer in c.layers), None)
    if cause is not None and not (place.known and declared_doubt(place, declared)):
        size = cause.size, cause.unit, cause.share
        return Disagreement(*finding, cause.kind, cause.in_words(), *size, remedy(cause.kind, *backends))

    def contours() -> list[Floats]:
        return [outline(reader.layer(layer), 0, (0.0, 0.0)).segments for reader in readers]

    likely = likely_cause(flaws, place, declared, contours)
    return Disagreement(*finding, likely, likely, remedy=remedy(likely, *backends))


def _empty_finding(
    flaws: MeshFlaws, names: list[str], layer: int, height_mm: float, tables: Sequence[Columns]
) -> Disagreement:
    """Name a layer that is empty in all stacks although facets of the part cross it; the value is the area."""
    x, y = flaws.place(height_mm)
    has_open = any(bool(columns["open_a"][layer] + columns["open_b"][layer] > 0) for columns in tables)
    extent, layer_class = float(np.linalg.norm(flaws.part.size)), str(tables[0]["class"][layer])
    cause = likely_cause(flaws, Place(x, y, height_mm, extent, 0.0, layer_class, has_open))
    backends = ",".join(names)
    finding = (layer, height_mm, backends, "part", "empty", 0.0, 0.0, x, y, cause, cause)
    return Disagreement(*finding, remedy=remedy(cause, backends, "part"))


# -- Systematic causes of the difference of two slicers, each with its size and the share that it explains ------------

# Least share of a difference that the causes together must explain to be named: noise, too, fits some cause by chance, and a scale
# that explains 51 % fits a square that has lost a corner
NAMED = 0.55
LARGE = 1.5  # factor of size from which sections differ by their unit


def diagnose(
    readers: Readers, differing: Ints, heights: Floats, areas: Floats, rings: Ints, flaws: MeshFlaws
) -> tuple[Cause, ...]:
    """Systematic causes of the differences of one slicer from another, the one that explains most first; none for noise.

    They differ on the layers `differing` (n,), rising; heights (L,), areas and numbers of closed rings (2, L) are of all layers, those
    of the first slicer first. At most :data:`~ebamcheck.comparison.whole_causes.MOST_SHEETS` layers are examined.
    """
    x, y, _ = flaws.part.bounds.mean(axis=0).tolist()
    solid = differing[rings[0, differing] > 0]
    sheets = sample(solid, rings.sum(axis=0), heights, *readers, (x, y))
    unit = _unit(sheets, flaws)
    if unit is not None:
        return (unit,)
    causes, left = layer_causes(sheets, differing, areas, rings, readers[1])
    remains = max(1.0 - sum(cause.share for cause in causes), 0.0)
    if left and remains > LEAST:
        step_mm = float(np.median(np.diff(heights))) if heights.size > 1 else 1.0
        causes += [cause.scaled(remains) for cause in _in_sheets(left, flaws, step_mm)]
    causes = sorted((c for c in causes if c.share >= LEAST), key=lambda c: -c.share)
    return tuple(causes) if sum(c.share for c in causes) >= NAMED else ()


def _unit(sheets: Sequence[Sheet], flaws: MeshFlaws) -> Cause | None:
    """A mistaken unit of the whole part, which also changes the section at each height."""
    solid = [sheet for sheet in sheets if sheet.both_solid]
    areas = [[float(np.abs(stack.ring_areas).sum()) for stack in (sheet.a, sheet.b)] for sheet in solid]
    ratios = [of_a / max(of_b, 1e-300) for of_a, of_b in areas]
    if not ratios or 1.0 / LARGE < math.sqrt(float(np.median(ratios))) < LARGE:
        return None
    unit = wrong_unit(solid, flaws)
    return unit if unit.share >= ENOUGH else None


def _in_sheets(sheets: list[Sheet], flaws: MeshFlaws, step_mm: float) -> list[Cause]:
    """Causes in whole rings, and in the position and size of contours."""
    rule = other_rule(sheets, flaws)
    if rule is not None and rule.share >= ENOUGH:
        return [rule]
    before = total_mm2(sheets)
    causes, mended = ring_causes(sheets, LEAST)
    remains = total_mm2(mended) / before if before > 0.0 else 0.0
    solid = [sheet for sheet in mended if sheet.both_solid]
    if remains > LEAST and solid:
        causes += [cause.scaled(remains) for cause in contour_causes(solid, flaws, step_mm)]
    return causes


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

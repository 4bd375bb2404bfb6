"""Deviation of a slicer's layers from the truth, a model's exact sections; its metrics, their tolerances, and the matrix of what is
measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import GENERIC, layer_classes
from ebamcheck.comparison.measure import FINEST_DEPTH_MM, Figures
from ebamcheck.comparison.pairwise import Pair, measure_stacks, shared_origin
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import sha256_of_json
from ebamcheck.kernels import Bools, Floats
from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import Model, models
from ebamcheck.settings.base import Between, NotNegative, Section
from ebamcheck.settings.checking import checked, read_toml
from ebamcheck.slicers.isolation import Outcome

SECTION_TOLERANCE_MM = 1e-4  # chord error of the dense rings that stand for an exact section
MOST_PLANES = (
    12  # planes through level faces that are cut on top of the uniform layers: enough to meet every kind of face
)
STEP_SHARE = (
    1e-3  # share of the area that may change over the rounding of a height; more is a step that rounding has moved
)
DEPTH_SHARE = (
    0.02  # depth is found to a hundredth of this share of the bound: a loss of a hundredth of the bound must show
)
MEASURED, REFUSED = "measured", "refused"


@dataclass(frozen=True, eq=False)
class Truth:
    """A model made ready: the mesh that slicers cut; heights (L,) of uniform layers' middles and of planes through level faces,
    where `uniform` marks the former; exact sections of the model; and the depth (L,) that the mesh may deviate from them.
    """

    part: Part
    heights: Floats
    uniform: Bools
    layer_height_mm: float
    layers: Layers
    allowance_mm: Floats


@dataclass(frozen=True)
class Measured:
    """Result of one backend on one model."""

    status: str  # ``measured``, or how the backend failed
    why: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)
    # Of each layer compared: number from 0, height, place of its deepest point (None where there is none), and what metrics sum up
    columns: Mapping[str, Sequence[float]] = field(default_factory=dict)


def truth_of(model: Model, tolerance_mm: float, layers: int) -> Truth:
    """Tessellate a model within a tolerance and cut it exactly, in so many uniform layers and through its level faces."""
    part = model.tessellate(tolerance_mm)
    low, high = model.bounds[:, 2].tolist()
    step = (high - low) / layers
    middles = low + (np.arange(layers) + 0.5) * step
    heights = np.union1d(middles, _level_planes(model, part))
    exact = _sections(model, heights)
    uniform = np.isin(heights, middles)
    return Truth(part, heights, uniform, step, exact, _allowance(model, exact, tolerance_mm))


def _level_planes(model: Model, part: Part) -> Floats:
    """Heights of level faces at which mesh and model lie on the same side of a step, although rounding of vertices may have moved
    it down."""
    z = part.vertices[:, 2][part.faces]
    levels = np.unique(z[(z == z[:, :1]).all(axis=1), 0])
    kept = []
    for level in levels.tolist():
        above = level + 2.0 * float(np.spacing(np.float32(np.abs(part.bounds[:, 2]).max())))
        here, there = model.area(level), model.area(above)
        if abs(here - there) <= STEP_SHARE * max(here, there):
            kept.append(level)
    spread = np.unique(np.linspace(0, len(kept) - 1, min(len(kept), MOST_PLANES)).round().astype(int))
    return np.array(kept)[spread] if kept else np.zeros(0)


def _sections(model: Model, heights: Floats) -> Layers:
    cut = [model.section(z, SECTION_TOLERANCE_MM) for z in heights.tolist()]
    return from_polygons(heights, cut, backend="truth")


def _allowance(model: Model, exact: Layers, tolerance_mm: float) -> Floats:
    """Depth that the mesh may have against the exact sections, (L,) mm: it lies about those between z - t and z + t, dilated by
    t."""
    pair, depth = Pair(0, 1, tolerance_mm, True, False), Figures._fields.index("depth")
    moved = []
    for side in (-1.0, 1.0):
        stacks = [exact, _sections(model, exact.heights + side * tolerance_mm).labelled(part="")]
        moved.append(measure_stacks(stacks, [pair], shared_origin(stacks))[0][:, depth])
    return np.asarray(np.maximum(*moved) + tolerance_mm + SECTION_TOLERANCE_MM + FINEST_DEPTH_MM)


def measure_outcome(truth: Truth, outcome: Outcome) -> Measured:
    """Measure the layers that a backend made of the truth's part; those in a vertex or face are left out where it declares no rule
    for them."""
    if outcome.file is None:
        return Measured(outcome.failure, outcome.why)
    judged = np.ones(truth.heights.size, np.bool_)
    if registry.slicer(outcome.name).coplanar_rule != "half-open":
        judged = layer_classes(truth.part, truth.heights, outcome.height_bound_mm) == GENERIC
    compared = np.flatnonzero(judged)
    layers, exact = outcome.read().take(compared), truth.layers.take(compared)
    columns = {"layer": compared.tolist(), **_columns(exact, truth.allowance_mm[compared], outcome, layers)}
    error = (layers.areas() - exact.areas())[truth.uniform[compared]]
    whole = {
        "volume_error_mm3": rounded(abs(float(error.sum())) * truth.layer_height_mm),
        "bound_mm": rounded(outcome.error_bound_mm, decimals=None),
        "not_compared_layers": float(len(truth.heights) - len(compared)),
    }
    return Measured(MEASURED, "", {**summarised(columns), **whole}, columns)


def _columns(exact: Layers, allowance_mm: Floats, outcome: Outcome, layers: Layers) -> dict[str, list[Any]]:
    pair = Pair(0, 1, DEPTH_SHARE * outcome.error_bound_mm, True, False)
    x0, y0 = shared_origin([exact, layers])
    figures = dict(zip(Figures._fields, measure_stacks([exact, layers], [pair], (x0, y0))[0].T, strict=True))
    depth, x, y = figures["depth"], figures["depth_x"], figures["depth_y"]
    hausdorff = np.maximum(figures["hausdorff_ab"], figures["hausdorff_ba"])
    x_mm, y_mm = ([rounded(v) if np.isfinite(v) else None for v in at.tolist()] for at in (x + x0, y + y0))
    lengths = {
        "depth_mm": depth,
        "hausdorff_mm": np.where(np.isfinite(hausdorff), hausdorff, 0.0),
        "area_error_mm2": layers.areas() - exact.areas(),
        "beyond_bound_mm": np.maximum(depth - allowance_mm - outcome.error_bound_mm, 0.0),
    }
    counts = {
        "ring_mismatch": layers.ring_counts() - exact.ring_counts(),
        "hole_mismatch": layers.hole_counts() - exact.hole_counts(),
        "empty_mismatch": (layers.ring_counts() > 0) ^ (exact.ring_counts() > 0),
        "open_paths": layers.open_counts(),
    }
    return {
        "z_mm": [rounded(z, 9, None) for z in exact.heights.tolist()],
        "x_mm": x_mm,
        "y_mm": y_mm,
        **{name: [rounded(v) for v in column.tolist()] for name, column in lengths.items()},
        **{name: column.astype(int).tolist() for name, column in counts.items()},
    }


# -- The figures by which an accuracy is held: each a number of one entry, less is better ----------------------
# A metric that sums up a column of the layers can be explained by it: which layers, by how much, where.
Column = Sequence[float]


@dataclass(frozen=True)
class Metric:
    """One figure: its name, the column of layers that it sums up, how, and what it says."""

    name: str
    column: str
    summary: str
    what: str


SUMMARIES: dict[str, Callable[[Column], float]] = {
    "largest": lambda column: max(map(abs, column), default=0.0),
    "mean": lambda column: math.fsum(map(abs, column)) / len(column) if column else 0.0,
    "count": lambda column: float(sum(value != 0 for value in column)),
}

# Figures that sum up a column of the layers
METRICS = (
    Metric("depth_max_mm", "depth_mm", "largest", "deepest point of the symmetric difference with the exact section"),
    Metric("depth_mean_mm", "depth_mm", "mean", "mean over the layers of their deepest points"),
    Metric("hausdorff_max_mm", "hausdorff_mm", "largest", "largest Hausdorff distance of the contours"),
    Metric("area_error_max_mm2", "area_error_mm2", "largest", "largest error of a layer's area"),
    Metric("area_error_mean_mm2", "area_error_mm2", "mean", "mean error of the layers' areas, signs dropped"),
    Metric("ring_mismatch_layers", "ring_mismatch", "count", "layers with more or fewer rings than the truth"),
    Metric("hole_mismatch_layers", "hole_mismatch", "count", "layers with more or fewer holes than the truth"),
    Metric("empty_mismatch_layers", "empty_mismatch", "count", "layers empty where the truth is not, or the reverse"),
    Metric("open_path_layers", "open_paths", "count", "layers with open paths"),
    Metric("beyond_bound_layers", "beyond_bound_mm", "count", "layers deeper than bound and mesh allow"),
)  # fmt: skip
# Figures of an entry that no column explains
WHOLE = {
    "volume_error_mm3": "areas times layer height, against those of the exact sections",
    "bound_mm": "error bound that the backend declares",
    "not_compared_layers": "layers left out, in a vertex or face where the backend declares no rule",
}

NAMES = (*(metric.name for metric in METRICS), *WHOLE)
# Columns that are held layer by layer, too: a loss on one layer must not hide behind a worse one
LAYER_COLUMNS = tuple(dict.fromkeys(metric.column for metric in METRICS))
TOLERANCE_NAMES = (*NAMES, *LAYER_COLUMNS)


def summarised(columns: Mapping[str, Column]) -> dict[str, float]:
    """All metrics of an entry's columns."""
    return {metric.name: rounded(SUMMARIES[metric.summary](columns[metric.column])) for metric in METRICS}


def rounded(value: float, digits: int = 6, decimals: int | None = 7) -> float:
    """Round to the digits that a baseline keeps, and to a tenth of the finest depth (mm, mm2) that is resolved; zero has no sign.

    >>> rounded(0.0123456789), rounded(-1e-17), rounded(123456.789)
    (0.0123457, 0.0, 123457.0)
    """
    near = value if decimals is None else round(value, decimals)
    return float(f"{near:.{digits}g}") + 0.0


MATRIX = "matrix.toml"


class Case(Section):
    """How a model is tessellated and layered."""

    tolerance_mm: Annotated[float, Between(1e-6, 100.0)] = 0.05
    """Distance that the mesh may have from the surface."""
    layers: Annotated[int, Between(1, 100_000)] = 24
    """Uniform layers, cut at their middles; planes through level faces come on top."""


class Matrix(Section):
    """Models x settings; backends are those of the machine."""

    default: Case = Case()
    models: dict[str, Case] = Field(default_factory=dict)
    """Models that need a case of their own."""
    every_day: tuple[str, ...] = ()
    """Models measured where ``--models`` names none; empty: all that are installed."""
    variant_models: tuple[str, ...] = ()
    """Models on which the variants are measured, too; empty: all."""
    variants: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    """Settings measured on top of the default ones: backend, name of the variant, settings."""

    def case(self, model: str) -> Case:
        """How a model is measured."""
        return self.models.get(model, self.default)


@dataclass(frozen=True)
class Subject:
    """One backend under one choice of settings."""

    backend: str
    settings: BackendSettings

    @property
    def given(self) -> dict[str, Any]:
        """Settings that are not the defaults; they alone make the key, so that a new setting leaves a baseline valid."""
        return self.settings.model_dump(mode="json", exclude_defaults=True)

    def __str__(self) -> str:
        given = ", ".join(f"{key}={value}" for key, value in self.given.items())
        return f"{self.backend} ({given})" if given else self.backend

    def settings_hash(self, case: Case) -> str:
        """Hash of the settings and of the case: what must be the same for two figures to be comparable."""
        return sha256_of_json({"settings": self.given, "case": case.model_dump()})[:12]


def read_matrix(folder: Path) -> Matrix:
    """Read the matrix beside the baselines; without one, every model under default settings."""
    path = folder / MATRIX
    return checked(Matrix, read_toml(path), path) if path.is_file() else Matrix()


def chosen_models(matrix: Matrix, names: Sequence[str]) -> dict[str, Model]:
    """Models named, all for ``all``, or without a name those of every day."""
    if names and names != ("all",):
        return models(names)
    daily = () if names else matrix.every_day
    return {name: model for name, model in models().items() if name in daily or not daily}


def rounds(matrix: Matrix, model: str, backends: Sequence[str]) -> list[dict[str, Subject]]:
    """Sort the subjects of one model into rounds with one subject per backend, whose processes run side by side."""
    varied = not matrix.variant_models or model in matrix.variant_models
    found: list[dict[str, Subject]] = []
    for name in backends:
        given: list[Mapping[str, Any]] = [{}, *(matrix.variants.get(name, {}).values() if varied else ())]
        subjects = [Subject(name, registry.slicer_settings(name, values)) for values in given]
        if len({str(subject) for subject in subjects}) < len(subjects):
            raise SettingsError(f"{MATRIX}: two variants of {name!r} are the same settings: drop one")
        for k, subject in enumerate(subjects):
            if k == len(found):
                found.append({})
            found[k][name] = subject
    return found


class Tolerance(Section):
    """A value may grow to ``old + absolute + relative * |old|`` before it counts as worse."""

    absolute: NotNegative = 0.0
    """In the unit of the metric."""
    relative: NotNegative = 0.0

    def allowed(self, old: float) -> float:
        """Growth that an old value may have."""
        return self.absolute + self.relative * abs(old)


LENGTH = Tolerance(absolute=1e-5, relative=1e-3)  # ten times what the comparison resolves
# Shipped tolerances by the end of a name; bounds of exact slicers are rounding, and counts may not grow at all
SHIPPED = {
    "_mm": LENGTH,
    "_mm2": Tolerance(absolute=1e-3, relative=1e-3),
    "_mm3": Tolerance(absolute=1e-2, relative=1e-3),
    "bound_mm": Tolerance(absolute=1e-6, relative=1e-3),
    "": Tolerance(),
}


def default_tolerance(name: str) -> Tolerance:
    """Return the shipped tolerance of a metric or column, by its unit."""
    return SHIPPED.get(name) or next(found for end, found in SHIPPED.items() if name.endswith(end))


class Tolerances(Section):
    """Tolerances by metric, and by backend and metric; what is not named keeps the shipped one."""

    metrics: dict[str, Tolerance] = Field(default_factory=dict)
    backends: dict[str, dict[str, Tolerance]] = Field(default_factory=dict)

    @field_validator("metrics", "backends")
    @classmethod
    def _known(cls, value: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        tables = [value] if info.field_name == "metrics" else value.values()
        for name in (name for table in tables for name in table if name not in TOLERANCE_NAMES):
            raise ValueError(f"unknown metric {name!r}: there are {', '.join(TOLERANCE_NAMES)}")
        return value

    def of(self, backend: str, metric: str) -> Tolerance:
        """Tolerance of a backend's metric."""
        own = self.backends.get(backend, {})
        return own.get(metric) or self.metrics.get(metric) or default_tolerance(metric)


def read_tolerances(path: Path) -> Tolerances:
    """Read a tolerance table, TOML with ``[metrics.NAME]`` and ``[backends.BACKEND.NAME]``."""
    return checked(Tolerances, read_toml(path), path)

"""What is measured, as data beside the baselines: models, their meshes and layers, settings of each backend, and what change each metric may take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator

from ebamcheck.accuracy.measurement import TOLERANCE_NAMES
from ebamcheck.backend import BackendSettings
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import sha256_of_json
from ebamcheck.plugins import registry
from ebamcheck.plugins.model import Model, models
from ebamcheck.settings.base import Between, NotNegative, Section
from ebamcheck.settings.checking import checked, read_toml

MATRIX = "matrix.toml"

ALL = "all"  # in place of the names of models: every one that is installed
HASH_DIGITS = 12  # digits of a settings hash that a key keeps: enough for any matrix


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
        """Settings that are not the defaults.

        Only they make the key: a new setting whose default changes nothing leaves the baseline valid, and a
        default that is changed is held against it.
        """
        return self.settings.model_dump(mode="json", exclude_defaults=True)

    def __str__(self) -> str:
        given = ", ".join(f"{key}={value}" for key, value in self.given.items())
        return f"{self.backend} ({given})" if given else self.backend

    def settings_hash(self, case: Case) -> str:
        """Hash of the settings and of the case: what must be the same for two figures to be comparable."""
        return sha256_of_json({"settings": self.given, "case": case.model_dump()})[:HASH_DIGITS]


def read_matrix(folder: Path) -> Matrix:
    """Read the matrix beside the baselines; without one, every model under default settings."""
    path = folder / MATRIX
    return checked(Matrix, read_toml(path), path) if path.is_file() else Matrix()


def chosen_models(matrix: Matrix, names: Sequence[str]) -> dict[str, Model]:
    """Models named, all for :data:`ALL`, or without a name those of every day."""
    if names and names != (ALL,):
        return models(names)
    daily = () if names else matrix.every_day
    return {name: model for name, model in models().items() if name in daily or not daily}


def rounds(matrix: Matrix, model: str, backends: Sequence[str]) -> list[dict[str, Subject]]:
    """Subjects of one model in rounds of one a backend, so that a round runs its processes side by side."""
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


# -- tolerances ------------------------------------------------------------------------------------


class Tolerance(Section):
    """A value may grow to ``old + absolute + relative * |old|`` before it counts as worse."""

    absolute: NotNegative = 0.0
    """In the unit of the metric."""
    relative: NotNegative = 0.0

    def allowed(self, old: float) -> float:
        """Growth that an old value may have."""
        return self.absolute + self.relative * abs(old)


LENGTH = Tolerance(absolute=1e-5, relative=1e-3)  # ten times what the comparison resolves

AREA = Tolerance(absolute=1e-3, relative=1e-3)
VOLUME = Tolerance(absolute=1e-2, relative=1e-3)
BOUND = Tolerance(absolute=1e-6, relative=1e-3)  # bounds of exact slicers are rounding

NONE = Tolerance()  # counts may not grow at all


def default_tolerance(name: str) -> Tolerance:
    """Return the shipped tolerance of a metric or column, by its unit."""
    if name == "bound_mm":
        return BOUND
    for ending, tolerance in (("_mm", LENGTH), ("_mm2", AREA), ("_mm3", VOLUME)):
        if name.endswith(ending):
            return tolerance
    return NONE


def _known(table: dict[str, Tolerance]) -> dict[str, Tolerance]:
    unknown = [name for name in table if name not in TOLERANCE_NAMES]
    if unknown:
        raise ValueError(f"unknown metric {unknown[0]!r}: there are {', '.join(TOLERANCE_NAMES)}")
    return table


class Tolerances(Section):
    """Tolerances by metric, and by backend and metric; what is not named keeps the shipped one."""

    metrics: dict[str, Tolerance] = Field(default_factory=dict)
    backends: dict[str, dict[str, Tolerance]] = Field(default_factory=dict)

    @field_validator("metrics")
    @classmethod
    def _metrics_known(cls, value: dict[str, Tolerance]) -> dict[str, Tolerance]:
        return _known(value)

    @field_validator("backends")
    @classmethod
    def _backends_known(cls, value: dict[str, dict[str, Tolerance]]) -> dict[str, dict[str, Tolerance]]:
        return {backend: _known(table) for backend, table in value.items()}

    def of(self, backend: str, metric: str) -> Tolerance:
        """Tolerance of a backend's metric."""
        own = self.backends.get(backend, {})
        return own.get(metric) or self.metrics.get(metric) or default_tolerance(metric)


def read_tolerances(path: Path) -> Tolerances:
    """Read a tolerance table, TOML with ``[metrics.NAME]`` and ``[backends.BACKEND.NAME]``."""
    return checked(Tolerances, read_toml(path), path)

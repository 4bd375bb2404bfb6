"""What change each metric may take."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator

from ebamcheck.regression.measurement import TOLERANCE_NAMES
from ebamcheck.settings.base import NotNegative, Section
from ebamcheck.settings.checking import checked, read_toml


class Tolerance(Section):
    """A value may grow to ``old + absolute + relative * |old|`` before it counts as worse."""

    absolute: NotNegative = 0.0
    """In the unit of the metric."""
    relative: NotNegative = 0.0

    def allowed(self, old: float) -> float:
        """Growth that an old value may have."""
        return self.absolute + self.relative * abs(old)


LENGTH = Tolerance(absolute=1e-5, relative=1e-3)
"""Ten times what the comparison resolves; a thousandth is left to compilers and renderers."""
AREA = Tolerance(absolute=1e-3, relative=1e-3)
VOLUME = Tolerance(absolute=1e-2, relative=1e-3)
BOUND = Tolerance(absolute=1e-6, relative=1e-3)
"""Bounds of exact slicers are rounding, under what the comparison resolves."""
NONE = Tolerance()
"""Counts may not grow at all."""


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
    """Read a tolerance table, TOML with ``[metrics.NAME]`` and ``[backends.BACKEND.NAME]``.

    Raises
    ------
    SettingsError
        If the file cannot be read, is not TOML, or names what there is not.
    """
    return checked(Tolerances, read_toml(path), path)

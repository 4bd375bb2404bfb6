"""The exact plane cut: a sweep over all layers that walks from facet to facet."""

from __future__ import annotations

from importlib.metadata import version
from typing import ClassVar, Literal

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Prepared, Probe
from ebamcheck.mesh.part import Part


class PlaneCutSettings(BackendSettings):
    """Settings of the exact plane cut."""

    overlaps: Literal["unite", "keep"] = "unite"
    """Unite overlapping shells (winding > 0), or keep every ring as the facets give it."""


class PlaneCut:
    """Exact plane cut of a triangle mesh, in float64, of any triangle soup."""

    name: ClassVar[str] = "planecut"
    summary: ClassVar[str] = "exact plane cut, own sweep (numba)"
    exact: ClassVar[bool] = True
    priority: ClassVar[int] = 100
    coplanar_rule: ClassVar[CoplanarRule] = "half-open"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = PlaneCutSettings
    isolated: ClassVar[bool] = False

    def probe(self) -> Probe:
        """Tell that it runs wherever numba does."""
        return Probe(True, versions={name: version(name) for name in ("numba", "numpy")})

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the rounding of one interpolation: four units in the last place of the largest coordinate."""
        return float(4.0 * np.spacing(np.abs(part.bounds).max(initial=1e-300)))

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return 0: heights are compared as they are, in float64."""
        return 0.0

    def prepare(self, part: Part, settings: BackendSettings) -> Prepared:
        """Find the neighbours of every facet, once."""
        from ebamcheck_planecut.cut import PreparedCut

        return PreparedCut(part, PlaneCutSettings.model_validate(settings.model_dump()))

"""The ray-casting slicer behind the slicer protocol."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import numpy as np

from ebamcheck.backend import BackendSettings, CoplanarRule, Prepared, Probe, installed, labels_of
from ebamcheck.errors import BackendFailed
from ebamcheck.mesh.part import Part
from ebamcheck.settings.base import Between
from ebamcheck_embree.grid import automatic_cell_mm, grid_over

# Error bound over cell: what a cell gets wrong lies in triangles between its nodes and points of the contour in it, and no point of
# these is farther from a corner than the radius of the circle around the cell
CELL_BOUND = math.sqrt(0.5)

SINGLE_EPS = 2.0**-24
SINGLE_ROUNDINGS = 8.0  # roundings of single precision between a facet and a ray that just misses it


class EmbreeSettings(BackendSettings):
    """Settings of the ray-casting slicer."""

    grid_mm: Annotated[float, Between(1e-7, 1000.0)] | None = None
    """Distance between rays. None: the part's longer side in x and y over 1024; at most 0.1 mm, but not under that
    side over 4096."""
    rays_per_call: Annotated[int, Between(1024, 10**8)] = 16_384
    """Rays in one call of Embree, which stay in the processor's cache then: changes no result."""


class Embree:
    """Ray casting with Embree; what its single precision finds is decided and located in float64."""

    name: ClassVar[str] = "embree"
    summary: ClassVar[str] = "ray casting by Embree in the planes of layers, and marching squares"
    exact: ClassVar[bool] = False
    priority: ClassVar[int] = 20
    coplanar_rule: ClassVar[CoplanarRule] = "undefined"
    inside_rule: ClassVar[str] = "winding > 0"
    Settings: ClassVar[type[BackendSettings]] = EmbreeSettings

    def probe(self) -> Probe:
        """Whether embreex can be imported."""
        return installed("embreex", "embreex.rtcore_scene")

    def error_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return the error that a cell may hide plus single and double rounding at the part's size, mm."""
        checked = EmbreeSettings.own(settings, self.name)
        cell = checked.grid_mm or automatic_cell_mm(part)
        single = SINGLE_ROUNDINGS * SINGLE_EPS * float(part.size.max(initial=0.0))
        return CELL_BOUND * cell + single + 4.0 * np.finfo(np.float64).eps * float(np.abs(part.bounds).max())

    def height_bound_mm(self, part: Part, settings: BackendSettings) -> float:
        """Return single rounding of heights from the part's middle plus double rounding of absolute heights, mm."""
        single = 4.0 * SINGLE_EPS * 0.5 * float(part.size[2])
        return single + 4.0 * np.finfo(np.float64).eps * float(np.abs(part.bounds[:, 2]).max())

    def prepare(self, part: Part, settings: BackendSettings) -> Prepared:
        """Sort the facets into slabs, whose trees are built when they are cut."""
        checked = EmbreeSettings.own(settings, self.name)
        if not math.isfinite(float(np.float32(part.size.max(initial=0.0)) ** 2)):
            raise BackendFailed(
                f"embree: part {part.name!r} is {part.size.max():.3g} mm large, beyond single precision"
            )
        grid = grid_over(part, checked.grid_mm or automatic_cell_mm(part))
        labels = labels_of(part, self.name, {**checked.model_dump(), "grid_mm": grid.cell_mm})
        from ebamcheck_embree.rays import InPlaneRays

        return InPlaneRays(part, grid, checked.rays_per_call, labels)

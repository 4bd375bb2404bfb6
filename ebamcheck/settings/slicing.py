"""Settings of the part, of the cuts, of the slicers and of their comparison."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from ebamcheck.settings.base import Finite, NotNegative, Positive, Section


class PartSettings(Section):
    """How the part's file is read and placed."""

    units: Literal["mm", "cm", "m", "um", "in", "ft"] = "mm"
    """Unit of the numbers in the file; converted to mm once, at reading."""
    direction: tuple[Finite, Finite, Finite] = (0.0, 0.0, 1.0)
    """Slicing direction in the coordinates of the file; the part is turned so that it points up."""
    fix_orientation: bool = False
    """Turn closed bodies of negative volume and single flipped facets over, and say so in the report."""


class LayerSettings(Section):
    """Where the part is cut."""

    layer_height_mm: Positive | None = None
    """None: the height of one bead, from the mass balance of the process."""
    heights_mm: tuple[Finite, ...] = ()
    """Listed heights, absolute z; they take the place of uniform ones."""
    base_mm: NotNegative = 0.0
    """Height of what stands under the lowest layer, over the base plate: a program of layers on a part that is half
    built begins there. Its heights are given by `heights_mm`."""


class SlicingSettings(Section):
    """Which slicers run and how."""

    backends: tuple[str, ...] = ()
    """Empty: every backend that is available on this machine."""
    required: tuple[str, ...] = ()
    """A run ends with exit code 4 where one of these is not available."""
    primary: str = ""
    """Whose contours go on to fitting and the program; empty: the default exact backend."""
    witnesses: tuple[str, ...] = ()
    """Outside programs that slice, too: names, or `all` for those that are installed on this machine."""
    block_points: Annotated[int, Field(ge=1000)] = 4_000_000
    """Points of an exact contour that are worked on at once: layers are cut, compared and written in blocks of about
    so many, which bounds the memory of a job (about 100 bytes a point and method)."""
    time_limit_s: Positive = 600.0
    """Time of one backend's process for the whole stack; beyond it the process is ended and reported."""
    memory_limit_mb: Positive = 8192.0
    """Resident memory of one backend's process, watched from outside."""
    processes: Annotated[int, Field(ge=1)] | None = None
    """Backends that slice side by side; None: as many as there are cores. With 1 a job needs the least memory."""
    settings: dict[str, dict[str, Any]] = Field(default={})
    """Settings of each backend, by its name."""


class ComparisonSettings(Section):
    """When two slicers agree."""

    tolerance_mm: NotNegative = 0.001
    """Added to the two declared error bounds: agreement within bound_A + bound_B + tolerance."""
    plane_margin_mm: NotNegative | None = None
    """A layer is generic if no vertex lies nearer to its plane; None: the largest height bound compared."""

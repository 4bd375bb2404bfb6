"""The protocol between the harness and a reference model: a solid whose every section is known.

A model is an object found by the entry point group ``ebamcheck.models``. The conformance kit and the
regression reports find models here, so that the core knows no model by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import registry


@runtime_checkable
class Model(Protocol):
    """A solid known in closed form, in mm.

    >>> model = models(["sphere"])["sphere"]
    >>> part = model.tessellate(0.01)
    >>> bool(part.volume < model.volume < part.volume + 0.02 * model.area(0.0) * 4)
    True
    """

    @property
    def name(self) -> str:
        """Key in the entry point group ``ebamcheck.models``, and the name of its parts."""
        ...

    @property
    def summary(self) -> str:
        """What it is, in one line."""
        ...

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Least and greatest corner, (2, 3) mm."""
        ...

    @property
    def volume(self) -> float:
        """Exact volume, mm3."""
        ...

    @property
    def euler_number(self) -> int:
        """Vertices - edges + faces of any mesh of the surface."""
        ...

    def section(self, z: float, tolerance_mm: float = ...) -> Sequence[shapely.Polygon]:
        """Solid regions at height `z` (that of z + 0 at a step), rings as dense as the tolerance asks."""
        ...

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2."""
        ...

    def tessellate(self, tolerance_mm: float) -> Part:
        """Return a closed, outward mesh no point of which is farther than the tolerance from the surface."""
        ...


def models(names: Sequence[str] | None = None) -> dict[str, Model]:
    """Find the installed models, all or those named, by name."""
    found = {name: m for name, m in registry.load_plugins(registry.MODELS).items() if isinstance(m, Model)}
    if names is None:
        return found
    unknown = [name for name in names if name not in found]
    if unknown:
        raise SettingsError(f"unknown model {unknown[0]!r}: installed are {', '.join(found) or 'none'}")
    return {name: found[name] for name in names}

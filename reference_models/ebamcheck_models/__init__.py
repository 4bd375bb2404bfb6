"""Reference models: parts whose cross-section at every height is known in closed form."""

from __future__ import annotations

from ebamcheck_models.blade import BLADE
from ebamcheck_models.model import COARSEST_TOLERANCE_MM, LEAST_TOLERANCE_MM, Model
from ebamcheck_models.revolved import SPHERE, TORUS
from ebamcheck_models.simple import CUBE, CYLINDER, PRISM
from ebamcheck_models.stl_file import write_stl

MODELS: dict[str, Model] = {model.name: model for model in (BLADE, CUBE, CYLINDER, PRISM, SPHERE, TORUS)}
"""Models of this package by name."""

__all__ = [
    "BLADE",
    "COARSEST_TOLERANCE_MM",
    "CUBE",
    "CYLINDER",
    "LEAST_TOLERANCE_MM",
    "MODELS",
    "PRISM",
    "SPHERE",
    "TORUS",
    "Model",
    "write_stl",
]

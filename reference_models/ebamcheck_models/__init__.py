"""Reference models: parts whose cross-section at every height is known in closed form."""

from __future__ import annotations

from ebamcheck_models.blade import BLADE
from ebamcheck_models.cases import CASES
from ebamcheck_models.cones import CONE, CYLINDER
from ebamcheck_models.model import COARSEST_TOLERANCE_MM, LEAST_TOLERANCE_MM, Model, TurnableModel, write_stl
from ebamcheck_models.polyhedra import COMB, MENGER_1, MENGER_2, MENGER_3, PYRAMID, THIN_WALLS, TILTED_PLATE
from ebamcheck_models.prisms import BRACKET
from ebamcheck_models.revolved import SPHERE, TORUS
from ebamcheck_models.ring_wall import LADDER, LADDER_TOLERANCES_MM
from ebamcheck_models.simple import CUBE, PRISM
from ebamcheck_models.two_spheres import TWO_SPHERES
from ebamcheck_models.walled_parts import BULKHEAD, HELICAL_CHANNEL, IMPELLER, NOZZLE

_SHAPES: tuple[Model, ...] = (
    BLADE, BRACKET, BULKHEAD, COMB, CONE, CUBE, CYLINDER, HELICAL_CHANNEL, IMPELLER, LADDER, MENGER_1, MENGER_2, MENGER_3,
    NOZZLE, PRISM, PYRAMID, SPHERE, THIN_WALLS, TILTED_PLATE, TORUS, TWO_SPHERES,
)  # fmt: skip

MODELS: dict[str, Model] = {model.name: model for model in (*_SHAPES, *CASES)}
"""Models of this package by name."""

__all__ = [
    "BLADE", "BRACKET", "BULKHEAD", "CASES", "COARSEST_TOLERANCE_MM", "COMB", "CONE", "CUBE", "CYLINDER", "HELICAL_CHANNEL",
    "IMPELLER", "LADDER", "LADDER_TOLERANCES_MM", "LEAST_TOLERANCE_MM", "MENGER_1", "MENGER_2", "MENGER_3", "MODELS", "NOZZLE",
    "PRISM", "PYRAMID", "SPHERE", "THIN_WALLS", "TILTED_PLATE", "TORUS", "TWO_SPHERES", "Model", "TurnableModel", "write_stl",
]  # fmt: skip

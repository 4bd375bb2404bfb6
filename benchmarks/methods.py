"""What is measured: every backend of the registry, a variant of one, and two programs by themselves."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from ebamcheck.plugins import registry

Kind = Literal["backend", "manifold3d", "prusa-stage"]

PAPERS_PIXEL_MM = 0.1
LITERAL = "stencil literal"
MANIFOLD_ALONE, PRUSA_STAGE = "manifold3d alone", "PrusaSlicer's slice stage"

BY_LAYER = ("trimesh",)
"""Backends that do the whole work again for each layer, and so may be timed on some of the layers."""


@dataclass(frozen=True)
class Method:
    """One way of slicing.

    Parameters
    ----------
    name
        As it stands in tables.
    kind
        A backend of the registry, or one of the programs that are measured by themselves.
    backend, settings
        Of a backend.
    by_layer
        Nothing is shared between layers: the time of some of them, evenly spread, may be scaled to all.
    """

    name: str
    kind: Kind = "backend"
    backend: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    by_layer: bool = False

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for another process."""
        return asdict(self)

    def missing(self) -> str:
        """Why this machine cannot run it; empty where it can."""
        if self.kind == "manifold3d":
            found = registry.probe("manifold")
            return "" if found.available else found.why
        if self.kind == "prusa-stage":
            return "" if shutil.which("prusa-slicer") else "the program prusa-slicer is not installed"
        found = registry.probe(self.backend)
        return "" if found.available else found.why


def all_methods() -> list[Method]:
    """Return the methods in the order in which they take turns: house slicers, witnesses, programs by themselves."""
    ranked = sorted(registry.slicers().values(), key=lambda s: (-s.priority, s.name))
    found: list[Method] = []
    for slicer in ranked:
        found.append(Method(slicer.name, backend=slicer.name, by_layer=slicer.name in BY_LAYER))
        if slicer.name == "stencil":
            found.append(literal())
    return [*found, Method(MANIFOLD_ALONE, "manifold3d"), Method(PRUSA_STAGE, "prusa-stage")]


def gpu_methods() -> list[Method]:
    """Return the two modes of the backend that a graphics device runs."""
    return [Method("stencil", backend="stencil"), literal()]


def literal() -> Method:
    """Return the paper's own method: all facets above a layer are drawn for it."""
    settings = {"mode": "literal", "pixel_mm": PAPERS_PIXEL_MM}
    return Method(LITERAL, backend="stencil", settings=settings, by_layer=True)

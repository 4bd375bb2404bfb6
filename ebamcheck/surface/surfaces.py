"""Surfaces of a part: its regions joined, with the dimensions of those that are known by formula.

The facets of one exact surface are one surface. So are other strips that continue each other, as a ruled surface, and freely
curved facets that are connected, as a freeform patch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ebamcheck.kernels import Floats, Ints
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.exact_forms import CONE, CYLINDER, FLAT, KIND, NAMES, OWN, SPHERE, TORUS
from ebamcheck.surface.part_surface import PartSurface, surface_of
from ebamcheck.surface.planes import area_vectors, connected
from ebamcheck.surface.regions import PLANE, STRIP

KINDS = ("plane", "cylinder", "cone", "sphere", "torus", "quadric", "ruled", "freeform")


@dataclass(frozen=True)
class Surface:
    """One surface of a part."""

    kind: str  # of KINDS; a quadric is one without a name of its own here, such as an ellipsoid
    facets: Ints  # (n,) indices
    area_mm2: float
    size_mm: tuple[float, float, float]  # extents of its bounding box
    figure: str = ""  # its dimensions, such as "radius 5 mm"; of a freeform patch the noise of its vertices

    def as_dict(self) -> dict[str, Any]:
        """Everything but the list of facets, for JSON."""
        return {
            "kind": self.kind,
            "facets": len(self.facets),
            "area_mm2": self.area_mm2,
            "size_mm": self.size_mm,
            "figure": self.figure,
        }


MOST_LISTED = 40  # Most surfaces listed one by one; the rest are only counted


def table(found: list[Surface]) -> str:
    """List surfaces by kind, then one by one, the largest first."""
    total = sum(s.area_mm2 for s in found)
    lines = []
    for kind in KINDS:
        areas = [s.area_mm2 for s in found if s.kind == kind]
        if areas:
            share = 100.0 * sum(areas) / max(total, 1e-300)
            lines.append(f"{kind:10} {len(areas):6} regions {sum(areas):14.6g} mm2 {share:6.1f} %")
    lines.append("")
    for s in found[:MOST_LISTED]:
        size = " x ".join(f"{x:.4g}" for x in s.size_mm)
        line = f"{s.kind:10} {s.area_mm2:12.6g} mm2 {len(s.facets):8} facets  {size} mm  {s.figure}"
        lines.append(line.rstrip())
    if len(found) > MOST_LISTED:
        lines.append(f"and {len(found) - MOST_LISTED} smaller ones")
    return "\n".join(lines)


def surfaces(part: Part, settings: CurveSettings) -> list[Surface]:
    """Find the surfaces of a part, the largest first."""
    surface = surface_of(part, settings)
    label, rows = surface.exact
    named = (label >= 0) & np.append(rows[:, KIND] != FLAT, False)[label]
    form = np.where(named, label, -1).astype(np.int64)  # exact surface of each facet; -1 for planes and others
    of_facet = _connected(surface, form)
    order = np.argsort(of_facet, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(of_facet))[:-1])
    found = [_surface(part, surface, facets, int(form[facets[0]])) for facets in groups if len(facets)]
    return sorted(found, key=lambda s: (-s.area_mm2, int(s.facets[0])))


def _connected(surface: PartSurface, form: Ints) -> Ints:
    """Number (F,) of the surface of each facet."""
    twin, region, kind = surface.twin, surface.region, surface.kind
    half = np.flatnonzero(twin != NO_TWIN)
    a, b = half // 3, twin[half] // 3
    unnamed = (form[a] < 0) & (form[b] < 0)
    joined = unnamed & ((region[a] == region[b]) | ((kind[a] == kind[b]) & (kind[a] != PLANE)))
    named = np.flatnonzero(form >= 0)
    first = np.zeros(len(surface.exact.rows), np.int64)
    first[form[named][::-1]] = named[::-1]
    a, b = np.concatenate([a[joined], named]), np.concatenate([b[joined], first[form[named]]])
    return connected(a, b, len(form))


def _surface(part: Part, surface: PartSurface, facets: Ints, form: int) -> Surface:
    corners = part.vertices[part.faces[facets]]
    area = np.linalg.norm(area_vectors(corners), axis=1)
    x, y, z = np.ptp(corners.reshape(-1, 3), axis=0).tolist()
    name, figure = {PLANE: "plane", STRIP: "ruled"}.get(int(surface.kind[facets[0]]), "freeform"), ""
    if form >= 0:
        row = surface.exact.rows[form]
        name, figure = NAMES[int(row[KIND])], _figure(row)
    elif name == "freeform":
        # Distance of vertices from a smooth surface through their neighbours, where it is known.
        noise = surface.noise[surface.sectors[facets]]
        known = noise[np.isfinite(noise)]
        figure = f"noise {np.median(known):.2g} mm" if known.size else ""
    return Surface(name, facets, float(area.sum()), (x, y, z), figure)


def _figure(row: Floats) -> str:
    """Dimensions of an exact surface, as text."""
    kind = int(row[KIND])
    if kind == SPHERE:
        return f"radius {row[OWN]:.6g} mm"
    if kind == CYLINDER:
        return f"radius {row[OWN + 3]:.6g} mm"
    if kind == CONE:
        return f"half angle {np.degrees(np.arctan2(abs(row[OWN + 4]), abs(row[OWN + 3]))):.4g} degrees"
    if kind == TORUS:
        return f"ring radius {abs(row[OWN + 3]):.6g} mm, tube radius {abs(row[OWN + 4]):.6g} mm"
    return ""

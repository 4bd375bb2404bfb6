"""Picture of the regions of a part: its facets seen from the front right above, coloured by kind of surface."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.curves.regions.surfaces import Surface
from ebamcheck.mesh.part import Part
from ebamcheck.showing.markup import element, svg_file, text

COLOURS = {
    "plane": (86, 180, 233),
    "cylinder": (230, 159, 0),
    "cone": (240, 228, 66),
    "ruled": (213, 94, 0),
    "sphere": (204, 121, 167),
    "torus": (0, 114, 178),
    "quadric": (153, 153, 153),
    "freeform": (0, 158, 115),
}
"""Colours that colour-blind readers tell apart (Okabe, Ito 2008)."""

VIEW = np.array([[0.8, 0.6, 0.0], [-0.36, 0.48, 0.8], [0.48, -0.64, 0.6]])
"""Rows to the right, up, and towards the eye."""

WIDTH_PX, MARGIN_PX, KEY_PX = 720.0, 10.0, 20.0

LEAST_LIGHT = 0.55

MOST_FACETS = 200_000
"""More facets than pixels: a part beyond is drawn without those too small to see."""


def regions_svg(part: Part, found: list[Surface]) -> str:
    """Draw the surfaces of a part, those behind first, with a key of the kinds that there are."""
    kinds = np.concatenate([np.full(len(s.facets), k) for k, s in enumerate(found)])
    facets = np.concatenate([s.facets for s in found])
    corners = part.vertices[part.faces[facets]] @ VIEW.T
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    seen = np.flatnonzero(normals[:, 2] > 0.0)
    seen = seen[np.argsort(-size[seen], kind="stable")[:MOST_FACETS]]
    seen = seen[np.argsort(corners[seen, :, 2].mean(axis=1), kind="stable")]
    low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
    scale = (WIDTH_PX - 2.0 * MARGIN_PX) / max(float((high - low).max()), 1e-9)
    names = [k for k in COLOURS if any(s.kind == k for s in found)]
    height = float(scale * (high - low)[1]) + 2.0 * MARGIN_PX + KEY_PX * (len(names) + 1)
    body = []
    for i in seen:
        x = MARGIN_PX + scale * (corners[i, :, 0] - low[0])
        y = MARGIN_PX + scale * (high[1] - corners[i, :, 1])
        light = LEAST_LIGHT + (1.0 - LEAST_LIGHT) * normals[i, 2] / size[i]
        red, green, blue = (round(light * c) for c in COLOURS[found[kinds[i]].kind])
        points = " ".join(f"{u:.2f},{v:.2f}" for u, v in zip(x, y, strict=True))
        colour = f"#{red:02x}{green:02x}{blue:02x}"
        body.append(element("polygon", points=points, fill=colour, stroke=colour, stroke_width=0.4))
    for row, name in enumerate(names):
        y = height - KEY_PX * (len(names) - row)
        colour = "rgb({},{},{})".format(*COLOURS[name])
        count = sum(s.kind == name for s in found)
        body += [
            element("rect", x=f"{MARGIN_PX:g}", y=f"{y - 11:.1f}", width=14, height=12, fill=colour),
            text(MARGIN_PX + 20, y, f"{name} ({count})", 13),
        ]
    return svg_file(WIDTH_PX, math.ceil(height), body, f"Regions of {part.name}")

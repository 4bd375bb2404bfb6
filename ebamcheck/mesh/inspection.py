"""Inspection of a part: the figures and the verdict of the input gate, before anything is sliced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from typing import Any, Literal

import numpy as np

from ebamcheck.kernels import Bools, Floats, ShortInts, kernel
from ebamcheck.mesh.bodies import MOST_LISTED, NO_VOLUME, Relation, bodies_of, body_volumes, inside_out_bodies
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import EdgeGroups, Index, body_labels, direction_balance, duplicates, edge_groups
from ebamcheck.showing import short_text

Verdict = Literal["sound", "inside-out", "open", "inconsistent", "non-manifold", "flat", "overlapping"]


# Figures of an inspection that `defects` counts
COUNTS = (
    "vertices", "open_edges", "nonmanifold_edges", "inconsistent_edges",
    "duplicate_facets", "degenerate_facets", "zero_area_facets",
)  # fmt: skip
FACETS_AT_ONCE = 1 << 18  # facets of which the area is looked at together, to bound the working memory


@dataclass(frozen=True)
class Inspection:
    """Result of the inspection of a part.

    `verdict` is the first that applies of: ``open`` (edges with one facet), ``inconsistent`` (neighbouring facets with the same
    direction along their edge), ``non-manifold`` (edges whose facets do not pair), ``flat`` (no volume), ``inside-out`` (a closed
    body of negative volume outside any other), ``overlapping`` (more volume than the box around it: bodies that are too many to be
    united, or one that passes through itself), ``sound``."""

    name: str
    facets: int
    vertices: int
    bodies: int
    size_mm: tuple[float, float, float]
    lower_mm: tuple[float, float, float]
    units: str  # unit of the file's numbers, before they became mm, and where it comes from
    units_from: str
    volume_mm3: float
    open_edges: int
    nonmanifold_edges: int
    inconsistent_edges: int
    duplicate_facets: int
    degenerate_facets: int
    zero_area_facets: int
    inside_out_bodies: int
    open_bodies: int
    # How bodies lie to each other: a hundred at most, those first of which something may be lost
    relations: tuple[Relation, ...]
    related_bodies: int  # how many such relations there are
    union_known: bool  # whether `volume_mm3` is that of the union of all bodies, else it is their sum
    notes: tuple[str, ...]
    verdict: Verdict
    why: str

    @property
    def passed(self) -> bool:
        """Whether the part may be sliced for production: closed, consistent and the right way out."""
        return self.verdict == "sound"

    def __repr__(self) -> str:
        counts = short_text.counted(self.facets, "facet"), short_text.counted(self.bodies, "body", "bodies")
        size, volume = short_text.size(self.size_mm), f"{self.volume_mm3:.6g} mm3"
        return short_text.line("Inspection", self.name, self.verdict, *counts, size, volume)

    def _repr_html_(self) -> str:
        """Show the result in a notebook."""
        shown = {n.replace("_", " "): v for n, v in self.as_dict().items() if n not in ("name", "notes")}
        return short_text.html(f"{self.name}: {self.verdict}", shown)

    def as_dict(self) -> dict[str, Any]:
        """All figures, for JSON."""
        return {**asdict(self), "passed": self.passed}


def inspect(part: Part) -> Inspection:
    """Count the defects of a part and judge whether it has an inside.

    Edges with more than two facets are counted, but refused only if their facets do not pair up in
    opposite directions: bodies that touch along an edge have an inside.

    Parameters
    ----------
    part
        The part; its position does not matter.

    Returns
    -------
    Inspection
        Counts of defects, bodies, volumes in mm3, and the verdict.

    Examples
    --------
    >>> from ebamcheck.mesh.part import from_arrays
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> inspect(from_arrays(corners, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])).verdict
    'sound'
    """
    groups = edge_groups(part.faces, len(part.vertices))
    counts, open_facets = defects(part, groups)
    told = bodies_of(part, groups)
    open_body = np.zeros(len(told.volumes), np.bool_)
    open_body[told.label[open_facets]] = True
    inside_out = inside_out_bodies(part, told.label, told.volumes) & ~open_body
    return inspection_of(
        part,
        counts,
        told.volumes,
        volume_mm3=told.volume_mm3,
        facets=len(part.faces),
        inside_out_bodies=int(inside_out.sum()),
        open_bodies=int(open_body.sum()),
        relations=told.relations,
        union_known=told.known,
    )


def defects(
    part: Part, groups: EdgeGroups, lower_mm: float = -np.inf, upper_mm: float = np.inf
) -> tuple[dict[str, int], Index]:
    """Counts of the vertices, edges and facets whose lowest point lies at ``lower_mm <= z < upper_mm``; facets at open edges."""
    z, faces = np.ascontiguousarray(part.vertices[:, 2]), part.faces

    def told(*corners: Index) -> Bools:
        lowest = reduce(np.minimum, [z[corner] for corner in corners])
        return np.asarray((lowest >= lower_mm) & (lowest < upper_mm))

    half_edge = groups.half_edges[groups.starts[:-1]]
    facet, corner = np.divmod(half_edge, 3)
    edge_told, facet_told = told(faces[facet, corner], faces[facet, (corner + 1) % 3]), told(*faces.T)
    facets_at_edge, unpaired = np.diff(groups.starts), direction_balance(faces, groups) != 0
    is_open = edge_told & (facets_at_edge == 1)
    more_than_two = edge_told & (facets_at_edge > 2)
    a, b, c = faces.T
    repeated = (a == b) | (b == c) | (c == a)
    whole = facet_told & ~repeated
    counts = {
        "vertices": told(np.arange(len(z), dtype=np.int32)),
        "open_edges": is_open,
        "nonmanifold_edges": more_than_two,
        "inconsistent_edges": edge_told & (facets_at_edge == 2) & unpaired,
        "unpaired_edges": more_than_two & unpaired,
        "degenerate_facets": facet_told & repeated,
    }
    flat = 0
    for start in range(0, len(faces), FACETS_AT_ONCE):
        rows = slice(start, start + FACETS_AT_ONCE)
        p, q, r = np.moveaxis(part.vertices[faces[rows][whole[rows]]], 1, 0)
        flat += int((np.cross(q - p, r - p) == 0.0).all(axis=1).sum())
    found = {name: int(np.count_nonzero(which)) for name, which in counts.items()}
    return {**found, "duplicate_facets": duplicates(faces[whole]), "zero_area_facets": flat}, facet[is_open]


def inspection_of(
    part: Part, counts: Mapping[str, int], volumes: Floats, relations: Sequence[Relation] = (), **of_bodies: Any
) -> Inspection:  # fmt: skip
    """Inspection by the counts of :func:`defects`, the signed volumes (B,) of the bodies, and other figures of them."""
    found = Inspection(
        name=part.name,
        size_mm=tuple(part.size.tolist()),
        lower_mm=tuple(part.bounds[0].tolist()),
        units=part.units,
        units_from=part.units_from,
        notes=part.notes,
        verdict="sound",
        why="",
        bodies=len(volumes),
        relations=tuple(relations[:MOST_LISTED]),
        related_bodies=len(relations),
        **of_bodies | {name: counts.get(name, 0) for name in COUNTS},
    )
    verdict, why = _judged(found, counts.get("unpaired_edges", 0), float(np.abs(volumes).sum()))
    return replace(found, verdict=verdict, why=why)


def _judged(found: Inspection, unpaired: int, enclosed_mm3: float) -> tuple[Verdict, str]:
    """First verdict that applies, with the reason; `unpaired` edges of more than two facets do not pair up."""
    negative = "; the volume is negative as well: the part is inside-out" if found.volume_mm3 < 0 else ""
    box_mm3 = float(np.prod(found.size_mm))
    faults: tuple[tuple[bool, Verdict, str], ...] = (
        (found.open_edges > 0, "open",
         (f"{found.open_edges} open edges in {found.open_bodies} of {found.bodies} bodies: "
         f"sections have open paths and no certain inside; close the mesh{negative}")),
        (found.inconsistent_edges > 0, "inconsistent",
         (f"{found.inconsistent_edges} edges whose two facets run the same way: some facets are flipped; "
         "turn them in the model, or use --fix-orientation")),
        (unpaired > 0, "non-manifold",
         f"{unpaired} edges whose facets do not pair up in opposite directions: mend the model"),
        (enclosed_mm3 <= NO_VOLUME * max(found.size_mm) ** 3, "flat",
         f"its facets enclose no volume ({found.volume_mm3:.3g} mm3): there is nothing to build"),
        (found.inside_out_bodies > 0, "inside-out",
         (f"{found.inside_out_bodies} of {found.bodies} closed bodies have negative volume (in all {found.volume_mm3:.6g} mm3): "
         "every facet faces inwards; turn them in the model, or use --fix-orientation")),
        # Over the rounding of a block.
        (found.volume_mm3 > (1.0 + 1e-9) * box_mm3, "overlapping",
         (f"its facets enclose {found.volume_mm3:.6g} mm3 in a box of {box_mm3:.6g} mm3: bodies or walls stand in one another; "
         "unite them in the model")),
    )  # fmt: skip
    faulty = next(((verdict, why) for wrong, verdict, why in faults if wrong), None)
    return faulty or ("sound", "closed, consistently oriented, volume positive")


def fix_orientation(part: Part) -> tuple[Part, int]:
    """Reverse facets until neighbours agree and closed bodies face outwards; returns the part and how many were reversed."""
    groups = edge_groups(part.faces, len(part.vertices))
    flip = _consistent_flips(part.faces, groups.half_edges, groups.starts)
    faces = np.where(flip[:, None], part.faces[:, ::-1], part.faces)
    mended = replace(part, faces=np.ascontiguousarray(faces))
    groups = edge_groups(mended.faces, len(mended.vertices))
    body = body_labels(mended.faces, groups)
    bodies = int(body.max(initial=-1)) + 1
    open_body = np.zeros(bodies, np.bool_)
    open_body[body[groups.half_edges[groups.starts[:-1][np.diff(groups.starts) == 1]] // 3]] = True
    wrong = inside_out_bodies(mended, body, body_volumes(mended, body, bodies)) & ~open_body
    turn = (body >= 0) & wrong[body] if bodies else np.zeros(len(body), np.bool_)
    turned = int(np.count_nonzero(flip != turn))
    if turned == 0:
        return part, 0
    faces = np.where(turn[:, None], mended.faces[:, ::-1], mended.faces)
    return replace(part, faces=np.ascontiguousarray(faces)), turned


@kernel
def _consistent_flips(faces: ShortInts, half_edges: ShortInts, starts: ShortInts) -> Bools:
    """Facets (F,) to turn so that neighbours across two-facet edges run opposite ways; the minority of a body turns."""
    count = faces.shape[0]
    across = np.full(3 * count, -1, np.int32)
    for e in range(starts.size - 1):
        a = starts[e]
        if starts[e + 1] - a == 2:
            across[half_edges[a]], across[half_edges[a + 1]] = half_edges[a + 1], half_edges[a]
    flip = np.zeros(count, np.bool_)
    seen = np.zeros(count, np.bool_)
    queue = np.empty(count, np.int32)
    for seed in range(count):
        if seen[seed]:
            continue
        first, last = 0, 1
        queue[0] = seed
        seen[seed] = True
        flipped = 0
        while first < last:
            f = queue[first]
            first += 1
            for i in range(3):
                h = across[3 * f + i]
                if h < 0 or seen[h // 3]:
                    continue
                g = h // 3
                same_way = faces[f, i] == faces[g, h % 3]
                flip[g] = flip[f] != same_way
                flipped += 1 if flip[g] else 0
                seen[g] = True
                queue[last] = g
                last += 1
        if 2 * flipped > last:
            for n in range(last):
                flip[queue[n]] = not flip[queue[n]]
    return flip

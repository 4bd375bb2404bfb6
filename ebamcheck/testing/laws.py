"""Laws that hold for every slicer, whatever the part: maps carry sections along, order does not matter; :data:`LAWS` apply each
with fixed numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.testing.solids import house_rule, joined, mapped, named, sections, simple, turn
from ebamcheck.testing.subject import NO_LAYER, Figure, Subject, differences, generic_heights, truth

LARGE_OFFSET_MM = (2.0**17, -(2.0**18), 2.0**16)  # 0.1 .. 0.3 km from the origin, as in plant coordinates
COORDINATE_STEP_MM = 2.0**-16  # grid on which vertices are placed where a large shift must not round them
# Solids without features thinner than any sensible bound
THICK = ("box", "plate with holes", "tilted plate", "sphere", "torus", "upright torus", "cavity")
# Solids whose vertices lie at few heights, between which the area is a polynomial
FEW_LEVELS = ("box", "plate with holes", "sphere", "torus", "pyramid", "comb", "pillars")
LEAST_INTERVAL_MM = 1e-9  # levels nearer to each other than this are one, by rounding


# -- maps ----------------------------------------------------------------------------------------------


def carried_layers(layers: Layers, matrix: ArrayLike, shift: ArrayLike, heights: Floats) -> Layers:
    """Map the rings of a stack in the plane, turned round where the map mirrors them; layers keep their order."""
    flat, move = np.asarray(matrix, float)[:2, :2], np.asarray(shift, float)[:2]
    step = 1 if np.linalg.det(flat) > 0.0 else -1
    stack: list[list[Floats]] = [
        [(layers.ring(r) @ flat.T + move)[::step] for r in layers.rings_of(k) if layers.closed[r]]
        for k in range(len(layers))
    ]
    return from_rings(heights, stack)


def carried_by_map(
    subject: Subject, law: str, part: Part, heights: Floats, matrix: ArrayLike, shift: ArrayLike = (0, 0, 0)
) -> list[Figure]:
    """Sections of the mapped part are the mapped sections; the map keeps level planes level."""
    linear, move = np.asarray(matrix, dtype=np.float64), np.asarray(shift, dtype=np.float64)
    image = named(part.name, mapped(part, linear, move))
    order = slice(None, None, 1 if linear[2, 2] > 0.0 else -1)
    planes = linear[2, 2] * heights + move[2]
    found = subject.cut(image, np.ascontiguousarray(planes[order]))
    before = subject.cut(part, heights).take(np.arange(len(heights))[order])
    wanted = carried_layers(before, linear, move, found.heights)
    scale = float(np.sqrt(abs(np.linalg.det(linear[:2, :2]))))
    limit_mm = scale * subject.limit_mm(part) + subject.limit_mm(image)
    return _alike(subject, law, image, found, wanted, limit_mm)


def same_sections(subject: Subject, law: str, part: Part, other: Part, heights: Floats) -> list[Figure]:
    """Two meshes of one solid have the same sections."""
    limit = subject.limit_mm(part) + subject.limit_mm(other)
    return _alike(subject, law, part, subject.cut(other, heights), subject.cut(part, heights), limit)


def _alike(subject: Subject, law: str, part: Part, found: Layers, wanted: Layers, limit_mm: float) -> list[Figure]:
    exact = subject.slicer.exact
    seen = differences(wanted, found, limit_mm, reference_exact=exact, found_exact=exact)
    return seen.depth_figures(law, part.name, limit_mm) + seen.topology_figures(law, part.name)


# -- meshes of the same solid --------------------------------------------------------------------------


def shuffled_facets(part: Part, seed: int = 5) -> Part:
    """The same facets in another order, each starting at another corner."""
    rng = np.random.default_rng(seed)
    faces = part.faces[rng.permutation(len(part.faces))]
    first = rng.integers(3, size=len(faces))
    columns = (first[:, None] + np.arange(3)) % 3
    return from_arrays(part.vertices, np.take_along_axis(faces, columns, axis=1), part.name)


def shuffled_vertices(part: Part, seed: int = 6) -> Part:
    """The same facets with the vertices numbered another way."""
    order = np.random.default_rng(seed).permutation(len(part.vertices))
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return from_arrays(part.vertices[order], number[part.faces], part.name)


def subdivided(part: Part) -> Part:
    """Every facet cut into four at the middles of its edges."""
    edges = np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middles = 0.5 * (part.vertices[unique[:, 0]] + part.vertices[unique[:, 1]])
    ab, bc, ca = len(part.vertices) + index.reshape(-1, 3).T
    a, b, c = part.faces.T
    faces = np.concatenate([np.stack(f, 1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return from_arrays(np.concatenate([part.vertices, middles]), faces, part.name)


# -- measures ------------------------------------------------------------------------------------------


def disjoint_union(subject: Subject, part: Part, other: Part, heights: Floats) -> list[Figure]:
    """Two parts beside each other have the sections of both."""
    gap = float(part.size[0]) + 3.7
    moved = mapped(other, shift=(gap + float(part.bounds[0, 0] - other.bounds[0, 0]), 1.3, 0.0))
    both = joined(part, moved)
    alone, every = [subject.cut(p, heights) for p in (part, moved)], range(len(heights))
    rings = [[n.ring(r) for n in alone for r in n.rings_of(k) if n.closed[r]] for k in every]
    limit = max(subject.limit_mm(part), subject.limit_mm(moved)) + subject.limit_mm(both)
    wanted = from_rings(heights, rings)
    return _alike(subject, "union of parts", both, subject.cut(both, heights), wanted, limit)


def volume_from_areas(subject: Subject, part: Part) -> list[Figure]:
    """The integral of the areas is the volume: between two levels of vertices the area is a quadratic polynomial of the height,
    which two points of Gauss integrate without error; a section within r of the true one misses its area by r times its perimeter
    and pi r squared a ring at most."""
    levels = np.unique(part.vertices[:, 2])
    levels = levels[np.append(True, np.diff(levels) > LEAST_INTERVAL_MM)]
    middle, half = 0.5 * (levels[1:] + levels[:-1]), 0.5 * np.diff(levels)
    planes = np.stack([middle - half / np.sqrt(3.0), middle + half / np.sqrt(3.0)], axis=1).ravel()
    weight = np.repeat(half, 2)
    volume = float((subject.cut(part, planes).areas() * weight).sum())
    exact = sections(part, planes, house_rule)
    r = subject.promise_mm(part)
    reach = r * exact.perimeters() + np.pi * r * r * exact.ring_counts()
    limit = float((reach * weight).sum()) + LEAST_INTERVAL_MM * float(exact.areas().max())
    error = abs(volume - part.volume)
    text = f"mm3: integral {volume:.9g}, volume of the mesh {part.volume:.9g}"
    return [Figure("volume", part.name, NO_LAYER, error, limit, text)]


def parity_of_rings(subject: Subject, part: Part, heights: Floats) -> list[Figure]:
    """The number of rings is odd or even as the Euler number of the surface below the plane z = h + 0: sheets with ``2 - 2 handles
    - rings`` each, which contracts onto the facets that lie wholly below, so that it is counted without any tracing."""
    layers = subject.cut(part, heights)
    edges = np.unique(np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    z = part.vertices[:, 2]
    top_of_edge, top_of_facet = z[edges].max(axis=1), z[part.faces].max(axis=1)
    figures = []
    for k, h in enumerate(heights.tolist()):
        below = [int(np.count_nonzero(top <= h)) for top in (z, top_of_edge, top_of_facet)]
        euler, rings = below[0] - below[1] + below[2], int(layers.ring_counts()[k])
        text = f"{rings} rings over a surface of Euler number {euler}, at z = {h:.9g} mm"
        figures.append(truth("ring parity", part.name, (euler - rings) % 2 == 0, text, k))
    return figures


def on_grid(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round to the grid that a large shift keeps."""
    return np.round(values / COORDINATE_STEP_MM) * COORDINATE_STEP_MM


# -- the laws with fixed numbers -----------------------------------------------------------------------

Law = tuple[str, str, Callable[[Subject], list[Figure]]]  # name, summary, and what finds the figures
LawOfPart = Callable[[Subject, Part, Floats], list[Figure]]


def _over(name: str, summary: str, solids: tuple[str, ...], layers: int, law: LawOfPart) -> Law:
    """A law of some solids, each at as many heights."""

    def figures(subject: Subject) -> list[Figure]:
        parts = [simple(solid) for solid in solids]
        return [figure for part in parts for figure in law(subject, part, generic_heights(part, layers))]

    return name, summary, figures


def _maps(name: str, summary: str, layers: int, *matrices: ArrayLike, shift: ArrayLike = (0, 0, 0)) -> Law:
    def figures(subject: Subject, part: Part, z: Floats) -> list[Figure]:
        return [f for matrix in matrices for f in carried_by_map(subject, name, part, z, matrix, shift)]

    return _over(name, summary, THICK, layers, figures)


def _meshes(name: str, summary: str, other: Callable[[Part], Part]) -> Law:
    def figures(subject: Subject, part: Part, z: Floats) -> list[Figure]:
        return same_sections(subject, name, part, other(part), z)

    return _over(name, summary, THICK, 2, figures)


def _far_away(subject: Subject, part: Part, z: Floats) -> list[Figure]:
    placed = from_arrays(on_grid(part.vertices), part.faces, part.name)
    return carried_by_map(subject, "large offset", placed, on_grid(z), np.eye(3), LARGE_OFFSET_MM)


def _beside_a_torus(subject: Subject, part: Part, z: Floats) -> list[Figure]:
    return disjoint_union(subject, part, simple("torus"), z)


def _volume(subject: Subject, part: Part, _: Floats) -> list[Figure]:
    return volume_from_areas(subject, part)


FAR_SOLIDS = ("tilted plate", "sphere", "upright torus")
LARGER = "A part twice or a quarter as large has sections twice or a quarter as large."
OVER = "The part turned upside down has mirrored sections, in the opposite order."
BESIDE = "Two parts beside each other have the sections of both."
PARITY = "Rings come and go with the handles and pieces of the surface below the plane."
LAWS = (
    _maps("translation", "Moving the part moves its sections.", 2, np.eye(3), shift=(3.1415, -7.77, 11.3)),
    _maps("rotation", "Turning the part about z turns its sections, by any angle.", 1, turn(45.0), turn(163.7)),
    _maps("mirror", "Mirroring the part mirrors its sections.", 2, np.diag([-1.0, 1.0, 1.0])),
    _maps("scale", LARGER, 1, 0.25 * np.eye(3), 2.0 * np.eye(3)),
    _maps("upside down", OVER, 2, np.diag([1.0, -1.0, -1.0])),
    _over("large offset", "Far from the origin sections are as good as near it.", FAR_SOLIDS, 2, _far_away),
    _meshes("facet order", "The order of facets and of their corners does not matter.", shuffled_facets),
    _meshes("vertex order", "How vertices are numbered does not matter.", shuffled_vertices),
    _meshes("subdivision", "Cutting every facet into four does not change the solid.", subdivided),
    _over("union of parts", BESIDE, ("plate with holes", "sphere"), 3, _beside_a_torus),
    _over("volume", "The integral of areas along z is the volume.", FEW_LEVELS, 1, _volume),
    _over("ring parity", PARITY, THICK, 5, parity_of_rings),
)

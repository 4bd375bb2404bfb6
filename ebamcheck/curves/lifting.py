"""Lifting: contour points move from the straight edges of the mesh to the curved edges of the surface that it approximates.

A contour's points lie on chords of the surface, so a curve through them keeps the chord error. Each edge between two vertices
is therefore replaced by a cubic that is perpendicular to the surface normals at its ends (a Hermite edge, as in Vlachos et al.
2001, "Curved PN triangles"), and the point moves to where that cubic crosses the layer. The edge bends at both ends by the
lesser of the two angles that the normals demand, and not at all where these demand large bends to opposite sides: so a normal
spoilt by a neighbour of another curvature does not make it overshoot. Edges of planes and the rulings of strips do not bend.
Any other edge bends, at each end, by no more than the mesh itself turns there from the edge to the facets behind its end: an
error d of a normal lifts an edge of length l by l d / 8, which is much for a long edge beside fine facets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.ends_ahead import ends_ahead, nothing_asked
from ebamcheck.curves.exact.refining import refined
from ebamcheck.curves.exact.sections import is_placed, place_beside
from ebamcheck.curves.plausible import (
    judge_ends,
    judge_far_ends,
    plausible_height,
    plausible_share,
    sure_share,
    told_share,
)
from ebamcheck.curves.regions import FREEFORM, PLANE, STRIP
from ebamcheck.curves.sagitta import surface_of
from ebamcheck.curves.sides import Sides, as_they_are
from ebamcheck.curves.surface_edges import (
    SurfaceMesh,
    Vector,
    behind,
    bend_at,
    dot,
    half_edges,
    minus,
    normals_of,
    scaled,
    vector,
)
from ebamcheck.curves.vertex_normals import SurfaceNormals, corners_of_vertices
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints

MOST_STEPS = 60
"""Most steps towards the place of a layer on a curved edge; as many halvings reach rounding."""

SAME_PLACE = 1e-14
"""Step along an edge, over its length, that counts as rounding."""

FLATTEST_SURFACE = 0.25
"""Sine of the surface's slope below which a move in the layer grows no further: a point moves at most the height of the
curved edge over its chord, divided by this."""

LEAST_SIDEWAYS = 1e-6
"""Horizontal part of a unit normal below which the contour has no tangent there: the surface is level."""

LARGEST_INFLECTION = np.sin(np.deg2rad(5.0))
"""Sine of the largest bends to opposite sides at the two ends of an edge; larger ones show a flat side between curved ones."""

MOST_OF_TURN = 2.0
"""An edge far longer than those behind its end bends there by at most this many times as much as a circle through it and
the neighbours behind would. These lie to both sides of its line, where the surface may be curved differently."""

JUMP = 4.0
"""An edge this many times longer than those behind one of its ends belongs to another region of the surface, unless it bends
as they do: the normal there describes the finer side, not the edge."""

ALIKE = 2.0
"""Curvatures of an edge and of the neighbours behind its end that differ by less than this factor are those of one surface."""

NOISE_LIFT = 0.5
"""Lift over noise: vertices that lie s off their surface tilt a normal so that it lifts an edge by a quarter to half of s."""

POINTS_A_BLOCK = 4096


class Lifting:
    """Lifts contours of one part; the normals are found once.

    Parameters
    ----------
    part
        The mesh that was cut.
    normals
        Normals of the surface that the mesh approximates.
    """

    def __init__(self, part: Part, normals: SurfaceNormals) -> None:
        self.mesh = judged_mesh(part, normals)
        self.exact = normals.exact

    def lift(self, layers: Layers) -> Sides:
        """Lift the points of layers that carry their edges; points without one stay where they are."""
        found = as_they_are(np.ascontiguousarray(layers.points).copy())
        if layers.edge is None or layers.edge_t is None:
            raise ValueError("layers without edges cannot be lifted")
        ring_heights = np.repeat(layers.heights, np.diff(layers.layer_starts))
        heights = np.repeat(ring_heights, np.diff(layers.ring_starts))
        edge, edge_t = np.ascontiguousarray(layers.edge), np.ascontiguousarray(layers.edge_t)

        def work(first: int, last: int) -> None:
            _lift(self.mesh, edge, edge_t, heights, first, last, found)

        run_blocks(work, len(layers.points), POINTS_A_BLOCK)
        return found

    def lifted_rings(self, layers: Layers) -> tuple[Sides, Ints]:
        """Lift the points of layers and insert points on exact surfaces; returns them and the new starts of the rings."""
        sides = self.lift(layers)
        heights = np.repeat(layers.heights, np.diff(layers.layer_starts))
        return refined(self.exact.rows, sides, heights, layers.ring_starts, layers.closed)


@kernel
def _lift(
    mesh: SurfaceMesh, edge: Index, edge_t: Floats, heights: Floats, first: int, last: int, found: Sides
) -> None:
    for i in range(first, last):
        low, high = edge[i, 0], edge[i, 1]
        if low < 0:
            continue
        # Facets look outward and solids lie to the left of a contour: the segment that ends here is in the facet
        # that runs up this edge, the one that begins here in the facet that runs down.
        up, down = half_edges(mesh, low, high)
        if up < 0 or down < 0:
            continue
        found.flat[i] = mesh.flat[down // 3]
        if mesh.kind[up // 3] == PLANE:
            found.plane_before[i] = mesh.region[up // 3]
        if mesh.kind[down // 3] == PLANE:
            found.plane_after[i] = mesh.region[down // 3]
        if not is_placed(mesh, up, down, heights[i], i, found):
            x, y = found.points[i, 0], found.points[i, 1]
            _lift_by_normals(mesh, up, down, heights[i], edge_t[i], i, found)
            place_beside(mesh, up, down, (x, y, heights[i]), i, found)


@kernel
def _lift_by_normals(
    mesh: SurfaceMesh, up: int, down: int, height: float, t: float, i: int, found: Sides
) -> None:
    """Lift point i of contours to the curved edge over its straight one."""
    low, high = mesh.faces[up // 3, up % 3], mesh.faces[up // 3, (up % 3 + 1) % 3]
    up_low, up_high = normals_of(mesh, up)
    down_high, down_low = normals_of(mesh, down)
    chord = minus(vector(mesh.vertices, high), vector(mesh.vertices, low))
    smooth = mesh.smooth[up] and mesh.smooth[down]
    found.plausible[i] = plausible_height(mesh, low, high)
    found.rough[i] = _is_rough(mesh, up) or _is_rough(mesh, down)
    if mesh.kind[up // 3] == FREEFORM or mesh.kind[down // 3] == FREEFORM:
        found.share[i] = mesh.share
    if not (found.rough[i] or _is_straight(mesh, up, down, smooth)):
        bend_low, bend_high = _bends(mesh, up, down, chord, smooth)
        flat = mesh.flat[up // 3] and mesh.flat[down // 3]
        if _bends_alike(chord, bend_low, bend_high, flat):
            if not (smooth and mesh.kind[up // 3] == STRIP and mesh.kind[down // 3] == STRIP):
                lesser = min(dot(bend_low, bend_low), dot(bend_high, bend_high))
                bend_low = scaled(bend_low, np.sqrt(lesser / dot(bend_low, bend_low)))
                bend_high = scaled(bend_high, np.sqrt(lesser / dot(bend_high, bend_high)))
            # The cubic leaves its chord by at most a quarter of the bend.
            most = 0.25 * np.sqrt(max(dot(bend_low, bend_low), dot(bend_high, bend_high)))
            outward = dot(bend_low, up_low) > 0.0
            if smooth:
                found.share[i] *= sure_share(mesh, up, down, most, outward)
            share = plausible_share(most, found.plausible[i])
            if smooth and mesh.ends.turns.size:
                share = min(share, told_share(mesh, up, down, most, outward))
            share *= found.share[i]
            bend_low, bend_high = scaled(bend_low, share), scaled(bend_high, share)
            start = vector(mesh.vertices, low)
            t = _place(start[2], chord[2], bend_low[2], bend_high[2], height, t)
            _move(found.points[i], start, chord, bend_low, bend_high, t, share * most / FLATTEST_SURFACE)
    _set_direction(up_low, up_high, t, found.before[i])
    _set_direction(down_low, down_high, t, found.after[i])
    x, y = 0.5 * (down_low[0] + down_high[0]), 0.5 * (down_low[1] + down_high[1])
    found.plausible[i] /= max(np.hypot(x, y), FLATTEST_SURFACE)
    found.smooth[i] = smooth


@kernel
def _is_rough(mesh: SurfaceMesh, half_edge: int) -> bool:
    f, k = half_edge // 3, half_edge % 3
    return bool(mesh.rough[mesh.sectors[f, k]] or mesh.rough[mesh.sectors[f, (k + 1) % 3]])


@kernel
def _is_straight(mesh: SurfaceMesh, up: int, down: int, smooth: bool) -> bool:
    """Whether an edge is a straight line of the part: in or along a plane, or a ruling between two strips."""
    kind, other = mesh.kind[up // 3], mesh.kind[down // 3]
    if smooth:
        if kind == PLANE or other == PLANE:
            return True
        return bool(kind == STRIP and other == STRIP and mesh.region[up // 3] != mesh.region[down // 3])
    return bool(kind == PLANE and other == PLANE)


@kernel
def _bends(mesh: SurfaceMesh, up: int, down: int, chord: Vector, smooth: bool) -> tuple[Vector, Vector]:
    """Bends at the lower and the upper end of an edge, as far as the mesh bears them out."""
    up_low, up_high = normals_of(mesh, up)
    down_high, down_low = normals_of(mesh, down)
    if smooth and mesh.kind[down // 3] == STRIP:
        up_low, up_high = down_low, down_high  # a strip's normals stand across its rulings
    bend_low = bend_at(chord, up_low, down_low, smooth)
    bend_high = bend_at(chord, up_high, down_high, smooth)
    if not smooth:
        return bend_low, bend_high
    if mesh.kind[up // 3] != FREEFORM or mesh.kind[down // 3] != FREEFORM:
        return bend_low, bend_high
    most_low, jump_low = _most(mesh, up, up % 3, chord, up_low)
    most_high, jump_high = _most(mesh, up, (up % 3 + 1) % 3, scaled(chord, -1.0), up_high)
    nowhere = jump_low and jump_high
    if jump_low and not jump_high:
        nowhere = not _is_worth(mesh, up // 3, (up % 3 + 1) % 3, bend_high)
    elif jump_high and not jump_low:
        nowhere = not _is_worth(mesh, up // 3, up % 3, bend_low)
    if nowhere:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return _limited(bend_low, most_low), _limited(bend_high, most_high)


@kernel
def _is_worth(mesh: SurfaceMesh, f: int, corner: int, bend: Vector) -> bool:
    """Whether the only end that tells how an edge bends tells more than the noise about it would."""
    return bool(0.25 * np.sqrt(dot(bend, bend)) >= NOISE_LIFT * mesh.noise[mesh.sectors[f, corner]])


@kernel
def _limited(bend: Vector, most: float) -> Vector:
    length = np.sqrt(dot(bend, bend))
    return bend if length <= most else scaled(bend, most / length)


@kernel
def _most(mesh: SurfaceMesh, up: int, corner: int, chord: Vector, normal: Vector) -> tuple[float, bool]:
    """How far an edge may bend at one end, mm, by what lies behind it; and whether that is far finer than the edge.

    Edge and neighbours behind, in the same smooth fan, drop from the tangent plane by angles whose sum does not depend on
    how the plane is tilted: the turn of the mesh along the edge, of which a circle gives the edge its share by length.
    Without a neighbour behind, at a crease, nothing limits it.
    """
    found = behind(mesh, up // 3, corner, chord, normal)
    reach, drop = found.reach, found.drop
    if reach == 0.0:
        return np.inf, False
    length = np.sqrt(dot(chord, chord))
    ahead = -dot(chord, normal) / length
    # On one surface edge and neighbours bend alike: their drops go with their lengths.
    alike = ahead * drop > 0.0 and 1.0 / ALIKE < (ahead * reach) / (drop * length) < ALIKE
    if length < JUMP * reach or alike:
        return np.inf, False
    return MOST_OF_TURN * abs(drop + ahead) * length * length / (length + reach), True


@kernel
def _bends_alike(chord: Vector, bend_low: Vector, bend_high: Vector, flat: bool) -> bool:
    """Whether an edge bends to one side, or so little, off flat sides, that an inflection is the surface's own."""
    alike = dot(bend_low, bend_high) < 0.0
    if alike or flat:
        return alike
    lesser = min(dot(bend_low, bend_low), dot(bend_high, bend_high))
    return bool(0.0 < lesser < LARGEST_INFLECTION * LARGEST_INFLECTION * dot(chord, chord))


@kernel
def _place(
    start: float, rise: float, bend_low: float, bend_high: float, height: float, guess: float
) -> float:
    """Parameter at which the curved edge passes a height: Newton's steps, kept within halves that hold it."""
    a, b = 0.0, 1.0
    t = guess
    for _ in range(MOST_STEPS):
        s = 1.0 - t
        off = start + rise * t + t * s * (s * bend_low - t * bend_high) - height
        if off <= 0.0:
            a = t
        else:
            b = t
        slope = rise + s * (s - 2.0 * t) * bend_low - t * (2.0 * s - t) * bend_high
        step = -off / slope if slope != 0.0 else np.inf
        following = t + step
        if not a < following < b:
            following = 0.5 * (a + b)
        if abs(following - t) <= SAME_PLACE:
            return following
        t = following
    return t


@kernel
def _move(
    point: Floats,
    low: Vector,
    chord: Vector,
    bend_low: Vector,
    bend_high: Vector,
    t: float,
    farthest: float,
) -> None:
    """Move a contour point to its place on the curved edge, as far as its bound lets it."""
    a, b = t * (1.0 - t) * (1.0 - t), t * t * (1.0 - t)
    dx = low[0] + chord[0] * t + a * bend_low[0] - b * bend_high[0] - point[0]
    dy = low[1] + chord[1] * t + a * bend_low[1] - b * bend_high[1] - point[1]
    moved = np.hypot(dx, dy)
    share = 1.0 if moved <= farthest else farthest / moved
    point[0] += share * dx
    point[1] += share * dy


@kernel
def _set_direction(low: Vector, high: Vector, t: float, direction: Floats) -> None:
    """Direction of a contour with the solid to its left, from outward normals; NaN stays where there is none."""
    x, y = low[0] * (1.0 - t) + high[0] * t, low[1] * (1.0 - t) + high[1] * t
    sideways = np.hypot(x, y)
    if sideways > LEAST_SIDEWAYS:
        direction[0], direction[1] = -y / sideways, x / sideways


# -- Judged mesh: a mesh with its estimated normals, and whether the mesh itself supports them -----------------


BY_CHANCE = 0.1
"""Ratio of strips to freely curved facets up to which the strips are facets of a decimated mesh, coplanar by chance."""

MOST_ASKED = 5_000
"""Facets of a tessellator's mesh whose edges are checked for noise, evenly spread: more would add nothing."""


def judged_mesh(part: Part, normals: SurfaceNormals) -> SurfaceMesh:
    """Put mesh and normals together, and judge them.

    Parameters
    ----------
    part
        The mesh that was cut.
    normals
        Its normals.
    """
    starts, corners = corners_of_vertices(part.faces, len(part.vertices))
    mesh = SurfaceMesh(
        part.vertices,
        part.faces,
        normals.sectors,
        normals.normals,
        normals.smooth,
        normals.flat,
        normals.kind,
        normals.region,
        normals.fans,
        normals.rough,
        normals.noise,
        starts,
        corners,
        *normals.sagittas,
        normals.rims,
        nothing_asked(),
        True,
        False,
        1.0,
        *normals.exact,
    )
    mesh, noisy = _with_ends(mesh, part, normals)
    ends = judge_ends(mesh)
    rough = mesh.rough.copy()
    share = normals.offsets.lift_share
    if ends.is_rough or noisy or share == 0.0:
        rough[mesh.sectors[_nothing_to_tell(mesh.kind)]] = True
    scattered = ends.is_scattered and mesh.far_ends_right
    return mesh._replace(scattered=scattered, rough=rough, share=share)


def _nothing_to_tell(kind: NDArray[np.uint8]) -> Bools:
    """Facets (F,) to leave unlifted if the freely curved ones show no surface: these, and strips that are few enough for chance."""
    free, strip = kind == FREEFORM, kind == STRIP
    by_chance = np.count_nonzero(strip) <= BY_CHANCE * np.count_nonzero(free)
    return np.asarray(free | strip if by_chance else free)


def _with_ends(mesh: SurfaceMesh, part: Part, normals: SurfaceNormals) -> tuple[SurfaceMesh, bool]:
    """The mesh with the turns ahead of its edges, if its normals need that check, and whether they show noise.

    A sample of edges is enough to find noise. The normals of a tessellator's mesh need no further check; on any other mesh all
    edges are checked, and the result is kept.
    """
    in_rows = normals.offsets.is_in_rows
    surface = surface_of(part, np.cos(np.deg2rad(normals.crease_angle_deg)))
    mesh = mesh._replace(ends=ends_ahead(surface, -(-len(part.faces) // MOST_ASKED) if in_rows else 1))
    found = judge_far_ends(mesh)
    if in_rows:
        return mesh._replace(ends=nothing_asked()), found.are_noise
    return mesh._replace(far_ends_right=found.are_right), found.are_noise

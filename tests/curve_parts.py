"""Meshes of parts whose surfaces are known, made as other programs make them: long strips beside fine fillets, slivers,
coordinates of 32 bits or four decimals, decimated, noisy, in any direction.

Each maker takes a chord error; the same part at a far smaller one is the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay

from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.slicers.slicing import slice_part

Array = NDArray[np.float64]
Maker = Callable[[float], Part]


def steps(radius: float, sweep: float, chord_mm: float, least: int = 1) -> int:
    """Chords of an arc that leave it by no more than the chord error."""
    most = 2.0 * np.arccos(max(1.0 - chord_mm / radius, 0.0))
    return max(least, int(np.ceil(abs(sweep) / most - 1e-9)))


def arc(x: float, y: float, radius: float, start_deg: float, end_deg: float, chord_mm: float) -> Array:
    start, end = np.deg2rad([start_deg, end_deg])
    at = np.linspace(start, end, steps(radius, end - start, chord_mm) + 1)
    return np.column_stack([x + radius * np.cos(at), y + radius * np.sin(at)])


def cap(rings: list[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Triangles (counter-clockwise) of a region within its first ring and outside of the others."""
    points = np.concatenate(rings)
    region = shapely.Polygon(rings[0], rings[1:])
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(region))
    corners = np.array([np.asarray(shapely.orient_polygons(t).exterior.coords)[:3] for t in triangles])
    index = {tuple(p): k for k, p in enumerate(points.tolist())}
    return points, np.array([[index[tuple(c)] for c in t.tolist()] for t in corners])


def extruded(rings: list[Array], height: float, rows: int = 1) -> Part:
    """Upright prism over rings: the first counter-clockwise, holes clockwise."""
    base, flat = cap(rings)
    count = len(base)
    vertices = np.concatenate(
        [np.column_stack([base, np.full(count, z)]) for z in np.linspace(0.0, height, rows + 1)]
    )
    faces = [flat[:, ::-1], flat + rows * count]
    first = 0
    for ring in rings:
        a = first + np.arange(len(ring))
        b = first + np.roll(np.arange(len(ring)), -1)
        for row in range(rows):
            low, high = row * count, (row + 1) * count
            faces += [
                np.column_stack([a + low, b + low, b + high]),
                np.column_stack([a + low, b + high, a + high]),
            ]
        first += len(ring)
    return from_arrays(vertices, np.concatenate(faces))


def revolved(profile: Array, chord_mm: float) -> Part:
    """Body of revolution about z; the profile goes up outside, from axis to axis."""
    inner = profile[1:-1]
    n = steps(inner[:, 0].max(), 2.0 * np.pi, chord_mm, 3)
    at = np.arange(n) * 2.0 * np.pi / n
    grid = np.stack(
        [inner[:, :1] * np.cos(at), inner[:, :1] * np.sin(at), np.repeat(inner[:, 1:], n, 1)], axis=-1
    ).reshape(-1, 3)
    rows = len(inner)
    ends = [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    faces = [np.column_stack([np.full(n, rows * n), b, a])]
    for r in range(rows - 1):
        low, high = r * n, (r + 1) * n
        faces += [
            np.column_stack([a + low, b + low, b + high]),
            np.column_stack([a + low, b + high, a + high]),
        ]
    faces.append(np.column_stack([np.full(n, rows * n + 1), a + (rows - 1) * n, b + (rows - 1) * n]))
    return from_arrays(np.concatenate([grid, ends]), np.concatenate(faces))


def rounded_box(size: ArrayLike, radius: float, chord_mm: float) -> Part:
    """Box whose edges and corners are rounded: six planes, twelve cylinders, eight spheres."""
    half = np.asarray(size, float) / 2.0 - radius
    n = steps(radius, 0.5 * np.pi, chord_mm, 2)
    angle = np.linspace(0.0, 0.5 * np.pi, n + 1)
    around = np.concatenate([k * 0.5 * np.pi + angle for k in range(4)])
    sign_x = np.repeat([1.0, -1.0, -1.0, 1.0], n + 1)
    sign_y = np.repeat([1.0, 1.0, -1.0, -1.0], n + 1)
    rows = []
    for tilt, sign_z in [(-angle[::-1], -1.0), (angle, 1.0)]:
        for t in tilt:
            x = sign_x * half[0] + radius * np.cos(t) * np.cos(around)
            y = sign_y * half[1] + radius * np.cos(t) * np.sin(around)
            rows.append(np.column_stack([x, y, np.full(x.size, sign_z * half[2] + radius * np.sin(t))]))
    m = around.size
    vertices = np.concatenate(rows)
    faces = []
    a, b = np.arange(m), np.roll(np.arange(m), -1)
    for r in range(len(rows) - 1):
        low, high = r * m, (r + 1) * m
        faces += [
            np.column_stack([a + low, b + low, b + high]),
            np.column_stack([a + low, b + high, a + high]),
        ]
    top = (len(rows) - 1) * m
    corners = np.arange(4) * (n + 1)
    faces += [
        np.array([[corners[0], corners[2], corners[1]], [corners[0], corners[3], corners[2]]]),
        top + np.array([[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]),
    ]
    return cleaned(vertices, np.concatenate(faces))


def cleaned(vertices: Array, faces: NDArray[np.int64]) -> Part:
    """Weld vertices at one place, and leave out facets that lost a corner by it."""
    _, first, inverse = np.unique(np.round(vertices, 9), axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    good = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return from_arrays(vertices[first], faces[good])


def rounded_rectangle(x: float, y: float, radius: float, chord_mm: float) -> Array:
    corners = [
        (x - radius, y - radius),
        (radius - x, y - radius),
        (radius - x, radius - y),
        (x - radius, radius - y),
    ]
    return np.concatenate(
        [arc(cx, cy, radius, 90.0 * k, 90.0 * k + 90.0, chord_mm) for k, (cx, cy) in enumerate(corners)]
    )


def lofted(bottom: Array, top: Array, height: float) -> Part:
    """Ruled side between two outlines of as many points, with flat caps."""
    part = extruded([bottom], height)
    vertices = part.vertices.copy()
    vertices[len(bottom) :, :2] = top
    return from_arrays(vertices, part.faces)


def draft_box(chord_mm: float) -> Part:
    """Sides that lean by 3 degrees; corners are pieces of cones."""
    lean = 30.0 * np.tan(np.deg2rad(3.0))
    n_mm = min(chord_mm, 4.9)
    bottom = rounded_rectangle(30.0, 20.0, 5.0, n_mm)
    centre = np.sign(bottom) * np.array([25.0, 15.0])
    top = centre + (bottom - centre) * (5.0 - lean) / 5.0
    return lofted(bottom, top, 30.0)


def polygon(sides: int, radius: float) -> Array:
    at = np.arange(sides) * 2.0 * np.pi / sides
    return radius * np.column_stack([np.cos(at), np.sin(at)])


def bent_plate(degrees: float, chord_mm: float = 0.1) -> Part:
    """Plate 6 mm thick of two planes that meet at an angle."""
    a = np.deg2rad(degrees)
    far = np.array([np.cos(a), np.sin(a)])
    half = np.tan(0.5 * a)
    up = np.array([-np.sin(a), np.cos(a)])
    below = [
        (-40.0, 0.0),
        (0.0, 0.0),
        tuple(40.0 * far),
        tuple(40.0 * far + 6.0 * up),
        (-6.0 * half, 6.0),
        (-40.0, 6.0),
    ]
    return extruded([np.array(below)], 50.0)


def bracket(chord_mm: float) -> Part:
    """Angle section with rounded corners and two bores."""
    outer = np.concatenate(
        [
            [[0.0, 0.0], [50.0, 0.0]],
            arc(47.0, 5.0, 3.0, 0.0, 90.0, chord_mm),
            arc(13.0, 13.0, 5.0, 270.0, 180.0, chord_mm),
            arc(5.0, 37.0, 3.0, 0.0, 90.0, chord_mm),
            [[0.0, 40.0]],
        ]
    )
    hole = arc(6.0, 6.0, 3.0, 360.0, 0.0, chord_mm)[:-1]
    other = arc(30.0, 4.0, 2.0, 360.0, 0.0, chord_mm)[:-1]
    return extruded([outer, hole, other], 40.0)


def knob(chord_mm: float) -> Part:
    """Cylinder that runs into a fillet, a cone, and a rounded rim."""
    profile = np.concatenate(
        [
            [[0.0, 0.0], [25.0, 0.0], [25.0, 4.0]],
            arc(15.0, 9.0, 5.0, 270.0, 180.0, chord_mm),
            [[10.0, 30.0], [13.0, 45.0]],
            arc(11.0, 45.0, 2.0, 0.0, 90.0, chord_mm),
            [[0.0, 47.0]],
        ]
    )
    return revolved(profile, chord_mm)


def frustum(chord_mm: float) -> Part:
    return revolved(np.array([[0.0, 0.0], [22.0, 0.0], [9.0, 35.0], [0.0, 35.0]]), chord_mm)


# -- what files and other programs do to meshes ---------------------------------------------------------


def turned(part: Part, seed: int) -> Part:
    """The part in a random direction, and a little off its place."""
    rng = np.random.default_rng(seed)
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0.0:
        q[:, 0] *= -1.0
    return from_arrays(part.vertices @ q.T + rng.uniform(-20.0, 20.0, 3), part.faces)


def as_float32(part: Part) -> Part:
    return from_arrays(part.vertices.astype(np.float32).astype(float), part.faces)


def as_decimals(part: Part, digits: int = 4) -> Part:
    return from_arrays(np.round(part.vertices, digits).astype(np.float32).astype(float), part.faces)


def noisy(part: Part, noise_mm: float, seed: int = 1) -> Part:
    rng = np.random.default_rng(seed)
    return from_arrays(part.vertices + noise_mm * rng.normal(size=part.vertices.shape), part.faces)


def split_edges(part: Part, count: int, off_mm: float, seed: int = 1, near: float = 0.5) -> Part:
    """Split random edges at a random place (from `near` to its opposite), and move the new vertices a little."""
    rng = np.random.default_rng(seed)
    faces = [tuple(f) for f in part.faces.tolist()]
    vertices = part.vertices.tolist()
    for _ in range(count):
        f = int(rng.integers(len(faces)))
        k = int(rng.integers(3))
        a, b = faces[f][k], faces[f][(k + 1) % 3]
        other = [g for g, t in enumerate(faces) if a in t and b in t and g != f]
        if len(other) != 1:
            continue
        t = rng.uniform(near, 1.0 - near) if near < 0.5 else 0.5
        place = np.asarray(vertices[a]) * (1.0 - t) + np.asarray(vertices[b]) * t
        vertices.append((place + off_mm * rng.choice([-1.0, 1.0]) * np.ones(3) / np.sqrt(3.0)).tolist())
        new = len(vertices) - 1
        for g in (f, other[0]):
            t3 = faces[g]
            faces[g] = tuple(new if v == b else v for v in t3)
            faces.append(tuple(new if v == a else v for v in t3))
    return from_arrays(vertices, faces)


def decimated(part: Part, share: float, seed: int = 1) -> Part:
    """Collapse random edges onto one of their vertices, where no facet turns over by it."""
    rng = np.random.default_rng(seed)
    faces = part.faces.astype(np.int64).copy()
    vertices = part.vertices
    alive = np.ones(len(faces), bool)
    around: list[set[int]] = [set() for _ in vertices]
    for f, t in enumerate(faces.tolist()):
        for v in t:
            around[v].add(f)

    def normal(t: Any) -> Array:
        a, b, c = vertices[t[0]], vertices[t[1]], vertices[t[2]]
        return np.cross(b - a, c - a)

    wanted = int(share * len(faces))
    for _ in range(50 * len(faces)):
        if alive.sum() <= wanted:
            break
        f = int(rng.integers(len(faces)))
        if not alive[f]:
            continue
        k = int(rng.integers(3))
        a, b = int(faces[f, k]), int(faces[f, (k + 1) % 3])
        ring_a = {int(v) for g in around[a] for v in faces[g]} - {a}
        ring_b = {int(v) for g in around[b] for v in faces[g]} - {b}
        if len(ring_a & ring_b) != 2:
            continue
        moving = [g for g in around[a] if b not in faces[g]]
        changed = {g: [b if v == a else int(v) for v in faces[g]] for g in moving}
        fine = True
        for g, t in changed.items():
            before, after = normal(faces[g]), normal(t)
            scale = np.linalg.norm(before) * np.linalg.norm(after)
            fine &= bool(before @ after > 0.94 * scale and scale > 0.0)
        if not fine:
            continue
        for g in around[a] & around[b]:
            alive[g] = False
            for v in faces[g]:
                if v != a:
                    around[v].discard(g)
        for g, t in changed.items():
            faces[g] = t
            around[b].add(g)
        around[a] = set()
    faces = faces[alive]
    used, inverse = np.unique(faces, return_inverse=True)
    return from_arrays(vertices[used], inverse.reshape(-1, 3))


def scattered_torus(points: int, seed: int = 1) -> Part:
    """Torus by Delaunay's triangles over random places, all on the surface."""
    rng = np.random.default_rng(seed)
    big, small = 30.0, 12.0
    u, v = rng.random(points), rng.random(points)
    shifts = [(i, j) for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)]
    wide = np.concatenate([np.column_stack([u + i, v + j]) for i, j in shifts])
    index = np.tile(np.arange(points), 9)
    triangles = Delaunay(wide * [2.0 * np.pi * big, 2.0 * np.pi * small]).simplices
    middle = wide[triangles].mean(axis=1)
    triangles = triangles[((middle >= 0.0) & (middle < 1.0)).all(axis=1)]
    a, b, c = (wide[triangles[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles[turn < 0.0] = triangles[turn < 0.0][:, ::-1]
    p, q = 2.0 * np.pi * u, 2.0 * np.pi * v
    r = big + small * np.cos(q)
    return from_arrays(np.column_stack([r * np.cos(p), r * np.sin(p), small * np.sin(q)]), index[triangles])


def heights_of(part: Part, count: int) -> Array:
    """Heights in the middle of so many layers of a part."""
    low, high = part.bounds[:, 2]
    return low + (high - low) * (np.arange(count) + 0.5) / count


def sliced(part: Part, count: int = 6) -> Layers:
    """So many layers of a part, by the default slicer."""
    return slice_part(part, heights_of(part, count))

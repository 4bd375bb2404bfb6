"""Bodies of a part: how they lie to each other, and the volume of what is built of them, where the winding number is over 0.
Boxes are looked at first, then points of the smaller body; manifold3d is asked where bodies cut each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.mesh.topology import (
    EdgeGroups,
    Index,
    body_labels,
    components,
    direction_balance,
    duplicates,
    edge_groups,
)

if TYPE_CHECKING:
    from manifold3d import Manifold

    from ebamcheck.mesh.part import Mesh, Part


# How far within a body its points are taken, and how deep boxes must meet, over the size of the part: over the rounding of files
ASIDE = 1e-6
# Volume, over that of the bounding cube, below which a part is flat: far above rounding, far below any real part
NO_VOLUME = 1e-12
SAME = 1e-6  # share by which volumes differ that are the same
# Most pairs of boxes that are looked at one by one, some tenths of a millisecond each; with more nothing is said of any
MOST_PAIRS = 20_000
# Most facets that manifold3d is given, in all, to see whether bodies lie in each other, whether they cut each other, and for their union
MOST_CUT_FACETS = 2_000_000
MOST_LISTED = 100  # most relations that are listed


@dataclass(frozen=True)
class Relation:
    """How a body lies to another one. Bodies are numbered from 1, by their first facet."""

    body: int
    other: int
    # `body` lies in `other`, is `other` once more, or overlaps it
    kind: Literal["inside", "doubled", "overlapping"]
    same_sense: bool  # whether the facets of both look the same way: out of them, or into them
    lower_mm: tuple[float, float, float]
    upper_mm: tuple[float, float, float]  # corners of the box of `body`

    @property
    def lost(self) -> bool:
        """Whether a body is lost that may have been meant as something else."""
        return self.kind == "doubled" or (self.kind == "inside" and self.same_sense)

    @property
    def text(self) -> str:
        """What is the case, and what is made of it."""
        size = " x ".join(f"{b - a:.6g}" for a, b in zip(self.lower_mm, self.upper_mm, strict=True))
        which = f"body {self.body} ({size} mm from {', '.join(f'{a:.6g}' for a in self.lower_mm)})"
        if self.kind == "doubled":
            return f"{which} is body {self.other} once more, doubled: it is built once"
        if self.kind == "overlapping":
            return f"{which} overlaps body {self.other}: they are built as one"
        if self.same_sense:
            return f"{which} lies in body {self.other}: body inside a body, same sense: lost cavity? It is built as solid metal"
        return f"{which} lies in body {self.other}, opposite sense: its surface bounds a cavity"


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of a part, and how they lie to each other: those first of which something may be lost."""

    label: Index  # (F,) body of each facet, from 0; -1 for a facet with a repeated corner
    volumes: Floats  # (B,) signed volume of each, mm3
    relations: tuple[Relation, ...]
    volume_mm3: (
        float  # volume of what is built (winding number > 0). Of a part that is open or inside out: the signed sum
    )
    signed_mm3: float
    known: bool = True
    """Whether that is the volume of the union; else it is the signed sum, because there were too many or too odd bodies."""


def bodies_of(mesh: Mesh, groups: EdgeGroups | None = None) -> Bodies:
    """Tell the bodies of a mesh apart; the result is kept with the mesh."""
    found: Bodies | None = mesh.__dict__.get("bodies")
    if found is None:
        found = _bodies_of(mesh, groups or edge_groups(mesh.faces, len(mesh.vertices)))
        mesh.__dict__["bodies"] = found
    return found


def _bodies_of(mesh: Mesh, groups: EdgeGroups) -> Bodies:
    label = body_labels(mesh.faces, groups)
    closed = not direction_balance(mesh.faces, groups).any()
    if closed:
        label = _apart(mesh, label)
    count = int(label.max(initial=-1)) + 1
    volumes = body_volumes(mesh, label, count)
    signed = mesh.signed_volume
    if not closed or count < 2 or inside_out_bodies(mesh, label, volumes).any():
        return Bodies(label, volumes, (), signed, signed)
    return _Look(mesh, label, volumes).found(signed)


def _apart(mesh: Mesh, label: Index) -> Index:
    """Bodies with the facets that repeat others as bodies of their own, where these are closed."""
    if not duplicates(mesh.faces):
        return label
    first = mesh.faces.argmin(axis=1)
    turned = np.take_along_axis(mesh.faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    order = np.lexsort(turned.T[::-1])
    same = (turned[order][1:] == turned[order][:-1]).all(axis=1)
    if not same.any():
        return label
    start = np.concatenate([[0], np.flatnonzero(~same) + 1])
    times = np.empty(len(order), np.int64)
    times[order] = np.arange(len(order)) - np.repeat(start, np.diff(np.append(start, len(order))))
    times[label < 0] = -1
    found, count = np.full_like(label, -1), 0
    for k in range(int(times.max()) + 1):
        rows = np.flatnonzero(times == k)
        faces = np.ascontiguousarray(mesh.faces[rows])
        groups = edge_groups(faces, len(mesh.vertices))
        if direction_balance(faces, groups).any():
            return label
        found[rows] = body_labels(faces, groups) + np.int32(count)
        count = int(found.max()) + 1
    return found


def body_volumes(mesh: Mesh, body: Index, bodies: int) -> Floats:
    """Signed volume of each body (B,), mm3, taken about a point of the body, which keeps rounding small."""
    if bodies == 0:
        return np.zeros(0)
    used = body >= 0
    first = np.full(bodies, len(body))
    np.minimum.at(first, body[used], np.flatnonzero(used))
    origin = mesh.vertices[mesh.faces[first, 0]]
    a, b, c = np.moveaxis(mesh.triangles[used] - origin[body[used], None, :], 1, 0)
    sixfold = np.bincount(body[used], np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=bodies)
    return sixfold.astype(np.float64) / 6.0


def inside_out_bodies(mesh: Mesh, body: Index, volumes: Floats) -> Bools:
    """Bodies (B,) of negative volume that are no cavity: whose box lies in that of no body of larger, positive volume."""
    negative = volumes < -NO_VOLUME * float(mesh.size.max(initial=0.0)) ** 3
    if not negative.any():
        return negative
    return outermost(negative, volumes, *body_boxes(mesh, body, volumes.size))


def body_boxes(mesh: Mesh, body: Index, bodies: int) -> tuple[Floats, Floats]:
    """Least and greatest corner of the box of each body, (B, 3) mm each."""
    order = np.argsort(body, kind="stable")
    starts = np.searchsorted(body[order], np.arange(bodies))
    a, b, c = (mesh.vertices[mesh.faces[order, corner]] for corner in range(3))
    lower = np.minimum.reduceat(np.minimum(np.minimum(a, b), c), starts)
    return lower, np.maximum.reduceat(np.maximum(np.maximum(a, b), c), starts)


def outermost(negative: Bools, volumes: Floats, lower: Floats, upper: Floats) -> Bools:
    """Bodies of negative volume (B,) that are no cavity of another body, by their boxes (B, 3)."""
    result = negative.copy()
    solid = np.flatnonzero(volumes > 0)
    for b in np.flatnonzero(negative):
        around = (lower[solid] <= lower[b]).all(axis=1) & (upper[solid] >= upper[b]).all(axis=1)
        result[b] = not (around & (volumes[solid] >= -volumes[b])).any()
    return result


class _Look:
    """A look at the bodies of a closed part."""

    def __init__(self, mesh: Mesh, label: Index, volumes: Floats) -> None:
        self.mesh, self.label, self.volumes = mesh, label, volumes
        self.count = len(volumes)
        self.lower, self.upper = body_boxes(mesh, label, self.count)
        self.aside_mm = ASIDE * float(np.linalg.norm(mesh.size))
        order = np.argsort(label, kind="stable")
        self._rows = np.split(order, np.searchsorted(label[order], np.arange(self.count)))[1:]
        self._solids: dict[int, Manifold | None] = {}
        self._budget = {"inside": MOST_CUT_FACETS, "cut": MOST_CUT_FACETS}
        self.known = True

    def found(self, signed: float) -> Bodies:
        """Relations and volume."""
        inside, overlapping = self._related()
        if not inside.size and not overlapping.size:
            return Bodies(self.label, self.volumes, (), signed, signed, self.known)
        volume = self._volume(inside, overlapping)
        known, whole = self.known and volume is not None, signed if volume is None else volume
        relations = sorted(self._relations(inside, overlapping), key=lambda r: (not r.lost, r.body))
        return Bodies(self.label, self.volumes, tuple(relations), whole, signed, known)

    def _related(self) -> tuple[Ints, Ints]:
        """Pairs (N, 2) of a body and one that it lies in, and pairs of bodies that overlap."""
        inside, overlapping = [], []
        pairs = self._near()
        for outer in np.unique(pairs[:, 1]).tolist():
            inner = pairs[pairs[:, 1] == outer, 0].tolist()
            for body, share in zip(inner, self._shares(inner, outer), strict=True):
                size = abs(float(self.volumes[body]))
                if share == 1.0 and not self._sticks_out(body, outer, size):
                    inside.append((body, outer))
                # Two bodies may cut each other where no point of one lies in the other.
                elif share > 0.0 or self._common(body, outer, "cut", 0.0) > SAME * size:
                    overlapping.append((body, outer))
        return np.array(inside, np.int64).reshape(-1, 2), np.array(overlapping, np.int64).reshape(-1, 2)

    def _near(self) -> Ints:
        """Pairs (N, 2) of bodies whose boxes share a volume: the smaller, or later, and the larger one."""
        pairs = boxes_meeting(self.lower, self.upper, self.aside_mm)
        self.known = len(pairs) <= MOST_PAIRS
        later, earlier = (pairs if self.known else pairs[:0]).T
        size = np.abs(self.volumes)
        turn = size[later] > size[earlier]
        return np.stack([np.where(turn, earlier, later), np.where(turn, later, earlier)], axis=1)

    def _shares(self, inner: list[int], outer: int) -> Iterator[float]:
        """Share of the surface of each body that lies in another one."""
        import shapely

        corners = self.mesh.vertices[self.mesh.faces[self._rows[outer]]]
        low, high = corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)
        tree = shapely.STRtree(shapely.box(*low.T, *high.T))
        for body in inner:
            points = self._points(body)
            at, facet = tree.query(shapely.points(points[:, :2]))
            yield float((windings(points, corners, at, facet) != 0).mean()) if len(points) else 0.0

    def _points(self, body: int) -> Floats:
        """Points (N, 3) just within a body, on some of its facets."""
        rows = self._rows[body]
        corners = self.mesh.vertices[self.mesh.faces[rows[:: max(1, len(rows) // 4096)]]]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(across, axis=1)
        kept = length > 0.0
        inwards = -np.sign(self.volumes[body]) * across[kept] / length[kept, None]
        # Where on a facet: on no line that a regular mesh has.
        within = np.einsum("k,fki->fi", np.array([0.3512, 0.2871, 0.3617]), corners[kept])
        return np.asarray(within + self.aside_mm * inwards)

    def _sticks_out(self, body: int, other: int, size: float) -> bool:
        """Whether a body, of which all points looked at lie in the other, reaches out of it between them."""
        below = self.lower[body] < self.lower[other] - self.aside_mm
        above = self.upper[body] > self.upper[other] + self.aside_mm
        return bool((below | above).any() or self._common(body, other, "inside", size) < (1.0 - SAME) * size)

    def _common(self, body: int, other: int, question: str, unknown: float) -> float:
        """Volume that two bodies share; `unknown` where manifold3d is not asked, or takes one for no solid."""
        facets = len(self._rows[body]) + len(self._rows[other])
        if facets > self._budget[question]:
            return unknown
        self._budget[question] -= facets
        a, b = self._solid(body), self._solid(other)
        return unknown if a is None or b is None else float((a ^ b).volume())

    def _solid(self, body: int) -> Manifold | None:
        """Body as a solid of manifold3d, whatever its sense; None where that takes it for none."""
        import manifold3d

        if body not in self._solids:
            used, faces = np.unique(self.mesh.faces[self._rows[body]], return_inverse=True)
            faces = faces.reshape(-1, 3)
            faces = faces if self.volumes[body] > 0.0 else faces[:, ::-1]
            mesh = manifold3d.Mesh64(self.mesh.vertices[used], np.ascontiguousarray(faces, np.uint64))
            solid = manifold3d.Manifold(mesh)
            self._solids[body] = solid if solid.status() == manifold3d.Error.NoError else None
        return self._solids[body]

    def _volume(self, inside: Ints, overlapping: Ints) -> float | None:
        """Volume of the places with a winding number over 0; None where it is not found."""
        sign = np.sign(self.volumes).astype(np.int64)
        outer = np.bincount(inside[:, 0], sign[inside[:, 1]], self.count).astype(np.int64)
        # A surface counts where the winding number changes between 0 and more.
        counts = (outer + sign > 0).astype(np.int64) - (outer > 0)
        cluster = np.full(self.count, -1)
        if overlapping.size:
            joined = components(self.count, *np.concatenate([inside, overlapping]).T)
            cut = np.isin(joined, joined[overlapping[:, 0]])
            cluster[cut] = joined[cut]
        volume = float((counts * np.abs(self.volumes))[cluster < 0].sum())
        for one in np.unique(cluster[cluster >= 0]).tolist():
            more = self._united(np.flatnonzero(cluster == one).tolist())
            if more is None:
                return None
            volume += more
        return volume

    def _united(self, bodies: list[int]) -> float | None:
        """Volume of the places that lie in more outward bodies than inward ones, of bodies that cut each other."""
        import manifold3d

        if sum(len(self._rows[k]) for k in bodies) > MOST_CUT_FACETS:
            return None
        made = {k: solid for k in bodies if (solid := self._solid(k)) is not None}
        if len(made) < len(bodies):
            return None
        solids = [solid for k, solid in made.items() if self.volumes[k] > 0.0]
        voids = [solid for k, solid in made.items() if self.volumes[k] < 0.0]
        if not voids:
            return float(manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).volume())
        layers = len(voids) + 1
        if layers * len(bodies) > 1000:
            return None
        # In at least k solids and fewer than k voids, for some k.
        whole = manifold3d.Manifold()
        for solid, void in zip(_layers(solids, layers), _layers(voids, layers), strict=True):
            whole = whole + (solid - void)
        return float(whole.volume())

    def _relations(self, inside: Ints, overlapping: Ints) -> Iterator[Relation]:
        """Each body in the smallest one around it, and each pair that overlaps."""
        size = np.abs(self.volumes)
        innermost: dict[int, int] = {}
        for body, outer in inside.tolist():
            if body not in innermost or (size[outer], -outer) < (size[innermost[body]], -innermost[body]):
                innermost[body] = outer
        for body, outer in innermost.items():
            box = np.array([self.lower[body] - self.lower[outer], self.upper[body] - self.upper[outer]])
            twice = abs(size[outer] - size[body]) <= SAME * size[outer] and np.abs(box).max() <= self.aside_mm
            yield self._relation(body, outer, "doubled" if twice else "inside")
        yield from (self._relation(body, other, "overlapping") for body, other in overlapping.tolist())

    def _relation(self, body: int, other: int, kind: Literal["inside", "doubled", "overlapping"]) -> Relation:
        same = bool(self.volumes[body] * self.volumes[other] > 0.0)
        lower, upper = tuple(self.lower[body].tolist()), tuple(self.upper[body].tolist())
        return Relation(body + 1, other + 1, kind, same, lower, upper)


def boxes_meeting(lower: Floats, upper: Floats, deep_mm: float) -> Ints:
    """Pairs (N, 2) of boxes (B, 3), the later first, that share more than a depth: all, or over :data:`MOST_PAIRS`."""
    import shapely

    boxes = np.asarray(shapely.box(*lower[:, :2].T, *upper[:, :2].T), object)
    tree, found = shapely.STRtree(boxes), [np.zeros((0, 2), np.int64)]
    for first in range(0, len(boxes), 256):
        a, b = tree.query(boxes[first : first + 256])
        a = a + first
        deep = np.minimum(upper[a], upper[b]) - np.maximum(lower[a], lower[b])
        kept = (a > b) & (deep > deep_mm).all(axis=1)
        found.append(np.stack([a[kept], b[kept]], axis=1))
        if sum(map(len, found)) > MOST_PAIRS:
            break
    return np.concatenate(found)


def _layers(solids: list[Manifold], count: int) -> list[Manifold]:
    """Places that lie in at least 1, 2 .. `count` solids."""
    import manifold3d

    found = [manifold3d.Manifold() for _ in range(count)]
    for solid in solids:
        for k in range(count - 1, 0, -1):
            found[k] = found[k] + (found[k - 1] ^ solid)
        found[0] = found[0] + solid
    return found


def windings(points: Floats, corners: Floats, at: Ints, facet: Ints) -> Ints:
    """Winding number (N,) at points: facets over it that look up, less those that look down; of pairs of a point and a facet."""
    (x, y, z), (a, b, c) = points[at].T, np.moveaxis(corners[facet], 1, 0)
    sides = ((u.T, v.T) for u, v in ((b, c), (c, a), (a, b)))
    s = np.stack([(v[0] - u[0]) * (y - u[1]) - (v[1] - u[1]) * (x - u[0]) for u, v in sides], axis=1)
    whole = s.sum(axis=1)
    over = ((s > 0.0).all(axis=1) | (s < 0.0).all(axis=1)) & (whole != 0.0)
    above = np.zeros(len(at), np.bool_)
    above[over] = (s[over] * corners[facet[over], :, 2]).sum(axis=1) / whole[over] > z[over]
    return np.bincount(at[above], np.sign(whole[above]), len(points)).astype(np.int64)


def volumes_between(part: Part, heights: Floats) -> Floats:
    """Exact volume of a mesh between consecutive ones of increasing heights, (L - 1,) mm3."""
    volumes = np.zeros(max(len(heights) - 1, 0))
    _add_volumes(part.vertices, part.faces, np.ascontiguousarray(heights), volumes)
    return volumes


@kernel
def _add_volumes(vertices: Floats, faces: Index, heights: Floats, volumes: Floats) -> None:
    """Area is the integral of (x dy - y dx) / 2 along the sections of facets, which is quadratic in z between corners."""
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0], 2], vertices[faces[f, 1], 2], vertices[faces[f, 2], 2]
        z = (min(a, b, c), max(min(a, b), min(max(a, b), c)), max(a, b, c))
        if z[2] <= heights[0] or z[0] >= heights[-1] or z[0] == z[2]:
            continue
        first = max(np.searchsorted(heights, z[0], side="right") - 1, 0)
        for layer in range(first, len(volumes)):
            if heights[layer] >= z[2]:
                break
            for piece in range(2):
                low = max(heights[layer], z[piece])
                high = min(heights[layer + 1], z[piece + 1])
                if high <= low:
                    continue
                # Simpson's rule is exact; which edges are cut is told by the middle, so that the ends are limits from inside.
                middle, total = 0.5 * (low + high), 0.0
                for level, weight in ((low, 1.0), (high, 1.0), (middle, 4.0)):
                    ax = ay = bx = by = 0.0
                    for k in range(3):
                        p, q = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
                        if (p[2] <= middle) == (q[2] <= middle):
                            continue
                        t = (level - p[2]) / (q[2] - p[2])
                        x, y = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
                        # A facet is left by its rising edge and entered by its falling one: solid lies to the left.
                        if p[2] <= middle:
                            ax, ay = x, y
                        else:
                            bx, by = x, y
                    total += weight * (0.5 * (bx * ay - by * ax))
                volumes[layer] += (high - low) / 6.0 * total

"""Heights at which a part is cut, those of its settings or given ones, blocks of them that fit in memory, and layer heights that
fit the part.

Each layer has one section all through its height: at a level face within a layer metal is added, or lacks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats, Ints
from ebamcheck.mesh.bodies import volumes_between
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import PlatePart
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import outside_window, unusual_layers

LARGEST_STACK = 1_000_000  # most layers of a stack: more come from a mistyped layer height
# Most layers of a block, however small their contours: rasters need memory for empty layers, too
LARGEST_BLOCK = 1024


def layer_heights(part: Part, layer_height: float) -> Floats:
    """Heights of the middles of uniform layers, from the part's lowest point up, (L,) mm.

    The number of layers is the part's height over the layer height, rounded to the nearest, at least 1;
    layer k spans ``zmin + k h .. zmin + (k + 1) h`` and is cut at its middle.

    Parameters
    ----------
    part
        The part as placed.
    layer_height
        Height of one layer, mm.

    Returns
    -------
    ndarray
        (L,) absolute heights of the cuts, mm, ascending.

    Raises
    ------
    SettingsError
        If the layer height is not positive, or would give more than :data:`LARGEST_STACK` layers.

    Examples
    --------
    >>> from ebamcheck_models import CUBE
    >>> layer_heights(CUBE.tessellate(0.1), 5.0).tolist()
    [2.5, 7.5, 12.5, 17.5]
    """
    if not (math.isfinite(layer_height) and layer_height > 0.0):
        raise SettingsError(f"layer height {layer_height} mm: give a positive number of millimetres")
    bottom, top = float(part.bounds[0, 2]), float(part.bounds[1, 2])
    count = max(1, math.ceil((top - bottom) / layer_height - 0.5 - 1e-9))
    if count > LARGEST_STACK:
        raise SettingsError(
            f"layer height {layer_height} mm cuts {top - bottom:g} mm into {count} layers, "
            f"over the limit of {LARGEST_STACK}: give a larger one, or check the unit of the part"
        )
    if count == 1 and top - bottom < layer_height:
        return np.array([0.5 * (bottom + top)])
    return np.asarray(bottom + (np.arange(count) + 0.5) * layer_height, dtype=np.float64)


def checked_heights(heights: ArrayLike) -> Floats:
    """Heights as a float64 column; raises :class:`SettingsError` if one is not finite."""
    column = np.asarray(heights, dtype=np.float64).reshape(-1)
    wrong = np.flatnonzero(~np.isfinite(column))
    if wrong.size:
        told = f"height {wrong[0]} is {column[wrong[0]]}"
        raise SettingsError(f"{told}: heights must be finite numbers of millimetres")
    return column


def is_rising(heights: Floats) -> bool:
    """Whether each height is above the one before it."""
    return bool((np.diff(heights) > 0.0).all())


def crossing_counts(part: Part, heights: ArrayLike) -> Ints:
    """Number of facets with ``min z <= h < max z`` at each height, (L,): those that a section at h + 0 cuts."""
    planes = np.asarray(heights, dtype=np.float64).reshape(-1)
    order = np.argsort(planes, kind="stable")
    level = np.searchsorted(planes[order], part.vertices[:, 2])
    a, b, c = level[part.faces.T]
    # A facet is cut by the planes between the levels of its vertices.
    ends = (reach(reach(a, b), c) for reach in (np.minimum, np.maximum))
    begin, end = (np.bincount(level, minlength=planes.size + 1) for level in ends)
    counts = np.empty(planes.size, np.int64)
    counts[order] = np.cumsum(begin - end)[: planes.size]
    return counts


def layer_blocks(part: Part, heights: ArrayLike, most_points: int) -> Ints:
    """Borders (B + 1,), 0 to L, of blocks of layers of at most so many points (one a cut facet), or of one layer."""
    ends = np.cumsum(crossing_counts(part, heights))
    borders = [0]
    while borders[-1] < ends.size:
        start = borders[-1]
        before = ends[start - 1] if start else 0
        fitting = int(np.searchsorted(ends, before + most_points, side="right"))
        borders.append(min(max(fitting, start + 1), start + LARGEST_BLOCK, ends.size))
    return np.array(borders if ends.size else [0, 0], dtype=np.int64)


def cut_heights(part: Part, config: Config) -> Floats:
    """Heights of the cuts by the settings, (L,) mm, checked to rise and to lie in the part."""
    if not config.layers.heights_mm:
        return layer_heights(part, config.layer_height_mm)
    heights = checked_heights(config.layers.heights_mm)
    if not is_rising(heights):
        raise SettingsError("layers.heights_mm must rise from layer to layer: sort them and drop repeats")
    return heights_within(part, heights, "layers.heights_mm")


def heights_within(part: Part, heights: ArrayLike, named: str) -> Floats:
    """Return heights from the part's lowest point (cut at z = h + 0) to its highest, as `named` in the error otherwise."""
    column = checked_heights(heights)
    low, high = part.bounds[:, 2].tolist()
    outside = np.flatnonzero((column < low) | (column > high))
    if outside.size:
        more = f" (and {outside.size - 1} more)" if outside.size > 1 else ""
        raise SettingsError(
            f"{named}: {column[outside[0]]:.10g} mm{more} is outside of the part {part.name!r}, which reaches from "
            f"z = {low:.10g} to {high:.10g} mm"
        )
    return column


# A facet that rises by less is level, and level facets within as much of height are one face: the rounding of files
LEVEL_MM = 0.01
# Least share of a level facet's area that is seen from above: a small steep facet rises by little, too
LEVEL_COS = float(np.cos(np.radians(0.5)))
SAME_BORDER_MM = 1e-6  # a face this near to a border of layers lies on it
THIN_MM = 1e-6  # height over a cut whose volume gives the area of the section: h + 0, no facet's height
OTHER_HEIGHTS = (
    0.25  # how far a layer height that is proposed may lie beside a bead's: what wire and feed can be changed for
)


class LevelFace(NamedTuple):
    """Level facets of one height, areas that look up less those that look down, and what the rule of layers makes of them."""

    z_mm: float  # height in the part
    area_mm2: float
    up: bool  # whether the solid lies under them
    added_mm: float  # how far the metal goes beyond the solid there; negative: how much of it lacks


@dataclass(frozen=True, eq=False)
class LayerRule:
    """What layers add to a solid and leave out, and the level faces within a layer, or over the last one, the gravest first."""

    solid_mm3: float
    added_mm3: float
    lacking_mm3: float
    faces: tuple[LevelFace, ...]

    @property
    def share(self) -> float:
        """The greater of both over the volume of the solid; infinite where that is nothing."""
        return max(self.added_mm3, self.lacking_mm3) / self.solid_mm3 if self.solid_mm3 > 0.0 else np.inf


def layer_rule(
    part: Part, cuts: Floats, borders: Floats, areas: Floats, volumes: Floats, least_face_mm2: float,
    allowed_mm: float = 0.0,
) -> LayerRule:  # fmt: skip
    """Hold layers of one section each against the solid; what lies under the lowest border counts neither here nor there.

    Layers are cut at `cuts` (L,), lie between `borders` (L + 1,), mm, and have sections of `areas` (L,), mm2; `volumes` (L + 1,) of
    the solid are those in each layer and over the last one, mm3. Level faces under `least_face_mm2` are not looked at one by one;
    their layer is, as a whole. Metal up to `allowed_mm` over or under a level face is wanted: the allowance for machining.
    """
    thickness = np.diff(borders)
    laid = areas * thickness
    off = laid - volumes[:-1]
    whole = float(volumes.sum())
    within = (cuts >= borders[:-1]) & (cuts <= borders[1:])
    if not within.all():  # Sections from elsewhere: no face has a layer of its own.
        total = float(laid.sum()) - whole
        return LayerRule(whole, max(total, 0.0), max(-total, 0.0), ())
    faces = _judged(level_faces(part, least_face_mm2), cuts, borders)
    plus, of_faces, wanted = np.zeros((3, len(cuts)))
    for face in faces:
        k = int(np.searchsorted(borders, face.z_mm, side="right")) - 1
        if k >= len(cuts):
            continue  # Over the last layer nothing is laid: that volume lacks, whatever its faces.
        mm3 = face.area_mm2 * face.added_mm
        of_faces[k] += mm3
        plus[k] += max(mm3, 0.0)
        wanted[k] += mm3 if 0.0 < face.added_mm <= allowed_mm else 0.0
    over = float(borders[-1])
    counted = [face for face in faces if face.z_mm < over or volumes[-1] > 0.0]
    added = plus + np.maximum(off - of_faces, 0.0)
    # A layer cannot add more than it has, nor leave out more than there is.
    added = np.clip(added, np.maximum(off, 0.0), np.maximum(np.minimum(laid, off + volumes[:-1]), 0.0))
    unwanted_mm3 = float(np.maximum(added - wanted, 0.0).sum())
    lacking_mm3 = float((added - off).sum() + volumes[-1])
    counted.sort(key=lambda face: -abs(face.area_mm2 * face.added_mm))
    return LayerRule(whole, unwanted_mm3, lacking_mm3, tuple(counted))


def level_faces(part: Part, least_mm2: float) -> list[LevelFace]:
    """Level faces of at least that area, from below; `added_mm` is 0."""
    corners = part.vertices[part.faces[np.ptp(part.vertices[part.faces, 2], axis=1) <= LEVEL_MM]]
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = np.abs(normal[:, 2]) > LEVEL_COS * np.linalg.norm(normal, axis=1)
    z, area = corners[level, :, 2].mean(axis=1), normal[level, 2]
    order = np.argsort(z, kind="stable")
    z, area = z[order], area[order]
    found, start = [], 0
    while start < z.size:
        stop = int(np.searchsorted(z, z[start] + LEVEL_MM, side="right"))
        size, net_mm2 = np.abs(area[start:stop]), float(area[start:stop].sum())
        if abs(net_mm2) >= least_mm2:
            z_mm = float(np.average(z[start:stop], weights=size))
            found.append(LevelFace(z_mm, abs(net_mm2), net_mm2 > 0.0, 0.0))
        start = stop
    return found


def moved_mm3(faces: list[LevelFace], cuts: Floats, borders: Floats, allowed_mm: float = 0.0) -> float:
    """Metal that layers add at level faces beyond the allowance, or leave out there, whichever is more; by the faces alone."""
    off = [face for face in _judged(faces, cuts, borders) if not 0.0 < face.added_mm <= allowed_mm]
    moved = np.array([face.area_mm2 * face.added_mm for face in off])
    return float(max(moved[moved > 0.0].sum(), -moved[moved < 0.0].sum()))


def _judged(faces: list[LevelFace], cuts: Floats, borders: Floats) -> list[LevelFace]:
    """Faces that lie within a layer, or over the last one, with what the layer makes of them."""
    found = []
    for face in faces:
        k = int(np.searchsorted(borders, face.z_mm + SAME_BORDER_MM, side="right")) - 1
        if k < 0 or np.abs(borders - face.z_mm).min() <= SAME_BORDER_MM:
            continue
        if k >= len(cuts) and not face.up:
            continue
        # The section of a cut is that of h + 0: a face at the cut itself has its solid below.
        border = borders[-1] if k >= len(cuts) else borders[k + 1] if face.z_mm > cuts[k] else borders[k]
        added = float(border) - face.z_mm
        found.append(face._replace(added_mm=added if face.up else -added))
    return found


def section_areas(part: Part, cuts: Floats) -> Floats:
    """Area (L,) of the sections of a mesh at rising heights, mm2; where bodies overlap, that of each of them."""
    if not len(cuts):
        return np.zeros(0)
    slabs = np.column_stack([cuts, cuts + THIN_MM]).ravel()
    return volumes_between(part, slabs)[::2] / np.diff(slabs)[::2]


class NearHeight(NamedTuple):
    """A layer height with which the layers have the metal of the solid."""

    height_mm: float
    share: float  # metal added or left out, whichever is more, over that of the solid


def share_off(part: Part, config: Config) -> float:
    """Metal that uniform layers add or leave out, over the solid's: the greatest of all parts of a plate."""
    cuts, borders = _uniform(part, config.layer_height_mm)
    return max(_share_of(mesh, cuts, borders, config) for mesh in _meshes(part))


def nearest_fitting(part: Part, config: Config) -> NearHeight | None:
    """Layer height nearest to that of the settings with which no part is off by more than `process.mass_tolerance`."""
    (bottom, top), spot_mm2 = part.bounds[:, 2].tolist(), config.process.bead_width_mm**2
    meshes, limit = _meshes(part), config.process.mass_tolerance
    faces = [level_faces(mesh, spot_mm2) for mesh in meshes]
    levels = {round(face.z_mm - bottom, 6) for some in faces for face in some}
    for height in _near_heights([*levels, top - bottom], config):
        cuts, borders = _uniform(part, height)
        # Most heights fail by their level faces alone, which takes no look at the mesh.
        moved = max(
            moved_mm3(some, cuts, borders, config.process.machining_allowance_mm) / max(mesh.volume, 1e-9)
            for mesh, some in zip(meshes, faces, strict=True)
        )
        if moved > 2.0 * limit:
            continue
        other = config.changed(layers={"layer_height_mm": height})
        share = max(_share_of(mesh, cuts, borders, other) for mesh in meshes)
        if share <= limit:
            return NearHeight(height, share)
    return None


def _uniform(part: Part, height_mm: float) -> tuple[Floats, Floats]:
    """Cuts (L,) and borders (L + 1,) of uniform layers of a part, mm."""
    cuts = layer_heights(part, height_mm)
    borders = np.asarray(float(part.bounds[0, 2]) + height_mm * np.arange(len(cuts) + 1), np.float64)
    return cuts, borders


def _meshes(part: Part) -> Sequence[Part]:
    return [part.member(m) for m in part.members] if isinstance(part, PlatePart) else [part]


def _share_of(mesh: Part, cuts: Floats, borders: Floats, config: Config) -> float:
    process = config.process
    top = max(float(mesh.bounds[1, 2]), float(borders[-1])) + 1.0
    volumes = volumes_between(mesh, np.append(borders, top))
    areas, spot_mm2 = section_areas(mesh, cuts), process.bead_width_mm**2
    allowed_mm = process.machining_allowance_mm
    return layer_rule(mesh, cuts, borders, areas, volumes, spot_mm2, allowed_mm).share


def _near_heights(levels: list[float], config: Config) -> Iterator[float]:
    """Layer heights of which a level over the bottom has a whole number, the nearest first, within the process window."""
    now = config.layer_height_mm
    tried, most = set[float](), 1.0 + OTHER_HEIGHTS
    for z_mm in levels:
        counts = range(max(1, int(z_mm / now / most)), int(z_mm / now * most) + 2)
        tried |= {round(z_mm / count, 4) for count in counts}
    near = sorted((h for h in tried if abs(h / now - 1.0) <= OTHER_HEIGHTS), key=lambda h: (abs(h - now), h))
    for height in near[:40]:
        other = config.changed(layers={"layer_height_mm": height})
        if not any(outside_window(other)) and not any(unusual_layers(other)):
            yield height

"""Parts that hide between rays, and cuts of them, for the tests of the ray-casting backend."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from parts import box, join, moved, sphere, tilted, torus, turn_z
from scipy.spatial.transform import Rotation
from section_oracle import prism

from ebamcheck_embree import Embree

SLICER = Embree()


if not SLICER.probe().available:
    pytest.skip(SLICER.probe().why, allow_module_level=True)


def cut(part, heights, progress=None, **settings):
    with SLICER.prepare(part, SLICER.Settings(**settings)) as prepared:
        return prepared.slice(np.atleast_1d(np.asarray(heights, float)), progress)


def heights_in(part, count=4):
    low, high = part.bounds[:, 2]
    return low + (high - low) * (np.arange(count) + 0.37) / count


def region(layers, k=0):
    return shapely.union_all(layers.polygons(k))


def same(a, b):
    return all(
        np.array_equal(getattr(a, c), getattr(b, c))
        for c in ("heights", "points", "ring_starts", "layer_starts", "closed", "dropped")
    )


WEDGE = shapely.Polygon([(0, 0), (30, 0.9), (0, 1.8)])
COMB = shapely.union_all(
    [shapely.box(0, 0, 20, 2)] + [shapely.box(x, 1, x + 0.55, 9) for x in np.arange(0, 20, 0.83)]
)
THIN = shapely.box(0, 0, 20, 20).difference(shapely.box(0.13, 0.13, 19.87, 19.87))
GAP = shapely.box(0, 0, 20, 10).difference(shapely.box(-1, 5, 15, 5.07))
PLATE = shapely.box(0, 0, 30, 20).difference(shapely.Point(12, 9).buffer(5))
STAR = shapely.Polygon(
    [
        ((10 if k % 2 else 1.5) * np.cos(k * np.pi / 9), (10 if k % 2 else 1.5) * np.sin(k * np.pi / 9))
        for k in range(18)
    ]
)

PARTS = {
    "box": box((0, 0, 0), (10, 7, 5)),
    "tilted box": tilted(box((0, 0, 0), (30, 7, 4))),
    "sphere": sphere(),
    "torus": torus(),
    "tilted torus": tilted(torus()),
    "cylinder": prism(shapely.Point(3, 4).buffer(8, quad_segs=24), 0.0, 5.0),
    "plate with hole": prism(PLATE, 0.0, 4.0),
    "wedge": prism(WEDGE, 0.0, 4.0),
    "turned wedge": moved(prism(WEDGE, 0.0, 4.0), turn_z(44.9)),
    "comb": prism(COMB, 0.0, 3.0),
    "turned comb": moved(prism(COMB, 0.0, 3.0), turn_z(31.0)),
    "tilted comb": tilted(prism(COMB, 0.0, 3.0)),
    "thin wall": prism(THIN, 0.0, 3.0),
    "turned thin wall": moved(prism(THIN, 0.0, 3.0), turn_z(45.0)),
    "gap": prism(GAP, 0.0, 3.0),
    "turned gap": moved(prism(GAP, 0.0, 3.0), turn_z(13.0)),
    "star": tilted(prism(STAR, 0.0, 3.0)),
    "overlapping": tilted(join(box((0, 0, 0), (10, 10, 10)), box((5, 5, 2), (16, 14, 13)))),
}


def random_solid(rng):
    """Prism of a random outline, turned anyhow, now and then with a second body through it."""
    pieces = [shapely.Polygon(rng.uniform(-10, 10, (3, 2))) for _ in range(rng.integers(1, 7))]
    outline = max(shapely.get_parts(shapely.union_all(pieces)), key=lambda piece: piece.area)
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    bodies = [moved(prism(outline, 0.0, rng.uniform(0.5, 8)), turn)]
    if rng.random() < 0.5:
        bodies.append(moved(box(rng.uniform(-5, 0, 3), rng.uniform(1, 6, 3)), turn))
    return join(*bodies)

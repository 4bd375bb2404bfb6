"""The ladder: one freeform part at eleven tolerances, from 4400 to 1.48 million facets.

It stands in for the part of the paper that this project follows (section 5.1, figure 9), of which only
the tolerances and file sizes are published: 0.23 .. 70.73 MB of binary STL for 1 .. 0.001 mm. Like it,
the stand-in has 4488 layers of 0.2 mm. Its shape is chosen so that the tolerance alone, kept as every
model keeps it, gives meshes of those sizes: the wall is curved in both directions, which makes facets
grow as one over the tolerance, and coarse meshes are held up by the greatest turn of a step.
"""

from __future__ import annotations

from ebamcheck_models.ring_wall import Channel, RingWall, Rounding

LADDER_TOLERANCES_MM = (1.0, 0.8, 0.4, 0.08, 0.06, 0.04, 0.01, 0.006, 0.004, 0.002, 0.001)
"""The paper's tolerances; its list has 0.4 and 0.8 swapped, as its file sizes show."""

LAYER_MM = 0.2
LAYERS = 4488

LADDER = RingWall(
    name="ladder",
    summary="twisted ring wall with rounded lips and three closed channels, 245 x 207 x 897.6 mm",
    height_mm=LAYERS * LAYER_MM,
    lip_mm=3.4,
    radius_mm=105.2,
    bulge=0.02,
    oval_mm=10.05,
    lobes_mm=0.6,
    half_mm=5.1,
    half_oval_mm=0.4,
    twist_deg=20.0,
    channels=(
        Channel(0.0, 6.0, 2.4, Rounding(40.0, 860.0, 4.0)),
        Channel(115.0, 5.0, 2.4, Rounding(70.0, 700.0, 4.0)),
        Channel(240.0, 4.5, 2.2, Rounding(200.0, 850.0, 4.0)),
    ),
)

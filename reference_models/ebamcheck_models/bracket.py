"""An angle bracket: two legs, fillets, two bolt holes, and a thin wall between the legs as a brace."""

from __future__ import annotations

import math

from ebamcheck_models.outlines import circle, rounded_polygon
from ebamcheck_models.prisms import Prism, prism

LEG_MM = 12.0
BRACE_X_MM, BRACE_Y_MM = 82.0, 62.0
"""Where the outer side of the brace would meet the insides of the legs."""
BRACE_MM = 0.8


def _bracket() -> Prism:
    along, up = BRACE_X_MM - LEG_MM, BRACE_Y_MM - LEG_MM
    # The inner side of the brace is parallel to the outer one, nearer to the corner by its thickness.
    nearer = 1.0 - BRACE_MM * math.hypot(along, up) / (along * up)
    outside = [
        *((0.0, 0.0, 16.0), (112.0, 0.0, 6.0), (112.0, LEG_MM, 5.0), (BRACE_X_MM, LEG_MM, 6.0)),
        *((LEG_MM, BRACE_Y_MM, 6.0), (LEG_MM, 90.0, 5.0), (0.0, 90.0, 6.0)),
    ]
    inside = [
        (LEG_MM, LEG_MM, 8.0),
        (LEG_MM + nearer * along, LEG_MM, 2.0),
        (LEG_MM, LEG_MM + nearer * up, 2.0),
    ]
    return prism(
        "bracket",
        "angle bracket of 112 x 90 x 30 mm: fillets, two bolt holes, a brace of 0.8 mm between the legs",
        rounded_polygon(outside),
        30.0,
        (rounded_polygon(inside), circle(100.0, 0.5 * LEG_MM, 3.0), circle(0.5 * LEG_MM, 79.0, 3.0)),
    )


BRACKET = _bracket()

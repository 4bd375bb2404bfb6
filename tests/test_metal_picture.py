"""The picture of a layer's metal shows each cell by its height, and leaves what lies beside the part white."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import shapely
from PIL import Image

from ebamcheck.checks.metal import LayerField
from ebamcheck.metal import target_of
from ebamcheck_reports.sections.metal import BLUE, COLOURS, RED, draw

WHITE = (255, 255, 255)


def images(picture: str) -> list[np.ndarray]:
    """Pixels (rows, columns, 3) of the images of a picture, read by another reader."""
    ET.fromstring(picture)
    fields = re.sub(r'<g class="scale">.*?</g>', "", picture)
    found = re.findall(r"base64,([^\"]+)", fields)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")) for data in found]


def test_each_cell_has_the_colour_of_its_height():
    section = shapely.box(0.0, 0.0, 4.0, 2.0)
    target = target_of(section, 1.0, 1.0)
    laid, over = np.zeros((4, 6)), np.zeros((4, 6))
    laid[1, 1:5] = [0.0, 1.5, 3.0, 9.0]  # the lowest row of the section, layer 1.5 mm high
    laid[3, 0] = 3.0  # metal beside the part is seen
    over[2, 1:5] = [-2.0, 0.0, 2.0, 5.0]
    metal, surface = images(draw(LayerField(target, laid, over), section, 1.5, 2.0, "a < b"))
    assert metal.shape == surface.shape == (4, 6, 3)
    lowest = [tuple(int(c) for c in pixel) for pixel in metal[2, 1:5]]
    assert lowest[0] == tuple(COLOURS[1].tolist())
    assert lowest[1] == tuple(COLOURS[128].tolist())
    assert lowest[2] == lowest[3] == RED
    assert tuple(metal[0, 0].tolist()) == RED
    assert tuple(metal[3, 5].tolist()) == WHITE
    assert tuple(surface[1, 1].tolist()) == tuple(COLOURS[1].tolist())
    assert tuple(surface[1, 3].tolist()) == tuple(surface[1, 4].tolist()) == RED
    assert np.abs(COLOURS[1].astype(int) - BLUE).max() <= 2

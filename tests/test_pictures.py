"""Pictures of layers and of their metal: sound XML, everything drawn where it lies, and small files."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import shapely
from PIL import Image

from ebamcheck.checks.metal import LayerField
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import from_rings
from ebamcheck.layers.svg import layer_svg, overlay_svg, sheet_svg
from ebamcheck.metal import target_of
from ebamcheck.showing.colours import COLOURS
from ebamcheck_reports.sections.metal import BLUE, RED, draw
from ebamcheck_reports.sections.metal import COLOURS as OF_HEIGHT

SQUARE = np.array([(0, 0), (40, 0), (40, 20), (0, 20)], float)
HOLE = np.array([(10, 5), (10, 10), (15, 10), (15, 5)], float)
LINE = [(30, 5), (35, 12), (38, 5)]
NAMESPACE = "{http://www.w3.org/2000/svg}"


def parsed(text):
    root = ET.fromstring(text)
    assert root.tag == NAMESPACE + "svg"
    assert "href" not in text
    assert "<script" not in text
    return root


def paths(root, name):
    return [p for p in root.iter(NAMESPACE + "path") if p.get("class") == name]


def rings_of(data):
    """Point arrays of the subpaths of path data."""
    return [
        np.array([[float(v) for v in pair.split(",")] for pair in part.rstrip("Z").split()])
        for part in re.split("M", data)[1:]
    ]


def layers():
    return from_rings([1.0, 2.5], [[SQUARE, HOLE], []], [[LINE], []])


def test_region_holes_open_paths_and_title_are_there():
    root = parsed(layer_svg(layers(), 0))
    (region,) = paths(root, "region")
    assert [len(r) for r in rings_of(region.get("d"))] == [4, 4]
    assert len(paths(root, "open")) == 1
    title = root.find(NAMESPACE + "title").text
    assert title == "layer 1, z = 1.000 mm: 1 outer, 1 holes, 1 open"


def test_y_runs_up_and_one_scale_serves_both_axes():
    (region,) = paths(parsed(layer_svg(layers(), 0, width_px=832)), "region")
    square = rings_of(region.get("d"))[0]
    assert np.ptp(square, axis=0) == pytest.approx([800.0, 400.0], abs=0.02)
    # The canonical first point is the least one, (0, 0): left and at the bottom of the picture.
    assert square[0] == pytest.approx([square[:, 0].min(), square[:, 1].max()])


def test_the_scale_bar_is_as_long_as_it_says():
    root = parsed(layer_svg(layers(), 0, width_px=832))
    (bar,) = paths(root, "scale")
    x0 = float(re.match(r"M([\d.]+)", bar.get("d"))[1])
    x1 = float(re.search(r"H([\d.]+)", bar.get("d"))[1])
    label = next(t.text for t in root.iter(NAMESPACE + "text") if t.text.endswith(" mm"))
    assert (x1 - x0) / 20.0 == pytest.approx(float(label.split()[0]), rel=1e-3)


@pytest.mark.parametrize("count", [3, 5, 1000, 200_000])
def test_the_drawing_is_reduced_and_stays_within_its_tolerance(count):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    wave = 1 + 0.1 * np.sin(9 * angle)
    ring = 50 * np.stack([np.cos(angle) * wave, np.sin(angle) * wave], axis=1)
    text = layer_svg(from_rings([0.0], [[ring]]), 0, width_px=832)
    assert len(text) < 12_000
    drawn = rings_of(paths(parsed(text), "region")[0].get("d"))[0]
    scale = 800 / np.ptp(ring[:, 0])
    on_paper = np.column_stack([16 + (ring[:, 0] - ring[:, 0].min()) * scale, 28 + (ring[:, 1].max() - ring[:, 1]) * scale])  # fmt: skip
    distance = shapely.distance(shapely.LinearRing(drawn), shapely.points(on_paper[:: max(1, count // 500)]))
    assert distance.max() <= 0.21  # px: well below what a screen shows


def test_an_overlay_has_a_group_a_colour_and_a_name_for_each_slicer():
    stacks = {f'slicer <{n}> & "co"': layers() for n in range(9)}
    text = overlay_svg(stacks, 0)
    root = parsed(text)
    groups = [g for g in root.iter(NAMESPACE + "g") if g.get("class") == "slicer"]
    assert [g.get("data-name") for g in groups] == list(stacks)
    labels = [t.text for t in root.iter(NAMESPACE + "text")]
    assert all(name in labels for name in stacks)
    colours = [g.find(NAMESPACE + "path").get("stroke") for g in groups]
    assert colours[: len(COLOURS)] == list(COLOURS)


def test_a_box_zooms():
    (region,) = paths(parsed(layer_svg(layers(), 0, width_px=832, box=(10, 5, 15, 10))), "region")
    assert np.ptp(rings_of(region.get("d"))[1], axis=0) == pytest.approx([800, 800], abs=0.02)


def test_empty_layers_and_flat_ones_are_drawn():
    parsed(layer_svg(layers(), 1))
    parsed(overlay_svg({"a": layers(), "b": layers()}, 1))
    flat = from_rings([0.0], [[]], [[[(0, 0), (10, 0)]]])
    point_like = from_rings([0.0], [[]], [[[(5, 5), (5, 5 + 1e-12)]]])
    for stack in (flat, point_like):
        assert "nan" not in layer_svg(stack, 0)
        parsed(layer_svg(stack, 0))


def test_a_sheet_shows_layers_from_the_first_to_the_last():
    many = from_rings(np.arange(100.0), [[SQUARE, HOLE]] * 100)
    root = parsed(sheet_svg(many))
    labels = [t.text for t in root.iter(NAMESPACE + "text") if t.text.startswith("layer ")]
    assert len(labels) == 16
    assert labels[0].startswith("layer 1,")
    assert labels[-1].startswith("layer 100,")
    height = float(root.get("height"))
    for path in paths(root, "region"):
        assert all((ring >= 0).all() and (ring[:, 1] <= height).all() for ring in rings_of(path.get("d")))
    parsed(sheet_svg(many.block(0, 1)))
    parsed(sheet_svg(many.block(0, 3)))


def test_control_characters_and_markup_in_a_title_do_no_harm():
    root = parsed(layer_svg(layers(), 0, title='a<b> & "c" \x00\x0b'))
    assert root.find(NAMESPACE + "title").text == 'a<b> & "c" \ufffd\ufffd'


def test_what_makes_no_sense_is_refused():
    with pytest.raises(SettingsError, match="no layer 2"):
        layer_svg(layers(), 2)
    with pytest.raises(SettingsError, match="no layer -3"):
        overlay_svg({"a": layers()}, -3)
    with pytest.raises(SettingsError, match="at least one"):
        overlay_svg({}, 0)
    with pytest.raises(SettingsError, match="pixels wide"):
        layer_svg(layers(), 0, width_px=10)
    with pytest.raises(SettingsError, match="no extent"):
        layer_svg(layers(), 0, box=(0, 0, 0, 1))
    with pytest.raises(SettingsError, match="empty"):
        sheet_svg(from_rings([], []))


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
    assert lowest[0] == tuple(OF_HEIGHT[1].tolist())
    assert lowest[1] == tuple(OF_HEIGHT[128].tolist())
    assert lowest[2] == lowest[3] == RED
    assert tuple(metal[0, 0].tolist()) == RED
    assert tuple(metal[3, 5].tolist()) == WHITE
    assert tuple(surface[1, 1].tolist()) == tuple(OF_HEIGHT[1].tolist())
    assert tuple(surface[1, 3].tolist()) == tuple(surface[1, 4].tolist()) == RED
    assert np.abs(OF_HEIGHT[1].astype(int) - BLUE).max() <= 2

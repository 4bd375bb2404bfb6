"""Slice files of the Common Layer Interface: what is kept, what other programs write, what is refused."""

from __future__ import annotations

import logging
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.common_layer_interface import read_cli, write_cli
from ebamcheck.layers.stack import Layers, from_rings

SQUARE = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
HOLE = np.array([(1, 1), (1, 2), (2, 2), (2, 1)], float)


def star_layers(seed=0, count=6):
    """Star-shaped rings, half of them holes, open paths and empty layers, anywhere in a metre."""
    rng = np.random.default_rng(seed)
    stack, lines = [], []
    for _ in range(count):
        rings = []
        for _ in range(rng.integers(0, 4)):
            n = rng.integers(3, 40)
            angle = (np.arange(n) + rng.uniform(0, 0.9, n)) * 2 * np.pi / n
            radius = rng.uniform(5, 20, n)
            ring = rng.uniform(-500, 500, 2) + np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)
            rings.append(ring if rng.random() < 0.5 else ring[::-1])
        stack.append(rings)
        lines.append([rng.normal(size=(5, 2)) * 100 for _ in range(rng.integers(0, 2))])
    heights = np.cumsum(rng.uniform(0.05, 2.0, count)) - 3.0
    return from_rings(
        heights, stack, lines, part="beef", backend="planecut", direction=(0.0, 1.0, 0.0), settings={"a": "//b$$"}
    )  # fmt: skip


def assert_equal(a: Layers, b: Layers) -> None:
    for name in ("heights", "points", "ring_starts", "layer_starts", "closed"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


# -- round trips -----------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_text_gives_every_bit_back(tmp_path_factory, seed):
    path = tmp_path_factory.getbasetemp() / "text.cli"
    layers = star_layers(seed)
    write_cli(layers, path)
    again = read_cli(path)
    assert_equal(again, layers)
    assert again.labels_json() == layers.labels_json()


def test_what_the_text_form_looks_like(tmp_path):
    layers = from_rings([0.5], [[SQUARE, HOLE]], [[[(9, 9), (10, 9.25)]]])
    write_cli(layers, tmp_path / "s.cli")
    text = (tmp_path / "s.cli").read_text().splitlines()
    assert text[:3] == ["$$HEADERSTART", "$$ASCII", "$$UNITS/1.0"]
    assert "$$LAYERS/1" in text
    assert "$$DIMENSION/0.0,0.0,0.5,10.0,9.25,0.5" in text
    geometry = text[text.index("$$GEOMETRYSTART") :]
    assert geometry == [
        "$$GEOMETRYSTART",
        "$$LAYER/0.5",
        "$$POLYLINE/1,1,5,0.0,0.0,4.0,0.0,4.0,4.0,0.0,4.0,0.0,0.0",
        "$$POLYLINE/1,0,5,1.0,1.0,1.0,2.0,2.0,2.0,2.0,1.0,1.0,1.0",
        "$$POLYLINE/1,2,2,9.0,9.0,10.0,9.25",
        "$$GEOMETRYEND",
    ]


# -- what other programs write ---------------------------------------------------------------------

HEADER = "$$HEADERSTART\n$$ASCII\n$$UNITS/{units}\n$$VERSION/200\n{more}$$HEADEREND\n"


def text_file(tmp_path, geometry, units="1", more=""):
    (tmp_path / "t.cli").write_text(HEADER.format(units=units, more=more) + geometry)
    return tmp_path / "t.cli"


def test_comments_hatches_several_models_and_broken_lines(tmp_path):
    geometry = (
        "$$GEOMETRYSTART\n//a comment $$LAYER/9 //\r\n$$LAYER/5.0// at the end//\n"
        "$$POLYLINE/1,1,4, 0,0 ,10,0,\n 10,10,0,0\n"
        "$$POLYLINE/2,0,3,1e0,1,1,2,2,2\n$$HATCHES/1,2,0,0,1,1,2,2,3,3 $$HATCHES/1,1,0,0,1,1\n"
        "$$LAYER/7.5\n$$GEOMETRYEND\nwhatever follows"
    )
    more = "// made by hand //\n$$DATE/010124\n$$LABEL/1,bracket\n$$LABEL/2,pin\n$$LAYERS/2\n"
    layers = read_cli(text_file(tmp_path, geometry, units="0.1", more=more))
    assert layers.heights.tolist() == [0.5, 0.75]
    assert layers.ring_counts().tolist() == [2, 0]
    assert layers.areas() == pytest.approx([0.5 - 0.005, 0])


def test_a_polyline_against_its_direction_is_turned_and_reported(tmp_path, caplog):
    path = text_file(tmp_path, "$$GEOMETRYSTART\n$$LAYER/1\n$$POLYLINE/1,1,4,0,0,0,4,4,4,4,0\n$$GEOMETRYEND\n")
    with caplog.at_level(logging.WARNING):
        assert read_cli(path).areas().tolist() == [16.0]
    assert "1 of 1 polylines" in caplog.text


def test_a_layer_at_the_same_height_goes_on(tmp_path):
    line = "$$POLYLINE/1,1,3,{0},0,{1},0,{0},1\n"
    geometry = "$$LAYER/1\n" + line.format(0, 1) + "$$LAYER/1\n" + line.format(5, 6) + "$$GEOMETRYEND"
    layers = read_cli(text_file(tmp_path, "$$GEOMETRYSTART\n" + geometry, more="$$LAYERS/2\n"))
    assert layers.ring_counts().tolist() == [2]


# -- the binary form --------------------------------------------------------------------------------

BINARY_HEADER = b"$$HEADERSTART\n$$BINARY\n$$UNITS/0.01\n$$VERSION/200\n"


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_binary_gives_32_bit_floats_back(tmp_path_factory, seed):
    path = tmp_path_factory.getbasetemp() / "binary.cli"
    layers = star_layers(seed)
    write_cli(layers, path, binary=True)
    found = read_cli(path)
    assert np.array_equal(found.heights, layers.heights.astype(np.float32))
    expected = from_rings(
        layers.heights,
        [[layers.ring(r).astype(np.float32) for r in layers.rings_of(k) if layers.closed[r]] for k in range(len(layers))],
        [[layers.ring(r).astype(np.float32) for r in layers.rings_of(k) if not layers.closed[r]] for k in range(len(layers))],
    )  # fmt: skip
    assert np.array_equal(found.points, expected.points)
    assert np.array_equal(found.ring_starts, layers.ring_starts)
    assert found.labels_json() == layers.labels_json()


def test_binary_data_follow_the_header_at_once(tmp_path):
    write_cli(from_rings([0.5], [[SQUARE]]), tmp_path / "b.cli", binary=True)
    _, _, body = (tmp_path / "b.cli").read_bytes().partition(b"$$HEADEREND")
    assert body == struct.pack("<HfHiii10f", 127, 0.5, 130, 1, 1, 5, 0, 0, 4, 0, 4, 4, 0, 4, 0, 0)


@pytest.mark.parametrize("ending", [b"", b"\n", b"\r\n"])
def test_short_commands_of_the_binary_form(tmp_path, ending):
    body = struct.pack("<HH", 128, 100)
    body += struct.pack("<4H8H", 129, 1, 1, 4, 0, 0, 400, 0, 400, 400, 0, 400)
    body += struct.pack("<3H4H", 131, 1, 1, 0, 0, 1, 1) + struct.pack("<Hii4f", 132, 1, 1, 0, 0, 1, 1)
    (tmp_path / "s.cli").write_bytes(BINARY_HEADER + b"$$HEADEREND" + ending + body)
    found = read_cli(tmp_path / "s.cli")
    assert found.heights.tolist() == [1.0]
    assert found.areas() == pytest.approx([16.0])


def test_aligned_commands_of_the_binary_form(tmp_path):
    body = struct.pack("<HHH2x", 128, 0, 100)
    body += struct.pack("<HH3H6H2x", 129, 0, 1, 1, 3, 0, 0, 400, 0, 400, 400)
    body += struct.pack("<HHiii6f", 130, 0, 1, 0, 3, 0, 0, 0, 100, 100, 0)
    (tmp_path / "a.cli").write_bytes(BINARY_HEADER + b"$$ALIGN\n$$HEADEREND" + body)
    assert read_cli(tmp_path / "a.cli").areas() == pytest.approx([8.0 - 0.5])


def test_wrong_binary_data_are_refused_with_their_byte(tmp_path):
    begin = len(BINARY_HEADER + b"$$HEADEREND")
    layer = struct.pack("<Hf", 127, 1.0)
    cases = [
        (struct.pack("<Hf", 133, 1.0), f"byte {begin}: unknown command 133"),
        (layer + b"\x01", f"byte {begin + 6}: .*cut off"),
        (layer + struct.pack("<Hiii2f", 130, 1, 1, 2, 0, 0), f"byte {begin + 20}: 4 coordinates"),
        (layer + struct.pack("<Hiii", 130, 1, 1, -1), "-2 coordinates"),
        (layer + struct.pack("<Hiii", 130, 1, 1, 2**31 - 1), "cut off"),
        (layer + struct.pack("<Hiii2f", 130, 1, 1, 1, np.nan, 0), f"byte {begin + 6}: coordinate 0"),
        (struct.pack("<Hf", 127, np.inf), f"byte {begin}: layer height inf"),
        (struct.pack("<Hiii", 130, 1, 1, 0), f"byte {begin}: polyline before"),
        (b"", "no geometry"),
    ]
    for body, says in cases:
        (tmp_path / "b.cli").write_bytes(BINARY_HEADER + b"$$HEADEREND" + body)
        with pytest.raises(InputError, match=says):
            read_cli(tmp_path / "b.cli")


# -- what is refused -------------------------------------------------------------------------------

POLYLINE = "$$POLYLINE/1,1,3,0,0,1,0,0,1"
BAD_TEXT = {
    ("$$LAYER/1\n" + POLYLINE, "line 8: .*GEOMETRYEND"),
    ("$$LAYER/1\n$$POLYLINE/1,1,4,0,0,1,0,0,1\n$$GEOMETRYEND", "line 8: the count is 4.* 3 follow"),
    ("$$LAYER/1\n$$POLYLINE/1,1,3,0,0,1,0,0\n$$GEOMETRYEND", "line 8: the count is 3.* 2.5 follow"),
    ("$$LAYER/1\n$$POLYLINE/1,1,nan,0,0,1,0,0,1\n$$GEOMETRYEND", "line 8: the count is nan"),
    ("$$LAYER/1\n$$POLYLINE/1,7,3,0,0,1,0,0,1\n$$GEOMETRYEND", "line 8: polyline of direction 7"),
    ("$$LAYER/1\n$$POLYLINE/1,0.5,3,0,0,1,0,0,1\n$$GEOMETRYEND", "line 8: polyline of direction"),
    ("$$LAYER/1\n$$POLYLINE/1,1,3,0,0,1,nan,0,1\n$$GEOMETRYEND", "line 8: coordinate 3 .* nan"),
    ("$$LAYER/1\n$$POLYLINE/1,1,3,0,0,1,1e999,0,1\n$$GEOMETRYEND", "line 8: coordinate 3 .* inf"),
    ("$$LAYER/1\n$$POLYLINE/1,1,3,0,0,1,x7,0,1\n$$GEOMETRYEND", "line 8: 'x7' is not a number"),
    ("$$LAYER/1\n$$POLYLINE/1,1,3,0,0,1,1_0,0,1\n$$GEOMETRYEND", "line 8: '1_0' is not a number"),
    ("$$LAYER/1\n$$POLYLINE/1\n$$GEOMETRYEND", "line 8: 1 numbers where at least 3"),
    ("$$LAYER/1\n$$HATCHES/1,2,0,0,1,1\n$$GEOMETRYEND", "line 8: the count is 2"),
    ("$$LAYER/\n$$GEOMETRYEND", "line 7: '' is not a number"),
    ("$$LAYER/inf\n$$GEOMETRYEND", "line 7: layer height inf"),
    ("$$LAYER/2\n$$LAYER/1\n$$GEOMETRYEND", "line 8: layer at 1.0 mm lies below"),
    (POLYLINE + "\n$$GEOMETRYEND", "line 7: polyline before the first layer"),
    ("$$LAYER/1\n$$CIRCLE/1,2,3\n$$GEOMETRYEND", "line 8: unknown command '\\$\\$CIRCLE"),
}


@pytest.mark.parametrize(("geometry", "says"), sorted(BAD_TEXT))
def test_wrong_text_is_refused_with_its_line(tmp_path, geometry, says):
    path = text_file(tmp_path, "$$GEOMETRYSTART\n" + geometry)
    with pytest.raises(InputError, match=says) as caught:
        read_cli(path)
    assert "t.cli" in str(caught.value)
    assert "\n" not in str(caught.value)


BAD_HEADERS = {
    ("solid part", "no Common Layer Interface file"),
    ("", "no Common Layer Interface file"),
    ("$$HEADERSTART\n$$ASCII\n", "no \\$\\$HEADEREND"),
    ("$$HEADERSTART\n$$ASCII\n$$HEADEREND\n$$GEOMETRYEND", "no \\$\\$UNITS"),
    ("$$HEADERSTART\n$$UNITS/1\n$$HEADEREND\n$$GEOMETRYEND", "neither"),
    ("$$HEADERSTART\n$$ASCII\n$$UNITS/0\n$$HEADEREND\n$$GEOMETRYEND", "line 3: .*UNITS"),
    ("$$HEADERSTART\n$$ASCII\n$$UNITS/nan\n$$HEADEREND\n$$GEOMETRYEND", "line 3: .*UNITS"),
    ("$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$VERSION/900\n$$HEADEREND\n", "line 4: .*VERSION '900'"),
    ("$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$LAYERS/x\n$$HEADEREND\n", "line 4: .*LAYERS 'x'"),
    ("$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$WHAT/1\n$$HEADEREND\n", "line 4: .*WHAT"),
    ("$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$USERDATA/a,99,b\n$$HEADEREND\n", "line 4: .*USERDATA"),
    (
        "$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$LAYERS/3\n$$HEADEREND\n$$LAYER/1 $$GEOMETRYEND",
        "1 layers.*says 3",
    ),
}


@pytest.mark.parametrize(("text", "says"), sorted(BAD_HEADERS))
def test_wrong_headers_are_refused(tmp_path, text, says):
    (tmp_path / "h.cli").write_text(text)
    with pytest.raises(InputError, match=says):
        read_cli(tmp_path / "h.cli")


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_no_bytes_break_the_reader(tmp_path_factory, body):
    path = tmp_path_factory.getbasetemp() / "fuzz.cli"
    for head in (
        b"",
        BINARY_HEADER + b"$$HEADEREND",
        b"$$HEADERSTART$$ASCII$$UNITS/1",
        b"$$HEADERSTART$$ASCII$$UNITS/1$$HEADEREND$$LAYER/1",
    ):
        path.write_bytes(head + body)
        message = ""
        try:
            read_cli(path)
        except InputError as error:
            message = str(error)
        assert message == "" or "fuzz.cli" in message
        assert "\n" not in message


def test_missing_files_and_wrong_arguments(tmp_path):
    with pytest.raises(InputError, match=r"none\.cli"):
        read_cli(tmp_path / "none.cli")
    layers = from_rings([1.0, 1.0], [[], []])
    with pytest.raises(SettingsError, match="layer 2"):
        write_cli(layers, tmp_path / "a.cli")
    near = from_rings([1000.0, np.nextafter(1000.0, 2000.0)], [[], []])
    write_cli(near, tmp_path / "a.cli")
    with pytest.raises(SettingsError, match="32-bit"):
        write_cli(near, tmp_path / "b.cli", binary=True)
    assert not (tmp_path / "b.cli").exists()

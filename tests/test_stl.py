"""The strict STL reader: what it reads, what it refuses, and what it says."""

from __future__ import annotations

import csv
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from parts import box, sphere

import ebamcheck
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.mesh.stl import FACET, read_triangles
from ebamcheck.mesh.topology import weld


def binary(triangles, header=b"", count=None, trailing=b""):
    facets = b"".join(struct.pack("<12fH", *([0.0] * 3), *np.ravel(t), 0) for t in triangles)
    return (
        header.ljust(80, b" ")
        + struct.pack("<I", len(triangles) if count is None else count)
        + facets
        + trailing
    )


def binary_file(corners):
    """A file of many facets, whose normals and attributes look like anything."""
    facets = np.zeros(len(corners), FACET)
    facets["normal"], facets["corners"], facets["attribute"] = np.nan, corners, 0x7F80
    return b" " * 80 + struct.pack("<I", len(corners)) + facets.tobytes()


def ascii_text(triangles, newline="\n", name="part", number=repr):
    lines = [f"solid {name}"]
    for t in triangles:
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += ["      vertex " + " ".join(number(float(c)) for c in corner) for corner in t]
        lines += ["    endloop", "  endfacet"]
    return newline.join([*lines, f"endsolid {name}", ""]).encode()


BOX = box().triangles


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(binary(BOX), id="binary"),
        pytest.param(binary(BOX, header=b"solid of a CAD system"), id="binary whose header says solid"),
        pytest.param(binary(BOX, header=b"solid a\nendsolid a"), id="binary whose header is an empty ASCII file"),
        pytest.param(binary(BOX, trailing=b"\0"), id="one trailing byte"),
        pytest.param(binary(BOX, header=b"solid x", trailing=b"\0" * 4096), id="zero padding"),
        pytest.param(ascii_text(BOX), id="ascii"),
        pytest.param(ascii_text(BOX, "\r\n"), id="CRLF"),
        pytest.param(ascii_text(BOX, "\r"), id="CR"),
        pytest.param(ascii_text(BOX).upper(), id="upper case"),
        pytest.param(b"\xef\xbb\xbf" + ascii_text(BOX), id="byte-order mark"),
        pytest.param(ascii_text(BOX[:5]) + ascii_text(BOX[5:]), id="two solids"),
        pytest.param(ascii_text(BOX, name="f\xe4hre \"x\" facet".encode().decode("latin1")), id="odd name"),
        pytest.param(ascii_text(BOX, number=lambda v: f"{v:+.3e}"), id="exponents"),
        pytest.param(ascii_text(BOX) + b"solid empty\nendsolid empty\n", id="an empty solid behind"),
        pytest.param(ascii_text(BOX).replace(b"normal 0 0 0", b"normal nan nan nan"), id="normals nobody uses"),
    ],
)  # fmt: skip
def test_reads(data):
    triangles, _ = read_triangles(data, "x.stl")
    assert np.array_equal(triangles, BOX.astype(np.float32))


BAD = BOX.copy()
BAD[3, 1, 2] = np.nan


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (b"\0" * 80, "80 bytes"),
        (binary([]), "no facet"),
        (b"solid\nendsolid\n", "no facet"),
        (binary(BOX)[:-1], "truncated.*12 facets"),
        (binary(BOX, count=11), "11 facets, but 50 bytes follow"),
        (binary(BOX, count=2**32 - 1), "4294967295 facets"),
        (binary(BOX) + binary(BOX), "joined"),
        (binary(BAD), "facet 3, vertex 1, z is nan"),
        (binary(np.where(np.isnan(BAD), np.inf, BAD)), "facet 3, vertex 1, z is inf"),
        (ascii_text(BAD), "line 26: vertex coordinate 'nan'"),
        (ascii_text(BOX).replace(b"2.0", b"1e39", 1), "'1e39' is beyond the range"),
        (ascii_text(BOX).replace(b"2.0", b"2,0", 1), "'2,0'"),
        (ascii_text(BOX).replace(b"2.0", b"2.0.1", 1), "'2.0.1' is not a number"),
        (ascii_text(BOX).replace(b"2.0", b"1_0", 1), "'1_0'"),
        (ascii_text(BOX)[:-20], "found 'end'|truncated|expected"),
        (ascii_text(BOX).rsplit(b"endsolid", 1)[0], "truncated: the file ends after 12 facets"),
        (ascii_text(BOX).replace(b"endloop", b"", 1), "line 8: found 'endfacet', expected 'endloop'"),
        (ascii_text(BOX).replace(b"outer", b"ou\0er", 1), "byte 0x00"),
        (ascii_text(BOX) + b"garbage", "found 'garbage', expected 'solid' or the end"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".ljust(130), "Git LFS"),
        (b"<!DOCTYPE html><html></html>".ljust(200), "page"),
        (b"\x1f\x8b\x08" + b"\1" * 200, "gzip"),
        (b"v 0 0 0\nv 1 0 0\nf 1 2 3\n" * 9, "not an STL"),
    ],
)
def test_refuses_in_one_line_that_names_file_place_and_value(data, says):
    with pytest.raises(InputError, match=says) as caught:
        read_triangles(data, "x.stl")
    assert str(caught.value).startswith("x.stl: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [np.nan, -np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("threads", ["1", "3"])
def test_a_number_that_is_none_is_found_wherever_it_stands(value, threads, monkeypatch):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    facets = np.resize(BOX, (40_000, 3, 3)).astype(np.float32)
    for row in (0, 16_383, 16_384, 39_999):
        for place in np.ndindex(3, 3):
            bad = facets.copy()
            bad[row, place[0], place[1]] = value
            says = f"facet {row}, vertex {place[0]}, {'xyz'[place[1]]} is"
            with pytest.raises(InputError, match=says):
                read_triangles(binary_file(bad), "x.stl")


def test_every_finite_number_is_read_in_its_bits():
    draw = np.random.default_rng(2)
    bits = draw.integers(0, 2**32, 9 * 5000, dtype=np.uint32)
    edges = np.array([0.0, -0.0, 1e-45, -1e-45, 3.4028235e38, -3.4028235e38], np.float32).view(np.uint32)
    numbers = np.concatenate([edges, bits[np.isfinite(bits.view(np.float32))]])
    facets = numbers[: len(numbers) // 9 * 9].view(np.float32).reshape(-1, 3, 3)
    for data in (binary_file(facets), memoryview(binary_file(facets)), binary_file(facets) + b" "):
        assert read_triangles(data, "x.stl")[0].tobytes() == facets.tobytes()


def test_weld_is_exact_on_bits_and_keeps_first_order():
    part = sphere()
    rng = np.random.default_rng(0)
    order = rng.permutation(len(part.faces))
    vertices, faces = weld(part.triangles[order].astype(np.float32))
    assert len(vertices) == len(part.vertices)
    assert np.array_equal(vertices[faces], part.triangles[order].astype(np.float32))
    assert faces.ravel()[0] == 0
    first_use = np.unique(faces.ravel(), return_index=True)[1]
    assert (np.diff(first_use) > 0).all()
    near = np.array(
        [[[0, 0, 0], [1, 0, 0], [0, 1, np.nextafter(0, 1)]], [[-0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    )
    assert len(weld(near)[0]) == 4


def test_units_are_converted_once_and_odd_sizes_warn(tmp_path: Path, caplog):
    path = tmp_path / "box.stl"
    path.write_bytes(binary(BOX))
    assert ebamcheck.load(path).size.tolist() == [2, 2, 2]
    assert not caplog.records
    assert ebamcheck.load(path, units="in").size.tolist() == [50.8, 50.8, 50.8]
    tiny = ebamcheck.load(path, units="um")
    assert "check the unit" in tiny.notes[0]
    assert "check the unit" in caplog.text
    with pytest.raises(SettingsError, match="furlong"):
        ebamcheck.load(path, units="furlong")


@pytest.mark.parametrize("kind", ["obj", "ply", "3mf", "stl"])
def test_other_formats_give_the_same_part(tmp_path: Path, kind):
    import trimesh

    part = sphere()
    path = tmp_path / f"ball.{kind}"
    trimesh.Trimesh(part.vertices, part.faces, process=False).export(path)
    read = ebamcheck.load(path)
    assert len(read.faces) == len(part.faces)
    assert len(read.vertices) == len(part.vertices)
    assert read.volume == pytest.approx(part.volume, rel=1e-6)


@pytest.mark.parametrize(
    "name", ["missing.stl", "folder.stl", "broken.obj", "broken.ply", "broken.3mf", "part.step"]
)
def test_unreadable_files_of_any_kind_are_refused(tmp_path: Path, name):
    (tmp_path / "folder.stl").mkdir()
    for suffix in ("obj", "ply", "3mf"):
        (tmp_path / f"broken.{suffix}").write_bytes(b"\x00\x01 this is none")
    (tmp_path / "part.step").write_bytes(b"ISO-10303-21;")
    with pytest.raises(InputError, match=name.replace(".", r"\.")) as caught:
        ebamcheck.load(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.corpus
def test_malformed_corpus_gets_the_verdict_of_its_manifest(corpus: Path):
    with (corpus / "MANIFEST.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["class"] == "malformed"]
    assert len(rows) > 30
    for row in rows:
        expect = row["expect"]
        facets = _facets_or_refusal(corpus / row["file"])
        if isinstance(facets, str):
            assert "reject" in expect, f"refused ({facets}), expected {expect}"
            assert "\n" not in facets
        else:
            assert not expect.startswith("reject") or "accept" in expect or "survive" in expect, row["file"]
            counted = re.search(r"(\d+) facet", expect)
            assert facets == (int(counted.group(1)) if counted else facets) > 0, row["file"]


def _facets_or_refusal(path: Path) -> int | str:
    try:
        return len(ebamcheck.load(path).faces)
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("facets", [1, 2, 50, 30_000])
def test_welded_vertices_are_numbered_by_first_appearance(facets, kind, threads, monkeypatch):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    rng = np.random.default_rng(facets)
    triangles = (rng.integers(-20, 21, (facets, 3, 3)) * 0.125).astype(kind)
    triangles[triangles == 0] *= rng.choice([-1, 1], (triangles == 0).sum()).astype(kind)
    vertices, faces = weld(triangles)
    numbers: dict[tuple[float, ...], int] = {}
    expected = [
        numbers.setdefault(tuple(corner), len(numbers)) for corner in triangles.reshape(-1, 3).tolist()
    ]
    assert faces.ravel().tolist() == expected
    assert vertices.tolist() == [list(corner) for corner in numbers]
    assert not np.signbit(vertices[vertices == 0]).any()


def test_numbers_that_differ_in_the_last_bit_stay_apart():
    corner = np.array([0.1, 0.2, 0.3])
    triangles = np.stack([corner, np.nextafter(corner, 1), [0.1, 0.2, np.nextafter(0.3, 0)]])[None]
    assert weld(np.concatenate([triangles, triangles]))[1].tolist() == [[0, 1, 2], [0, 1, 2]]

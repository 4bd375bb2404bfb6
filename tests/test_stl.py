"""Readers of STL, OBJ and PLY: what they read, what they refuse, and what they say; a mutated file of any format."""

from __future__ import annotations

import csv
import io
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from parts import box, sphere

import ebamcheck
from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.mesh.obj_and_ply import read_obj, read_ply
from ebamcheck.mesh.stl import FACET, read_triangles
from ebamcheck.mesh.topology import weld


def binary(triangles, header=b"", count=None, trailing=b""):
    facets = b"".join(struct.pack("<12fH", *([0.0] * 3), *np.ravel(t), 0) for t in triangles)
    return header.ljust(80, b" ") + struct.pack("<I", len(triangles) if count is None else count) + facets + trailing


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
        pytest.param(ascii_text(BOX, " "), id="one line"),
        pytest.param((ascii_text(BOX[:5], " ") + ascii_text(BOX[5:], " ")).strip(), id="two solids in one line"),
        pytest.param(ascii_text(BOX, " ", name="the facet of a box"), id="one line, with a name of several words"),
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


def test_every_finite_number_is_read_in_its_bits():
    draw = np.random.default_rng(2)
    bits = draw.integers(0, 2**32, 9 * 5000, dtype=np.uint32)
    edges = np.array([0.0, -0.0, 1e-45, -1e-45, 3.4028235e38, -3.4028235e38], np.float32).view(np.uint32)
    numbers = np.concatenate([edges, bits[np.isfinite(bits.view(np.float32))]])
    facets = numbers[: len(numbers) // 9 * 9].view(np.float32).reshape(-1, 3, 3)
    for data in (binary_file(facets), memoryview(binary_file(facets)), binary_file(facets) + b" "):
        assert read_triangles(data, "x.stl")[0].tobytes() == facets.tobytes()


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


@pytest.mark.parametrize("name", ["missing.stl", "folder.stl", "broken.obj", "broken.ply", "broken.3mf", "part.step"])
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
    expected = [numbers.setdefault(tuple(corner), len(numbers)) for corner in triangles.reshape(-1, 3).tolist()]
    assert faces.ravel().tolist() == expected
    assert vertices.tolist() == [list(corner) for corner in numbers]
    assert not np.signbit(vertices[vertices == 0]).any()


def test_numbers_that_differ_in_the_last_bit_stay_apart():
    corner = np.array([0.1, 0.2, 0.3])
    triangles = np.stack([corner, np.nextafter(corner, 1), [0.1, 0.2, np.nextafter(0.3, 0)]])[None]
    assert weld(np.concatenate([triangles, triangles]))[1].tolist() == [[0, 1, 2], [0, 1, 2]]


# -- all readers, against edited, cut and scrambled files ----------------------------------------


QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
"""Sides of the unit cube below, outwards or inwards."""
CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
MIXED = [*QUADS[:3], *[t for q in QUADS[3:] for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]]
"""Three sides of four corners, and three of two triangles each."""

MUTATIONS, OF_ZIPS = 300, 60  # a zip is read in a process of its own


def obj(faces=MIXED, style="{0}"):
    lines = ["# cube", "o cube", *(f"v {x}.0 {y}.0 {z}.0" for x, y, z in CUBE), "vn 0 0 1"]
    lines += ["f " + " ".join(style.format(i + 1) for i in face) for face in faces]
    return ("\n".join(lines) + "\n").encode()


def ply_head(kind, faces, index="int"):
    return (
        f"ply\nformat {kind} 1.0\ncomment cube\nelement vertex {len(CUBE)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar {index} vertex_indices\nend_header\n"
    ).encode()


def ply_text(faces=MIXED):
    rows = [" ".join(map(str, v)) for v in CUBE] + [" ".join(map(str, (len(f), *f))) for f in faces]
    return ply_head("ascii", faces) + ("\n".join(rows) + "\n").encode()


def ply_binary(order, faces=MIXED):
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    body = b"".join(struct.pack(order + "3f", *v) for v in CUBE)
    body += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    return ply_head(kind, faces) + body


def three_mf():
    import trimesh

    out = io.BytesIO()
    trimesh.Trimesh(box().vertices, box().faces, process=False).export(out, file_type="3mf")
    return out.getvalue()


TRIANGULAR = [t for q in QUADS for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
FILES = {
    "binary.stl": lambda: binary(BOX),
    "text.stl": lambda: ascii_text(BOX),
    "line.stl": lambda: ascii_text(BOX, " "),
    "mixed.obj": obj,
    "slashes.obj": lambda: obj(style="{0}//1"),
    "text.ply": ply_text,
    "little.ply": lambda: ply_binary("<", TRIANGULAR),
    "mixed.ply": lambda: ply_binary("<"),
    "big.ply": lambda: ply_binary(">"),
    "zip.3mf": three_mf,
}
"""Sound files of every format and form."""


def mutated(data, draw):
    """One to four edits: bytes changed, cut out, put in, doubled, numbers exchanged, lines moved, the end cut off."""
    data = bytearray(data)
    for _ in range(draw.integers(1, 5)):
        at = int(draw.integers(0, len(data) + 1))
        span = int(draw.integers(1, 1 + min(64, len(data))))
        match int(draw.integers(0, 8)):
            case 0 if at < len(data):
                data[at] ^= 1 << int(draw.integers(0, 8))
            case 1:
                del data[at : at + span]
            case 2:
                data[at:at] = draw.bytes(span)
            case 3:
                data[at:at] = data[at : at + span]
            case 4:
                del data[at:]
            case 5:
                odd = b"nan -1 1e999 4294967295 0 1_0 - \xff\xff\xff\xff 99999999999999999999".split()
                data[at : at + 2] = odd[int(draw.integers(0, len(odd)))]
            case 6:
                lines = bytes(data).split(b"\n")
                i, j = draw.integers(0, len(lines), 2)
                lines[i], lines[j] = lines[j], lines[i]
                data = bytearray(b"\n".join(lines))
            case _:
                data[at : at + span] = bytes(reversed(data[at : at + span]))
        if not data:
            break
    return bytes(data)


def part_or_refusal(path):
    try:
        return ebamcheck.load(path)
    except EbamcheckError as error:
        return str(error)


@pytest.mark.parametrize("name", FILES)
def test_a_mutated_file_gives_a_sound_part_or_one_line(tmp_path, name):
    sound, draw = FILES[name](), np.random.default_rng(14)
    path = tmp_path / name
    path.write_bytes(sound)
    assert len(ebamcheck.load(path).faces) == 12
    refused = 0
    count = OF_ZIPS if name.endswith(".3mf") else MUTATIONS
    for _ in range(count):
        path.write_bytes(mutated(sound, draw))
        part = part_or_refusal(path)
        if isinstance(part, str):
            assert part.count("\n") == 0 < len(part) < 500
            refused += 1
            continue
        assert 0 < len(part.faces) < 1000
        assert np.isfinite(part.vertices).all()
        assert 0 <= part.faces.min() <= part.faces.max() < len(part.vertices)
    assert refused > count // 10


@pytest.mark.parametrize("name", [n for n in FILES if not n.endswith((".obj", ".3mf"))])
def test_every_cut_file_that_counts_is_refused(name):
    read = read_ply if name.endswith(".ply") else read_triangles
    data = FILES[name]()
    # The name behind the last word of a text may be missing, and the end of its last line.
    whole = data.rfind(b"endsolid") + len(b"endsolid") if b"endsolid" in data else len(data)
    for size in range(len(data.rstrip()) if name == "text.ply" else whole):
        with pytest.raises(InputError):
            read(data[:size], name)


def test_a_cut_obj_is_refused_or_told_unless_it_ends_with_a_line():
    data = obj()
    for size in range(1, len(data)):
        try:
            _, notes = read_obj(data[:size], "x.obj")
        except InputError:
            continue
        assert notes or data[size - 1 : size] == b"\n" or not data[:size].splitlines()[-1].startswith(b"f"), size


def test_polygons_of_mixed_lengths_are_the_part():
    want = ebamcheck.mesh.part.from_arrays(CUBE, TRIANGULAR).triangles
    for read, data in (
        (read_obj, obj()),
        (read_ply, ply_text()),
        (read_ply, ply_binary("<")),
        (read_ply, ply_binary(">")),
    ):
        corners, notes = read(data, "x")
        assert np.array_equal(corners, want)
        assert notes == []


def test_references_of_an_obj_by_any_form():
    want = read_obj(obj(), "x")[0]
    from_end = b"\n".join(b"f " + b" ".join(str(i - 8).encode() for i in face) for face in MIXED)
    vertices = b"".join(b"v %d %d %d\n" % v for v in CUBE)
    for style in ("{0}/1", "{0}/1/1", "{0}//1"):
        assert np.array_equal(read_obj(obj(style=style), "x")[0], want)
    assert np.array_equal(read_obj(vertices + from_end + b"\n", "x")[0], want)
    folded = obj().replace(b"f 1 2 4 3", b"f 1 2 \\\n4 3").replace(b"\n", b"\r\n")
    assert np.array_equal(read_obj(folded, "x")[0], want)
    coloured = vertices.replace(b"\n", b" 0.5 0.5 0.5\n") + from_end + b"\n"
    assert np.array_equal(read_obj(coloured, "x")[0], want)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (obj().replace(b"v 1.0 1.0 1.0", b"v 1.0 1.0"), r"line 10: 'v 1.0 1.0' has 2 numbers"),
        (obj().replace(b"v 1.0 1.0 1.0\n", b""), r"corner '8' is none of the 7 vertices"),
        (obj().replace(b"f 1 2 4 3", b"f 1 2"), r"has 2 corners"),
        (obj().replace(b"f 1 2 4 3", b"f 1 2 x 3"), r"corner 'x' is none"),
        (obj().replace(b"f 1 2 4 3", b"f 1 2 0 3"), r"corner '0' is none"),
        (obj().replace(b"1.0", b"1_0", 1), r"'1_0' is not a number"),
        (obj().replace(b"1.0", b"nan", 1), r"coordinates must be finite"),
        (obj().replace(b"vn 0", b"surf 0"), r"line 11: 'surf' is free-form geometry"),
        (obj().replace(b"vn 0", b"1 0"), r"line 11: '1 0 0 1' is no line of an OBJ file"),
        (b"v 0 0 0\n", "holds no facet"),
        (b"f 1 2 3\n", "no vertex"),
        (b"", "empty"),
    ],
)
def test_an_obj_that_does_not_fit_is_refused(data, says):
    with pytest.raises(InputError, match=says):
        read_obj(data, "x.obj")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (ply_text().replace(b"element face 9", b"element face 8"), "1 lines follow the last element"),
        (
            ply_text().replace(b"element face 9", b"element face 10"),
            "counts 10 of 'face', but there are lines for 9",
        ),
        (ply_binary("<")[:-4], "counts 9 of 'face', but number 8 lacks some of 'vertex_indices'"),
        (ply_binary("<", TRIANGULAR)[:-4], "counts 12 of 'face'"),
        (ply_binary("<") + b"\1\2\3\4", "4 bytes follow"),
        (ply_text().replace(b"vertex 8", b"vertex 4294967295"), "counts 4294967295 of 'vertex'"),
        (ply_binary(">").replace(b"vertex 8", b"vertex 999999999"), "counts 999999999 of 'vertex'"),
        (ply_text().replace(b"4 0 1 3 2", b"4 0 1 3 8"), "facet 0 names vertex 8, which is none of 8"),
        (ply_text().replace(b"4 0 1 3 2", b"4 0 1 3 -1"), "facet 0 names vertex -1"),
        (ply_text().replace(b"4 0 1 3 2", b"2 0 1"), "facet 0 has 2 corners"),
        (ply_text().replace(b"4 0 1 3 2", b"4 0 1 3 2 7"), "face 0 has 6 numbers"),
        (ply_text().replace(b"property float z", b"property float w"), "have no z"),
        (ply_text().replace(b"float x", b"half x"), "line 5: 'property half x' is no line of a PLY header"),
        (ply_text().replace(b"format ascii 1.0\n", b""), "has no format"),
        (ply_text().replace(b"end_header", b"end"), "lacks end_header"),
        (ply_text().replace(b"element face", b"element strips"), "holds no facet"),
    ],
)
def test_a_ply_whose_counts_do_not_fit_is_refused(data, says):
    with pytest.raises(InputError, match=says):
        read_ply(data, "x.ply")

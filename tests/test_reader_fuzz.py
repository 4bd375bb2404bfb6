"""Readers of meshes against edited, cut and scrambled files: a sound part comes out, or one line that says why not."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from parts import box

import ebamcheck
from ebamcheck.errors import EbamcheckError, InputError
from ebamcheck.mesh.obj_and_ply import read_obj, read_ply
from ebamcheck.mesh.stl import read_triangles

PART = box()
TRIANGLES = PART.triangles
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
"""Sides of the unit cube below, outwards or inwards."""
CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
MIXED = [*QUADS[:3], *[t for q in QUADS[3:] for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]]
"""Three sides of four corners, and three of two triangles each."""

MUTATIONS = 300


def stl_binary():
    facets = b"".join(struct.pack("<12fH", *([0.0] * 3), *np.ravel(t), 0) for t in TRIANGLES)
    return b"box".ljust(80) + struct.pack("<I", len(TRIANGLES)) + facets


def stl_text(separator="\n"):
    words = ["solid box"]
    for t in TRIANGLES:
        words += [
            "facet normal 0 0 0",
            "outer loop",
            *("vertex " + " ".join(repr(float(v)) for v in c) for c in t),
        ]
        words += ["endloop", "endfacet"]
    return separator.join([*words, "endsolid box\n"]).encode()


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
    trimesh.Trimesh(PART.vertices, PART.faces, process=False).export(out, file_type="3mf")
    return out.getvalue()


TRIANGULAR = [t for q in QUADS for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
FILES = {
    "binary.stl": stl_binary,
    "text.stl": stl_text,
    "line.stl": lambda: stl_text(" "),
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
                odd = [
                    b"nan",
                    b"-1",
                    b"1e999",
                    b"4294967295",
                    b"0",
                    b"1_0",
                    b"-",
                    b"\xff\xff\xff\xff",
                    b"99999999999999999999",
                ]
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
    for _ in range(MUTATIONS):
        path.write_bytes(mutated(sound, draw))
        part = part_or_refusal(path)
        if isinstance(part, str):
            assert part.count("\n") == 0 < len(part) < 500
            refused += 1
            continue
        assert 0 < len(part.faces) < 1000
        assert np.isfinite(part.vertices).all()
        assert 0 <= part.faces.min() <= part.faces.max() < len(part.vertices)
    assert refused > MUTATIONS // 10


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
        assert notes or data[size - 1 : size] == b"\n" or not data[:size].splitlines()[-1].startswith(b"f"), (
            size
        )


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


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(stl_text(" "), id="one line"),
        pytest.param(stl_text(" ").strip(), id="no end of line"),
        pytest.param(stl_text(" ").replace(b"solid box", b"solid", 1), id="no name"),
        pytest.param(stl_text(" ").replace(b"solid box", b"solid the facet of a box", 1), id="a name of several words"),
        pytest.param(stl_text(" ").upper(), id="upper case"),
        pytest.param(stl_text(" ").replace(b"normal 0 0 0", b"normal nan nan nan"), id="normals that nobody uses"),
        pytest.param(stl_text("\n").replace(b"solid box", b"solid facet normal test", 1), id="a name like a facet"),
    ],
)  # fmt: skip
def test_a_text_stl_in_one_line_is_read(data):
    assert np.array_equal(read_triangles(data, "x.stl")[0], TRIANGLES.astype(np.float32))


def test_two_solids_in_one_line_are_both_read():
    line = stl_text(" ").strip()
    read = read_triangles(line + b" " + line, "x.stl")[0]
    assert np.array_equal(read, np.concatenate([TRIANGLES, TRIANGLES]).astype(np.float32))
    with pytest.raises(InputError, match=r"truncated|expected"):
        read_triangles(line[: len(line) // 2], "x.stl")

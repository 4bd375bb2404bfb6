"""Parts in slabs of z: the same sections, inspection, tables and verdicts as of the whole; planted faults are found."""

from __future__ import annotations

import dataclasses
import json
from contextlib import nullcontext

import numpy as np
import pytest
from command_line import ebamcheck, write_stl
from parts import box, join, moved, sphere, tilted, torus
from slicers_here import slicers_here

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.heights import crossing_counts, layer_heights
from ebamcheck.mesh.files import load
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.slabs import SlabInspection, divided, read_once
from ebamcheck.pipeline.slabs import check_in_slabs
from ebamcheck.preflight.workload import wanted_slabs
from ebamcheck.settings.config import Config
from ebamcheck_embree import Embree
from ebamcheck_manifold import ManifoldCut
from ebamcheck_models import MODELS
from ebamcheck_planecut import PlaneCut

REACH_MM = 1e-5
SLABS = (1, 3, 20)
SLICERS = (PlaneCut, ManifoldCut, Embree)
FAST = Config().changed(slicing={"backends": ["planecut", "manifold"]}, layers={"layer_height_mm": 1.0})


def holed(part: Part, *facets: int) -> Part:
    return Part(part.vertices, np.delete(part.faces, facets, axis=0), part.name)


def shuffled(part: Part) -> Part:
    order = np.random.default_rng(3).permutation(len(part.faces))
    return Part(part.vertices, np.ascontiguousarray(part.faces[order]), f"{part.name}-shuffled")


SOUND = {
    "box": box(),  # every side facet spans all slabs
    "sphere": sphere(),
    "shuffled": shuffled(sphere()),
    "torus": torus(),
    "tilted": tilted(box()),
    "far": moved(torus(), shift=(900.0, -700.0, 400.0)),
    "apart": join(box(), box((0, 0, 6), (2, 2, 9))),  # layers without a facet between
    "edge": join(box(), box((2, 2, 0), (3, 3, 5))),
    "cavity": join(sphere(10.0), sphere(5.0).reversed()),
    "overlap": join(sphere(10.0), moved(sphere(7.0), shift=(6.0, 1.0, 2.0))),
    "sponge": MODELS["menger-2"].tessellate(0.1),
    "bracket": MODELS["bracket"].tessellate(0.1),
}

FAULTY = {
    "reversed": box().reversed(),
    "open": holed(sphere(), 100),
    "holes in two slabs": holed(sphere(), 100, 1900),
    "open and apart": join(holed(sphere(), 7), moved(sphere(), shift=(30.0, 0.0, 5.0))),
    "inside": join(sphere(10.0), moved(sphere(5.0), shift=(30.0, 0.0, 0.0)).reversed()),
    "doubled": Part(sphere().vertices, np.vstack([sphere().faces, sphere().faces[90:95]])),
    "without area": Part(
        np.vstack([sphere().vertices, [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0]]]),
        np.vstack([sphere().faces, [[5, 5, 7]], len(sphere().vertices) + np.arange(3)[None]]),
    ),
    "flipped": Part(
        sphere().vertices,
        np.where(np.arange(len(sphere().faces))[:, None] == 500, sphere().faces[:, ::-1], sphere().faces),
    ),
}


def in_slabs(part: Part, tmp_path, count: int, heights=None):
    """The part as its file has it, heights, and its division."""
    path = write_stl(part, tmp_path / "part.stl")
    whole = load(path)
    chosen = layer_heights(whole, float(whole.size[2]) / 20) if heights is None else heights(whole)
    return whole, chosen, divided(read_once(path), chosen, count, REACH_MM)


def on_vertices(whole: Part) -> np.ndarray:
    """Heights of vertices, of the middle between two of them, and one a rounding apart: slab borders fall anywhere."""
    z = np.unique(whole.vertices[:, 2])[:-1]
    z = z[:: max(1, len(z) // 12)]
    return np.unique([*z, *(0.5 * (z[1:] + z[:-1])), *np.nextafter(z, np.inf)])


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("name", [*SOUND, *FAULTY])
@pytest.mark.parametrize("heights", [None, on_vertices], ids=["mid-layer", "on vertices"])
def test_sections_of_the_slabs_are_those_of_the_whole_bit_for_bit(name, heights, tmp_path):
    slicers = SLICERS if name in ("box", "sphere", "apart", "edge") else SLICERS[:2]
    if name in FAULTY:
        slicers = SLICERS[:1]  # manifold3d refuses most of them
    expected = {}
    for count in SLABS:
        whole, chosen, division = in_slabs({**SOUND, **FAULTY}[name], tmp_path, count, heights)
        assert 1 <= len(division) <= count
        if name != "apart" and len(chosen) >= count:
            assert len(division) == count
        pieces = [division.slab(k).part for k in range(len(division))]
        for slicer in [made() for made in slicers]:
            settings = slicer.Settings()
            if slicer.name not in expected:
                with slicer.prepare(whole, settings) as prepared:
                    expected[slicer.name] = prepared.slice(chosen)
            for k, piece in enumerate(pieces):
                first, past = division.layers[k : k + 2]
                assert (piece.bounds == whole.bounds).all()
                assert slicer.error_bound_mm(piece, settings) == slicer.error_bound_mm(whole, settings)
                with slicer.prepare(piece, settings) as prepared:
                    found = prepared.slice(chosen[first:past])
                same = expected[slicer.name].block(first, past)
                assert (found.layer_starts == same.layer_starts).all()
                assert (found.ring_starts == same.ring_starts).all()
                assert (found.points == same.points).all(), (slicer.name, count, k)
                assert (found.closed == same.closed).all()


@pytest.mark.in_turn(3, 1)
@pytest.mark.parametrize("name", [*SOUND, *FAULTY])
def test_inspection_of_the_slabs_is_that_of_the_whole(name, tmp_path):
    for count in SLABS:
        whole, heights, division = in_slabs({**SOUND, **FAULTY}[name], tmp_path, count)
        looked = SlabInspection(division.file.outline, len(division.file))
        crossing = crossing_counts(whole, heights)
        for k in range(len(division)):
            slab = division.slab(k)
            first, past = division.layers[k : k + 2]
            assert (crossing_counts(slab.part, heights[first:past]) == crossing[first:past]).all()
            if name in SOUND:
                assert inspect(slab.part).open_edges == 0
            looked.add(slab)
        found, expected = dataclasses.asdict(looked.found()), dataclasses.asdict(inspect(whole))
        # How bodies lie to each other is seen in the whole alone; slabs sum their volumes, and say so.
        expected.pop("volume_mm3")
        assert found.pop("volume_mm3") == pytest.approx(whole.signed_volume, rel=1e-9, abs=1e-9)
        related, known = expected.pop("related_bodies"), expected.pop("union_known")
        assert found.pop("related_bodies") == 0 == len(found.pop("relations"))
        assert not (found.pop("union_known") and known and related)
        expected.pop("relations")
        # The reason of a part inside out holds its volume.
        assert found.pop("why")[:40] == expected.pop("why")[:40]
        assert found == expected


# -- the whole command -----------------------------------------------------------------------------------


def tables(run):
    """Tables of a run, byte for byte, and what its record says but for what is of the slabs."""
    record = json.loads((run / "run.json").read_text())
    judged = {name: record[name] for name in ("gates", "comparison", "findings", "exit_code", "primary")}
    counts = {n: [b[k] for k in ("status", "rings", "points", "settings")] for n, b in record["backends"].items()}
    return (run / "layers.csv").read_bytes(), (run / "compare.csv").read_bytes(), judged, counts


@pytest.mark.parametrize(
    ("part", "slabs", "backends"),
    [
        pytest.param(SOUND["bracket"], 3, "planecut,manifold,embree", marks=pytest.mark.slow),
        (SOUND["apart"], 4, "planecut,manifold"),
        (FAULTY["reversed"], 2, "planecut,manifold"),
        pytest.param(SOUND["torus"], 3, "planecut,stencil", marks=pytest.mark.gl),
    ],
    ids=["bracket", "apart", "reversed", "stencil"],
)
def test_a_check_in_slabs_writes_the_tables_of_a_check(part, slabs, backends, tmp_path):
    path = write_stl(part, tmp_path / "part.stl")
    height = part.size[2] / 12
    # The bracket's slicers have processes of their own, as a user's do.
    with nullcontext() if part is SOUND["bracket"] else slicers_here():
        codes = [
            ebamcheck(
                "check", path, "--layer-height", height, "--backends", backends, "-o", f"{count}.run",
                "--slabs", count, cwd=tmp_path,
            ).returncode
            for count in (1, slabs)
        ]  # fmt: skip
    assert codes == [int(part is FAULTY["reversed"])] * 2
    whole, found = tables(tmp_path / "1.run"), tables(tmp_path / f"{slabs}.run")
    assert found == whole
    record = json.loads((tmp_path / f"{slabs}.run" / "run.json").read_text())
    assert record["slabs"]["count"] == slabs
    assert not (tmp_path / f"{slabs}.run" / "layers").exists()
    page = (tmp_path / f"{slabs}.run" / "report.html").read_text()
    assert f"checked in {slabs} slabs" in page
    assert "No method found a contour" not in page or codes[0] == 1


# -- what is refused -------------------------------------------------------------------------------------


def test_files_that_are_none_are_refused_in_one_line_and_nothing_is_made(tmp_path):
    whole = write_stl(sphere(), tmp_path / "whole.stl").read_bytes()
    bad = {
        "cut.stl": (whole[:-70], "truncated or not an STL file: byte 80 counts"),
        "long.stl": (whole + bytes(range(1, 101)), "bytes follow the last one"),
        "nan.stl": (whole[:146] + np.float32(np.nan).tobytes() + whole[150:], "facet 1, vertex 0, x is nan"),
        "none.stl": (bytes(84), "holds no facet"),
        "small.stl": (b"abc", "under the 84 of a binary header"),
        "ascii.stl": (b"solid a\nfacet normal 0 0 1\n outer loop\n" + b" " * 80, "is an ASCII STL"),
        "gone.stl": (None, "there is no such file"),
        "zip.stl": (b"PK\x03\x04" + bytes(200), "is a zip archive"),
        "part.3mf": (b"PK\x03\x04" + bytes(200), "only a binary STL file is read in slabs"),
        "part.ply": (b"ply\n" + bytes(200), "only a binary STL file is read in slabs"),
    }
    for name, (data, said) in bad.items():
        if data is not None:
            (tmp_path / name).write_bytes(data)
        found = ebamcheck("check", name, "--slabs", 3, "-o", "a.run", cwd=tmp_path)
        assert (found.returncode, found.stdout) == (2, ""), name
        assert said in found.stderr, (name, found.stderr)
        assert len(found.stderr.strip().splitlines()) == 1
        assert not (tmp_path / "a.run").exists()


def test_a_file_that_changes_meanwhile_is_refused(tmp_path):
    _, _, division = in_slabs(sphere(), tmp_path, 3)
    (tmp_path / "part.stl").write_bytes((tmp_path / "part.stl").read_bytes()[:-50])
    with pytest.raises(InputError, match="was changed while it was read"):
        division.slab(1)


@pytest.mark.parametrize(
    ("section", "name"),
    [
        ({"direction": (1.0, 0.0, 0.0)}, "part.direction"),
        ({"place_at_mm": (1.0, 2.0)}, "part.place_at_mm"),
        ({"rotate_deg": 5.0}, "part.rotate_deg"),
        ({"fix_orientation": True}, "part.fix_orientation"),
    ],
)
def test_what_would_move_or_mend_the_part_is_refused(section, name, tmp_path):
    path = write_stl(box(), tmp_path / "part.stl")
    with pytest.raises(SettingsError, match=name):
        check_in_slabs(path, tmp_path / "a.run", FAST.changed(part=section), 2)


# -- when a part is checked in slabs ---------------------------------------------------------------------


def test_slabs_come_by_themselves_where_memory_asks_for_them(tmp_path):
    path = write_stl(MODELS["sphere"].tessellate(0.002), tmp_path / "part.stl")
    text = tmp_path / "part.obj"
    text.write_text("v 0 0 0\n")
    two = FAST.changed(slicing={"processes": 2})
    assert wanted_slabs(path, two) == 1
    tight = two.changed(work={"most_memory_mb": 955.0})
    assert wanted_slabs(path, tight) > 2
    assert wanted_slabs(path, tight.changed(slicing={"slabs": 1})) == 1
    assert wanted_slabs(path, two.changed(slicing={"slabs": 9})) == 9
    assert wanted_slabs(text, tight) == wanted_slabs(tmp_path / "none.stl", tight) == 1
    assert wanted_slabs(path, two.changed(slicing={"memory_limit_mb": 255.0})) > 2

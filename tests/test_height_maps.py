"""Measured surfaces: read from every kind of file, judged by figures, kept in the journal to the byte."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import settings as trials
from hypothesis import strategies as st
from measured_surfaces import SIZE, grid_of, level_metal, map_of, surface_of, write_csv
from PIL import Image

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.height_map import HOLE, HeightMap, MapCells, Refused, figures_of, in_cells, read_map
from ebamcheck.metal import target_of
from ebamcheck.settings.config import Config

FRAME = Config().height_map


@pytest.fixture(scope="module")
def metal(maker):
    return level_metal(maker)


def cells_of(path, metal, frame=FRAME):
    return in_cells(read_map(path, frame), metal.surface)


def judged(found, metal, **frame):
    """Figures of a map on the metal."""
    return figures_of(in_cells(found, metal.surface), metal.surface, Config().changed(height_map=frame))


def test_one_surface_is_the_same_from_every_kind_of_file(metal, tmp_path):
    z = surface_of(3.4, 0.5, slope=(0.01, -0.004))
    x, _, height = grid_of(z)
    wanted = cells_of(write_csv(tmp_path / "m.csv", z), metal)
    step = "step_mm = [0.5, 0.5]\n"
    at = f"origin_mm = [-3.0, -3.0]\n{step}"
    micrometres = np.round(height[::-1] * 1000.0 + 500.0).astype(np.uint16)
    for name, grid, frame in (
        ("m.npy", height, f'{at}rows = "up"'),
        ("grid.csv", height, f'{at}rows = "up"'),
        ("m.tif", height[::-1].astype(np.float32), f'{at}rows = "down"'),
        ("um.tif", micrometres, f"{at}unit_mm = 0.001\nzero_mm = -0.5"),
        # A quarter turn to the left: what was along X is along Y.
        ("t.npy", height.T[::-1], f'origin_mm = [{x.max()}, -3.0]\n{step}turn_deg = 90.0\nrows = "up"'),
    ):
        path = tmp_path / name
        if path.suffix == ".npy":
            np.save(path, grid)
        elif path.suffix == ".csv":
            np.savetxt(path, grid, delimiter=",", fmt="%.6f")
        else:
            Image.fromarray(grid).save(path)
        (tmp_path / f"{name}.frame.toml").write_text(frame)
        found = cells_of(path, metal)
        assert ((found.kept == HOLE) == (wanted.kept == HOLE)).all(), name
        assert np.abs(found.kept - wanted.kept).max() <= 1, name  # half a micrometre, and its rounding


def test_coarse_maps_come_to_nearly_the_same_between_their_places(metal):
    z = surface_of(3.4, slope=(0.01, 0.005))
    fine, coarse = (in_cells(map_of(z, step), metal.surface) for step in (0.5, 3.0))
    inside = np.abs(fine.height_mm - coarse.height_mm)[metal.surface.share > 0.5]
    assert np.nanmax(inside) < 0.03
    assert np.isfinite(inside).all()


def test_holes_are_left_out(metal, tmp_path):
    z = surface_of(3.4)
    path = write_csv(tmp_path / "m.csv", z, lambda x, y: 10 < x < 20 and 10 < y < 20)
    found = cells_of(path, metal)
    row, column = (int(15 / metal.surface.step_mm) - first for first in metal.surface.corner[::-1])
    assert found.kept[row, column] == HOLE
    figures = judged(read_map(path, FRAME), metal)
    assert figures.mean_mm == pytest.approx(3.4, abs=1e-3)
    assert 0.75 < figures.known < 0.95
    marked = {"hole": -99.0, "origin_mm": (-3.0, -3.0), "step_mm": (0.5, 0.5), "rows": "up"}
    grid = grid_of(z)[2]
    grid[26:46, 26:46] = -99.0
    np.save(tmp_path / "m.npy", grid)
    assert judged(read_map(tmp_path / "m.npy", FRAME.model_copy(update=marked)), metal).known < 0.95


BAD = {
    "a.txt": (b"1,2", "height maps are .csv"),
    "none.csv": (None, "cannot be read"),
    "empty.csv": (b"", "nor a grid of numbers"),
    "words.csv": (b"a,b\nc,d\n", "nor a grid of numbers"),
    "bytes.csv": (b"\xff\xfe\x00\x01", "nor a grid of numbers"),
    "place.csv": (b"x_mm,y_mm,height_mm\n1,2,3\n,2,3\n", "place.csv:3: a place is no number"),
    "word.csv": (b"x_mm,y_mm,height_mm\n1,2,high\n", "nor a grid of numbers"),
    "holes.csv": (b"x_mm,y_mm,height_mm\n1,2,\n", "has no height at all"),
    "no.npy": (b"\x93NUMPY", "is no NPY file"),
    "no.tif": (b"II*\x00", "is no TIFF"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_told_in_one_line(name, tmp_path):
    content, said = BAD[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as told:
        read_map(tmp_path / name, FRAME)
    assert said in str(told.value)
    assert "\n" not in str(told.value)


def test_bad_arrays_and_frames_are_told(tmp_path):
    path = tmp_path / "m.npy"
    wrong = (np.zeros(4), np.zeros((2, 2, 2)), np.array([["a"]]), np.zeros((2, 2), complex), np.zeros((0, 3)))
    for array in wrong:
        np.save(path, array)
        with pytest.raises(InputError, match="no grid of numbers"):
            read_map(path, FRAME)
    np.save(path, np.array([{}], object), allow_pickle=True)
    with pytest.raises(InputError, match="is no NPY file"):
        read_map(path, FRAME)
    np.save(path, np.ones((3, 3)))
    Image.new("RGB", (3, 3)).save(tmp_path / "m.tif")
    with pytest.raises(InputError, match="one channel"):
        read_map(tmp_path / "m.tif", FRAME)
    for text, said in (("step_mm = [0, 1]", "step_mm"), ("origin = [1, 2]", "origin"), ("=", "is not TOML")):
        (tmp_path / "m.npy.frame.toml").write_text(text)
        with pytest.raises(InputError, match=said):
            read_map(path, FRAME)
    for values in ({"step_mm": (0.0, 1.0)}, {"rows": "left"}, {"least_known": 0.0}, {"unit_mm": -1.0}):
        with pytest.raises(SettingsError, match=r"height_map\."):
            Config().changed(height_map=values)


# -- figures -----------------------------------------------------------------------------------------


@trials(deadline=None, max_examples=25)
@given(st.floats(-0.012, 0.012), st.floats(-0.012, 0.012), st.floats(1.0, 50.0))
def test_a_plane_has_its_slope_and_its_mean(metal, a, b, base):
    figures = judged(map_of(surface_of(base, slope=(a, b))), metal)
    assert figures.mean_mm == pytest.approx(base, abs=0.02)
    assert figures.slope_deg == pytest.approx(math.degrees(math.atan(math.hypot(a, b))), abs=0.02)
    if math.hypot(a, b) > 0.003:
        off = (figures.slope_to_deg - math.degrees(math.atan2(b, a)) + 180.0) % 360.0 - 180.0
        assert abs(off) < 8.0


def test_a_hump_is_found_where_it_is_and_a_dip_too(metal):
    for hump in (0.6, -0.6):
        figures = judged(map_of(surface_of(3.4, hump, (26.0, 12.0))), metal)
        size, at = (figures.hump_mm, figures.hump_at_mm) if hump > 0 else (figures.dip_mm, figures.dip_at_mm)
        assert at == pytest.approx((26.0, 12.0), abs=1.5)
        assert 0.3 < size < 0.6


def test_what_is_too_uneven_or_not_known_is_refused_with_its_place(metal):
    part = map_of(surface_of(3.4))
    kept = part.x_mm < 18.0
    half = HeightMap(part.x_mm[kept], part.y_mm[kept], part.height_mm[kept], 0.5)
    for found, frame, code, said in (
        (
            map_of(surface_of(3.4, 2.0, (12.0, 18.0))),
            {},
            "map-uneven",
            r"over its mean .* at \(1[12]\.5, 1[78]\.5\)",
        ),
        (map_of(surface_of(3.4, -2.0)), {}, "map-uneven", "under its mean"),
        (map_of(surface_of(3.4, 0.3)), {"uneven_mm": 0.1}, "map-uneven", "0.10 mm can be mended"),
        (half, {}, "map-holes", r"the middle of the largest hole is at \("),
    ):
        with pytest.raises(Refused, match=said) as told:
            judged(found, metal, **frame)
        assert told.value.code == code


def test_spatter_is_a_hole_and_flanks_along_the_border_are_no_unevenness(metal):
    x, y, z = grid_of(surface_of(3.4))
    spatter = np.where(np.hypot(x - 20.0, y - 20.0) < 1.5, z + 30.0, z)
    flanks = np.where(np.minimum.reduce([x, 42.0 - x, y, 36.0 - y]) < 2.0, 1.5, z)
    for height, off_mm in ((spatter, 1e-3), (flanks, 0.05)):
        figures = judged(HeightMap(x.ravel(), y.ravel(), height.ravel(), 0.5), metal)
        assert figures.mean_mm == pytest.approx(3.4, abs=1e-3)
        assert max(figures.hump_mm, figures.dip_mm) < off_mm
        assert (figures.known < 1.0) == (height is spatter)


@trials(deadline=None, max_examples=30)
@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 2**31), st.integers(-50, 50))
def test_the_journal_gives_a_map_back_as_it_was(rows, columns, seed, corner):
    random = np.random.default_rng(seed)
    kept = random.integers(-(10**8), 10**8, (rows, columns)).astype(np.int32)
    kept[random.random((rows, columns)) < 0.2] = HOLE
    cells = MapCells((corner, -corner), kept)
    again = MapCells.of_entry(json.loads(json.dumps(cells.entry())))
    assert again.sha256 == cells.sha256
    assert (again.kept == kept).all()
    entry = cells.entry()
    for change in (
        {"um": entry["um"][:-4]},
        {"corner": [corner + 1, -corner]},
        {"shape": [rows + 1, columns]},
        {"um": None},
    ):
        with pytest.raises(InputError):
            MapCells.of_entry(entry | change)


def test_a_surface_keeps_what_was_measured_until_the_next_layer_lies_on_it(metal):
    over = np.where(metal.surface.share > 0.5, 0.4, 0.0)
    mapped = metal.surface.with_map(over)
    assert mapped.mapped
    assert not metal.surface.mapped
    assert mapped.measured().mapped
    target = target_of(shapely.box(0, 0, *SIZE[:2]), mapped.step_mm, 12.0)
    mapped.add(target, target.share, 1.0)
    assert not mapped.mapped

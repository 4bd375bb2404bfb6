"""Samples of curves and their measures, files of curves, and requests that are wrong."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import shapely
from fitted_rings import EXACT_MM, SQUARE, circle, one, paper_fit, raw, stack, wavy

from ebamcheck.curves import ARC, LINE, Curves, fit, fit_deviation
from ebamcheck.errors import GeometryError, InputError, SettingsError
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.plugins.registry import models
from ebamcheck.slicers.slicing import slice_part

# -- sampling and measures -------------------------------------------------------------------------


def test_samples_lie_on_the_curve_no_farther_apart_than_the_step() -> None:
    curves = paper_fit(stack())
    for step in (0.05, 0.7, 1000.0):
        sampled = curves.sample(step)
        assert isinstance(sampled, Layers)
        assert len(sampled) == 4
        for r in range(sampled.closed.size):
            ring = sampled.ring(r)
            closing = [ring[:1]] if sampled.closed[r] else []
            assert np.hypot(*np.diff(np.vstack([ring, *closing]), axis=0).T).max() <= step + EXACT_MM
    assert np.abs(np.hypot(*one(circle(48)).sample(0.01).points.T) - 20).max() < 2e-5


def test_sample_tolerance_bounds_the_chord_error() -> None:
    curves = one(wavy())
    fine = curves.sample(0.005)
    for tolerance in (0.1, 0.001):
        coarse = curves.sample_tolerance(tolerance)
        line = shapely.LinearRing(coarse.points)
        assert shapely.distance(shapely.points(fine.points), line).max() < tolerance
    assert len(one(SQUARE).sample_tolerance(1e-6).points) == 4


def test_lengths_are_those_of_circle_and_square() -> None:
    assert one(circle(200)).lengths().sum() == pytest.approx(2 * np.pi * 20, rel=1e-8)
    assert one(SQUARE).lengths().tolist() == [10, 10, 10, 10]


def test_bezier_spans_are_the_curve() -> None:
    curves = paper_fit(stack())
    spans = curves.bezier_spans()
    assert len(spans) == curves.block_count()
    for i in range(curves.kind.size):
        mine = spans.points[spans.piece == i]
        h = spans.interval_mm[spans.piece == i]
        assert np.array_equal(mine[1:, 0], mine[:-1, 3])
        starts = np.concatenate([[0], np.cumsum(h)])
        for t in (0.0, 0.3, 1.0):
            at = np.stack([(1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t**2, t**3]) @ mine
            assert np.abs(at - curves.evaluate(i, starts[:-1] + t * h)).max() < EXACT_MM
    assert np.array_equal(curves.ring_layer[spans.ring], spans.layer)


def test_fit_deviation_of_an_interpolating_fit_is_rounding() -> None:
    layers = stack()
    table = fit_deviation(paper_fit(layers), layers)
    assert table["kept_points_mm"].max() < 1e-12
    assert table["points_mm"].max() < 0.0011
    assert table["bulge_mm"].iloc[0] > 0.01
    assert table["blocks"].sum() == paper_fit(layers).block_count()
    assert table["bulge_mm"].iloc[1] == 0  # an empty layer


def test_fit_deviation_sees_a_curve_that_moved() -> None:
    layers = from_rings([0.0], [[circle(60)]])
    curves = paper_fit(layers)
    curves.control[:, 0] += 0.25
    table = fit_deviation(curves, layers)
    assert table["points_mm"][0] == pytest.approx(0.25, abs=2e-3)
    assert table["bulge_mm"][0] == pytest.approx(0.25, abs=0.03)


# -- files, settings, errors -----------------------------------------------------------------------


def test_parquet_brings_back_every_bit(tmp_path: Path) -> None:
    part = models()["prism"].tessellate(0.1)
    arcs = fit(slice_part(part, [20.0, 40.0]), part=part)
    assert {LINE, ARC} <= set(arcs.kind)
    for curves in (arcs, *map(paper_fit, (stack(), from_rings([], []), from_rings([1.0, 2.0], [[], []])))):
        curves.to_parquet(tmp_path / "c.parquet")
        back = Curves.from_parquet(tmp_path / "c.parquet")
        # The file holds curves; what speaks for them stands in the record of a run.
        for field in (f for f in fields(Curves) if f.name != "evidence"):
            ours, theirs = getattr(curves, field.name), getattr(back, field.name)
            if isinstance(ours, np.ndarray):
                assert ours.dtype == theirs.dtype, field.name
                assert np.array_equal(ours, theirs), field.name
            else:
                assert ours == theirs, field.name
        assert back.block_count() == curves.block_count()
    assert [p.name for p in tmp_path.iterdir()] == ["c.parquet"]


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path_ = tmp_path / "c.parquet"
    paper_fit(stack()).to_parquet(path_)
    table = pq.read_table(path_)
    with pytest.raises(InputError, match="cannot be read"):
        Curves.from_parquet(tmp_path / "none.parquet")
    (tmp_path / "cut.parquet").write_bytes(path_.read_bytes()[:-100])
    with pytest.raises(InputError, match="cannot be read"):
        Curves.from_parquet(tmp_path / "cut.parquet")
    damaged = {
        "version": table.replace_schema_metadata({}),
        "missing": table.drop_columns(["knot"]),
        "same rings": table.set_column(
            table.schema.get_field_index("ring_pieces"),
            "ring_pieces",
            table["ring_pieces"].take([2, 1, 0, 3]),
        ),
        "should be": table.set_column(0, "height_mm", pa.array(["a"] * 4)),
        "not finite": table.set_column(0, "height_mm", pa.array([np.nan] * 4)),
    }
    for said, wrong in damaged.items():
        pq.write_table(wrong, tmp_path / "w.parquet")
        with pytest.raises(InputError, match=said):
            Curves.from_parquet(tmp_path / "w.parquet")


def test_wrong_requests_say_what_is_wrong() -> None:
    layers = from_rings([0.0], [[SQUARE]])
    with pytest.raises(
        SettingsError, match="'magic' is unknown: choose one of bounded, surface, chord, paper"
    ):
        paper_fit(layers, method="magic")
    with pytest.raises(SettingsError, match="corner_angle_deg"):
        paper_fit(layers, corner_angle_deg=200)
    with pytest.raises(SettingsError, match="corner_angel"):
        paper_fit(layers, corner_angel=100)
    for step in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SettingsError, match="positive"):
            paper_fit(layers).sample(step)
        with pytest.raises(SettingsError, match="positive"):
            paper_fit(layers).sample_tolerance(step)
    with pytest.raises(SettingsError, match="larger step"):
        paper_fit(layers).sample(1e-9)
    with pytest.raises(SettingsError, match="not fitted to these"):
        fit_deviation(paper_fit(layers), stack())
    bad = raw(np.array([(0.0, 0.0), (1.0, np.nan), (1.0, 1.0)]))
    with pytest.raises(GeometryError, match="layer 1"):
        paper_fit(bad)

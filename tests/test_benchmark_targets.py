"""Targets of the benchmarks: which are met, and how far a floor lies under them."""

from __future__ import annotations

import pytest
from benchmark_figures import cell, one_round, raw_figures

from benchmarks import tables, target_rows
from benchmarks.floors import FLOORS
from benchmarks.targets import Figures


def results(**tasks: list[dict[str, object]]) -> dict[str, object]:
    raw = raw_figures()
    found = target_rows.evaluate(Figures(raw["cells"], tasks, raw["parts"], "ladder", 11))
    return {result.target.key: result for result in found}


def test_a_target_is_met_missed_or_says_why_it_was_not_measured():
    told = results(
        crossings=[{"status": "done", "why": "", "farthest_mm": 1e-6, "broken_layers": 3}],
        cold=[{"status": "failed", "why": "it crashed"}],
    )
    assert told["planecut-seconds"].met
    assert told["planecut-seconds"].verdict == "met"
    assert told["embree-crossings"].met
    assert told["embree-broken"].met is False
    assert told["embree-broken"].verdict == "**missed** by 3"
    assert told["cold"].verdict == "not measured (failed: it crashed)"
    assert told["bitmaps"].verdict == "not measured (not measured)"
    assert told["literal"].verdict == "no target"
    assert told["literal"].measured.median == pytest.approx(2.5 + 20.0)


def test_growth_is_per_facet_and_point_over_the_base_size():
    base, small = 0.02 / (38_000 + 38_000), 0.01 / (4_000 + 1_000)
    growth = results()["growth"]
    assert growth.measured.median == pytest.approx(small / base)
    assert growth.met is False
    assert growth.verdict.startswith("**missed**: 2.53 times")


def test_memory_is_related_to_file_and_layers():
    memory = results()["planecut-memory"]
    assert memory.measured.median == pytest.approx(300e6 / (50 * 1_480_000 + 16 * 8_000_000))


def test_a_floor_is_the_bytes_that_must_be_touched_over_the_bandwidth():
    raw, done = raw_figures(), {"status": "done", "why": ""}
    tasks = {
        "imports": [{**done, "wall_s": 0.5}],
        "in order": [{**done, "rounds": [one_round(0.4)]}],
    }
    told = target_rows.evaluate(Figures(raw["cells"], tasks, raw["parts"], "ladder", 11, copy_bytes_s=1e9))
    floors = {result.target.key: result.floor for result in told}
    cut_s = (50 * 1_480_000 + 16 * 8_000_000) / 1e9
    assert floors["planecut-seconds"] == pytest.approx(cut_s)
    assert floors["cold"] == pytest.approx(0.5 + cut_s)
    new = Figures(raw["cells"], tasks, raw["parts"], "ladder", 11, copy_bytes_s=1e9, touch_bytes_s=5e8)
    floors_new = {result.target.key: result.floor for result in target_rows.evaluate(new)}
    assert floors_new["cold"] == pytest.approx(0.5 + 16 * 8_000_000 / 5e8)
    assert floors["shuffled"] == pytest.approx(1.0 + 3 * 64 * 1_480_000 / 1e9 / 0.4)
    assert floors["growth"] == 1.0
    assert floors["planecut-manifold"] is None  # the library by itself was not measured
    assert floors["layer"] == pytest.approx(16 * 8_000_000 / 1e9 / 100)
    assert floors["literal"] == pytest.approx(0.5 * 100 * 24 * 1_480_000 / 1e9)
    assert floors["bitmaps"] is None  # their size was not measured
    shown = {result.target.key: result.floor_text for result in told}
    assert shown["planecut-seconds"] == "202 ms"
    assert shown["bitmaps"] == "-"
    assert all(result.floor is None or result.floor > 0.0 for result in told)


def test_without_the_bandwidth_no_floor_of_bytes_is_told():
    floors = {key: result.floor for key, result in results().items()}
    assert floors["planecut-seconds"] is None
    assert floors["compare"] is None


def test_every_floor_belongs_to_a_target():
    every = (*target_rows.TARGETS, *target_rows.GPU, *target_rows.JOB, *target_rows.SCALE)
    assert set(FLOORS) <= {target.key for target in every}


def test_the_floor_of_a_command_is_its_processor_time_on_all_cores():
    done = {"status": "done", "why": "", "wall_s": 40.0}
    tasks = {
        "main job": [{**done, "processor_s": 60.0}],
        "islands": [{**done, "layer_s": [2.0] * 10, "islands": [300] * 10, "processor_s": 30.0}],
        "warm": [done],
    }
    told = {result.target.key: result for result in target_rows.job_results(tasks, 2)}
    assert told["demo"].floor == pytest.approx(30.0)
    assert told["islands"].floor == pytest.approx(1.5)
    assert told["warm"].floor is None  # figures of before processor time was kept
    (time_s, memory_mb) = (
        next(r.floor for r in target_rows.scale_results([answer], 2) if r.target.key == key)
        for key, answer in (
            ("scale-time", {**done, "processor_s": 500.0, "peak_mb": 1.0, "facets": 10}),
            ("scale-memory", {**done, "peak_mb": 9.0, "facets": 1_000_000}),
        )
    )
    assert (time_s, memory_mb) == (pytest.approx(250.0), pytest.approx(50.0))


def test_pixels_are_held_beside_what_the_lattice_of_rasterisers_leaves():
    counts = {"against_literal": [3, 9], "against_exact": [2, 9], "by_lattice": [1, 7]}
    told = results(bitmaps=[{"status": "done", "why": "", **counts, "farthest_px": 0.001, "bitmaps_s": [1.0],
                             "contours_s": [1.0], "side_px": [1024, 1024]}])  # fmt: skip
    assert told["pixels-exact"].floor == told["pixels-literal"].floor == 7


def test_a_gpu_has_targets_of_its_own():
    raw = raw_figures()
    cells = [cell("ladder-11", "stencil", 0.5, points=1_000_000), cell("ladder-11", "stencil literal", 10.0)]
    tasks = {"drawing": [{"status": "done", "why": "", "device_s": 6.5}]}
    figures = Figures(cells, tasks, raw["parts"], "ladder", 11, copy_bytes_s=1e9)
    told = {result.target.key: result for result in target_rows.evaluate(figures, gpu=True)}
    assert told["gpu-once"].met
    assert told["gpu-once"].floor == pytest.approx((50 * 1_480_000 + 16_000_000) / 1e9)
    assert told["gpu-literal"].met is False
    assert told["gpu-literal"].floor == 6.5
    assert told["bitmaps"].verdict == "not measured (not measured)"
    assert "stencil literal" in tables.targets_text(
        {**raw, "cells": cells, "targets": {"ladder": tasks}}, gpu=True
    )


def test_one_failed_turn_spoils_a_task():
    done = {"status": "done", "why": "", "wall_s": 1.0}
    assert results(cold=[done, done])["cold"].met
    assert results(cold=[done, {"status": "over", "why": "ended"}])["cold"].measured is None


def test_every_remark_belongs_to_a_target():
    import tomllib

    alone = [target for target in target_rows.GPU if target not in target_rows.TARGETS]
    every = (*target_rows.TARGETS, *alone, *target_rows.JOB, *target_rows.SCALE)
    keys = {target.key for target in every}
    assert len(keys) == len(every)
    assert set(tomllib.loads(tables.REMARKS.read_text(encoding="utf-8"))) <= keys

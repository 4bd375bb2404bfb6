"""Targets of the benchmarks: which are met, and by how much one is missed."""

from __future__ import annotations

import pytest
from benchmark_figures import cell, raw_figures

from benchmarks.targets import TARGETS, Figures, targets_text

DONE = {"status": "done", "why": ""}


def results(**tasks: list[dict[str, object]]) -> dict[str, tuple[str, str]]:
    raw = raw_figures()
    figures = Figures(raw["cells"], tasks, raw["parts"], "ladder", 11)
    return {
        target.what.partition(",")[2].strip() or target.what: target.judged(figures) for target in TARGETS
    }


def test_a_target_is_met_missed_or_says_why_it_was_not_measured():
    told = results(
        **{"cold": [{"status": "failed", "why": "it crashed"}], "start-up": [{**DONE, "wall_s": 1.6}]}
    )
    assert told["file to contours, warm process"] == ("400 ms (380 ms .. 420 ms, n = 3)", "met")
    assert told["whole command, cold"] == ("-", "not measured (failed: it crashed)")
    assert told["one layer)"] == ("1.60 s", "**missed**: 2.00 times the target")
    assert told["the paper's way, 0.1 mm pixels"] == ("22.5 s", "no target")
    assert told["part loaded"] == ("-", "not measured (not measured)")


def test_growth_is_per_facet_and_point_over_the_base_size():
    base, small = 0.02 / (38_000 + 38_000), 0.01 / (4_000 + 1_000)
    figure, verdict = results()["worst of all sizes"]
    assert float(figure) == pytest.approx(small / base, rel=1e-2)
    assert verdict == "**missed**: 2.53 times the target"


def test_memory_is_related_to_file_and_layers():
    figure, _ = results()["peak memory of the process over input + output"]
    assert float(figure.split()[0]) == pytest.approx(300e6 / (50 * 1_480_000 + 16 * 8_000_000), rel=1e-2)


def test_one_failed_turn_spoils_a_task():
    done = {**DONE, "wall_s": 1.0}
    assert results(cold=[done, done])["whole command, cold"][1] == "met"
    assert results(cold=[done, {"status": "over", "why": "ended"}])["whole command, cold"][0] == "-"


def test_a_gpu_has_targets_of_its_own():
    cells = [cell("ladder-11", "stencil", 0.5, points=1_000_000), cell("ladder-11", "stencil literal", 10.0)]
    text = targets_text({**raw_figures(), "cells": cells}, gpu=True)
    assert "| 500 ms | met |" in text
    assert "| 10.0 s | **missed**: 2.00 times the target |" in text

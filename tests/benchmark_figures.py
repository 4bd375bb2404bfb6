"""Figures of the benchmarks, made up."""

from __future__ import annotations


def one_round(
    seconds: float, layers_cut: int = 100, layers: int = 100, points: int = 1000
) -> dict[str, object]:
    return {
        "load_s": 0.25 * seconds, "prepare_s": 0.25 * seconds, "slice_s": 0.5 * seconds,
        "layers": layers, "layers_cut": layers_cut, "points": points, "rings": 10, "output_bytes": 16 * points,
    }  # fmt: skip


def cell(part: str, method: str, *seconds: float, **round_: int) -> dict[str, object]:
    runs = [{"rounds": [one_round(s, **round_)], "peak_mb": 300.0, "resident_mb": 100.0} for s in seconds]
    return {"part": part, "method": method, "status": "done", "why": "", "limit_s": 60.0, "runs": runs}


def over(part: str, method: str) -> dict[str, object]:
    return {**cell(part, method), "status": "over", "why": "ended after 60 s"}


def raw_figures() -> dict[str, object]:
    facets = {1: 4_000, 6: 38_000, 11: 1_480_000}
    return {
        "command": "python -m benchmarks",
        "machine": {
            "cpu": "made up", "cores": 2, "memory_gb": 24.0, "load_at_start": [0.1, 0.1, 0.1], "started": "now",
            "ebamcheck": "0", "commit": "", "python": "3", "packages": {"numpy": "2"}, "renderer": "llvmpipe (made up)",
        },
        "methods": ["planecut", "stencil literal", "slic3r", "cura"],
        "parts": {
            f"ladder-{size}": {"series": "ladder", "size": size, "facets": n, "bytes": 50 * n, "layer_mm": 0.2}
            for size, n in facets.items()
        },
        "cells": [
            cell("ladder-1", "planecut", 0.01), cell("ladder-6", "planecut", 0.02, points=38_000),
            cell("ladder-11", "planecut", 0.40, 0.42, 0.38, points=8_000_000),
            cell("ladder-11", "stencil literal", 10.0, layers_cut=25), over("ladder-11", "slic3r"),
            {**cell("ladder-11", "cura"), "status": "missing", "why": "the program | is not installed"},
        ],
        "targets": {"ladder": {}}, "job": {},
    }  # fmt: skip

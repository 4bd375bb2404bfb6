"""The targets, one row each, and how each is read from the raw figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import methods
from benchmarks.figures import cell_times, find, ratio, total_s
from benchmarks.floors import floor_of
from benchmarks.parts import BASE_SIZE
from benchmarks.spread import Spread, spread
from benchmarks.targets import SLICE, Figures, Result, Target, judged

Raw = Mapping[str, Any]
CUT = ("slice_s",)

PIXELS = 8
SUBPIXEL = 1.0 / 256.0
PROPORTION = 1.5
"""The union of a layer may cost so much more where many layers need one than where few do."""


def evaluate(figures: Figures, gpu: bool = False) -> list[Result]:
    """Hold the figures of a series against all targets, or against those of the stencil on a GPU."""
    return [judged(target, figures, floor_of(target.key, figures)) for target in (GPU if gpu else TARGETS)]


def job_results(answers: Mapping[str, Sequence[Raw]], cores: int | None = None) -> list[Result]:
    """Hold the main job and the first use of a new install against their targets."""
    figures = Figures([], answers, {}, "", 0, cores=cores)
    return [judged(target, figures, floor_of(target.key, figures)) for target in JOB]


def scale_results(answers: Sequence[Raw], cores: int | None = None) -> list[Result]:
    """Hold the run beyond memory against its target."""
    figures = Figures([], {"scale": answers}, {}, "", 0, cores=cores)
    return [judged(target, figures, floor_of(target.key, figures)) for target in SCALE]


def _memory(figures: Figures) -> Spread | None:
    """Greatest memory of the process over file and layers together."""
    cell = find(figures.cells, f"{figures.series}-{figures.top}", "planecut")
    if cell is None or not cell["runs"]:
        return None
    given = figures.parts[cell["part"]]["bytes"]
    return spread(1e6 * run["peak_mb"] / (given + run["rounds"][-1]["output_bytes"]) for run in cell["runs"])


def _memory_gained(figures: Figures) -> Spread | None:
    """The same without what the process held before it began: interpreter, libraries, compiled kernels."""
    cell = find(figures.cells, f"{figures.series}-{figures.top}", "planecut")
    if cell is None or not cell["runs"]:
        return None
    given = figures.parts[cell["part"]]["bytes"]
    return spread(
        1e6 * (run["peak_mb"] - run["resident_mb"]) / (given + run["rounds"][-1]["output_bytes"])
        for run in cell["runs"]
    )


def _growth(figures: Figures) -> Spread | None:
    """Time over (facets + points) at every size, over that of the base size; the worst of them."""
    costs: dict[int, float] = {}
    for key, part in figures.parts.items():
        cell = find(figures.cells, key, "planecut")
        times = cell_times(cell)
        if part["series"] == figures.series and cell is not None and times is not None:
            costs[part["size"]] = times.median / (part["facets"] + cell["runs"][-1]["rounds"][-1]["points"])
    if BASE_SIZE not in costs or len(costs) < 2:
        return None
    return spread([max(cost / costs[BASE_SIZE] for size, cost in costs.items() if size != BASE_SIZE)])


def _shuffled(figures: Figures) -> Spread | None:
    return ratio(figures.told("shuffled", total_s), figures.told("in order", total_s))


def _overlap_test(figures: Figures) -> Spread | None:
    return figures.told("overlaps", lambda a: max(0.0, min(a["with_s"]) - min(a["without_s"])))


def _union_proportion(figures: Figures) -> Spread | None:
    """Cost of a layer that needs a union, where many do, over that where few do."""

    def proportion(answer: Raw) -> float:
        few, many = (cost / layers for cost, layers in zip(answer["union_s"], answer["layers"], strict=True))
        return float(many / few)

    return figures.told("unions", proportion)


def _median_of(name: str) -> Callable[[Raw], float]:
    return lambda answer: spread(answer[name]).median


TARGETS: tuple[Target, ...] = (
    Target(
        "planecut-prusa", "planecut, file to contours, over PrusaSlicer's slice stage", 0.25, "",
        lambda f: ratio(f.times("planecut", ("load_s", *SLICE)), f.times(methods.PRUSA_STAGE, CUT)),
    ),
    Target(
        "planecut-manifold", "planecut, file to contours, over manifold3d's construct + slice + to_polygons", 0.125, "",
        lambda f: ratio(f.times("planecut", ("load_s", *SLICE)), f.times(methods.MANIFOLD_ALONE)),
    ),
    Target(
        "planecut-seconds", "planecut, file to contours, warm process", 0.4, "s",
        lambda f: f.times("planecut", ("load_s", *SLICE)),
    ),
    Target("planecut-memory", "planecut, peak memory of the process over input + output", 2.5, "", _memory),
    Target("planecut-memory-gained", "the same without what the warm process held before", None, "", _memory_gained),
    Target("overlap-test", "overlap test of all layers of a clean part", 2.0, "s", _overlap_test, "overlaps"),
    Target(
        "union-proportion", "union: cost a layer where 50 % of them need it over that where 5 % do", PROPORTION, "",
        _union_proportion, "unions",
    ),
    Target("cold", "planecut, whole command, cold", 2.5, "s", lambda f: f.told("cold", lambda a: a["wall_s"]), "cold"),
    Target(
        "start-up", "of which start-up (the same command on a cube, one layer a height)", 0.8, "s",
        lambda f: f.told("start-up", lambda a: a["wall_s"]), "start-up",
    ),
    Target("growth", "time per (facets + points) over that of 38 k facets, worst of all sizes", 3.0, "", _growth),
    Target("shuffled", "shuffled facets over facets in order", 1.5, "", _shuffled, "shuffled"),
    Target("layer", "one layer at a new height, part loaded", 5e-3, "s", lambda f: f.told("latency", _median_of("at_s")), "latency"),
    Target(
        "direction", "a new direction, part loaded", 0.150, "s",
        lambda f: f.told("latency", _median_of("along_s")), "latency",
    ),
    Target(
        "direction-layer", "a new direction with its first layer", None, "s",
        lambda f: f.told("latency", _median_of("along_at_s")), "latency",
    ),
    Target(
        "bitmaps", "stencil draw-once, all bitmaps at 1024 x 1024", 0.5, "s",
        lambda f: f.told("bitmaps", _median_of("bitmaps_s")), "bitmaps",
    ),
    Target(
        "pixels-literal", "pixels that differ from the literal mode, worst judged layer", PIXELS, "",
        lambda f: f.told("bitmaps", lambda a: max(a["against_literal"])), "bitmaps",
    ),
    Target(
        "pixels-exact", "pixels that differ from the exact section, worst judged layer", PIXELS, "",
        lambda f: f.told("bitmaps", lambda a: max(a["against_exact"])), "bitmaps",
    ),
    Target(
        "pixels-distance", "distance of such a pixel's centre from the exact boundary, in pixels", SUBPIXEL, "",
        lambda f: f.told("bitmaps", lambda a: a["farthest_px"]), "bitmaps",
    ),
    Target(
        "bitmap-contours", "stencil bitmaps to contours, all layers, 1024 x 1024", 4.0, "s",
        lambda f: f.told("bitmaps", _median_of("contours_s")), "bitmaps",
    ),
    Target("literal", "stencil literal, the paper's way, 0.1 mm pixels, all layers", None, "s", lambda f: f.times(methods.LITERAL)),
    Target("embree", "embree in-plane, 0.1 mm grid, all layers", 15.0, "s", lambda f: f.times("embree")),
    Target(
        "embree-crossings", "embree in-plane, distance of its points from the exact section", 2e-6, "mm",
        lambda f: f.told("crossings", lambda a: a["farthest_mm"]), "crossings",
    ),
    Target(
        "embree-broken", "embree in-plane, broken layers", 0.0, "",
        lambda f: f.told("crossings", lambda a: a["broken_layers"]), "crossings",
    ),
    Target(
        "manifold", "backend manifold over manifold3d's own time", 1.10, "",
        lambda f: ratio(f.times("manifold"), f.times(methods.MANIFOLD_ALONE)),
    ),
    Target(
        "compare", "comparison of all pairs of the house's slicers, all layers, all metrics", 40.0, "s",
        lambda f: f.told("cross-check", lambda a: a["stages_s"]["compare"]), "cross-check",
    ),
    Target(
        "cross-check", "the whole cross-check: `ebamcheck check`, file to JSON and CSV", 89.0, "s",
        lambda f: f.told("cross-check", lambda a: a["wall_s"]), "cross-check",
    ),
    Target(
        "cross-check-memory", "its peak memory, all processes", 8000.0, "MB",
        lambda f: f.told("cross-check", lambda a: a["peak_mb"]), "cross-check",
    ),
)  # fmt: skip


GPU = (
    Target(
        "gpu-once", "stencil draw-once, 0.1 mm pixels, all layers, file to contours", 1.0, "s",
        lambda f: f.times("stencil", ("load_s", *SLICE)),
    ),
    Target(
        "gpu-literal", "stencil literal, the paper's way, 0.1 mm pixels, all layers, file to contours", 5.0, "s",
        lambda f: f.times(methods.LITERAL, ("load_s", *SLICE)),
    ),
    *(target for target in TARGETS if target.task == "bitmaps"),
)  # fmt: skip


def _layer_s(answer: Raw) -> float:
    """Time a layer, once the first ones have brought everything up."""
    return float(np.mean(answer["layer_s"][1:]))


def _linear(answer: Raw) -> float:
    """Time an island of the upper half of the layers over that of the lower half."""
    seconds, islands = np.asarray(answer["layer_s"]), np.asarray(answer["islands"])
    half = len(seconds) // 2
    lower, upper = (seconds[part].sum() / islands[part].sum() for part in (slice(1, half), slice(half, None)))
    return float(upper / lower)


def _wall_s(answer: Raw) -> float:
    return float(answer["wall_s"])


JOB = (
    Target("demo", "`ebamcheck run` on the demo part", 12.0, "s", lambda f: f.told("main job", _wall_s), "main job"),
    Target(
        "islands", "order and heat of a layer of 277 to 345 islands (1000 layers within 10 minutes: 0.6 s)", 0.6, "s",
        lambda f: f.told("islands", _layer_s), "islands",
    ),
    Target(
        "islands-linear", "the same, time an island in the upper half of 100 layers over that in the lower half", 1.1, "",
        lambda f: f.told("islands", _linear), "islands",
    ),
    Target("warm", "`ebamcheck warm` of a new install", 60.0, "s", lambda f: f.told("warm", _wall_s), "warm"),
    Target("first-slice", "first `ebamcheck slice` of a new install", 15.0, "s", lambda f: f.told("slice", _wall_s), "slice"),
    Target("first-run", "first `ebamcheck run` of a new install, demo part, nothing compiled", None, "s", lambda f: f.told("run", _wall_s), "run"),
    Target("make-demo", "`make demo` in a new clone, with all its set-up", 120.0, "s", lambda f: f.told("demo", _wall_s), "demo"),
)  # fmt: skip

SCALE = (
    Target(
        "scale-memory", "10 million facets x 10,000 layers, peak memory of all processes", 8000.0, "MB",
        lambda f: f.told("scale", lambda a: a["peak_mb"]), "scale",
    ),
    Target("scale-time", "10 million facets x 10,000 layers, time", 600.0, "s", lambda f: f.told("scale", lambda a: a["wall_s"]), "scale"),
)  # fmt: skip

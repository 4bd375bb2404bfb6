"""Accuracy and speed of every slicer on one part, each in a process of its own as a run has it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any

import numpy as np

from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import Comparison
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.cross_check import compared_layers
from ebamcheck.plugins import registry
from ebamcheck.plugins.model import Model
from ebamcheck.regression.measurement import Truth, measure_outcome, truth_of
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Limits, Outcome, bounds_of, slice_all

ACCURACY_LAYERS = 48
"""Layers on which accuracy is judged: the exact sections of a model are dense."""

REPEATS = 3
"""Timed runs of each backend, after one that warms caches; their median counts."""


@dataclass(frozen=True)
class Workpiece:
    """What the slicers are tried on.

    Parameters
    ----------
    part
        The part as placed.
    judged
        Heights on which accuracy is judged, mm.
    timed
        Heights of the whole stack, on which speed is.
    truth
        Exact sections at the judged heights, where the part is a reference model.
    title
        What it is, for a table and for the settings.
    """

    part: Part
    judged: Floats
    timed: Floats
    title: str
    truth: Truth | None = None


@dataclass(frozen=True)
class Trial:
    """What one backend came to; lengths in mm, times in seconds."""

    name: str
    exact: bool
    priority: int
    available: bool
    why: str = ""
    """Why it is not available or did not slice the part, or what its layers have wrong; empty if nothing."""
    bound_mm: float = float("nan")
    measured_mm: float = float("nan")
    """Depth of the symmetric difference with the exact section of the mesh, at most."""
    seconds: float = float("nan")
    """To prepare the part and slice the whole stack, median."""
    device: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


def workpiece_of_part(part: Part, layer_height_mm: float) -> Workpiece:
    """Take a part of the user's; what is exact is found by the slicers' consensus."""
    timed = layer_heights(part, layer_height_mm)
    every = np.unique(np.linspace(0, len(timed) - 1, min(len(timed), ACCURACY_LAYERS)).round().astype(int))
    return Workpiece(part, timed[every], timed, f"{part.name}, {len(part.faces)} facets")


def workpiece_of_model(model: Model, mesh_tolerance_mm: float, layer_height_mm: float) -> Workpiece:
    """Take a reference model: what is exact is known."""
    low, high = model.bounds[:, 2].tolist()
    layers = min(max(1, round((high - low) / layer_height_mm)), ACCURACY_LAYERS)
    truth = truth_of(model, mesh_tolerance_mm, layers)
    timed = layer_heights(truth.part, layer_height_mm)
    title = f"model {model.name} within {mesh_tolerance_mm:g} mm, {len(truth.part.faces)} facets"
    return Workpiece(truth.part, truth.heights, timed, title, truth)


def try_backends(
    workpiece: Workpiece,
    config: Config,
    repeats: int = REPEATS,
    note: Callable[[str], None] = lambda text: None,
) -> list[Trial]:
    """Try every installed backend, or those that the settings name (``slicing.backends``).

    Parameters
    ----------
    workpiece
        What to slice.
    config
        Settings of the backends, limits of their processes, tolerance of the comparison.
    repeats
        Timed runs of each backend, one at a time.
    note
        Called with a line for each backend begun.

    Returns
    -------
    list of Trial
        By name; none raises. A backend has a fault where it is outvoted by the others on a layer, or on a
        model leaves the exact section by more than its bound and the mesh allow.
    """
    limits = Limits(config.slicing.time_limit_s, config.slicing.memory_limit_mb)
    trials: dict[str, Trial] = {}
    settings: dict[str, BackendSettings] = {}
    for name in config.slicing.backends or registry.house_slicers():
        slicer = registry.slicer(name)
        probe = registry.probe(name)
        why = "" if probe.available else f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}"
        trials[name] = Trial(
            name, slicer.exact, slicer.priority, probe.available, why,
            device=probe.device, versions=dict(probe.versions),
        )  # fmt: skip
        if probe.available:
            settings[name] = registry.slicer_settings(name, config.slicing.settings.get(name, {}))
    note(f"accuracy of {', '.join(settings)}")
    with scratch_folder() as folder:
        outcomes = slice_all(workpiece.part, workpiece.judged, settings, folder, limits)
        comparison = _comparison(workpiece, config, outcomes)
        for name, outcome in outcomes.items():
            if outcome.file is None:
                trials[name] = replace(trials[name], why=f"{outcome.failure}: {outcome.why}")
                continue
            note(f"speed of {name}")
            seconds, failure = _seconds(workpiece, name, settings[name], limits, repeats)
            trials[name] = replace(
                trials[name],
                why=failure or _fault(workpiece, outcome, comparison),
                bound_mm=outcome.error_bound_mm,
                measured_mm=_measured_mm(name, outcomes, comparison),
                seconds=seconds,
                device=outcome.probe.device,
            )
    return [trials[name] for name in sorted(trials)]


def _seconds(
    workpiece: Workpiece, name: str, settings: BackendSettings, limits: Limits, repeats: int
) -> tuple[float, str]:
    """Median time of a backend on the whole stack, alone on the machine, and why there is none."""
    times = []
    for _ in range(repeats):
        with scratch_folder() as folder:
            outcome = slice_all(workpiece.part, workpiece.timed, {name: settings}, folder, limits)[name]
        if outcome.file is None:
            return float("nan"), f"{outcome.failure}: {outcome.why}"
        times.append(outcome.prepare_s + outcome.slice_s)
    return median(times), ""


def _comparison(workpiece: Workpiece, config: Config, outcomes: Mapping[str, Outcome]) -> Comparison:
    done = {name: o for name, o in outcomes.items() if o.file is not None}
    stacks = {name: outcome.read() for name, outcome in done.items()}
    return compared_layers(stacks, workpiece.part, bounds_of(done), config, count_evidence=False)


def _reference(outcomes: Mapping[str, Outcome]) -> str:
    """The exact backend of the highest priority that sliced the part."""
    exact = [n for n, o in outcomes.items() if o.file is not None and registry.slicer(n).exact]
    return max(exact, key=lambda n: (registry.slicer(n).priority, n), default="")


def _measured_mm(name: str, outcomes: Mapping[str, Outcome], comparison: Comparison) -> float:
    """Greatest depth against the reference on the layers that both have a rule for; NaN where there is none."""
    reference = _reference(outcomes)
    if name == reference:
        return 0.0
    pairs: Any = comparison.pairs
    if not len(pairs):
        return float("nan")
    both = pairs["a"].isin((name, reference)) & pairs["b"].isin((name, reference)) & pairs["gated"]
    depth = pairs.loc[both, "depth_mm"]
    return float(depth.max()) if len(depth) else float("nan")


def _fault(workpiece: Workpiece, outcome: Outcome, comparison: Comparison) -> str:
    """What is wrong with a backend's layers, with the first place; empty if nothing."""
    if workpiece.truth is not None:
        measured = measure_outcome(workpiece.truth, outcome)
        beyond = [k for k, by in enumerate(measured.columns["beyond_bound_mm"]) if by > 0.0]
        if beyond:
            first = {name: column[beyond[0]] for name, column in measured.columns.items()}
            return (
                f"{len(beyond)} layers beyond its bound, first at z = {first['z_mm']:g} mm: "
                f"depth {first['depth_mm']:g} mm"
            )
    against = [f for f in comparison.findings if f.backend == outcome.name and f.against != "part"]
    if against:
        f = against[0]
        layers = len({finding.layer for finding in against})
        return (
            f"outvoted on {layers} layers, first by {f.against} at z = {f.height_mm:g} mm: "
            f"{f.metric} {f.value:.4g} over {f.limit:.4g}"
        )
    return ""

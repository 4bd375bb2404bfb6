"""Which slicers suit this machine: accuracy and speed of each on a part, a choice by stated rules, and the machine's section of the
settings file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from ebamcheck import __version__
from ebamcheck.accuracy.measurement import Truth, measure_outcome, truth_of
from ebamcheck.atomic_file import regular_file, replacing
from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import Comparison
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import plain
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import layer_heights
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline.cross_check import compared_layers
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import Model
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Limits, Outcome, bounds_of, slice_all

ACCURACY_LAYERS = 48  # layers on which accuracy is judged: the exact sections of a model are dense
REPEATS = 3  # timed runs of each backend, after one that warms caches; their median counts


@dataclass(frozen=True)
class Workpiece:
    """What the slicers are tried on."""

    part: Part  # as placed
    judged: Floats  # heights on which accuracy, and on which speed is judged
    timed: Floats
    title: str
    truth: Truth | None = None  # exact sections at the judged heights, of a reference model


@dataclass(frozen=True)
class Trial:
    """Result of one backend; lengths in mm, times in seconds."""

    name: str
    exact: bool
    priority: int
    available: bool
    why: str = ""  # why it is not available or did not slice the part, or what its layers have wrong; empty if nothing
    bound_mm: float = float("nan")
    # Depth of the symmetric difference with the exact section of the mesh, at most
    measured_mm: float = float("nan")
    seconds: float = float("nan")  # to prepare the part and slice the whole stack, median
    device: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


def workpiece_of_part(part: Part, layer_height_mm: float) -> Workpiece:
    """Take a part of the user's; the slicers' consensus stands for its exact sections."""
    timed = layer_heights(part, layer_height_mm)
    every = np.unique(np.linspace(0, len(timed) - 1, min(len(timed), ACCURACY_LAYERS)).round().astype(int))
    return Workpiece(part, timed[every], timed, f"{part.name}, {len(part.faces)} facets")


def workpiece_of_model(model: Model, mesh_tolerance_mm: float, layer_height_mm: float) -> Workpiece:
    """Take a reference model, whose exact sections are known."""
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
    """Try ``slicing.backends``, else every installed backend of priority 0 or more; trials are sorted by name, and none raises.

    A backend is at fault if a layer is outvoted, or, on a model, deviates from the exact section by more than bound and mesh allow.
    """
    limits = Limits(config.slicing.time_limit_s, config.slicing.memory_limit_mb)
    trials: dict[str, Trial] = {}
    settings: dict[str, BackendSettings] = {}
    for name in config.slicing.backends or registry.house_slicers():
        slicer = registry.slicer(name)
        probe = registry.probe(name)
        why = "" if probe.available else f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}"
        trial = Trial(name, slicer.exact, slicer.priority, probe.available, why)
        trials[name] = replace(trial, device=probe.device, versions=dict(probe.versions))
        if probe.available:
            settings[name] = registry.slicer_settings(name, config.slicing.settings.get(name, {}))
    note(f"accuracy of {', '.join(settings)}")
    with scratch_folder() as folder:
        outcomes = slice_all(workpiece.part, workpiece.judged, settings, folder, limits)
        done = {name: outcome for name, outcome in outcomes.items() if outcome.file is not None}
        stacks = {name: outcome.read() for name, outcome in done.items()}
        comparison = compared_layers(stacks, workpiece.part, bounds_of(done), config, count_evidence=False)
        exact = [name for name in done if registry.slicer(name).exact]
        reference = max(exact, key=lambda name: (registry.slicer(name).priority, name), default="")
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
                measured_mm=_measured_mm(name, reference, comparison),
                seconds=seconds,
                device=outcome.probe.device,
            )
    return [trials[name] for name in sorted(trials)]


def _seconds(
    workpiece: Workpiece, name: str, settings: BackendSettings, limits: Limits, repeats: int
) -> tuple[float, str]:
    times = []
    for _ in range(repeats):
        with scratch_folder() as folder:
            outcome = slice_all(workpiece.part, workpiece.timed, {name: settings}, folder, limits)[name]
        if outcome.file is None:
            return float("nan"), f"{outcome.failure}: {outcome.why}"
        times.append(outcome.prepare_s + outcome.slice_s)
    return median(times), ""


def _measured_mm(name: str, reference: str, comparison: Comparison) -> float:
    """Greatest depth against the reference on the layers that both have a rule for; NaN where there is none."""
    pairs: Any = comparison.pairs
    if name == reference or not len(pairs):
        return 0.0 if name == reference else float("nan")
    both = pairs["a"].isin((name, reference)) & pairs["b"].isin((name, reference)) & pairs["gated"]
    return float(pairs.loc[both, "depth_mm"].max())


def _fault(workpiece: Workpiece, outcome: Outcome, comparison: Comparison) -> str:
    if workpiece.truth is not None:
        measured = measure_outcome(workpiece.truth, outcome)
        beyond = [k for k, by in enumerate(measured.columns["beyond_bound_mm"]) if by > 0.0]
        if beyond:
            z_mm, depth_mm = (measured.columns[name][beyond[0]] for name in ("z_mm", "depth_mm"))
            return f"{len(beyond)} layers beyond its bound, first at z = {z_mm:g} mm: depth {depth_mm:g} mm"
    against = [f for f in comparison.findings if f.backend == outcome.name and f.against != "part"]
    if not against:
        return ""
    f, layers = against[0], len({finding.layer for finding in against})
    where = f"outvoted on {layers} layers, first by {f.against} at z = {f.height_mm:g} mm"
    return f"{where}: {f.metric} {f.value:.4g} over {f.limit:.4g}"


# Times that differ by less than this share of the shorter are a tie: runs differ by as much from each other.
TIE_SHARE = 0.1
RULES = (
    "A slicer must be available and slice the part without a fault; its bound and its measured error must meet the "
    "tolerance; of those left the fastest is primary. Times within 10 % are a tie, which goes by priority, then by "
    "name. The next one is required, too: agreement takes two."
)


@dataclass(frozen=True)
class Choice:
    """What was chosen, and why."""

    primary: str  # empty where no slicer is fit
    witness: str  # the slicer that the primary is held against; empty where none is left
    reasons: Mapping[str, str]

    @property
    def required(self) -> tuple[str, ...]:
        """Slicers that a run on this machine must have."""
        return tuple(name for name in (self.primary, self.witness) if name)


def choose(trials: Sequence[Trial], tolerance_mm: float) -> Choice:
    """Choose by :data:`RULES`.

    >>> quick = Trial("quick", False, 1, True, bound_mm=0.2, measured_mm=0.1, seconds=1.0)
    >>> sound = Trial("sound", True, 9, True, bound_mm=0.0, measured_mm=0.0, seconds=5.0)
    >>> choose([quick, sound], tolerance_mm=0.1).reasons["quick"]
    'its bound of 0.2 mm is over the tolerance of 0.1 mm'
    """
    reasons = {trial.name: unfit(trial, tolerance_mm) for trial in trials}
    fit = ranked([trial for trial in trials if not reasons[trial.name]])
    if not fit:
        return Choice("", "", reasons)
    best, *rest = fit
    tied = [trial.name for trial in rest if trial.seconds <= (1.0 + TIE_SHARE) * best.seconds]
    among = f", of the highest priority among those as fast ({', '.join(tied)})" if tied else ""
    reasons[best.name] = f"primary: the fastest that meets the tolerance{among}"
    for trial in rest:
        slower = f"{trial.seconds:.3g} s against {best.seconds:.3g} s of {best.name}"
        is_next = trial is rest[0]
        reasons[trial.name] = f"witness: the next after {best.name} ({slower})" if is_next else f"not needed: {slower}"
    return Choice(best.name, rest[0].name if rest else "", reasons)


def unfit(trial: Trial, tolerance_mm: float) -> str:
    """Why a slicer cannot be chosen; empty where it can."""
    if not trial.available:
        return f"it is not available: {trial.why}"
    if trial.why:
        return trial.why
    for what, value in (("bound", trial.bound_mm), ("measured error", trial.measured_mm)):
        if value != value:
            return f"its {what} is not known: there is no layer on which it can be judged"
        if value > tolerance_mm:
            return f"its {what} of {value:.4g} mm is over the tolerance of {tolerance_mm:g} mm"
    return ""


def ranked(trials: Sequence[Trial]) -> list[Trial]:
    """Fastest first; from those that tie with the fastest left, the one of the highest priority."""
    left, order = list(trials), list[Trial]()
    while left:
        most_s = (1.0 + TIE_SHARE) * min(trial.seconds for trial in left)
        tied = (trial for trial in left if trial.seconds <= most_s)
        order.append(min(tied, key=lambda trial: (-trial.priority, trial.name)))
        left.remove(order[-1])
    return order


def write_choice(
    path: Path, machine: str, choice: Choice, trials: Sequence[Trial], circumstances: Mapping[str, Any]
) -> None:
    """Write ``[machines."NAME"]`` with primary, required and provenance into a settings file, whole or not at all; all other
    sections stay.

    In a ``pyproject.toml`` it goes under ``[tool.ebamcheck]``. `circumstances` are part, layers and tolerance of the trials.
    """
    document = _read(path)
    root: Any = document
    keys = ["tool", "ebamcheck"] if path.name == "pyproject.toml" else []
    for key in [*keys, "machines"]:
        root = _table(root, key, path, is_super=True)
    section = _table(root, machine, path)
    section["primary"] = choice.primary
    section["required"] = list(choice.required)
    section["provenance"] = provenance(choice, trials, circumstances)
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="")


def provenance(choice: Choice, trials: Sequence[Trial], circumstances: Mapping[str, Any]) -> dict[str, Any]:
    """What the choice rests on, without a date: circumstances, and figures and versions of every backend."""
    backends: dict[str, dict[str, Any]] = {}
    for trial in trials:
        told: dict[str, Any] = {"reason": choice.reasons[trial.name], "device": trial.device}
        figures = {name: getattr(trial, name) for name in ("bound_mm", "measured_mm", "seconds")}
        # Four digits: provenance, not input.
        known = {name: float(f"{value:.4g}") for name, value in figures.items() if value == value}
        backends[trial.name] = {**told, "versions": dict(trial.versions), **known}
    made: dict[str, Any] = plain({"ebamcheck": __version__, **circumstances, "backends": backends})
    return made


def _read(path: Path) -> tomlkit.TOMLDocument:
    if not path.exists():
        return tomlkit.document()
    try:
        # Line ends as they are: the user's file stays theirs but for one section.
        return tomlkit.parse(regular_file(path, SettingsError).read_bytes().decode("utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, TOMLKitError) as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None


def _table(parent: Any, key: str, path: Path, is_super: bool = False) -> Any:
    if key not in parent:
        parent[key] = tomlkit.table(is_super)
    found = parent[key]
    if not isinstance(found, Table | tomlkit.container.OutOfOrderTableProxy):
        what = "must be a table, as in [machines.NAME]: rename what stands there"
        raise SettingsError(f"{path}: {key!r} {what}")
    return found

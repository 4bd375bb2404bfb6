"""One regression report: measure, hold against the baselines, keep the history."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ebamcheck import __version__
from ebamcheck.accuracy.baselines import (  # fmt: skip
    FORMAT_VERSION,
    STORED,
    Difference,
    Entry,
    Key,
    UpdateMode,
    differences,
    read_baselines,
    write_baselines,
)
from ebamcheck.accuracy.matrix import Case, Matrix, Subject, Tolerances, chosen_models, read_matrix, rounds
from ebamcheck.accuracy.measurement import Truth, measure_outcome, truth_of
from ebamcheck.errors import BackendMissing, ExitCode, SettingsError
from ebamcheck.plugins import registry
from ebamcheck.plugins.model import models as installed_models
from ebamcheck.scratch import scratch_folder
from ebamcheck.slicers.isolation import Limits, Outcome, slice_all

CHECKOUT_BASELINES = Path("reports", "baselines")

UPDATED_BY_FAILED = ("worse", "new", "vanished")  # by ``--update-baseline=failed``

Note = Callable[[str], None]


@dataclass(frozen=True)
class Regression:
    """What a report came to."""

    baselines: Path
    entries: Mapping[Key, Entry]
    held: Mapping[Key, Entry]  # baselines of the models and backends asked for
    differences: Sequence[Difference]
    tolerances: Tolerances
    timings: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Seconds by entry; they stand in ``timings.json`` and nowhere else."""

    @property
    def compared(self) -> int:
        """Entries that were held against a baseline."""
        return sum(d.verdict in ("same", "worse", "better") for d in self.differences)

    @property
    def exit_code(self) -> ExitCode:
        """1 where something got worse, 5 where nothing could be compared, else 0."""
        if any(d.fails for d in self.differences):
            return ExitCode.OUT_OF_TOLERANCE
        return ExitCode.PASS if self.compared else ExitCode.NOTHING_COMPARED

    def record(self) -> dict[str, Any]:
        """The report as strict JSON holds it: everything but timings."""
        return {
            "format": FORMAT_VERSION,
            "ebamcheck": __version__,
            "exit_code": int(self.exit_code),
            "compared": self.compared,
            "differences": [difference.record() for difference in self.differences],
            "entries": [
                {"model": e.key.model, "settings_hash": e.key.settings_hash, **e.record()}
                for e in self.entries.values()
            ],
        }


def run_regression(
    folder: Path,
    models: Sequence[str] = (),
    backends: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    limits: Limits | None = None,
    note: Note = lambda text: None,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Regression:
    """Measure models x backends x settings and hold them against the baselines of a folder; where these are missing every entry is new.

    Without names: every model of every day and every backend that is available. `note` gets a line for each model begun, each backend left out
    and each that is measured under other `settings`, which go on top of those of the matrix and are held against the same baselines.
    """
    matrix = read_matrix(folder)
    chosen = chosen_models(matrix, models)
    usable, not_run = _usable(backends)
    for name, why in not_run.items():
        note(f"backend {name} is left out: {why}")
    given = {name: values for name, values in (settings or {}).items() if values}
    for name, values in given.items():
        registry.slicer_settings(name, values)
        if name in usable:
            told = ", ".join(f"{key} = {value}" for key, value in values.items())
            note(
                f"backend {name} runs with {told}, and is held against the baselines of its settings in the matrix"
            )
    entries: dict[Key, Entry] = {}
    timings: dict[str, Mapping[str, float]] = {}
    for name, model in chosen.items():
        note(f"model {name}")
        truth = truth_of(model, matrix.case(name).tolerance_mm, matrix.case(name).layers)
        for entry, seconds in _measure(name, truth, matrix, usable, limits or Limits(), given):
            entries[entry.key] = entry
            timings[str(entry.key)] = seconds
    held = {
        key: entry
        for key, entry in read_baselines(folder, _models_held(folder, chosen, models)).items()
        if not backends or key.backend in backends
    }
    found = differences(entries, held, not_run, tolerances or Tolerances())
    ordered = {key: entries[key] for key in sorted(entries)}
    return Regression(folder, ordered, held, found, tolerances or Tolerances(), timings)


def _usable(names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    if names:
        return [registry.available_slicer(name).name for name in dict.fromkeys(names)], {}
    usable, not_run = [], {}
    for name in registry.house_slicers():
        probe = registry.probe(name)
        if probe.available:
            usable.append(name)
        else:
            not_run[name] = f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}"
    if not usable:
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    return usable, not_run


def _models_held(folder: Path, chosen: Mapping[str, object], named: Sequence[str]) -> list[str]:
    """Models whose baselines count: those chosen; without a choice those no longer installed, too."""
    if named or not folder.is_dir():
        return list(chosen)
    installed = installed_models()
    return [*chosen, *(path.stem for path in sorted(folder.glob("*.json")) if path.stem not in installed)]


def _measure(
    model: str,
    truth: Truth,
    matrix: Matrix,
    backends: Sequence[str],
    limits: Limits,
    given: Mapping[str, Mapping[str, Any]],
) -> list[tuple[Entry, Mapping[str, float]]]:
    case = matrix.case(model)
    found: list[tuple[Entry, Mapping[str, float]]] = []
    for subjects in rounds(matrix, model, backends):
        settings = {
            name: registry.slicer_settings(name, {**subject.given, **given.get(name, {})})
            for name, subject in subjects.items()
        }
        with scratch_folder() as folder:
            outcomes = slice_all(truth.part, truth.heights, settings, folder, limits)
            for name, subject in subjects.items():
                start = time.perf_counter()
                entry = _entry(model, truth, case, subject, outcomes[name])
                seconds = {
                    "prepare_s": outcomes[name].prepare_s,
                    "slice_s": outcomes[name].slice_s,
                    "measure_s": time.perf_counter() - start,
                }
                found.append((entry, seconds))
    return found


def _entry(model: str, truth: Truth, case: Case, subject: Subject, outcome: Outcome) -> Entry:
    key = Key(model, subject.backend, subject.settings_hash(case))
    metadata = {
        "case": case.model_dump(),
        "facets": len(truth.part.faces),
        "mesh_sha256": truth.part.sha256,
        "machine": f"{platform.system()} {platform.machine()}",
        "renderer": outcome.probe.device,
        "versions": {"ebamcheck": __version__, "python": platform.python_version(), **outcome.probe.versions},
    }
    return Entry(key, subject.given, measure_outcome(truth, outcome), metadata)


def updated(regression: Regression, mode: UpdateMode) -> list[Path]:
    """Write the baselines anew: those that failed, are new or vanished, or all that were measured; returns the files that changed.

    Crashes and entries that could not run here stay as they were.
    """
    verdicts = {d.key: d.verdict for d in regression.differences}
    touched = [
        key
        for key, verdict in verdicts.items()
        if verdict in UPDATED_BY_FAILED or (mode == "all" and verdict in ("same", "better"))
    ]
    files = sorted({key.model for key in touched})
    stored = read_baselines(regression.baselines, files)
    for key in touched:
        entry = regression.entries.get(key)
        if entry is None:
            stored.pop(key, None)
        elif entry.measured.status in STORED:
            stored[key] = entry
    return write_baselines(regression.baselines, stored.values(), files)


def accepted(regression: Regression) -> Regression:
    """Return the report once its differences are accepted as the new baselines; failures stay."""
    kept = [
        replace(d, verdict="same") if d.verdict in UPDATED_BY_FAILED or d.verdict == "better" else d
        for d in regression.differences
    ]
    return replace(regression, differences=kept)


def default_baselines(given: Path | None, setting: str) -> Path:
    """Folder of the baselines: the one given, the one set, or ``reports/baselines`` of a checkout."""
    if given is not None:
        return given
    if setting:
        return Path(setting)
    for folder in (Path.cwd(), *Path.cwd().parents):
        if (folder / CHECKOUT_BASELINES).is_dir():
            return folder / CHECKOUT_BASELINES
    raise SettingsError(
        f"there is no {CHECKOUT_BASELINES} here or above: name the folder of the baselines with --baselines"
    )

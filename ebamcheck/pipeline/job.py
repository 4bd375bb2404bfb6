"""One run from part to program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ebamcheck import __version__, inspection, layer_files, mesh_files, registry
from ebamcheck.backend import BackendSettings
from ebamcheck.comparison import Comparison, compare_all
from ebamcheck.config import Config
from ebamcheck.errors import BackendMissing, ExitCode, SettingsError
from ebamcheck.heights import checked_heights, layer_heights
from ebamcheck.isolate import Limits, Outcome, slice_all
from ebamcheck.layers import Layers
from ebamcheck.part import Part
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.gates import Gate
from ebamcheck.pipeline.programming import make_program
from ebamcheck.pipeline.record import manifest as make_manifest
from ebamcheck.pipeline.work import Job, Observer, Silent
from ebamcheck.rings import Floats
from ebamcheck.store import FINGERPRINT, MANIFEST, RunFolder, sha256_of_json, start_run, write_json


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    folder: RunFolder
    gates: tuple[Gate, ...]
    exit_code: ExitCode
    manifest: Mapping[str, Any]


def run_job(
    part_path: str | Path,
    target: str | Path,
    config: Config | None = None,
    reference: str | Path | None = None,
    resume: bool = False,
    observer: Observer | None = None,
) -> RunResult:
    """Slice a part with every backend, compare, fit, partition, order, write the program and verify it.

    Parameters
    ----------
    part_path
        Mesh file of the part.
    target
        Run folder to make; it appears when it is whole, and takes the place of a former run.
    config
        Settings; the defaults if None.
    reference
        A finer tessellation of the same part, against which the errors of contours and curves are measured.
    resume
        Go on with what a killed run of the same part and settings left behind.
    observer
        Told of stages and progress.

    Raises
    ------
    InputError, SettingsError
        If the part or the reference cannot be read, or settings make no sense.
    BackendMissing
        If a required or named backend is unknown, or a required one is not available.
    """
    config, observer = config or Config(), observer or Silent()
    part, found = _placed_part(part_path, config, observer)
    fine = mesh_files.load(reference, config.part.units).along(config.part.direction) if reference else None
    heights = _heights(part, config)
    names = _backends(config, observer)
    backends = {n: registry.slicer_settings(n, config.slicing.settings.get(n, {})) for n in names}
    fingerprint = sha256_of_json(
        [part.sha256, config.model_dump(), heights, names, __version__, fine.sha256 if fine else ""]
    )
    job = Job(config, observer, part, found, heights, start_run(Path(target), fingerprint, resume))
    try:
        return _run(job, backends, fine, resume)
    except OSError as error:
        raise SettingsError(f"{job.folder.path}: cannot be written: {error.strerror or error}") from error
    finally:
        job.folder.release()


# -- stages ------------------------------------------------------------------------------------------


def _run(job: Job, backends: Mapping[str, BackendSettings], fine: Part | None, resume: bool) -> RunResult:
    """All stages from slicing to the finished folder."""
    outcomes = _slice(job, backends, resume) | _unavailable(job.config)
    stacks = {n: o.layers for n, o in outcomes.items() if o.layers is not None}
    comparison = _compare(job, stacks, outcomes)
    shut = [gates.input_gate(job.found), gates.agreement_gate(comparison, outcomes, len(job.heights))]
    primary = _primary(job.config, stacks)
    if primary:
        shut += make_program(job, primary, stacks, fine, validated_so_far=all(g.passed for g in shut))
    code = gates.exit_code(shut, comparison.compared_layers, outcomes)
    manifest = make_manifest(job, outcomes, comparison, shut, primary, code)
    write_json(manifest, job.folder.path / MANIFEST)
    _write_reports(job)
    (job.folder.path / FINGERPRINT).unlink()
    return RunResult(job.folder.finish(), tuple(shut), code, manifest)


def _placed_part(path: str | Path, config: Config, observer: Observer) -> tuple[Part, inspection.Inspection]:
    """Read, mend if asked to, turn and inspect the part."""
    part = mesh_files.load(path, config.part.units)
    if config.part.fix_orientation:
        part, turned = inspection.fix_orientation(part)
        if turned:
            observer.note(f"{turned} of {len(part.faces)} facets were turned over (fix_orientation)")
    part = part.along(config.part.direction)
    return part, inspection.inspect(part)


def _heights(part: Part, config: Config) -> Floats:
    if config.layers.heights_mm:
        heights = checked_heights(config.layers.heights_mm)
        if (np.diff(heights) <= 0).any():
            raise SettingsError("layers.heights_mm must rise from layer to layer: sort them and drop repeats")
        return heights
    return layer_heights(part, config.layer_height_mm)


def _backends(config: Config, observer: Observer) -> list[str]:
    """Names of the backends to run: those asked for, or all that are available."""
    for name in config.slicing.required:
        registry.available_slicer(name)
    for name in config.slicing.settings:
        registry.slicer(name)
    if config.slicing.primary:
        registry.available_slicer(config.slicing.primary)
    if config.slicing.backends:
        left_out = [
            n
            for n in (config.slicing.primary, *config.slicing.required)
            if n and n not in config.slicing.backends
        ]
        if left_out:
            raise SettingsError(
                f"slicing.backends {', '.join(config.slicing.backends)} leaves out {left_out[0]!r}, "
                "which slicing.primary or slicing.required names"
            )
        return [registry.slicer(name).name for name in dict.fromkeys(config.slicing.backends)]
    usable = []
    for name in registry.slicers():
        probe = registry.probe(name)
        if probe.available:
            usable.append(name)
        else:
            observer.note(
                f"backend {name} is not available: {probe.why}{f'; {probe.hint}' if probe.hint else ''}"
            )
    if not usable:
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    return usable


def _unavailable(config: Config) -> dict[str, Outcome]:
    """The backends that would have run if this machine had what they need."""
    if config.slicing.backends:
        return {}
    probes = {name: registry.probe(name) for name in registry.slicers()}
    return {
        name: Outcome(
            name, "unavailable", f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}", probe=probe
        )
        for name, probe in probes.items()
        if not probe.available
    }


def _slice(job: Job, backends: Mapping[str, BackendSettings], resume: bool) -> dict[str, Outcome]:
    """Slice with every backend, each in its own process; results are on disk as they come in."""
    limits = Limits(job.config.slicing.time_limit_s, job.config.slicing.memory_limit_mb)
    kept: dict[str, Outcome] = {}
    for name, settings in backends.items():
        if resume and job.folder.layers_file(name).is_file():
            slicer = registry.slicer(name)
            kept[name] = Outcome(
                name,
                layers=job.folder.read_layers(name),
                probe=registry.probe(name),
                error_bound_mm=slicer.error_bound_mm(job.part, settings),
                height_bound_mm=slicer.height_bound_mm(job.part, settings),
            )
            job.observer.note(f"{name}: layers of the former run are kept")

    def finished(outcome: Outcome) -> None:
        if outcome.layers is not None:
            layer_files.write_parquet(outcome.layers, job.folder.layers_file(outcome.name))
        else:
            job.observer.note(f"backend {outcome.name} {outcome.failure}: {outcome.why}")

    waiting = {n: s for n, s in backends.items() if n not in kept}
    with job.stage("slice", len(waiting) * len(job.heights)):
        made = slice_all(
            job.part, job.heights, waiting, limits, lambda _, done: job.observer.advance(done), finished
        )
    return {name: kept[name] if name in kept else made[name] for name in backends}


def _compare(job: Job, stacks: Mapping[str, Layers], outcomes: Mapping[str, Outcome]) -> Comparison:
    pairs = len(stacks) * (len(stacks) - 1) // 2
    with job.stage("compare", pairs * len(job.heights)):
        comparison = compare_all(
            stacks,
            job.part,
            bounds={n: (outcomes[n].error_bound_mm, outcomes[n].height_bound_mm) for n in stacks},
            exact={n: registry.slicer(n).exact for n in stacks},
            rules={n: registry.slicer(n).coplanar_rule for n in stacks},
            settings=job.config.comparison,
            progress=job.observer.advance,
        )
        comparison.pairs.to_parquet(job.folder.path / "compare.parquet", index=False)
        comparison.pairs.to_csv(job.folder.path / "compare.csv", index=False)
        _layer_table(stacks, comparison).to_csv(job.folder.path / "layers.csv", index=False)
    return comparison


def _layer_table(stacks: Mapping[str, Layers], comparison: Comparison) -> pd.DataFrame:
    """One row a layer: class, verdict, and area and rings of every backend."""
    table = comparison.layers.copy()
    for name, layers in stacks.items():
        table[f"area_mm2_{name}"] = layers.areas()
        table[f"rings_{name}"] = layers.ring_counts()
        table[f"open_paths_{name}"] = layers.open_counts()
    return table


def _primary(config: Config, stacks: Mapping[str, Layers]) -> str:
    """Backend whose contours go on: the one set, else the exact one of the highest priority that has some."""
    if config.slicing.primary in stacks:
        return config.slicing.primary if stacks[config.slicing.primary].closed.any() else ""
    ranked = sorted(stacks, key=lambda n: (registry.slicer(n).exact, registry.slicer(n).priority, n))
    return ranked[-1] if ranked and stacks[ranked[-1]].closed.any() else ""


def _write_reports(job: Job) -> None:
    """Let every installed report writer render the run; a broken one is a note, not the end."""
    for name, write in registry.load_plugins(registry.REPORTS).items():
        try:
            write(RunFolder(job.folder.path))
        except Exception as error:
            job.observer.note(f"report writer {name!r} failed: {type(error).__name__}: {error}")

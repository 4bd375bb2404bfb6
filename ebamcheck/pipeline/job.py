"""One run from part to program."""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd

from ebamcheck import __version__, inspection, layer_files, mesh_files, registry
from ebamcheck.comparison import Comparison, compare_all
from ebamcheck.config import Config
from ebamcheck.curves import Curves, contour_error, error_reduction, fit, fit_deviation
from ebamcheck.errors import BackendMissing, ExitCode, NothingCompared, SettingsError
from ebamcheck.heights import checked_heights, layer_heights
from ebamcheck.isolate import Limits, Outcome, slice_all
from ebamcheck.layers import Layers, from_polygons
from ebamcheck.part import Part
from ebamcheck.pipeline import gates
from ebamcheck.pipeline.gates import Gate
from ebamcheck.program import (
    Check,
    mark_validated,
    program_summary,
    read_program,
    verify_program,
    write_program,
)
from ebamcheck.rings import Floats
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.store import (
    FORMAT_VERSION,
    MANIFEST,
    RunFolder,
    RunInProgress,
    sha256_of_json,
    start_run,
    write_json,
)


TOTALS = ("motions", "contour_mm", "hatch_mm", "travel_mm", "deposit_s", "travel_s", "wire_mm", "wire_kg")
"""Columns of the program's summary that add up over the layers."""


class Observer(Protocol):
    """Whoever watches a run."""

    def stage(self, name: str, total: int) -> None:
        """Tell that a stage of `total` steps begins."""

    def advance(self, steps: int) -> None:
        """Tell that steps of the stage are done."""

    def note(self, text: str) -> None:
        """Tell something worth a line."""


class _Silent:
    def stage(self, name: str, total: int) -> None:
        """Ignore it."""

    def advance(self, steps: int) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    folder: RunFolder
    gates: tuple[Gate, ...]
    exit_code: ExitCode
    manifest: Mapping[str, Any]


@dataclass
class _Job:
    """A run in progress: its parts as they come to be."""

    config: Config
    observer: Observer
    part: Part
    found: inspection.Inspection
    heights: Floats
    folder: RunInProgress
    timings: dict[str, float] = field(default_factory=dict)
    record: dict[str, Any] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[None]:
        """Time a stage and tell the observer of it."""
        self.observer.stage(name, total)
        start = time.perf_counter()
        yield
        self.timings[name] = time.perf_counter() - start


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
    config, observer = config or Config(), observer or _Silent()
    part, found = _placed_part(part_path, config, observer)
    fine = mesh_files.load(reference, config.part.units).along(config.part.direction) if reference else None
    heights = _heights(part, config)
    names = _backends(config, observer)
    backends = {n: registry.slicer_settings(n, config.slicing.settings.get(n, {})) for n in names}
    fingerprint = sha256_of_json(
        [part.sha256, config.model_dump(), heights, names, __version__, fine.sha256 if fine else ""]
    )
    job = _Job(config, observer, part, found, heights, start_run(Path(target), fingerprint, resume))
    outcomes = _slice(job, backends, resume)
    stacks = {n: o.layers for n, o in outcomes.items() if o.layers is not None}
    comparison = _compare(job, stacks, outcomes)
    shut = [gates.input_gate(found), gates.agreement_gate(comparison, outcomes, len(heights))]
    primary = _primary(config, stacks)
    if primary:
        shut += _make_program(job, primary, stacks, fine, validated_so_far=all(g.passed for g in shut))
    code = gates.exit_code(shut, comparison.compared_layers, outcomes)
    manifest = _manifest(job, outcomes, comparison, shut, primary, code)
    write_json(manifest, job.folder.path / MANIFEST)
    _write_reports(job)
    (job.folder.path / "fingerprint").unlink()
    return RunResult(job.folder.finish(), tuple(shut), code, manifest)


# -- stages ------------------------------------------------------------------------------------------


def _placed_part(path: str | Path, config: Config, observer: Observer) -> tuple[Part, inspection.Inspection]:
    """Read, mend if asked to, turn and inspect the part."""
    part = mesh_files.load(path, config.part.units)
    for note in part.notes:
        observer.note(note)
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


def _slice(job: _Job, backends: Mapping[str, Any], resume: bool) -> dict[str, Outcome]:
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


def _compare(job: _Job, stacks: Mapping[str, Layers], outcomes: Mapping[str, Outcome]) -> Comparison:
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
        _layer_table(job, stacks, comparison).to_csv(job.folder.path / "layers.csv", index=False)
    return comparison


def _layer_table(job: _Job, stacks: Mapping[str, Layers], comparison: Comparison) -> pd.DataFrame:
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


def _make_program(
    job: _Job, primary: str, stacks: Mapping[str, Layers], fine: Part | None, validated_so_far: bool
) -> list[Gate]:
    """Fit, partition, order, write, read back and verify."""
    config, layers = job.config, stacks[primary]
    deviation = _fit(job, layers, fine)
    with job.stage("partition and order", len(layers)):
        plan = plan_stack(layers, config, progress=job.observer.advance)
        plan.to_parquet(job.folder.path / "scan.parquet")
        plan.metrics.to_csv(job.folder.path / "scan.csv", index=False)
    with job.stage("program", 1):
        beads = _bead_paths(layers, plan, config)
        beads.to_parquet(job.folder.path / "beads.parquet")
        checks = _write_and_verify(job, beads, plan, _witness(primary, stacks))
    made = [
        gates.fit_gate(deviation, config),
        gates.coverage_gate(plan.metrics, config),
        gates.program_gate(checks),
    ]
    job.record["scan"] = {
        "order": config.scan.order,
        "seed": config.scan.seed,
        "islands": len(plan.islands),
        "hatch_mm": float(plan.metrics["hatch_length_mm"].sum()),
        "travel_mm": float(plan.metrics["travel_mm"].sum()),
        "starts": int(plan.metrics["starts"].sum()),
        "time_s": float(plan.metrics["time_s"].sum()),
    }
    if validated_so_far and all(gate.passed for gate in made):
        files = mark_validated(job.record.pop("files"))
    else:
        files = job.record.pop("files")
    job.record["program"]["validated"] = files.validated
    job.record["program"]["files"] = [
        {"name": name, "sha256": files.sha256[name], "blocks": files.blocks[name]} for name in files.names
    ]
    return made


def _fit(job: _Job, layers: Layers, fine: Part | None) -> pd.DataFrame:
    """Fit the contours, measure the fit, and both against the reference where there is one."""
    with job.stage("fit", len(layers)):
        curves = fit(layers, settings=job.config.curves, progress=job.observer.advance)
        curves.to_parquet(job.folder.path / "curves.parquet")
        deviation = fit_deviation(curves, layers)
        deviation.to_csv(job.folder.path / "fit.csv", index=False)
    job.record["fit"] = {
        "method": "paper",
        "blocks": int(curves.block_count()),
        "points": len(layers.points),
        "max_points_mm": float(deviation["points_mm"].max()),
        "max_bulge_mm": float(deviation["bulge_mm"].max()),
    }
    if fine is not None:
        with job.stage("reference", len(layers)):
            job.record["reference"] = _against_reference(job, layers, curves, fine)
    return deviation


def _against_reference(job: _Job, layers: Layers, curves: Curves, fine: Part) -> dict[str, Any]:
    """Errors of contour and curve against the finer tessellation (paper, section 5.2)."""
    from ebamcheck.slicing import slice_part

    truth = slice_part(fine, layers.heights)
    before, after = contour_error(layers, truth), contour_error(curves, truth)
    pd.concat([before.assign(of="contour"), after.assign(of="curve")]).to_csv(
        job.folder.path / "reference.csv", index=False
    )
    figures = ("polar_min_mm", "polar_max_mm", "normal_min_mm", "normal_max_mm")
    return {
        "part": {"source": fine.source, "sha256": fine.source_sha256, "facets": len(fine.faces)},
        "contour": {f: _extreme(before[f], f) for f in figures} | _rms(before),
        "curve": {f: _extreme(after[f], f) for f in figures} | _rms(after),
        "reduction": error_reduction(before, after).to_dict(),
        "unmatched_rings": int(before["unmatched"].sum()),
    }


def _extreme(column: pd.Series[float], name: str) -> float:
    return float(column.min() if "_min_" in name else column.max())


def _rms(errors: pd.DataFrame) -> dict[str, float]:
    """Root mean square over all layers of both errors; NaN where one is defined nowhere."""
    known = {f: errors[f].dropna().to_numpy() for f in ("polar_rms_mm", "normal_rms_mm")}
    return {f: float(np.sqrt((v**2).mean())) if v.size else float("nan") for f, v in known.items()}


def _bead_paths(layers: Layers, plan: ScanPlan, config: Config) -> Curves:
    """Curves along the centre lines of the contour beads."""
    lines = from_polygons(
        layers.heights,
        [[region] for region in plan.contours],
        part=layers.part,
        direction=layers.direction,
        backend=layers.backend,
        settings=layers.settings,
    )
    return fit(lines, settings=config.curves)


def _witness(primary: str, stacks: Mapping[str, Layers]) -> Layers:
    """Contours by another exact method than the one that made the program, where there is one."""
    others = [n for n in stacks if n != primary and registry.slicer(n).exact]
    return stacks[max(others, key=lambda n: registry.slicer(n).priority)] if others else stacks[primary]


def _write_and_verify(job: _Job, beads: Curves, plan: ScanPlan, witness: Layers) -> list[Check]:
    """Write the program, read its text back and check it against what it was made from."""
    header = {
        "PART": job.part.source_sha256 or job.part.sha256,
        "SETTINGS": sha256_of_json(job.config.model_dump()),
    }
    files = write_program(beads, plan, job.config, job.folder.program_folder, header=header)
    program = read_program(files.main, job.config)
    checks = verify_program(
        program, config=job.config, curves=beads, plan=plan, layers=witness, sha256=files.sha256
    )
    summary = program_summary(program, job.config)
    summary.to_csv(job.folder.path / "program.csv", index=False)
    job.record["files"] = files
    job.record["program"] = {
        "checks": [asdict(check) for check in checks],
        "witness": witness.backend,
        "totals": {c: float(summary[c].sum()) for c in TOTALS},
    }
    return checks


# -- the record --------------------------------------------------------------------------------------


def _manifest(
    job: _Job,
    outcomes: Mapping[str, Outcome],
    comparison: Comparison,
    passed: list[Gate],
    primary: str,
    code: ExitCode,
) -> dict[str, Any]:
    config = job.config.model_dump()
    return {
        "format": FORMAT_VERSION,
        "ebamcheck": __version__,
        "python": platform.python_version(),
        "part": {
            "name": job.part.name,
            "source": Path(job.part.source).name,
            "sha256": job.part.source_sha256,
            "mesh_sha256": job.part.sha256,
            "units": job.part.units,
            "direction": list(job.part.direction),
            "inspection": job.found.as_dict(),
        },
        "settings": config,
        "settings_sha256": sha256_of_json(config),
        "heights": {
            "count": len(job.heights),
            "first_mm": float(job.heights[0]),
            "last_mm": float(job.heights[-1]),
            "layer_height_mm": job.config.layer_height_mm,
        },
        "primary": primary,
        "backends": {name: _backend_record(outcome) for name, outcome in outcomes.items()},
        "comparison": {
            "compared_layers": comparison.compared_layers,
            "passed": comparison.passed,
            "verdicts": comparison.layers["verdict"].value_counts().sort_index().to_dict(),
            "classes": comparison.layers["class"].value_counts().sort_index().to_dict(),
            "pairs": _pair_records(comparison.pairs),
            "findings": [asdict(finding) for finding in comparison.findings],
        },
        **job.record,
        "gates": [asdict(gate) for gate in passed],
        "exit_code": int(code),
        "timings": {
            "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "machine": platform.machine(),
            "stages_s": job.timings,
            "backends": {
                name: {"prepare_s": o.prepare_s, "slice_s": o.slice_s, "peak_mb": o.peak_mb}
                for name, o in outcomes.items()
            },
        },
    }


def _backend_record(outcome: Outcome) -> dict[str, Any]:
    slicer, layers = registry.slicer(outcome.name), outcome.layers
    return {
        "status": outcome.failure or "done",
        "why": outcome.why,
        "summary": slicer.summary,
        "exact": slicer.exact,
        "coplanar_rule": slicer.coplanar_rule,
        "inside_rule": slicer.inside_rule,
        "device": outcome.probe.device,
        "versions": dict(outcome.probe.versions),
        "error_bound_mm": outcome.error_bound_mm,
        "height_bound_mm": outcome.height_bound_mm,
        "settings": dict(layers.settings) if layers is not None else {},
        "rings": int(layers.ring_counts().sum()) if layers is not None else 0,
        "open_paths": int(layers.open_counts().sum()) if layers is not None else 0,
        "points": len(layers.points) if layers is not None else 0,
        "file": f"layers/{outcome.name}.parquet" if layers is not None else "",
    }


def _pair_records(pairs: pd.DataFrame) -> list[dict[str, Any]]:
    """One record a pair of backends: the worst figures over its layers."""
    records: list[dict[str, Any]] = []
    if not len(pairs):
        return records
    for (a, b), rows in pairs.groupby(["a", "b"], sort=True):
        gated = rows[rows["gated"]]
        records.append(
            {
                "a": a,
                "b": b,
                "layers": len(rows),
                "gated": len(gated),
                "agree": int(gated["agrees"].sum()),
                "limit_mm": float(rows["limit_mm"].max()),
                "max_depth_mm": float(gated["depth_mm"].max()),
                "max_hausdorff_mm": float(gated["hausdorff_mm"].max()),
                "max_p95_mm": float(np.nanmax(gated[["p95_ab_mm", "p95_ba_mm"]].to_numpy(), initial=0.0)),
                "max_area_difference_mm2": float(gated["area_difference_mm2"].abs().max()),
                "min_iou": float(gated["iou"].min()),
            }
        )
    return records


def _write_reports(job: _Job) -> None:
    """Let every installed report writer render the run; a broken one is a note, not the end."""
    for name, write in registry.load_plugins(registry.REPORTS).items():
        try:
            write(RunFolder(job.folder.path))
        except NothingCompared:
            raise
        except Exception as error:
            job.observer.note(f"report writer {name!r} failed: {type(error).__name__}: {error}")

"""One job from part to report: the cross-check alone, or all the way to the program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ebamcheck import __version__
from ebamcheck.backend import BackendSettings
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.findings import has_fault
from ebamcheck.mesh import files as mesh_files
from ebamcheck.mesh import inspection
from ebamcheck.pipeline import gates, noticed
from ebamcheck.pipeline.certificate import write_certificate
from ebamcheck.pipeline.choice import chosen_backends, primary_backend, unavailable_backends
from ebamcheck.pipeline.cross_check import CrossCheck, cross_check
from ebamcheck.pipeline.gates import Gate
from ebamcheck.pipeline.placement import cut_heights, placed_part
from ebamcheck.pipeline.programming import make_program
from ebamcheck.pipeline.record import manifest as make_manifest
from ebamcheck.pipeline.run_folder import (
    FINGERPRINT,
    MANIFEST,
    RunFolder,
    sha256_of_json,
    start_run,
    write_json,
)
from ebamcheck.pipeline.work import Job, Observer, Silent
from ebamcheck.plugins import registry
from ebamcheck.program.language.dialects import TEXT_CONTROLS
from ebamcheck.program.language.templates import usable_templates
from ebamcheck.program.simulators.heat_paths import PATH_FILES
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import checked_window, outside_window, unusual_layers


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
        If the part or the reference cannot be read, or settings make no sense or are outside of the process window.
    BackendMissing
        If a required or named backend is unknown, or a required one is not available.
    """
    config = config or Config()
    if config.machine.control in PATH_FILES:
        raise SettingsError(
            f"machine.control {config.machine.control!r} is a path file for a heat simulator, which no reader can prove: "
            f"run for a control, then `ebamcheck post RUN --control {config.machine.control} -o FOLDER`"
        )
    checked_window(config)
    if config.machine.control in TEXT_CONTROLS:
        usable_templates(config, config.machine.control)
    fine = mesh_files.load(reference, config.part.units).along(config.part.direction) if reference else None

    def program(job: Job, checked: CrossCheck, sound: bool) -> list[Gate]:
        return make_program(job, _primary(job, checked), checked, fine, sound)

    return _job("run", part_path, target, config, [fine.sha256 if fine else ""], resume, observer, program)


def check_job(
    part_path: str | Path,
    target: str | Path,
    config: Config | None = None,
    resume: bool = False,
    observer: Observer | None = None,
) -> RunResult:
    """Slice a part with every backend and compare them, no more; parameters and errors as in :func:`run_job`."""
    return _job("check", part_path, target, config or Config(), [], resume, observer, None)


# -- stages ------------------------------------------------------------------------------------------


def _job(
    kind: str,
    part_path: str | Path,
    target: str | Path,
    config: Config,
    inputs: list[str],
    resume: bool,
    observer: Observer | None,
    program: Callable[[Job, CrossCheck, bool], list[Gate]] | None,
) -> RunResult:
    """Cross-check a part in a run folder, and make the program where one is wanted."""
    observer = observer or Silent()
    part, turned, facets = placed_part(part_path, config)
    heights = cut_heights(part, config)
    backends = chosen_backends(config)
    fingerprint = sha256_of_json(
        [kind, part.sha256, config.model_dump(), heights, list(backends), __version__, *inputs]
    )
    found = inspection.inspect(part)
    job = Job(kind, config, observer, part, found, heights, start_run(Path(target), fingerprint, resume))
    if turned:
        job.add_finding(noticed.turned_over(turned, facets))
    job.add_finding(*noticed.of_part(found, config))
    # A job without a program may cut layers that no process can lay.
    job.add_finding(*outside_window(config, "warning"), *unusual_layers(config))
    try:
        return _finished(job, backends, resume, program)
    except OSError as error:
        raise SettingsError(f"{job.folder.path}: cannot be written: {error.strerror or error}") from error
    finally:
        job.folder.release()


def _finished(
    job: Job,
    backends: Mapping[str, BackendSettings],
    resume: bool,
    program: Callable[[Job, CrossCheck, bool], list[Gate]] | None,
) -> RunResult:
    """All stages from slicing to the finished folder."""
    checked = cross_check(job, backends, resume)
    outcomes = {**checked.outcomes, **unavailable_backends(job.config)}
    shut = [
        gates.input_gate(job.found),
        gates.agreement_gate(checked.comparison, outcomes, len(job.heights), job.config.layer_height_mm),
    ]
    job.add_finding(*noticed.of_doubt(checked.comparison.pairs, job.config))
    job.add_finding(*(noticed.unavailable(o) for o in outcomes.values() if o.failure == "unavailable"))
    if program is not None and _primary(job, checked):
        job.add_finding(*noticed.of_profile(job.config))
        shut += program(job, checked, all(gate.passed for gate in shut))
    code = gates.exit_code(shut, checked.comparison.compared_layers, outcomes)
    if code is ExitCode.PASS and has_fault(job.findings):
        code = ExitCode.OUT_OF_TOLERANCE
    manifest = make_manifest(job, outcomes, checked.comparison, shut, _primary(job, checked), code)
    write_json(manifest, job.folder.path / MANIFEST)
    _write_reports(job)
    if program is not None:
        # Last of all: it lists every file, and so finds any byte that is changed after it.
        write_certificate(RunFolder(job.folder.path))
    (job.folder.path / FINGERPRINT).unlink()
    return RunResult(job.folder.finish(), tuple(shut), code, manifest)


def _primary(job: Job, checked: CrossCheck) -> str:
    """Backend whose contours go on; none where it has found no contour."""
    name = primary_backend(job.config, checked.done)
    return name if name and checked.comparison.stacks[name]["rings"].any() else ""


def _write_reports(job: Job) -> None:
    """Let every installed report writer render the run; a broken one is a note, not the end."""
    for name, write in registry.load_plugins(registry.REPORTS).items():
        try:
            write(RunFolder(job.folder.path))
        except Exception as error:
            job.observer.note(f"report writer {name!r} failed: {type(error).__name__}: {error}")

"""One job from part to report: the cross-check alone, or all the way to the program."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from ebamcheck.errors import SettingsError
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.part_source import read_reference
from ebamcheck.nc.control import control
from ebamcheck.nc.templates import usable_templates
from ebamcheck.pipeline.cross_check import chosen_backends, cross_check
from ebamcheck.pipeline.entry_program import check_waits
from ebamcheck.pipeline.job import Job, Observer, RunResult, Silent, carried_out
from ebamcheck.preflight.report import Ready, ready
from ebamcheck.preflight.workload import wanted_slabs
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import checked_window
from ebamcheck.slicers.isolation import WorkerPool
from ebamcheck.writing.posts import check_entry

LATER_STAGES = "ebamcheck.pipeline.finishing"  # module of what comes after the cross-check


def run_job(
    part_path: str | Path,
    target: str | Path,
    config: Config | None = None,
    reference: str | Path | None = None,
    resume: bool = False,
    observer: Observer | None = None,
    begun: Ready | None = None,
    yes: bool = False,
    force: bool = False,
    from_layer: int = 1,
    live: bool = False,
    workers: WorkerPool | None = None,
) -> RunResult:
    """Slice a part (a mesh file, or ``plate.toml``) with every backend, compare, fit, partition, order, write the program and
    verify it.

    The run folder `target` appears when it is whole. `reference` is a finer tessellation of the same part, against which errors are
    measured; `resume` goes on with what a killed run of the same part and settings left, and returns a finished one; `force` makes
    the run although a finished one stands there, which is kept under a name with its date. From `from_layer` on, counted from 1, a
    second program is written; `live` asks for a main program that waits between layers. `begun` is the same part and settings made
    ready before, `workers` are those spawned early. Raises InputError or SettingsError for what cannot be read or makes no sense,
    BackendMissing for a slicer that is not there."""
    config = config or Config()
    if not control(config.machine.control).is_read:
        raise SettingsError(
            f"machine.control {config.machine.control!r} writes what is not read back, and so cannot be validated: "
            f"run for a control, then `ebamcheck post RUN --control {config.machine.control} -o FOLDER`"
        )
    if live:
        check_waits(config)
    check_entry(from_layer, config)
    checked_window(config)
    usable_templates(config, config.machine.control)
    part = begun or ready(part_path, config, "run", yes)
    part.preflight.stop("run")
    config = part.config
    fine = read_reference(reference, part_path, config.part) if reference else None

    inputs = [fine.sha256 if fine else "", f"from layer {from_layer}", f"live {live}"]
    if not 1 <= from_layer <= len(part.heights):
        raise SettingsError(f"--from-layer {from_layer}: the part has layers 1 to {len(part.heights)}")
    job = Job("run", config, observer or Silent(), part.part, part.found, part.heights)
    job.from_layer, job.live, job.workers = from_layer, live, workers
    return _carried_out(job, part, target, inputs, resume, force, fine)


def check_job(
    part_path: str | Path,
    target: str | Path,
    config: Config | None = None,
    resume: bool = False,
    observer: Observer | None = None,
    begun: Ready | None = None,
    yes: bool = False,
    force: bool = False,
    workers: WorkerPool | None = None,
) -> RunResult:
    """Slice a part with every backend and compare them, no more; parameters and errors as in :func:`run_job`. A part that would not
    fit into memory, or of which ``slicing.slabs`` says so, is checked in slabs (:func:`~ebamcheck.pipeline.slabs.check_in_slabs`),
    unless it was made ready before."""
    config = config or Config()
    if begun is None and (slabs := wanted_slabs(Path(part_path), config)) > 1:
        from ebamcheck.pipeline.slabs import check_in_slabs

        return check_in_slabs(part_path, target, config, slabs, resume, observer, yes, force)
    part = begun or ready(part_path, config, "check", yes)
    part.preflight.stop("check")
    job = Job("check", config, observer or Silent(), part.part, part.found, part.heights)
    job.workers = workers
    return _carried_out(job, part, target, [], resume, force, None)


def _carried_out(
    job: Job,
    begun: Ready,
    target: str | Path,
    inputs: list[str],
    resume: bool,
    force: bool,
    fine: Part | None,
) -> RunResult:
    """Cross-check a part in a run folder, and make the program of a run."""
    backends = chosen_backends(job.config)

    def work(job: Job) -> RunResult:
        # What is needed when the layers are there takes half a second to load, in which the slicers work.
        checked = cross_check(job, backends, resume, lambda: import_module(LATER_STAGES))
        from ebamcheck.pipeline.finishing import finish

        return finish(job, checked, begun, fine)

    kind, sha256 = job.kind, begun.part.sha256
    return carried_out(job, kind, sha256, backends, inputs, target, work, resume=resume, force=force)

"""``ebamcheck run`` and ``ebamcheck check``: the whole job, and its cross-check alone."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ebamcheck.commands.options import (
    BackendsOption,
    ConfigOption,
    DirectionOption,
    FixOption,
    ForceOption,
    JobPart,
    JsonOption,
    LayerHeightOption,
    PlaceOption,
    PlateOption,
    ResumeOption,
    RotateOption,
    RunFolderOption,
    UnitsOption,
    WitnessesOption,
    YesOption,
    begun,
    job_settings,
    part_or_plate,
    placed_settings,
    print_json,
)
from ebamcheck.errors import ExitCode

if TYPE_CHECKING:
    from ebamcheck.pipeline import RunResult
    from ebamcheck.settings.config import Config
    from ebamcheck.slicers.worker_pool import WorkerPool


def run(
    part: JobPart = None,
    plate: PlateOption = None,
    config_file: ConfigOption = None,
    output: RunFolderOption = None,
    layer_height: LayerHeightOption = None,
    backends: BackendsOption = "",
    witnesses: WitnessesOption = "",
    reference: Annotated[Path | None, typer.Option(help="A finer tessellation of the same part.")] = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
    place: PlaceOption = "",
    rotate: RotateOption = None,
    fix_orientation: FixOption = False,
    from_layer: Annotated[
        int,
        typer.Option(min=1, help="Write a program that begins at this layer, too: to go on after a break."),
    ] = 1,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Write a main program that waits between layers until each is released, too."
        ),
    ] = False,
    yes: YesOption = False,
    resume: ResumeOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Look at the part, slice, cross-check, fit, partition, order, write the NC program, verify it and report."""
    config = job_settings(config_file, units, direction, layer_height, backends, witnesses, fix_orientation)
    config, source = placed_settings(config, place, rotate), part_or_plate(part, plate)
    from ebamcheck.numeric.compiling_beside import ROOMS, compiled_beside

    with compiled_beside(modules=ROOMS):
        part_ready = begun(source, config, "run", yes)
        with _first_slicers(config) as workers:
            from ebamcheck.commands.progress import watched
            from ebamcheck.pipeline import run_job

            with watched() as observer:
                result = run_job(
                    source,
                    output or Path(f"{source.stem}.run"),
                    config,
                    reference,
                    resume,
                    observer,
                    part_ready,
                    force=force,
                    from_layer=from_layer,
                    live=live,
                    workers=workers,
                )
    return _told(result, as_json)


def check(
    part: JobPart = None,
    plate: PlateOption = None,
    config_file: ConfigOption = None,
    output: RunFolderOption = None,
    layer_height: LayerHeightOption = None,
    backends: BackendsOption = "",
    witnesses: WitnessesOption = "",
    units: UnitsOption = "",
    direction: DirectionOption = "",
    place: PlaceOption = "",
    rotate: RotateOption = None,
    fix_orientation: FixOption = False,
    slabs: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=10_000,
            help="Read, cut and compare a binary STL in so many slabs of z; default: 1, more where memory asks for it.",
        ),
    ] = None,
    yes: YesOption = False,
    resume: ResumeOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Slice with every backend and compare all pairs on every layer; as `run`, without a program."""
    config = job_settings(config_file, units, direction, layer_height, backends, witnesses, fix_orientation)
    config, source = placed_settings(config, place, rotate), part_or_plate(part, plate)
    config = config if slabs is None else config.changed(slicing={"slabs": slabs})
    from ebamcheck.numeric.compiling_beside import CHECKING, compiled_beside
    from ebamcheck.preflight.workload import wanted_slabs

    with compiled_beside(modules=CHECKING), ExitStack() as opened:
        part_ready = workers = None
        # A part that is checked in slabs is never read whole.
        if wanted_slabs(source, config) == 1:
            part_ready = begun(source, config, "check", yes)
            workers = opened.enter_context(_first_slicers(config))
        from ebamcheck.commands.progress import watched
        from ebamcheck.pipeline import check_job

        with watched() as observer:
            folder = output or Path(f"{source.stem}.run")
            result = check_job(source, folder, config, resume, observer, part_ready, yes, force, workers)
    return _told(result, as_json)


def _first_slicers(config: Config) -> WorkerPool:
    """Workers of the slicers: their interpreters come up while the rest of this one is loaded."""
    from ebamcheck.plugins import registry
    from ebamcheck.slicers.worker_pool import WorkerPool, longest_first

    names = longest_first(config.slicing.backends or registry.house_slicers())
    return WorkerPool(names[: config.slicing.processes or None])


def _told(result: RunResult, as_json: bool) -> ExitCode:
    """Tell what a job came to."""
    from ebamcheck.commands.summaries import run_summary

    if as_json:
        print_json(result.manifest)
    else:
        print(run_summary(result.manifest))
        report = result.folder.path / "report.html"
        print(f"\nrun folder: {result.folder.path}" + (f"\nreport:     {report}" if report.is_file() else ""))
    return result.exit_code

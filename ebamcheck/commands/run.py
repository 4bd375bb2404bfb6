"""``ebamcheck run``, ``check``, ``verify`` and ``preflight``: the whole job, its cross-check alone, a finished run or a program
worked out again, and what can be said before a job."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ebamcheck.commands import options
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.showing.short_text import counted, text_table

if TYPE_CHECKING:
    from ebamcheck.pipeline import RunResult
    from ebamcheck.preflight.report import Preflight
    from ebamcheck.settings.config import Config
    from ebamcheck.slicers.isolation import WorkerPool


@options.explained(
    from_layer=Option(min=1, help="Write a program that begins at this layer, too: to go on after a break."),
    live="Write a main program that waits between layers until each is released, too.",
)
def run(
    part: Path | None = None,
    plate: Path | None = None,
    config_file: Path | None = None,
    output: Path | None = None,
    layer_height: float | None = None,
    backends: str = "",
    witnesses: str = "",
    reference: Annotated[Path | None, Option(help="A finer tessellation of the same part.")] = None,
    units: str = "",
    direction: str = "",
    place: str = "",
    rotate: float | None = None,
    fix_orientation: bool = False,
    from_layer: int = 1,
    live: bool = False,
    yes: bool = False,
    resume: bool = False,
    force: bool = False,
    as_json: bool = False,
) -> ExitCode:
    """Make a validated NC program of a part, and a report of it.

    Look at the part, slice, cross-check, fit, partition, order, write the NC program, verify it and report.
    """
    config = options.job_settings(config_file, units, direction, layer_height, backends, witnesses, fix_orientation)
    config, source = options.placed_settings(config, place, rotate), options.part_or_plate(part, plate)
    part_ready = options.begun(source, config, "run", yes)
    folder = output or Path(f"{source.stem}.run")
    with _first_slicers(config) as workers:
        from ebamcheck.commands.summaries import watched
        from ebamcheck.pipeline import run_job

        with watched() as observer:
            result = run_job(
                source, folder, config, reference, resume, observer, part_ready,
                force=force, from_layer=from_layer, live=live, workers=workers,
            )  # fmt: skip
    return _told(result, as_json)


@options.explained(
    slabs=Option(
        min=1,
        max=10_000,
        help="Read, cut and compare a binary STL in so many slabs of z; default: 1, more where memory asks for it.",
    ),
)
def check(
    part: Path | None = None,
    plate: Path | None = None,
    config_file: Path | None = None,
    output: Path | None = None,
    layer_height: float | None = None,
    backends: str = "",
    witnesses: str = "",
    units: str = "",
    direction: str = "",
    place: str = "",
    rotate: float | None = None,
    fix_orientation: bool = False,
    slabs: int | None = None,
    yes: bool = False,
    resume: bool = False,
    force: bool = False,
    as_json: bool = False,
) -> ExitCode:
    """Slice with every backend and compare all pairs on every layer; as `run`, without a program."""
    config = options.job_settings(config_file, units, direction, layer_height, backends, witnesses, fix_orientation)
    config, source = options.placed_settings(config, place, rotate), options.part_or_plate(part, plate)
    config = config if slabs is None else config.changed(slicing={"slabs": slabs})
    from ebamcheck.preflight.workload import wanted_slabs

    with ExitStack() as opened:
        part_ready = workers = None
        # A part that is checked in slabs is never read whole.
        if wanted_slabs(source, config) == 1:
            part_ready = options.begun(source, config, "check", yes)
            workers = opened.enter_context(_first_slicers(config))
        from ebamcheck.commands.summaries import watched
        from ebamcheck.pipeline import check_job

        folder = output or Path(f"{source.stem}.run")
        with watched() as observer:
            result = check_job(source, folder, config, resume, observer, part_ready, yes, force, workers)
    return _told(result, as_json)


def _first_slicers(config: Config) -> WorkerPool:
    """Workers of the slicers: their interpreters come up while the rest of this one is loaded."""
    from ebamcheck.plugins import registry
    from ebamcheck.slicers.isolation import WorkerPool, longest_first

    names = longest_first(config.slicing.backends or registry.house_slicers())
    return WorkerPool(names[: config.slicing.processes or None])


def _told(result: RunResult, as_json: bool) -> ExitCode:
    from ebamcheck.commands.summaries import run_summary

    if as_json:
        options.print_json(result.manifest)
    else:
        print(run_summary(result.manifest))
        report = result.folder.path / "report.html"
        print(f"\nrun folder: {result.folder.path}" + (f"\nreport:     {report}" if report.is_file() else ""))
    return result.exit_code


@options.explained(
    target=Argument(help="A run folder; or, with --part, a program, or the folder of a live build."),
    part="File of the part that the program should make; of a run: if it was moved since.",
    whole="Of a program that begins at a layer (--from-layer): the run folder or program that it is the end of.",
    quick="Of a run: believe its recorded layers and gates, slice nothing anew.",
    trusted="Public key, or a folder of them; one must have signed. May be given again.",
)
def verify(
    target: Path,
    part: Path | None = None,
    whole: Path | None = None,
    quick: bool = False,
    trusted: list[Path] | None = None,
    config_file: Path | None = None,
    layer_height: float | None = None,
    units: str = "",
    as_json: bool = False,
) -> ExitCode:
    """Prove a finished run again, or a program by its text alone.

    Work every gate of a finished run out again, or check a program against a part, from the program's text.
    """
    from ebamcheck.live.verifying import holds_layers
    from ebamcheck.record.certificate import find_record
    from ebamcheck.record.run_folder import MANIFEST
    from ebamcheck.result import check_record
    from ebamcheck.verification import verify as verification

    if holds_layers(target):
        return _build(target, part, as_json)
    # A run has its own settings: a file that lies about does not matter to it, nor to a program in it.
    main = whole or target
    own = (main / MANIFEST).is_file()
    if not own and main.exists() and not (config_file or units or layer_height):
        own = find_record(main) is not None
    default = not (config_file or units or layer_height or options.DEFAULT_CONFIG.is_file())
    config = None if own or default else options.settings_of(config_file, units, "", layer_height)
    checks = verification.verify(target, part, config, quick=quick, trusted=trusted or (), whole=whole)
    if as_json:
        options.print_json([check_record(check) for check in checks])
    else:
        verdicts = {True: "pass", False: "FAIL"}
        rows = [[verdicts[c.passed], c.name, c.value, c.limit, c.unit, c.where, c.text] for c in checks]
        print(text_table(["", "check", "value", "limit", "unit", "where", ""], rows))
        failed = sum(not c.passed for c in checks)
        print(f"\n{len(checks) - failed} of {len(checks)} checks passed")
    return ExitCode.PASS if all(c.passed for c in checks) else ExitCode.OUT_OF_TOLERANCE


def _build(folder: Path, part: Path | None, as_json: bool) -> ExitCode:
    from ebamcheck.live.verifying import VerifiedLayer, verify_build

    if part is None:
        what = "holds layers of a live build, or of `ebamcheck relayer`: name the part with --part"
        raise SettingsError(f"{folder}: {what}")

    def tell(layer: VerifiedLayer) -> None:
        verdict = "pass" if layer.passed else "FAIL"
        if not as_json:
            print(f"{verdict}  {layer.name}  {layer.checks} checks  {layer.why}".rstrip())

    found = verify_build(folder, part, tell)
    good = sum(layer.passed for layer in found)
    if as_json:
        options.print_json([vars(layer) for layer in found])
    else:
        print(f"\n{good} of {len(found)} published layers verify from their text alone")
    return ExitCode.PASS if found and good == len(found) else ExitCode.OUT_OF_TOLERANCE


@options.explained()
def preflight_command(
    part: Annotated[Path | None, Argument(help="Mesh file: .stl, .obj, .ply or .3mf; or plate.toml.")] = None,
    plate: Path | None = None,
    job: Annotated[str, Option(help="Job that is meant: run, or check without a program.")] = "run",
    config_file: Path | None = None,
    layer_height: float | None = None,
    units: str = "",
    direction: str = "",
    place: str = "",
    rotate: float | None = None,
    fix_orientation: bool = False,
    yes: bool = False,
    as_json: bool = False,
) -> ExitCode:
    """Look at mesh, units, machine, settings and work before a run.

    Exit code 1 where something cannot work.

    Example: ebamcheck preflight blade.stl -c ebamcheck.toml --place 100,50
    """
    from ebamcheck.preflight.report import ready
    from ebamcheck.preflight.workload import EVERY

    if job not in EVERY:
        raise SettingsError(f"--job {job!r}: give one of {', '.join(EVERY)}")
    config = options.settings_of(config_file, units, direction, layer_height)
    config = options.placed_settings(config, place, rotate)
    if fix_orientation:
        config = config.changed(part={"fix_orientation": True})
    found = ready(options.part_or_plate(part, plate), config, job, yes).preflight
    if as_json:
        options.print_json(found.as_dict())
    else:
        typer.echo(preflight_text(found))
    return found.exit_code


def preflight_text(found: Preflight) -> str:
    """Table of the checks, what to do about those that do not pass, and the verdict."""
    from ebamcheck.result import known

    levels, rows = {"pass": "pass", "warning": "warn", "fault": "FAULT"}, []
    for check in found.checks:
        figures = ["" if value is None else f"{value:.6g}" for value in (check.figure, known(check.limit))]
        rows.append([levels[check.level], check.name, *figures, check.unit, check.text])
    warnings = (check for check in found.checks if check.level != "pass" and check.remedy)
    remedies = [f"{check.name}: {check.remedy}" for check in warnings]
    counts = {level: sum(check.level == level for check in found.checks) for level in ("fault", "warning")}
    verdict = ", ".join(counted(count, level) for level, count in counts.items())
    table = text_table(["", "check", "figure", "limit", "unit", ""], rows)
    blocks = [table, "\n".join(remedies), f"{len(rows)} checks: {verdict}"]
    return "\n\n".join(block for block in blocks if block)

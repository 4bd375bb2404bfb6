"""``ebamcheck preflight PART``: what can be known of a job before anything is sliced."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from ebamcheck.commands import options
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.preflight.report import Preflight, ready
from ebamcheck.preflight.workload import EVERY, RUN
from ebamcheck.result import Check, known
from ebamcheck.showing.short_text import counted, text_table

SHOWN = {"pass": "pass", "warning": "warn", "fault": "FAULT"}  # levels as the table has them


def preflight_command(
    part: Annotated[Path | None, Argument(help="Mesh file: .stl, .obj, .ply or .3mf; or plate.toml.")] = None,
    plate: options.PlateOption = None,
    job: Annotated[str, Option(help="Job that is meant: run, or check without a program.")] = RUN,
    config_file: options.ConfigOption = None,
    layer_height: options.LayerHeightOption = None,
    units: options.UnitsOption = "",
    direction: options.DirectionOption = "",
    place: options.PlaceOption = "",
    rotate: options.RotateOption = None,
    fix_orientation: options.FixOption = False,
    yes: options.YesOption = False,
    as_json: options.JsonOption = False,
) -> ExitCode:
    """Look at mesh, units, machine, settings and the work to come; exit code 1 where something cannot work.

    Example: ebamcheck preflight blade.stl -c ebamcheck.toml --place 100,50
    """
    if job not in EVERY:
        raise SettingsError(f"--job {job!r}: give one of {', '.join(EVERY)}")
    config = options.placed_settings(
        options.settings_of(config_file, units, direction, layer_height), place, rotate
    )
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
    remedies = [
        f"{check.name}: {check.remedy}" for check in found.checks if check.level != "pass" and check.remedy
    ]
    faults = sum(check.level == "fault" for check in found.checks)
    warned = sum(check.level == "warning" for check in found.checks)
    blocks = [
        text_table(["", "check", "figure", "limit", "unit", ""], [_row(check) for check in found.checks]),
        "\n".join(remedies),
        f"{len(found.checks)} checks: {counted(faults, 'fault')}, {counted(warned, 'warning')}",
    ]
    return "\n\n".join(block for block in blocks if block)


def _row(check: Check) -> Sequence[str]:
    figures = ["" if value is None else f"{value:.6g}" for value in (check.figure, known(check.limit))]
    return [SHOWN[check.level], check.name, *figures, check.unit, check.text]

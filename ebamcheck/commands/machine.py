"""``ebamcheck machine RUN``: a control to try a build on: it calls the published layers, and measures what grew."""

from __future__ import annotations

import csv
import math
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.commands.live_opcua import play_control
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.live.bed import Growth
from ebamcheck.live.heights import bead_limits
from ebamcheck.live.loading import finished_run
from ebamcheck.live.opcua.panel import FAULTS
from ebamcheck.live.opcua.server import SESSIONS
from ebamcheck.live.playing import Played, Server, play

TABLE = "machine.csv"

START = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"


def machine_command(
    run: Annotated[Path, typer.Argument(help="A finished run folder.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Folder of the build, or with --opcua of keys and table; default: RUN.live, RUN.opcua.",
        ),
    ] = None,
    part: Annotated[
        Path | None, typer.Option(help="File of the part, if it was moved since the run.")
    ] = None,
    drift: Annotated[
        float, typer.Option(help="Share by which every layer comes out higher than planned.")
    ] = 0.0,
    noise: Annotated[float, typer.Option(help="Standard deviation of that share.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    speed: Annotated[float, typer.Option(help="How many times faster than planned layers are laid.")] = 100.0,
    heights: Annotated[str, typer.Option(help="How heights are chosen: uniform, adaptive.")] = "uniform",
    cusp: Annotated[float, typer.Option(help="Greatest cusp of adaptive heights, mm.")] = 0.5,
    faults: Annotated[
        bool, typer.Option("--faults", help="Send bad lines before every reading; each has to be refused.")
    ] = False,
    layers: Annotated[int | None, typer.Option(min=1, help="Stop after so many layers.")] = None,
    opcua: Annotated[
        bool,
        typer.Option(
            "--opcua", help="Be a control with an OPC UA server, and wait for `ebamcheck live RUN --opcua`."
        ),
    ] = False,
    url: Annotated[str, typer.Option(help="With --opcua: address to listen at.")] = "",
    fault: Annotated[
        list[str] | None,
        typer.Option(help=f"With --opcua: NAME@LAYER, also several times; {', '.join(FAULTS)}."),
    ] = None,
    sessions: Annotated[
        int, typer.Option(min=1, help="With --opcua: sessions that the server has.")
    ] = SESSIONS,
) -> ExitCode:
    """Play a machine: start `ebamcheck live RUN` beside it and build the part, whose layers grow by a stated law.

    Example: ebamcheck machine blade.run --drift 0.1 --noise 0.05 --speed 100
    """
    if not (math.isfinite(speed) and speed > 0.0):
        raise SettingsError(f"--speed {speed}: give a positive number")
    growth = Growth(drift, noise, seed)
    if not opcua and (url or fault):
        raise SettingsError("--url and --fault belong to --opcua")
    if opcua and (faults or layers):
        raise SettingsError(
            "--faults and --layers belong to the lines of JSON; with --opcua give --fault NAME@LAYER"
        )
    found = finished_run(run, part)
    if opcua:
        desk = output or run.with_name(f"{run.resolve().name.removesuffix('.run')}.opcua")
        return play_control(found, desk, url, growth, speed, fault or [], sessions)
    limits = bead_limits(found.config)
    folder = output or run.with_name(f"{run.resolve().name.removesuffix('.run')}.live")
    command = [sys.executable, "-c", START, "live", str(run.resolve()), "-o", str(folder.resolve())]
    command += ["--part", str(found.part_file.resolve()), "--heights", heights, "--cusp", str(cusp)]
    rows: list[Played] = []
    server = Server(command)
    try:
        typer.echo(f"{'layer':>5} {'base':>9} {'planned':>8} {'grown':>8} {'answer':>8}  program")
        answer = play(server, folder, growth, speed, lambda row: _tell(row, rows), faults, layers)
    finally:
        server.close()
    if not rows:
        typer.echo(f"nothing was laid: {answer.get('reason', 'the part is built already')}")
        return ExitCode.PASS if answer["answer"] == "done" else ExitCode.OUT_OF_TOLERANCE
    with replacing(folder / TABLE) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Played)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    seconds = np.array([row.answer_s for row in rows])
    median, late = np.median(seconds), np.quantile(seconds, 0.99)
    typer.echo(
        f"\n{len(rows)} layers; from the height to the program {median:.3f} s (median), {late:.3f} s (99th percentile)"
    )
    if answer["answer"] == "published":
        typer.echo(f"stopped at Z {answer['base_mm']:.3f} mm, as asked for")
        return ExitCode.PASS
    if answer["answer"] != "done":
        typer.echo(f"the build stopped at layer {rows[-1].layer + 1}: {answer.get('reason', answer)}")
        return ExitCode.OUT_OF_TOLERANCE
    tolerance_mm = 0.5 * limits.least_mm
    off_mm = float(answer["off_mm"])
    typer.echo(f"the top came out {off_mm:+.3f} mm off, of {tolerance_mm:.3f} mm (half the least layer)")
    return ExitCode.PASS if abs(off_mm) <= tolerance_mm else ExitCode.OUT_OF_TOLERANCE


def _tell(row: Played, rows: list[Played]) -> None:
    rows.append(row)
    typer.echo(
        f"{row.layer:5d} {row.base_mm:9.3f} {row.planned_mm:8.3f} {row.measured_mm:8.3f} {row.answer_s:7.3f}s  {row.name}"
        + (f"  ({row.said})" if row.said else "")
    )

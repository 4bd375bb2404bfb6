"""``ebamcheck machine RUN``: plays a control to try a build on, which calls the released layers and measures what grew."""

from __future__ import annotations

import asyncio
import csv
import math
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from ebamcheck.atomic_file import made_folder, replacing
from ebamcheck.commands.live import MOVED_PART, opcua_of
from ebamcheck.commands.options import explained
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.live.heights import bead_limits
from ebamcheck.live.opcua.link import installed
from ebamcheck.live.publishing import JOURNAL
from ebamcheck.live.relaying import finished_run
from ebamcheck.scratch import scratch_folder
from ebamcheck.testing.played_control.program import FAULTS, Growth, PlayedLayer, PlayedProgram
from ebamcheck.testing.played_control.server import PROFILE, SESSIONS, desk_profile, faults_of, played

TABLE = "machine.csv"
START = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"


@explained(
    output="Folder of the build, or with --opcua of keys and table; default: RUN.live, RUN.opcua.",
    opcua="Start nothing: wait for `ebamcheck live RUN --opcua` in another terminal.",
    fault=f"NAME@LAYER, also several times; {', '.join(FAULTS)}.",
    part=MOVED_PART,
)
def machine_command(
    run: Path,
    output: Path | None = None,
    part: Path | None = None,
    drift: Annotated[float, Option(help="Share by which every layer comes out higher than planned.")] = 0.0,
    noise: Annotated[float, Option(help="Standard deviation of that share.")] = 0.0,
    seed: Annotated[int, Option(min=0, help="Seed of the noise.")] = 0,
    speed: Annotated[float, Option(help="How many times faster than planned layers are laid.")] = 100.0,
    heights: Annotated[str, Option(help="How heights are chosen: uniform, adaptive.")] = "uniform",
    cusp: Annotated[float, Option(help="Greatest cusp of adaptive heights, mm.")] = 0.5,
    opcua: bool = False,
    url: Annotated[str, Option(help="With --opcua: address to listen at.")] = "",
    fault: list[str] | None = None,
    sessions: Annotated[int, Option(min=1, help="Sessions that the OPC UA server has.")] = SESSIONS,
) -> ExitCode:
    """Play a control with an OPC UA server, start `ebamcheck live RUN` beside it, and build the part, whose layers grow by a stated
    law.

    Example: ebamcheck machine blade.run --drift 0.1 --noise 0.05 --speed 100
    """
    if not (math.isfinite(speed) and speed > 0.0):
        raise SettingsError(f"--speed {speed}: give a positive number")
    if url and not opcua:
        raise SettingsError("--url belongs to --opcua")
    growth, faults = Growth(drift, noise, seed), faults_of(fault or [])
    installed()
    found = finished_run(run, part)
    if not opcua:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            url = f"opc.tcp://127.0.0.1:{free.getsockname()[1]}"
    link = opcua_of(found.config, None, url)
    name = run.resolve().name.removesuffix(".run")
    folder = output or run.with_name(f"{name}.{'opcua' if opcua else 'live'}")
    if not opcua and (folder / JOURNAL).is_file():
        raise SettingsError(f"{folder}: holds a build that was begun: give another folder with -o")
    top_mm = float(found.part.size[2])

    def tell(row: PlayedLayer) -> None:
        heights = f"{row.base_mm:9.3f} {row.planned_mm:8.3f} {row.grown_mm:8.3f}"
        typer.echo(f"{row.layer:5d} {heights} {row.wait_s:7.2f}s  {row.name}")

    def listens() -> None:
        if opcua:
            typer.echo(f"listens at {link.url}; in another terminal: ")
            typer.echo(f"    ebamcheck live {run} --opcua --config {desk / PROFILE}")
        else:
            command = ["live", run.resolve(), "--opcua", "--config", desk / PROFILE, "-o", folder.resolve()]
            command += ["--part", found.part_file.resolve(), "--heights", heights, "--cusp", cusp]
            open_.callback(_started(command, program))
        typer.echo(f"{'layer':>5} {'base':>9} {'planned':>8} {'grown':>8} {'waited':>8}  program")

    program = PlayedProgram(found.config, link, top_mm, growth, speed, faults, tell)
    with ExitStack() as open_:
        desk = folder if opcua else open_.enter_context(scratch_folder())
        access = desk_profile(desk, link)
        asyncio.run(played(program, access, sessions, listens))
    made_folder(folder)
    with replacing(folder / TABLE) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(PlayedLayer)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in program.laid)
    off_mm, tolerance_mm = program.bed_mm - top_mm, 0.5 * bead_limits(found.config).least_mm
    layers = len(program.laid)
    if not program.ended:
        typer.echo(f"the main program stopped after {layers} layers: no layer was released in time")
        return ExitCode.OUT_OF_TOLERANCE
    off = f"{off_mm:+.3f} mm off, of {tolerance_mm:.3f} mm (half the least layer)"
    typer.echo(f"{layers} layers; the top came out {off}")
    return ExitCode.PASS if abs(off_mm) <= tolerance_mm else ExitCode.OUT_OF_TOLERANCE


def _started(words: Sequence[object], program: PlayedProgram) -> Callable[[], object]:
    """Start an ebamcheck command, and return a function that waits for its end; if the command fails, the program stops."""
    process = subprocess.Popen([sys.executable, "-c", START, *map(str, words)], stdout=subprocess.DEVNULL)

    def watch() -> None:
        if process.wait():
            program.stopped = True

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()

    def end() -> None:
        # Where the program stopped by itself, nobody releases anything any more.
        if not program.ended:
            process.terminate()
        watching.join()

    return end

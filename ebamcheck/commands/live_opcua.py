"""The door of ``ebamcheck live RUN --opcua``, and the control of ``ebamcheck machine RUN --opcua``."""

from __future__ import annotations

import asyncio
import csv
import json
import sys
from dataclasses import asdict, fields
from pathlib import Path

import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import ExitCode
from ebamcheck.json_values import plain
from ebamcheck.live.bed import Growth
from ebamcheck.live.building import Answer, Building
from ebamcheck.live.desk import BetweenLayers
from ebamcheck.live.heights import bead_limits
from ebamcheck.live.loading import FinishedRun
from ebamcheck.live.opcua.desk import PROFILE, desk_profile, faults_of, played
from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.link import checked, installed
from ebamcheck.live.opcua.panel import Panel
from ebamcheck.live.opcua.playing import PlayedLayer
from ebamcheck.live.opcua.stored_files import StoredFiles
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.opcua import OpcuaSettings

TABLE = "machine.csv"


def opcua_of(config: Config, file: Path | None, url: str) -> OpcuaSettings:
    """Settings of the connection: those of the run, in whose place those of a file may stand, with another address."""
    found = load_config(file) if file else config
    return (found.changed(opcua={"url": url}) if url else found).opcua


def follow_control(building: Building, opcua: OpcuaSettings) -> ExitCode:
    """Lead a build on a control to its end, and tell every answer as a line of JSON."""
    between = BetweenLayers(building)

    def tell(answer: Answer) -> None:
        sys.stdout.write(json.dumps(plain(answer), sort_keys=True, allow_nan=False) + "\n")
        sys.stdout.flush()
        # What is published goes to the control first.
        if answer["answer"] != "published":
            between(answer)

    async def lead() -> Answer:
        return await Door(building, building.maker.config.machine, opcua, tell).run()

    checked(opcua)
    tell(asyncio.run(lead()))
    return ExitCode.PASS


def play_control(
    found: FinishedRun,
    folder: Path,
    url: str,
    growth: Growth,
    speed: float,
    faults: list[str],
    sessions: int,
) -> ExitCode:
    """Play a control with an OPC UA server until its main program ends."""
    installed()
    opcua = opcua_of(found.config, None, url)
    named = faults_of(faults)
    access = desk_profile(folder, opcua)
    top_mm = float(found.part.size[2])
    rows: list[PlayedLayer] = []

    def tell(row: PlayedLayer) -> None:
        rows.append(row)
        typer.echo(
            f"{row.layer:5d} {row.base_mm:9.3f} {row.planned_mm:8.3f} {row.grown_mm:8.3f} {row.wait_s:7.2f}s  {row.name}"
        )

    def listens() -> None:
        typer.echo(f"listens at {opcua.url}; in another terminal: ")
        typer.echo(f"    ebamcheck live {found.folder.path} --opcua --config {folder / PROFILE}")
        typer.echo(f"{'layer':>5} {'base':>9} {'planned':>8} {'grown':>8} {'waited':>8}  program")

    with scratch_folder() as files:
        panel = Panel(files=StoredFiles(files))
        program, ended = asyncio.run(
            played(found.config, opcua, access, top_mm, growth, speed, named, tell, sessions, panel, listens)
        )
    with replacing(folder / TABLE) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(PlayedLayer)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    off_mm, tolerance_mm = program.bed_mm - top_mm, 0.5 * bead_limits(found.config).least_mm
    if not ended:
        typer.echo(f"the main program stopped after {len(rows)} layers: no layer was released in time")
        return ExitCode.OUT_OF_TOLERANCE
    typer.echo(
        f"{len(rows)} layers; the top came out {off_mm:+.3f} mm off, of {tolerance_mm:.3f} mm (half the least layer)"
    )
    return ExitCode.PASS if abs(off_mm) <= tolerance_mm else ExitCode.OUT_OF_TOLERANCE

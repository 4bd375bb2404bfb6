"""``ebamcheck live RUN``: waits for measured heights and publishes a proved layer on each, by lines or on a control."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from ebamcheck.commands.options import numbers
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.json_values import plain
from ebamcheck.live.building import Answer, BetweenLayers, Building, Lines, serve
from ebamcheck.live.heights import HeightRule, height_rule
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.link import checked
from ebamcheck.live.publishing import JOURNAL, read_journal
from ebamcheck.live.relaying import finished_run
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.opcua import OpcuaSettings

MODES = ("uniform", "adaptive", "listed")

FinishedRunArgument = Annotated[Path, typer.Argument(help="A finished run folder.")]
MovedPart = Annotated[Path | None, typer.Option(help="File of the part, if it was moved since the run.")]
AnnealingOption = Annotated[
    int,
    typer.Option(min=0, help="Moves by which the order of islands is improved; each thousand takes time."),
]


def live_command(
    run: FinishedRunArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Folder of the build; default: RUN.live. A build that was begun there goes on.",
        ),
    ] = None,
    part: MovedPart = None,
    heights: Annotated[str, typer.Option(help=f"How heights are chosen: {', '.join(MODES)}.")] = MODES[0],
    cusp: Annotated[float, typer.Option(help="Greatest cusp of adaptive heights, mm.")] = 0.5,
    tops: Annotated[
        str, typer.Option(help="Tops of listed heights over the base plate, mm, with commas.")
    ] = "",
    annealing: AnnealingOption = 0,
    timeout: Annotated[float, typer.Option(help="Time without a line after which it says so, s.")] = 3600.0,
    replay: Annotated[
        Path | None,
        typer.Option(help="A journal: make its build again and compare every byte; nothing is waited for."),
    ] = None,
    opcua: Annotated[
        bool, typer.Option("--opcua", help="Lead the build on a control, by OPC UA; needs ebamcheck[opcua].")
    ] = False,
    url: Annotated[
        str, typer.Option(help="With --opcua: address of the control, in place of that of the settings.")
    ] = "",
    config_file: Annotated[
        Path | None,
        typer.Option(
            "-c", "--config", help="With --opcua: file whose section [opcua] stands for that of the run."
        ),
    ] = None,
) -> ExitCode:
    """Follow a build: for every measured height that comes in, publish the next layer, proved.

    Example: ebamcheck live blade.run
    """
    if heights not in MODES:
        raise SettingsError(f"--heights {heights!r}: choose one of {', '.join(MODES)}")
    if not timeout > 0.0:
        raise SettingsError(f"--timeout {timeout}: give a positive number of seconds")
    if (url or config_file) and not opcua:
        raise SettingsError("--url and --config belong to --opcua")
    found = finished_run(run, part)
    link = opcua_of(found.config, config_file, url) if opcua else None
    if link is not None:
        checked(link)
    listed = numbers(tops, "--tops") if tops else ()
    first = next(read_journal(replay), {}) if replay else {}
    if replay:
        heights, cusp = str(first.get("mode", heights)), float(first.get("cusp_mm", cusp))
        listed = tuple(first.get("listed_mm", listed))
        annealing = int(first.get("annealing_steps", annealing))
    rule = height_rule(found.part, found.config, heights, cusp, listed)  # type: ignore[arg-type]
    with LayerMaker(found.part, found.config, found.primary, annealing) as maker:
        if replay is not None:
            return _replayed(replay, maker, rule)
        folder = output or run.with_name(f"{run.resolve().name.removesuffix('.run')}.live")
        _tell_of_journal(folder)
        building = Building(maker, folder, rule)
        try:
            if link is not None:
                _follow_control(building, link)
            else:
                serve(building, Lines(sys.stdin.fileno()), sys.stdout, timeout)
        finally:
            building.close()
    return ExitCode.PASS


def opcua_of(config: Config, file: Path | None, url: str) -> OpcuaSettings:
    """Settings of the connection: those of the run, in whose place those of a file may stand, with another address."""
    found = load_config(file) if file else config
    return (found.changed(opcua={"url": url}) if url else found).opcua


def _follow_control(building: Building, opcua: OpcuaSettings) -> None:
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

    tell(asyncio.run(lead()))


def _tell_of_journal(folder: Path) -> None:
    """Say beforehand what takes a while: the layers of a build that goes on are made again."""
    journal = folder / JOURNAL
    layers = sum(entry["kind"] == "layer" for entry in read_journal(journal)) if journal.is_file() else 0
    if layers:
        typer.echo(f"{folder}: goes on; its {layers} layers are made again and compared first", err=True)


def _replayed(journal: Path, maker: LayerMaker, rule: HeightRule) -> ExitCode:
    """Make the build of a journal again, in a folder of its own."""
    with TemporaryDirectory(prefix="ebamcheck-replay-") as folder:
        place = Path(folder)
        (place / JOURNAL).write_bytes(journal.read_bytes())
        try:
            building = Building(maker, place, rule)
        except InputError as error:
            typer.echo(f"ebamcheck: {error}", err=True)
            return ExitCode.OUT_OF_TOLERANCE
        building.close()
    layers = sum(entry["kind"] == "layer" for entry in read_journal(journal))
    typer.echo(f"{journal}: {layers} layers made again, every byte is the same")
    return ExitCode.PASS

"""``ebamcheck live`` and ``relayer``: a build followed by its measured heights, and one layer of a finished run made again at
one."""

from __future__ import annotations

import asyncio
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from typer import Option

from ebamcheck.checks.table import stands_of
from ebamcheck.commands.options import explained, numbers, print_json
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.json_values import plain
from ebamcheck.live.before import Before
from ebamcheck.live.building import Answer, BetweenLayers, Building, Lines, serve
from ebamcheck.live.height_map import MapCells, figures_of, in_cells, read_map
from ebamcheck.live.heights import HeightRule, height_rule
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.opcua.door import Door
from ebamcheck.live.opcua.link import checked
from ebamcheck.live.publishing import JOURNAL, read_journal
from ebamcheck.live.relaying import FinishedRun, Relayered, check_below, finished_run, relayer, tilted
from ebamcheck.nc.files import preheat_name
from ebamcheck.printable import index_of_number
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.machine import OpcuaSettings

MODES = ("uniform", "adaptive", "listed")
MOVED_PART = "File of the part, if it was moved since the run."
ANNEALING = Option(min=0, help="Moves by which the order of islands is improved; each thousand takes time.")


@explained(
    output="Folder of the build; default: RUN.live. A build that was begun there goes on.",
    replay="A journal: make its build again and compare every byte; nothing is waited for.",
    opcua="Lead the build on a control, by OPC UA; needs ebamcheck[opcua].",
    url="With --opcua: address of the control, in place of that of the settings.",
    config_file="With --opcua: file whose section [opcua] stands for that of the run.",
    part=MOVED_PART,
    annealing=ANNEALING,
)
def live_command(
    run: Path,
    output: Path | None = None,
    part: Path | None = None,
    heights: Annotated[str, Option(help=f"How heights are chosen: {', '.join(MODES)}.")] = MODES[0],
    cusp: Annotated[float, Option(help="Greatest cusp of adaptive heights, mm.")] = 0.5,
    tops: Annotated[str, Option(help="Tops of listed heights over the base plate, mm, with commas.")] = "",
    annealing: int = 0,
    timeout: Annotated[float, Option(help="Time without a line after which it says so, s.")] = 3600.0,
    replay: Path | None = None,
    opcua: bool = False,
    url: str = "",
    config_file: Path | None = None,
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
        layers = _layers_of(folder / JOURNAL) if (folder / JOURNAL).is_file() else 0
        if layers:
            typer.echo(f"{folder}: goes on; its {layers} layers are made again and compared first", err=True)
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


def _layers_of(journal: Path) -> int:
    return sum(entry["kind"] == "layer" for entry in read_journal(journal))


def _replayed(journal: Path, maker: LayerMaker, rule: HeightRule) -> ExitCode:
    with TemporaryDirectory(prefix="ebamcheck-replay-") as folder:
        place = Path(folder)
        (place / JOURNAL).write_bytes(journal.read_bytes())
        try:
            building = Building(maker, place, rule)
        except InputError as error:
            typer.echo(f"ebamcheck: {error}", err=True)
            return ExitCode.OUT_OF_TOLERANCE
        building.close()
    typer.echo(f"{journal}: {_layers_of(journal)} layers made again, every byte is the same")
    return ExitCode.PASS


@explained(
    measured_z="Height of what stands, over the base plate, mm: the layer is laid on it.",
    height_map="Measured surface of what stands, in place of --measured-z: CSV, NPY or TIFF.",
    direction="Slicing direction in the file's coordinates, as X,Y,Z; default: that of the run.",
    output="Folder of the new layers; default: RUN.live.",
    part=MOVED_PART,
    annealing=ANNEALING,
)
def relayer_command(
    run: Path,
    layer: Annotated[int, Option(help="Layer that comes next, counted from 1.")],
    measured_z: float | None = None,
    height_map: Path | None = None,
    direction: str = "",
    output: Path | None = None,
    part: Path | None = None,
    annealing: int = 0,
    as_json: bool = False,
) -> ExitCode:
    """Slice a layer at its measured height, plan, write and verify it, and put it under a new name beside the old one.

    Example: ebamcheck relayer blade.run --layer 13 --measured-z 20.4
    """
    if (measured_z is None) == (height_map is None):
        raise SettingsError("give --measured-z or --height-map: the mean of a map is its height")
    if height_map is not None and direction:
        raise SettingsError("--height-map is of the layers that were laid: it does not go with --direction")
    if measured_z is not None and not 0.0 <= measured_z < math.inf:
        raise SettingsError(f"--measured-z {measured_z}: give a height over the base plate in mm")
    turned = numbers(direction, "--direction") if direction else None
    if turned is not None and len(turned) != 3:
        raise SettingsError(f"--direction {direction!r}: give three numbers")
    found = finished_run(run, part, turned)
    if turned is not None and alike(turned, run):
        turned, found = None, finished_run(run, part)
    index = index_of_number(layer, len(found.thickness_mm))
    upright, built_mm = None, 0.0
    if turned is not None:
        machine = found.config.machine
        if not (machine.tilt_axes or machine.rotary):
            what = "has no axes that turn the part between layers (machine.tilt_axes)"
            raise SettingsError(f"--direction {direction}: the control {machine.control!r} {what}")
        upright = finished_run(run, part)
        built_mm = float(upright.tops_mm[index - 1]) if index else 0.0
        found = replace(found, config=tilted(upright, found, built_mm))
    before = found.before(index)
    folder = output or run.with_name(f"{run.resolve().name.removesuffix('.run')}.live")
    with LayerMaker(found.part, found.config, found.primary, annealing) as maker:
        if upright is not None:
            maker.stands = stands_of(upright.part, found.part, built_mm, upright.config)
            # Along another direction other layers would have been laid than those that the run knows.
            before = replace(before, below=None)
        cells: MapCells | None = None
        if height_map is not None:
            before, cells, measured_z = mapped(found, maker, index, before, height_map)
        assert measured_z is not None
        if upright is None:
            check_below(folder, found, index, measured_z)
        done = relayer(maker, before, index, measured_z, folder, cells)
    if as_json:
        print_json({**done.certificate, "place": done.place, "said": done.said, "seconds": done.made.seconds})
    else:
        _tell(done, found, index)
    return ExitCode.PASS if done.place is not None else ExitCode.OUT_OF_TOLERANCE


def alike(direction: tuple[float, ...], run: Path) -> bool:
    """Whether a direction is that of a run."""
    both = np.array([RunFolder(run).manifest()["settings"]["part"]["direction"], direction], np.float64)
    was, now = both / np.linalg.norm(both, axis=1)[:, None]
    return bool(np.allclose(was, now, atol=1e-9))


def mapped(
    found: FinishedRun, maker: LayerMaker, layer: int, before: Before, file: Path
) -> tuple[Before, MapCells, float]:
    """What stands under a layer of a run with its section, a map in the cells of that, and the mean of the map."""
    if layer == 0:
        raise SettingsError("--height-map is of a layer that was laid: on the plate give --measured-z")
    middle_mm = float(found.tops_mm[layer - 1] - 0.5 * found.thickness_mm[layer - 1])
    before = before.on_section(maker.section_at(middle_mm), found.part, found.config)
    assert before.surface is not None
    cells = in_cells(read_map(file, found.config.height_map), before.surface)
    return before, cells, figures_of(cells, before.surface, found.config).mean_mm


def _tell(done: Relayered, found: FinishedRun, layer: int) -> None:
    wanted = done.made.wanted
    for text in done.said:
        typer.echo(f"note: {text}")
    old = found.program_of(layer)
    was = f" in place of {old['name']}" if old else ""
    scan = preheat_name(found.config.machine.program_name, layer)
    if old and scan in {Path(file["name"]).stem for file in found.manifest["program"]["files"]}:
        was += f" and of {scan}, the scan before it"
    if done.place is None:
        stays = f", {old['name']}" if old else ""
        typer.echo(f"layer {layer + 1}: {done.made.why}; the old layer stays{stays}")
        return
    if of_map := done.certificate.get("height_map"):
        typer.echo(
            f"map: mean {of_map['mean_mm']:.3f} mm, {of_map['hump_mm']:.2f} mm over it at {tuple(of_map['hump_at_mm'])}, "
            f"{of_map['dip_mm']:.2f} mm under it at {tuple(of_map['dip_at_mm'])}, slope {of_map['slope_deg']:.2f} deg; "
            f"{100 * of_map['mended']:.0f} % of it is mended"
        )
    seconds = sum(done.made.seconds.values())
    typer.echo(
        f"layer {layer + 1}: Z {wanted.base_mm:.3f} to {wanted.top_mm:.3f} mm, cut at {done.made.cut_mm:.3f} mm, "
        f"{done.made.islands} islands, {len(done.made.gates)} gates open, {seconds:.2f} s"
    )
    typer.echo(f"{done.place}: {done.certificate['called']}{was}; wait {done.made.wait_s:g} s before it")

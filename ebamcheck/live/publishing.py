"""Publishing a layer: its program under a new name, its settings and its certificate, whole and on disk, or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import json_text, plain, sha256_of_json
from ebamcheck.live.making import MadeLayer
from ebamcheck.live.released_layer import current_off
from ebamcheck.mesh.on_table import on_table
from ebamcheck.mesh.part import Part
from ebamcheck.nc.control import control
from ebamcheck.nc.files import LONGEST_NAME
from ebamcheck.nc.special_rules import checked_tilt
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s
from ebamcheck.settings.text import values_as_toml
from ebamcheck.version import __version__
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.table import Tilt, tilt_of

CERTIFICATE, SETTINGS, PROGRAM = "layer.json", "settings.toml", "program"
"""Files of a published layer, and the folder of its program."""

LAYERS, CURRENT, JOURNAL = "layers", "current.json", "journal.jsonl"
"""In the folder of a build: published layers, the one that is to be called next, and what happened."""

FORMAT = "ebamcheck layer 2"
"""Format of a certificate: it counts layers from 1, as the layer's name does; format 1 counted them from 0."""

STEM = 10
"""Characters of the program's name that a layer's name keeps: with layer and number it fits a control."""


def layer_name(program: str, layer: int, number: int) -> str:
    """Name of a layer's program: that of the run, the number of the layer of that index, from 1, and how often it was made.

    Examples
    --------
    >>> layer_name("MAIN", 35, 2)
    'MAIN_K0036R2'
    """
    name = f"{program[:STEM]}_K{layer + 1:04d}R{number}"
    if len(name) > LONGEST_NAME - len("_L0001"):
        raise SettingsError(
            f"layer {layer + 1}, number {number}: the name {name!r} is too long for the control"
        )
    return name


def called_name(made: MadeLayer) -> str:
    """File that the running program calls: the subprogram, or the one file of a control without subprograms."""
    if made.files is None:
        raise InputError(f"layer {made.wanted.layer + 1}: there is no program")
    suffix = control(made.config.machine.control).subprogram_suffix
    return made.files.names[1] if suffix and len(made.files.names) > 1 else made.files.names[0]


def certificate_of(
    made: MadeLayer, part: Part, primary: str, witness: str, measured: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What is known of a made layer, as its certificate holds it: nothing of the clock, so that it can be made again.

    What was `measured` under it beside its height is kept there, too.
    """
    wanted, files = made.wanted, made.files
    return dict(
        plain(
            {
                "format": FORMAT,
                "software": __version__,
                "name": wanted.name,
                "layer": wanted.layer + 1,
                "shifted": wanted.shifted,
                "base_mm": wanted.base_mm,
                "thickness_mm": wanted.thickness_mm,
                "top_mm": wanted.top_mm,
                "cut_mm": made.cut_mm,
                "travel_speed_mm_s": made.config.process.travel_speed_mm_s,
                "wire_speed_mm_s": nominal_wire_speed_mm_s(made.config, wanted.thickness_mm),
                "direction": part.direction,
                **told_of_table(made.config),
                "control": made.config.machine.control,
                "part": {
                    "name": part.name,
                    "sha256": part.source_sha256 or part.sha256,
                    "mesh_sha256": part.sha256,
                },
                "settings_sha256": sha256_of_json(made.config.model_dump()),
                "primary": primary,
                "witness": witness,
                "islands": made.islands,
                "metal_so_far": asdict(made.metal.below),
                "spent": asdict(made.metal.spent),
                "wait_s": made.wait_s,
                "layer_s": made.deposit_s,
                "leave_k": made.heat.surface_k,
                "gates": [asdict(gate) for gate in made.gates],
                "checks": len(made.checks),
                "called": called_name(made),
                "files": {} if files is None else dict(files.sha256),
                "validated": made.passed,
            }
            | dict(measured or {})
        )
    )


def read_certificate(place: Path) -> dict[str, Any]:
    """Return the certificate of a layer in its folder.

    Raises
    ------
    InputError
        If it is none, or of a format that counts layers otherwise.
    """
    try:
        found: dict[str, Any] = json.loads((place / CERTIFICATE).read_text(encoding="utf-8"))
        found["part"]["sha256"], found["base_mm"] + 0.0, found["layer"] + 0
    except (OSError, ValueError, TypeError, KeyError):
        raise InputError(f"{place / CERTIFICATE}: is no certificate of a layer") from None
    if found.get("format") != FORMAT:
        raise InputError(
            f"{place / CERTIFICATE}: is of the format {found.get('format')!r:.40}, not {FORMAT!r}: make the layer again"
        )
    return found


def publish(
    folder: Path, made: MadeLayer, certificate: Mapping[str, Any], before: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Publish a layer that passed, from the place where it was made.

    Parameters
    ----------
    folder
        Folder of the build.
    before
        Called when the layer lies on disk under its name and is not yet the current one: the journal's entry.

    Returns
    -------
    dict
        The content of ``current.json``.

    Raises
    ------
    InputError
        If the layer did not pass, or its files are not the ones that were verified.
    SettingsError
        If a layer of that name with other bytes is there.
    """
    if not made.passed or made.files is None:
        raise InputError(
            f"layer {made.wanted.layer + 1}: is not validated and cannot be published: {made.why}"
        )
    staged = made.files.folder.parent
    (staged / SETTINGS).write_text(values_as_toml(made.config), encoding="utf-8")
    (staged / CERTIFICATE).write_text(json_text(certificate), encoding="utf-8")
    for name, wanted in made.files.sha256.items():
        _check_hash(made.files.folder / name, wanted)
    _sync(staged)
    target = folder / LAYERS / made.wanted.name
    target.parent.mkdir(parents=True, exist_ok=True)
    fresh = not target.exists()
    if not fresh:
        for name, wanted in made.files.sha256.items():
            _check_hash(target / PROGRAM / name, wanted)
        shutil.rmtree(staged)
    else:
        os.rename(staged, target)
    _sync_folder(target.parent)
    current = current_of(certificate)
    wrong = current_off(target / PROGRAM, folder / str(current["program"]), current, certificate)
    if wrong:
        if fresh:
            shutil.rmtree(target)
        raise InputError(
            f"layer {made.wanted.layer + 1}: the control would be told another {', '.join(wrong)}"
        )
    before()
    write_synced(folder / CURRENT, json_text(current))
    return current


def current_of(certificate: Mapping[str, Any]) -> dict[str, Any]:
    """What a control has to know of the layer that is to be called next."""
    name, called = certificate["name"], certificate["called"]
    return {
        "name": name,
        "layer": certificate["layer"],
        "base_mm": certificate["base_mm"],
        "thickness_mm": certificate["thickness_mm"],
        "travel_speed_mm_s": certificate["travel_speed_mm_s"],
        "program": f"{LAYERS}/{name}/{PROGRAM}/{called}",
        "sha256": certificate["files"][called],
        "wait_s": certificate["wait_s"],
        "layer_s": certificate["layer_s"],
    }


def read_current(folder: Path) -> dict[str, Any] | None:
    """Return the layer that is to be called next; None before there is one."""
    try:
        found: dict[str, Any] = json.loads((folder / CURRENT).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return found


def write_synced(path: Path, text: str) -> None:
    """Write a file that is on disk, whole, when this returns."""
    temporary = path.with_name(f".{path.name}.new")
    with temporary.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
    _sync_folder(path.parent)


def _check_hash(path: Path, wanted: str) -> None:
    found = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "no file"
    if found != wanted:
        raise SettingsError(f"{path}: is not the file that was verified ({found[:12]}, not {wanted[:12]})")


def _sync(folder: Path) -> None:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
    for path in [*sorted(p for p in folder.rglob("*") if p.is_dir()), folder]:
        _sync_folder(path)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def tilted(before: Part, now: Part, config: Config, built_mm: float = 0.0) -> Config:
    """Settings of layers of a part that was built up to a height and is turned by the table; those given where the user turns it.

    Raises
    ------
    SettingsError
        If the control has no frames, or the table cannot turn the part so.
    """
    if not config.machine.rotary:
        return config
    part = config.part.model_copy(update={"on_table": on_table(before, now, built_mm)})
    config = config.model_copy(update={"part": part})
    checked_tilt(config, config.machine.control)
    tilt_of_config(config)
    return config


def tilt_of_config(config: Config) -> Tilt | None:
    """How the program turns the table; None where it turns none."""
    return tilt_of(config, BlockFormat(config.machine.printed_decimals))


def told_of_table(config: Config) -> dict[str, Any]:
    """What a certificate tells of a table: positions of its axes, zero and turn of the frame; nothing where nothing is turned."""
    tilt = tilt_of_config(config)
    if tilt is None:
        return {}
    names = [axis.name for axis in config.machine.rotary]
    return {
        "table": {
            "positions_deg": dict(zip(names, tilt.positions_deg, strict=True)),
            "frame_zero_mm": tilt.zero_mm.tolist(),
            "frame_turn_deg": tilt.turn_deg,
            "turns_at_z_mm": tilt.up_mm,
        }
    }

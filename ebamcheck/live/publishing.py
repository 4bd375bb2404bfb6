"""Publishing a layer, whole and on disk or not at all: its program under a new name, its settings and certificate; and the journal
of a build.

What is told beside a layer no gate judges: server and `verify` look at it once more. Each line of the journal carries the hash of
the last."""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import json_text, plain, sha256_of_file, sha256_of_json
from ebamcheck.live.making import LayerMaker, MadeLayer
from ebamcheck.nc.control import control
from ebamcheck.nc.files import LONGEST_NAME
from ebamcheck.result import gate_record
from ebamcheck.settings.checking import values_as_toml
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import nominal_wire_speed_mm_s
from ebamcheck.version import __version__
from ebamcheck.writing.blocks import BlockFormat
from ebamcheck.writing.table import tilt_of

CERTIFICATE, SETTINGS, PROGRAM = "layer.json", "settings.toml", "program"  # of a published layer
LAYERS, CURRENT, JOURNAL = "layers", "current.json", "journal.jsonl"  # in the folder of a build
FORMAT = "ebamcheck layer 2"  # format of a certificate: it counts layers from 1, as the layer's name does; format 1 counted them from 0
# What a control is told of a layer that stands in its certificate, too
SAID = ("layer", "base_mm", "thickness_mm", "travel_speed_mm_s", "wait_s", "layer_s")


def layer_name(program: str, layer: int, number: int) -> str:
    """Name of a layer's program: that of the run, the number of the layer of that index, from 1, and how often it was made.

    >>> layer_name("MAIN", 35, 2)
    'MAIN_K0036R2'
    """
    name = f"{program[:10]}_K{layer + 1:04d}R{number}"
    if len(name) > LONGEST_NAME - len("_L0001"):
        said = f"the name {name!r} is too long for the control"
        raise SettingsError(f"layer {layer + 1}, number {number}: {said}")
    return name


def certificate_of(made: MadeLayer, maker: LayerMaker, measured: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What is known of a made layer, and was `measured` under it, as its certificate holds it: nothing of the clock."""
    wanted, after, config, part, files = made.wanted, made.after, made.config, maker.part, made.files
    assert after.below is not None
    # The subprogram is called, or the one file of a control without subprograms.
    calls = bool(control(config.machine.control).subprogram_suffix) and len(files.names) > 1
    fields = {
        "format": FORMAT,
        "software": __version__,
        "name": wanted.name,
        "layer": wanted.layer + 1,
        "shifted": wanted.shifted,
        "base_mm": wanted.base_mm,
        "thickness_mm": wanted.thickness_mm,
        "top_mm": wanted.top_mm,
        "cut_mm": made.cut_mm,
        "travel_speed_mm_s": config.process.travel_speed_mm_s,
        "wire_speed_mm_s": nominal_wire_speed_mm_s(config, wanted.thickness_mm),
        "direction": part.direction,
        "control": config.machine.control,
        "part": {"name": part.name, "sha256": part.source_sha256 or part.sha256, "mesh_sha256": part.sha256},
        "settings_sha256": sha256_of_json(config.model_dump()),
        "primary": maker.primary,
        "witness": maker.witness,
        "islands": made.islands,
        "metal_so_far": asdict(after.below),
        "spent": asdict(after.spent),
        "wait_s": made.wait_s,
        "layer_s": made.deposit_s,
        "leave_k": after.surface_k,
        "gates": [gate_record(gate) for gate in made.gates],
        "checks": len(made.checks),
        "called": files.names[calls],
        "files": dict(files.sha256),
        "validated": made.passed,
    }
    if (tilt := tilt_of(config, BlockFormat(config.machine.printed_decimals))) is not None:
        names = [axis.name for axis in config.machine.rotary]
        fields["table"] = {
            "positions_deg": dict(zip(names, tilt.positions_deg, strict=True)),
            "frame_zero_mm": tilt.zero_mm.tolist(),
            "frame_turn_deg": tilt.turn_deg,
            "turns_at_z_mm": tilt.up_mm,
        }
    return dict(plain(fields | dict(measured or {})))


def read_certificate(place: Path) -> dict[str, Any]:
    """Return the certificate of a layer in its folder; refused is what is none, or of a format that counts layers otherwise."""
    try:
        found: dict[str, Any] = json.loads((place / CERTIFICATE).read_text(encoding="utf-8"))
        found["part"]["sha256"], found["base_mm"] + 0.0, found["layer"] + 0
    except (OSError, ValueError, TypeError, KeyError):
        raise InputError(f"{place / CERTIFICATE}: is no certificate of a layer") from None
    if found.get("format") != FORMAT:
        said = f"is of the format {found.get('format')!r:.40}, not {FORMAT!r}: make the layer again"
        raise InputError(f"{place / CERTIFICATE}: {said}")
    return found


def publish(
    folder: Path, made: MadeLayer, certificate: Mapping[str, Any], before: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Publish a layer that passed, from the place where it was made, in the folder of the build; the content of ``current.json``.

    `before` is called when it lies on disk under its name and is not yet the current one. Refused is one that did not pass, one of
    which the control would be told what is not so, and files that are not those that were verified."""
    layer = f"layer {made.wanted.layer + 1}"
    if not made.passed:
        raise InputError(f"{layer}: is not validated and cannot be published: {made.why}")
    staged = made.files.folder.parent
    (staged / SETTINGS).write_text(values_as_toml(made.config), encoding="utf-8")
    (staged / CERTIFICATE).write_text(json_text(certificate), encoding="utf-8")
    _check_hashes(made.files.folder, made.files.sha256)
    for path in sorted(staged.rglob("*")):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
    for path in [*sorted(p for p in staged.rglob("*") if p.is_dir()), staged]:
        _sync_folder(path)
    target = folder / LAYERS / made.wanted.name
    target.parent.mkdir(parents=True, exist_ok=True)
    if fresh := not target.exists():
        os.rename(staged, target)
    else:
        _check_hashes(target / PROGRAM, made.files.sha256)
        shutil.rmtree(staged)
    _sync_folder(target.parent)
    current = current_of(certificate)
    wrong = current_off(target / PROGRAM, folder / str(current["program"]), current, certificate)
    if wrong:
        if fresh:
            shutil.rmtree(target)
        raise InputError(f"{layer}: the control would be told another {', '.join(wrong)}")
    before()
    write_synced(folder / CURRENT, json_text(current))
    return current


def current_of(certificate: Mapping[str, Any]) -> dict[str, Any]:
    """What a control has to know of the layer that is to be called next."""
    name, called = certificate["name"], certificate["called"]
    program, sha256 = f"{LAYERS}/{name}/{PROGRAM}/{called}", certificate["files"][called]
    return {"name": name, "program": program, "sha256": sha256, **{key: certificate[key] for key in SAID}}


def current_off(place: Path, program: Path, current: Mapping[str, Any], paper: Mapping[str, Any]) -> list[str]:
    """What a control is told in `current` that is not so, by the file that it is to call and the certificate; empty where all
    is."""
    inside = program.parent == place and program.is_file()
    wanted: dict[str, Any] = {key: paper.get(key) for key in SAID}
    wanted |= {"name": place.parent.name, "sha256": sha256_of_file(program) if inside else None}
    return [key for key, value in wanted.items() if value is None or current.get(key) != value]


def ended_early(height_mm: float, at_mm: float, config: Config) -> str:
    """Why a build that is said to be done at a height is not; empty where what is left is less than the process can lay."""
    process = config.process
    wire_mm3_s = process.wire_speed_min_mm_s * math.pi * process.wire_diameter_mm**2 / 4.0
    by_wire_mm = wire_mm3_s / (process.travel_speed_mm_s * process.bead_width_mm * process.bead_spacing)
    least_mm = max(process.layer_over_bead[0] * process.bead_height_mm, by_wire_mm)
    if height_mm - at_mm < least_mm:
        return ""
    return f"the build is said to be done at {at_mm:.3f} mm, the part is {height_mm:.3f} mm high"


def read_current(folder: Path) -> dict[str, Any] | None:
    """Return the layer that is to be called next; None before there is one."""
    path = folder / CURRENT
    found: dict[str, Any] | None = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
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


def _check_hashes(folder: Path, files: Mapping[str, str]) -> None:
    for path, wanted in ((folder / name, sha256) for name, sha256 in files.items()):
        found = sha256_of_file(path) if path.is_file() else "no file"
        if found != wanted:
            hashes = f"{found[:12]}, not {wanted[:12]}"
            raise SettingsError(f"{path}: is not the file that was verified ({hashes})")


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


JOURNAL_FORMAT = "ebamcheck journal 2"  # counts layers from 1; journals without a format counted from 0
FIRST = "0" * 64  # in place of a hash in the first line


class Journal(AbstractContextManager["Journal"]):
    """A journal that is written to; locked against a second writer."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            said = "another `ebamcheck live` writes to it: end that one first"
            raise SettingsError(f"{path}: {said}") from None
        try:
            self._last, whole, self.lines = FIRST, 0, 0
            for line, _ in _lines(path):
                self._last = hashlib.sha256(line).hexdigest()
                whole, self.lines = whole + len(line), self.lines + 1
            self._file.truncate(whole)
        except BaseException:
            self._file.close()
            raise

    def __exit__(self, *_: object) -> None:
        """Close the file and let go of the lock."""
        self._file.close()

    close = __exit__

    def append(self, entry: Mapping[str, Any]) -> None:
        """Add a line; it is on disk when this returns."""
        text = json.dumps(plain({**entry, "after": self._last}), sort_keys=True, separators=(",", ":"))
        line = text.encode() + b"\n"
        self._file.write(line)
        self._file.flush()
        os.fsync(self._file.fileno())
        self._last, self.lines = hashlib.sha256(line).hexdigest(), self.lines + 1


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Entries of a journal, from the first; a last line that a kill has cut off is left out, a damaged one raises
    :class:`InputError`."""
    return (entry for _, entry in _lines(path))


def _lines(path: Path) -> Iterator[tuple[bytes, dict[str, Any]]]:
    last = FIRST
    try:
        file = regular_file(path).open("rb")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    with file:
        for number, line in enumerate(file, 1):
            if not line.endswith(b"\n"):
                return
            try:
                entry = json.loads(line)
                after = entry["after"]
            except (ValueError, KeyError, TypeError):
                raise InputError(f"{path}:{number}: is no line of a journal") from None
            if after != last:
                said = "does not follow the line before: one was changed or is missing"
                raise InputError(f"{path}:{number}: {said}")
            last = hashlib.sha256(line).hexdigest()
            yield line, entry

"""Writing a program with the writer of the machine's control, whole, or beginning at a layer."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ebamcheck.errors import SettingsError
from ebamcheck.nc.control import control
from ebamcheck.nc.files import ProgramFiles, block_count
from ebamcheck.nc.inputs import CurveColumns, ScanColumns
from ebamcheck.settings.config import Config


def write_program(
    curves: CurveColumns, plan: ScanColumns, config: Config, folder: str | Path, *, validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:  # fmt: skip
    """Write the program of a stack for ``machine.control``, an entry point of the group ``ebamcheck.controls``.

    Parameters
    ----------
    curves
        Centre lines of the contour beads, mm.
    plan
        Islands, their order and their hatch vectors.
    config
        The machine and process sections say all that is not geometry.
    folder
        Is replaced as a whole by the program, or stays as it was.
    validated
        Status of every file; see :func:`mark_validated` for the order in which a run does it.
    header
        Further lines ``KEY: VALUE`` of the program's comment block (part hash, commit).

    Returns
    -------
    ProgramFiles
        Folder, names and hashes of the files.

    Raises
    ------
    SettingsError
        If no post-processor has that name, curves and plan are of different stacks, heights do not rise, a name
        is not legal, a template makes no block, or the control does not have the form of curves asked for.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import ebamcheck
    >>> from ebamcheck.scan import plan_stack
    >>> from ebamcheck_models import CUBE
    >>> layers = ebamcheck.slice(CUBE.tessellate(0.1), [1.0, 3.0])
    >>> config = ebamcheck.Config(machine={"control": "linuxcnc"}, layers={"layer_height_mm": 2.0})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_program(ebamcheck.fit(layers), plan_stack(layers, config), config, Path(folder) / "program").names
    ('MAIN.ngc',)
    """
    post = control(config.machine.control).load("writer")
    files: ProgramFiles = post(curves, plan, config, folder, validated=validated, header=header)
    return files


# -- going on after a break: the same layers, without those before ---------------------------------------
# Each layer sets its own modes and values, so that its blocks are those of the whole program, byte for byte.
_CALL = re.compile(r"N\d+ (\S+_L\d+)")
_LAYER = re.compile(r"(?:; |\()LAYER: (\d+) OF (\d+)\b.*")


def check_entry(layer: int, config: Config) -> None:
    """Refuse to begin at a layer (from 1) of a build that preheats: the plate's preheating belongs before its first one."""
    if layer > 1 and config.preheat.when != "off":
        what = "which belongs to a build from the plate: set it to 'off'"
        raise SettingsError(f"--from-layer {layer}: preheat.when is {config.preheat.when!r}, {what}")


def begin_at_layer(files: ProgramFiles, layer: int) -> ProgramFiles:
    """Take the layers before `layer` (from 1) out of a program that was written, which says so; SettingsError where it has no such
    layer.

    It is no proof of the part: checks of the whole miss the layers left out.
    """
    lines = files.main.read_text(encoding="ascii").split("\n")
    calls = [i for i, line in enumerate(lines) if _CALL.fullmatch(line)]
    heads = [i for i, line in enumerate(lines) if _LAYER.fullmatch(line)]
    begins = calls or heads
    if not 1 <= layer <= len(begins):
        raise SettingsError(f"layer {layer}: the program has layers 1 to {len(begins)}")
    gone = {f"{lines[i].split()[1]}.SPF" for i in calls[: layer - 1]}
    said = f"ENTRY: AT LAYER {layer} OF {len(begins)}, THE LAYERS BEFORE IT ARE LEFT OUT"
    at = next(i for i, line in enumerate(lines) if line.startswith(("; LAYERS:", "(LAYERS:")))
    kept = [*lines[: begins[0]], *lines[begins[layer - 1] :]]
    kept.insert(at + 1, f"({said})" if lines[at].startswith("(") else f"; {said}")
    files.main.write_text("\n".join(kept), encoding="ascii", newline="\n")
    for name in gone:
        (files.folder / name).unlink()
    names = tuple(name for name in files.names if name not in gone)
    main = files.names[0]
    sha256 = {name: files.sha256[name] for name in names}
    sha256[main] = hashlib.sha256(files.main.read_bytes()).hexdigest()
    blocks = {name: files.blocks[name] for name in names} | {main: block_count("\n".join(kept))}
    return replace(files, names=names, sha256=sha256, blocks=blocks)

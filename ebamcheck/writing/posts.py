"""Writing a program with the writer of the machine's control."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ebamcheck.nc.control import control
from ebamcheck.nc.files import ProgramFiles
from ebamcheck.nc.inputs import CurveColumns, ScanColumns
from ebamcheck.settings.config import Config


def write_program(
    curves: CurveColumns,
    plan: ScanColumns,
    config: Config,
    folder: str | Path,
    *,
    validated: bool = False,
    header: Mapping[str, str] | None = None,
) -> ProgramFiles:
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

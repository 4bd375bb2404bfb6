"""Independent reader of programs: text in, motions out. It shares no code with the post-processors.

It knows the languages that a validated program may use, and refuses every other word with its line and
column: a word that is skipped is a path that is not checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.nc.control import Control, controls
from ebamcheck.nc.motions import NCProgram
from ebamcheck.regular_file import regular_file
from ebamcheck.settings.config import Config

TABLE_TITLES = (b"Mode\t", b"Mode X(m)", b"Number of path segments")
"""First lines of path tables."""


def read_program(
    path: str | Path, config: Config | None = None, *, bspline_shift: Literal[2, 3, "uniform"] | None = None
) -> NCProgram:
    """Read a program from its main file, or from the folder that holds it and its subprograms.

    Parameters
    ----------
    path
        ``.MPF`` (or ``.SPF``) file of a SINUMERIK, ``.ngc`` of LinuxCNC, ``.gcode``, ``.nc`` or ``.g`` of plain
        G-code, or a folder with exactly one of them that is no ``.SPF``.
    config
        Its machine section holds the beam and wire templates; None: the default profile.
    bspline_shift
        Which knot interval a BSPLINE block's PL carries (2 or 3, or "uniform" for none); None: as the
        machine profile says. What the header of the program says of it counts for nothing.

    Returns
    -------
    NCProgram
        Every motion with its curve (mm), feed (mm/min), beam and wire, and the place in the text that it comes from.

    Raises
    ------
    InputError
        ``FILE:line:column: ...`` for a word or block that is not understood; also where a file is missing.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "square.ngc"
    ...     _ = file.write_text("G21 G90 G94\\nG0 X0 Y0 Z5\\nG1 X10 F600\\nG1 Y10\\nM2\\n")
    ...     nc = read_program(file)
    >>> nc.lengths[1:].tolist(), nc.feed_mm_min[1:].tolist()
    ([10.0, 10.0], [600.0, 600.0])
    """
    config = config or Config()
    known = {name: control for name, control in controls().items() if control.is_read}
    main = _main_file(Path(path), known)
    control = _control_of(main, config, known)
    options = {} if bspline_shift is None else {"bspline_shift": bspline_shift}
    nc: NCProgram = control.load("reader")(main, config, **options)
    return nc


def _main_file(path: Path, controls: Mapping[str, Control]) -> Path:
    if not path.is_dir():
        return path
    endings = [s for c in controls.values() for s in c.suffixes if s != c.subprogram_suffix]
    mains = sorted(p for p in path.iterdir() if p.suffix.upper() in endings)
    if len(mains) != 1:
        raise InputError(f"{path}: holds {len(mains)} main programs ({', '.join(endings)}); name one of them")
    return mains[0]


def _control_of(path: Path, config: Config, controls: Mapping[str, Control]) -> Control:
    """The control of a file: by its first bytes, by its ending, the one of the profile first, else that of the profile."""
    try:
        with regular_file(path).open("rb") as file:
            begin = file.readline(40)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if begin.startswith(TABLE_TITLES):
        raise InputError(
            f"{path}:1:1: the path table of a heat simulator is an export, no program to be read"
        )
    marked = [c for c in controls.values() if c.mark and begin.startswith(c.mark)]
    ending = [c for c in controls.values() if path.suffix.upper() in c.suffixes]
    own = controls.get(config.machine.control)
    if own is not None and (own in marked or not marked) and (own in ending or not ending):
        return own
    if found := marked or ending:
        return found[0]
    raise SettingsError(f"{path}: machine.control {config.machine.control!r} is none whose programs are read")

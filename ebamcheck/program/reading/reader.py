"""Independent reader of programs: text in, motions out. It shares no code with the post-processors.

It knows the languages that a validated program may use, and refuses every other word with its line and
column: a word that is skipped is a path that is not checked.
"""

from __future__ import annotations

from pathlib import Path

from ebamcheck.errors import InputError
from ebamcheck.program.controls.gcode.reading import GcodeReader
from ebamcheck.program.controls.sinumerik.reading import Shift, SinumerikReader
from ebamcheck.program.language.dialects import LINUXCNC, PLAIN, SINUMERIK
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config

DIALECTS = {
    ".MPF": SINUMERIK,
    ".SPF": SINUMERIK,
    ".NGC": LINUXCNC,
    ".GCODE": PLAIN,
    ".NC": PLAIN,
    ".G": PLAIN,
}
"""Language by the suffix of the main file; a SINUMERIK's header counts for more, and is the choice for others."""

TABLE_TITLES = (b"Mode\t", b"Mode X(m)", b"Number of path segments")
"""First lines of path tables."""

MAIN_SUFFIXES = tuple(suffix for suffix in DIALECTS if suffix != ".SPF")


def read_program(
    path: str | Path, config: Config | None = None, *, bspline_shift: Shift | None = None
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
        Which knot interval a BSPLINE block's PL carries (2 or 3, or "uniform" for none); None: as the header of
        the program states, else as the machine profile does.

    Raises
    ------
    InputError
        ``FILE:line:column: ...`` for a word or block that is not understood; also where a file is missing.
    """
    main = _main_file(Path(path))
    config = config or Config()
    dialect = _dialect(main)
    if dialect == SINUMERIK:
        sinumerik = SinumerikReader(main.parent, config, bspline_shift)
        sinumerik.run(main)
        return sinumerik.out.program()
    gcode = GcodeReader(main.parent, config, dialect)
    gcode.run(main)
    return gcode.out.program()


def _main_file(path: Path) -> Path:
    if not path.is_dir():
        return path
    mains = sorted(p for p in path.iterdir() if p.suffix.upper() in MAIN_SUFFIXES)
    if len(mains) != 1:
        raise InputError(
            f"{path}: holds {len(mains)} main programs ({', '.join(MAIN_SUFFIXES)}); name one of them"
        )
    return mains[0]


def _dialect(path: Path) -> str:
    try:
        with path.open("rb") as file:
            begin = file.readline(40)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if begin.startswith(TABLE_TITLES):
        raise InputError(
            f"{path}:1:1: the path table of a heat simulator is an export, no program to be read"
        )
    return SINUMERIK if begin.startswith(b"%_N") else DIALECTS.get(path.suffix.upper(), SINUMERIK)

"""Names and values that may stand in ``run.json`` and ``certificate.json``: of slicers, of files inside of the run folder, figures."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, JsonValue

from ebamcheck.findings import CODES
from ebamcheck.printable import printable

PRINTED = 60
"""Characters of a name or value that a message quotes."""


def file_inside(name: str) -> str:
    """Return the name of a file inside of a run folder, as ``run.json`` lists it; raises :class:`ValueError` for another.

    Examples
    --------
    >>> file_inside("program/MAIN.MPF")
    'program/MAIN.MPF'
    """
    if any(part in ("", ".", "..") for part in name.split("/")) or "\\" in name or printable(name) != name:
        raise ValueError(f"{printable(name, PRINTED)!r} is no name of a file inside of the run folder")
    return name


def plain_name(name: str) -> str:
    """Return the name of a file without a folder; raises :class:`ValueError` for another."""
    if "/" in name:
        raise ValueError(f"{printable(name, PRINTED)!r} is no plain file name")
    return file_inside(name)


def _slicer(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", name):
        raise ValueError(f"{printable(name, PRINTED)!r} is no name of a slicer")
    return name


def known_code(code: str) -> str:
    """Return the code of a finding; raises :class:`ValueError` for one that stands in no table."""
    if code not in CODES:
        raise ValueError(f"{printable(code, PRINTED)!r} is no code of a finding")
    return code


Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def part_file(name: str) -> str:
    """Return the name of a part's file, which is the user's choice, without a folder; raises :class:`ValueError` for another."""
    if "/" in name or "\0" in name or name in ("", ".", ".."):
        raise ValueError(f"{printable(name, PRINTED)!r} is no plain file name")
    return name


SlicerName = Annotated[str, AfterValidator(_slicer)]
RunFile = Annotated[str, AfterValidator(file_inside)]
FileName = Annotated[str, AfterValidator(plain_name)]
SettingsTables = dict[str, dict[str, JsonValue]]
Number = float | Literal["NaN", "Infinity", "-Infinity"]
Figures = dict[str, Number]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]

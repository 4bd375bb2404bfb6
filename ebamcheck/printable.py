"""What stands in messages: foreign text, which could tell a terminal to erase a line, made printable; and layers, which people
count from 1."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING, Any, TextIO

from ebamcheck.errors import SettingsError

if TYPE_CHECKING:
    import pandas as pd

# Categories of Unicode that move the cursor, hide or reorder text: controls, formats, surrogates, unassigned, line ends
UNPRINTABLE = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")

_BETWEEN = re.compile(r"[^\n\t -~]+")
_SUSPECT = re.compile(r"[^ -~]")


def printable(text: object, most: int | None = None) -> str:
    r"""Write control characters, line ends and what reorders text as escapes; every other character stays.

    >>> printable("Jane\x1b[2K Doe\n\u202e"), printable("Jürgen"), printable("x" * 99, most=8)
    ('Jane\\x1b[2K Doe\\n\\u202e', 'Jürgen', 'xxxxx...')
    """
    found = _SUSPECT.sub(_escaped, str(text))
    return found if most is None or len(found) <= most else found[: most - 3] + "..."


class PrintableStream:
    """A text stream to which line ends and tabs alone go as they are, of all characters that :func:`printable` escapes."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text, made printable line by line; returns the number of characters written."""
        return self._stream.write(_BETWEEN.sub(lambda found: printable(found.group()), text))

    def __getattr__(self, name: str) -> Any:
        """Return what the stream itself has."""
        return getattr(self._stream, name)


def _escaped(found: re.Match[str]) -> str:
    character = found.group()
    if unicodedata.category(character) not in UNPRINTABLE:
        return character
    return character.encode("unicode_escape").decode("ascii")


def numbered(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table as a person opens it: its column `layer`, an index, counts from 1; one without layers stays as it is.

    >>> import pandas as pd
    >>> numbered(pd.DataFrame({"layer": [0, 1]}))["layer"].tolist()
    [1, 2]
    """
    return table.assign(layer=table["layer"] + 1) if "layer" in table else table


def indexed(table: pd.DataFrame) -> pd.DataFrame:
    """Take back :func:`numbered`, for a table that was read: its column `layer` is an index from 0."""
    return table.assign(layer=table["layer"] - 1) if "layer" in table else table


def index_of_number(number: int, layers: int, option: str = "--layer") -> int:
    """Index of the layer that an option names by its number.

    >>> index_of_number(12, 12)
    11
    """
    if not 1 <= number <= layers:
        why = "layers are counted from 1, as in the names of the program's files: " if number == 0 else ""
        raise SettingsError(f"{option} {number}: {why}the run has the layers 1 to {layers}")
    return number - 1

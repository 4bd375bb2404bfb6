"""Foreign text made printable: names and messages that come from files, on one line and without control characters.

A terminal obeys what is written to it: a name with an escape sequence in it can erase a line that says FAIL.
"""

from __future__ import annotations

import re
import unicodedata
from typing import Any, TextIO

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

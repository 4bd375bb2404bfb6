"""The journal of a build: what came in, what was decided and what was made, one line each, on disk before it is published.

Each line carries the hash of the one before, so that a line that was changed or lost shows. A line that a kill has cut off
is the last one and never told anything that was published; it goes when the build goes on.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import plain
from ebamcheck.regular_file import regular_file

FORMAT = "ebamcheck journal 2"
"""Of the first line: its entries count layers from 1; those of a journal without a format counted them from 0."""

FIRST = "0" * 64
"""In place of a hash in the first line."""


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
            raise SettingsError(
                f"{path}: another `ebamcheck live` writes to it: end that one first"
            ) from None
        try:
            self._last, whole, self.lines = FIRST, 0, 0
            for line, _ in _lines(path):
                self._last, whole, self.lines = _hash(line), whole + len(line), self.lines + 1
            self._file.truncate(whole)
        except BaseException:
            self._file.close()
            raise

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file and let go of the lock."""
        self._file.close()

    def append(self, entry: Mapping[str, Any]) -> None:
        """Add a line; it is on disk when this returns."""
        text = json.dumps(plain({**entry, "after": self._last}), sort_keys=True, separators=(",", ":"))
        line = text.encode() + b"\n"
        self._file.write(line)
        self._file.flush()
        os.fsync(self._file.fileno())
        self._last, self.lines = _hash(line), self.lines + 1


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Entries of a journal, from the first; a last line that a kill has cut off is left out, a damaged one raises :class:`InputError`."""
    for _, entry in _lines(path):
        yield entry


def check_format(first: Mapping[str, Any], path: Path) -> None:
    """Refuse to go on with a journal of another format, by its first entry."""
    if first.get("format") != FORMAT:
        raise InputError(
            f"{path}: is of an earlier version of ebamcheck, which counted layers from 0: end that build with it, or give another "
            "folder with -o"
        )


def _lines(path: Path) -> Iterator[tuple[bytes, dict[str, Any]]]:
    last, number = FIRST, 0
    try:
        file = regular_file(path).open("rb")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    with file:
        for line in file:
            number += 1
            if not line.endswith(b"\n"):
                return
            try:
                entry = json.loads(line)
                after = entry["after"]
            except (ValueError, KeyError, TypeError):
                raise InputError(f"{path}:{number}: is no line of a journal") from None
            if after != last:
                raise InputError(
                    f"{path}:{number}: does not follow the line before: one was changed or is missing"
                )
            last = _hash(line)
            yield line, entry


def _hash(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()

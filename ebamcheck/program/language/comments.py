"""What the comments of a program say: its header, and nothing of its motions."""

from __future__ import annotations

import re

from ebamcheck.program.reading.recorder import Recorder

_KEY = re.compile(r"\s*([^:]+):\s*(.*?)\s*")


def read_header(comment: str, into: Recorder) -> None:
    """Read ``KEY: VALUE``; the first value of a key counts."""
    key = _KEY.fullmatch(comment)
    if key:
        into.header.setdefault(key[1], key[2])

"""What the comments of a program say: its header, the layer, and the role of the motions that follow."""

from __future__ import annotations

import re

from ebamcheck.program.recorder import Recorder

_ROLE = re.compile(r"\s*(RING|ISLAND)\s*:?\s*(\d+)\s*")
_KEY = re.compile(r"\s*([^:]+):\s*(.*?)\s*")


def role_of(comment: str) -> tuple[int, int] | None:
    """Ring and island that ``RING 3`` or ``ISLAND: 5`` names, -1 for the other; None for another comment."""
    role = _ROLE.fullmatch(comment)
    if not role:
        return None
    number = int(role[2])
    return (number, -1) if role[1] == "RING" else (-1, number)


def read_header(comment: str, into: Recorder) -> None:
    """Read ``KEY: VALUE``; the first value of a key counts."""
    key = _KEY.fullmatch(comment)
    if key:
        into.header.setdefault(key[1], key[2])


def is_turn(comment: str) -> bool:
    """Whether the motion is a turn between two hatch lines."""
    return comment.strip() == "TURN"


def goes_on(comment: str) -> bool:
    """Whether the motion is a further part of the hatch line before it, at another power."""
    return comment.strip() == "GOES ON"

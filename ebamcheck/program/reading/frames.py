"""Frames as a SINUMERIK takes them: TRANS and ROT begin anew, ATRANS and AROT go on from the frame in force.

Source: Siemens NC Programming manual 12/2019, section 2.12. A turn about one axis, or by RPL in the plane G17, is counter-clockwise
for one who looks against the axis. Turns about several axes in one block depend on a machine datum and are refused.
"""

from __future__ import annotations

import re

import numpy as np

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.language.words import NUMBER, WordError

NONE = np.eye(4)[:3]
"""No frame: turn and shift (3, 4)."""

_FRAME = re.compile(r"(A?TRANS|A?ROT)\s+(\S.*)")
_PART = re.compile(rf"\s*(?:([XYZ])\s*=?|(RPL)\s*=)\s*({NUMBER})")


def frame_after(code: str, frame: Floats) -> Floats | None:
    """Frame (3, 4) that is in force after a block; None where the block sets none.

    Raises
    ------
    WordError
        For a frame that is not read.

    Examples
    --------
    >>> frame_after("TRANS X10 Z5", NONE)[:, 3].tolist()
    [10.0, 0.0, 5.0]
    >>> (frame_after("AROT Z90", NONE)[:, 0] + 0.0).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    found = _FRAME.fullmatch(code.strip())
    if found is None:
        return None
    word, at, parts = found[1], 0, dict[str, float]()
    while at < len(found[2]):
        part = _PART.match(found[2], at)
        if part is None:
            raise WordError(f"{found[2][at:].split()[0]!r} is no part of a frame", found.start(2) + at)
        name = part[1] or part[2]
        if name in parts:
            raise WordError(f"{name} stands twice in one block", found.start(2) + at)
        parts[name], at = float(part[3]), part.end()
    base = NONE if word in ("TRANS", "ROT") else frame
    if word.endswith("TRANS"):
        if "RPL" in parts:
            raise WordError(f"RPL belongs to ROT and AROT, not to {word}", 0)
        own = np.hstack([np.eye(3), [[parts.get(axis, 0.0)] for axis in "XYZ"]])
    else:
        if len(parts) > 1:
            raise WordError(
                f"{word} about several axes: their order is a datum of the machine, turn one by one", 0
            )
        (name, angle), *_ = parts.items()
        own = np.hstack(
            [_about("XYZ".index(name) if name != "RPL" else 2, np.radians(angle)), np.zeros((3, 1))]
        )
    return np.asarray(base @ np.vstack([own, [[0.0, 0.0, 0.0, 1.0]]]), np.float64)


def _about(axis: int, angle_rad: float) -> Floats:
    """Turn (3, 3) about X, Y or Z."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(angle_rad)
    turn[i, j], turn[j, i] = -np.sin(angle_rad), np.sin(angle_rad)
    return turn

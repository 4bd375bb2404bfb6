"""Columns of integers as short text: differences, zigzag, groups of seven bits, deflated, in base 64; ``src/columns.js`` reads them."""

from __future__ import annotations

import base64
import re
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.kernels import Ints

STEP_MM = 0.001
"""Step of all coordinates: far below a machine's, so that nobody sees it."""

NUMBER_STEP = 10
"""Difference of block numbers that needs no digits: a block that follows by it begins with one character in place of its number."""

_NUMBER = re.compile(r"N(\d+) ")
_GROUPS = 10  # groups of seven bits that hold any 64


def quantised(values: ArrayLike, step: float = STEP_MM) -> Ints:
    """Multiples of a step nearest to values; what is unknown is 0."""
    return np.rint(np.nan_to_num(np.asarray(values, np.float64), posinf=0.0, neginf=0.0) / step).astype(np.int64)


def packed(columns: Mapping[str, Ints]) -> str:
    """Columns by their names as one text.

    Examples
    --------
    >>> len(packed({"x": np.arange(1000)})) < 100
    True
    """
    return deflated(b"".join(_column(name, np.asarray(values, np.int64)) for name, values in columns.items()))


def packed_text(data: bytes) -> str:
    """The text of a file of a program; most block numbers cost one character."""
    lines, last = data.decode("latin-1").split("\n"), 0
    for k, line in enumerate(lines):
        if number := _NUMBER.match(line):
            if int(number[1]) == last + NUMBER_STEP:
                lines[k] = f"\1{line[number.end() :]}"
            last = int(number[1])
    return deflated("\n".join(lines).encode("latin-1"))


def deflated(data: bytes) -> str:
    """Bytes without header, as ``DecompressionStream("deflate-raw")`` opens them, in base 64."""
    squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
    return base64.b64encode(squeeze.compress(data) + squeeze.flush()).decode("ascii")


def _column(name: str, values: Ints) -> bytes:
    label = name.encode("ascii")
    steps = np.diff(values, prepend=0)
    return bytes([len(label)]) + label + _groups(np.array([values.size])).tobytes() + _groups(steps).tobytes()


def _groups(values: Ints) -> NDArray[np.uint8]:
    """Zigzag numbers in groups of seven bits, the lowest first; the eighth bit says that another follows."""
    zigzag = ((values << 1) ^ (values >> 63)).astype(np.uint64)
    count = np.ones(values.size, np.int64)
    for k in range(1, _GROUPS):
        count += zigzag >= np.uint64(1) << np.uint64(7 * k)
    starts = np.cumsum(count) - count
    result = np.empty(int(count.sum()), np.uint8)
    for k in range(int(count.max(initial=0))):
        longer = count > k
        bits = (zigzag[longer] >> np.uint64(7 * k)) & np.uint64(127)
        result[starts[longer] + k] = bits + np.where(count[longer] > k + 1, 128, 0).astype(np.uint64)
    return result

"""What a worker tells its parent, checked at the border: words that are none, and floods of them, make it lost."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from ebamcheck.backend import Probe
from ebamcheck.plugins.processes import one_line

CHUNK_BYTES = 1 << 16
MOST_CHUNKS = 16
"""Chunks that are read of one worker before its limits and the other workers are looked at."""

LONGEST_LINE_BYTES = 1_000_000
"""An event is a line of a few hundred bytes."""

FLOOD_BYTES, FLOOD_BYTES_S = 4_000_000, 100_000
"""More than the first, and so much more for each second, is a flood: progress is some 1000 bytes a second."""

LONGEST_TEXT = 4000

LONGEST_NAME, MOST_NAMES = 200, 2000
"""Names of kernels that a worker compiles."""


class NoEvent(Exception):
    """A worker told something that is none of its words."""


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST_TEXT


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**53


def _is_amount(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and value >= 0.0


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST_NAME


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and len(value) <= MOST_NAMES and all(map(_is_name, value))


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _is_probe(value: Any) -> bool:
    if not isinstance(value, dict) or set(value) != {"available", "why", "hint", "versions", "device"}:
        return False
    versions = value["versions"]
    texts = [value["why"], value["hint"], value["device"]]
    if not (type(value["available"]) is bool and isinstance(versions, dict) and len(versions) < 100):
        return False
    return all(_is_text(text) for text in (*texts, *versions, *versions.values()))


FAILURES = ("unavailable", "refused", "crashed", "out of memory")
"""What a worker says of itself; what is seen from outside it cannot say."""

WORDS: Mapping[str, Callable[[Any], bool]] = {
    "done": _is_count,
    "probe": _is_probe,
    "error_bound_mm": _is_number,
    "height_bound_mm": _is_number,
    "prepare_s": _is_amount,
    "slice_s": _is_amount,
    "compile_s": _is_amount,
    "compiling": _is_name,
    "missing": _are_names,
    "peak_mb": _is_amount,
    "rings": _is_count,
    "open_paths": _is_count,
    "points": _is_count,
    "written": lambda value: value is True,
    "failure": lambda value: value in FAILURES,
    "why": lambda value: isinstance(value, str),
    "unwritable": lambda value: isinstance(value, str),
}
"""Every word of an event, and whether a value may stand behind it."""


def event_of(line: bytes) -> dict[str, Any]:
    """One event from one line; raises :class:`NoEvent` with what was found."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        raise NoEvent(f"told what is no event: {_shown(line)}") from None
    if not isinstance(event, dict) or not event:
        raise NoEvent(f"told what is no event: {_shown(line)}")
    for word, value in event.items():
        if word not in WORDS or not WORDS[word](value):
            raise NoEvent(
                f"told {one_line(word, 40)} = {one_line(repr(value), 60)}, which is no word of a worker"
            )
    for word in ("why", "unwritable"):
        if word in event:
            event[word] = one_line(event[word], LONGEST_TEXT)
    if "compiling" in event:
        event.setdefault("missing", [])
    if "failure" in event and "why" not in event:
        event["why"] = "it did not say why"
    return event


def bounds_fault(told: Mapping[str, Any], extent_mm: float) -> str:
    """What is wrong with declared bounds, in one line; empty if nothing.

    Parameters
    ----------
    told
        With ``error_bound_mm`` and ``height_bound_mm``.
    extent_mm
        Largest extent of the part: within a bound like that everything is a section of it.
    """
    for word, what in (("error_bound_mm", "error bound"), ("height_bound_mm", "height bound")):
        value = float(told.get(word, math.nan))
        if not 0.0 <= value < math.inf:
            return f"it declares an {what} of {value:g} mm: a bound is a number from 0 up".replace(
                "an h", "a h"
            )
        if value >= extent_mm > 0.0:
            return (
                f"it declares an {what} of {value:g} mm on a part of {extent_mm:g} mm: that promises nothing"
            ).replace("an h", "a h")
    return ""


def probe_of(told: Mapping[str, Any]) -> Probe:
    """The probe that a worker told of; one of no word where it came to none."""
    return Probe(**told["probe"]) if "probe" in told else Probe(False)


def _shown(line: bytes) -> str:
    return repr(one_line(line[:200].decode("utf-8", "replace"), 60))

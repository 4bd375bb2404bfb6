"""What becomes of a backend that slices: its file of layers and figures, or why it has none; and the events in which a worker tells it.

Events are checked on arrival: malformed ones, or floods of them, make the worker lost.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ebamcheck.backend import Probe
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.layers.stack import Layers
from ebamcheck.plugins.processes import one_line

Failure = Literal["", "unavailable", "refused", "crashed", "timed out", "out of memory", "killed"]
"""What can become of a backend but success."""


@dataclass(frozen=True)
class Limits:
    """What a backend's process may use, and how many there are at a time."""

    time_s: float = 600.0
    memory_mb: float = 8192.0
    processes: int | None = None
    """Processes side by side; None: as many as there are cores."""


@dataclass(frozen=True)
class Outcome:
    """What became of one backend."""

    name: str
    failure: Failure = ""
    why: str = ""
    file: Path | None = None
    """Where its layers lie; None where it failed."""
    probe: Probe = field(default_factory=lambda: Probe(False))
    error_bound_mm: float = 0.0
    height_bound_mm: float = 0.0
    rings: int = 0
    open_paths: int = 0
    points: int = 0
    prepare_s: float = 0.0
    slice_s: float = 0.0
    compile_s: float = 0.0
    """Time in which kernels were compiled; it is in none of the others."""
    peak_mb: float = 0.0

    def made(self) -> Path:
        """File of its layers; raises what it failed of."""
        if self.file is None:
            kind = BackendMissing if self.failure == "unavailable" else BackendFailed
            raise kind(f"backend {self.name!r} {self.failure}: {self.why}")
        return self.file

    def read(self) -> Layers:
        """Read all its layers; raises what it failed of."""
        from ebamcheck.layers.files import read_parquet

        return read_parquet(self.made())


CHUNK_BYTES = 1 << 16
MOST_CHUNKS = 16  # chunks that are read of one worker before its limits and the other workers are looked at
LONGEST_LINE_BYTES = 1_000_000  # an event is a line of a few hundred bytes

FLOOD_BYTES, FLOOD_BYTES_S = 4_000_000, 100_000
"""More than the first, and so much more for each second, is a flood: progress is some 1000 bytes a second."""

LONGEST_TEXT = 4000

_Text = Annotated[str, Field(max_length=LONGEST_TEXT)]
_Name = Annotated[str, Field(max_length=200)]
_Count = Annotated[int, Field(ge=0, lt=2**53)]
_Amount = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class NoEvent(Exception):
    """A worker told something that is none of its words."""


class _Told(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class _ProbeTold(_Told):
    available: bool
    why: _Text
    hint: _Text
    versions: Annotated[dict[_Text, _Text], Field(max_length=99)]
    device: _Text


class _Event(_Told):
    """Every word of an event, and what may stand behind it."""

    done: _Count = 0
    probe: _ProbeTold = _ProbeTold(available=False, why="", hint="", versions={}, device="")
    error_bound_mm: float = 0.0
    height_bound_mm: float = 0.0
    prepare_s: _Amount = 0.0
    slice_s: _Amount = 0.0
    compile_s: _Amount = 0.0
    compiling: _Name = ""
    """A kernel that is compiled, and with the first one those that are missing."""
    missing: Annotated[list[_Name], Field(max_length=2000)] = []
    peak_mb: _Amount = 0.0
    rings: _Count = 0
    open_paths: _Count = 0
    points: _Count = 0
    written: Literal[True] = True
    failure: Literal["unavailable", "refused", "crashed", "out of memory"] = "crashed"
    """What a worker says of itself; what is seen from outside it cannot say."""
    why: str = ""
    unwritable: str = ""


def event_of(line: bytes) -> dict[str, Any]:
    """One event from one line; raises :class:`NoEvent` with what was found."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        raise NoEvent(f"told what is no event: {_shown(line)}") from None
    if not isinstance(event, dict) or not event:
        raise NoEvent(f"told what is no event: {_shown(line)}")
    try:
        _Event.model_validate(event)
    except ValidationError as error:
        word = str(error.errors()[0]["loc"][0])
        raise NoEvent(
            f"told {one_line(word, 40)} = {one_line(repr(event[word]), 60)}, which is no word of a worker"
        ) from None
    for word in ("why", "unwritable"):
        if word in event:
            event[word] = one_line(event[word], LONGEST_TEXT)
    if "compiling" in event:
        event.setdefault("missing", [])
    if "failure" in event and "why" not in event:
        event["why"] = "it did not say why"
    return event


def bounds_fault(told: Mapping[str, Any], extent_mm: float) -> str:
    """What is wrong with declared bounds, in one line; empty if nothing: within a bound like the part's extent all is a section of it."""
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

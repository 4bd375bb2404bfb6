"""The time line of a program: what it switches, sets, calls and waits for, in the order of execution, and the state before each
event."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.codes import DWELL, VALUES
from ebamcheck.nc.words import SKIPPED
from ebamcheck.showing import short_text

PAUSE = "layer_pause_s"  # Event of a wait of the build, named by its placeholder; that of a template is DWELL
AXIS_EVENT = "table axis "  # Begin of the event of a commanded rotary axis; its value is the position


class Kind(IntEnum):
    """Kinds of events. A word of the control that is of no other kind is a WORD: a mode, mostly."""

    WORD = 0
    BEAM_ON = 1
    BEAM_OFF = 2
    WIRE_START = 3
    WIRE_STOP = 4
    VALUE = 5
    WAIT = 6
    STOP = 7
    CALL = 8
    END = 9
    TOLERANCE = 10
    SKIPPED = 11
    LACKS = 12
    NOT_ALONG = 13
    FRAME_LACKS = 14
    TABLE_AXIS = 15


# Kinds of events that have a name of their own.
BY_NAME = {
    "beam_on": Kind.BEAM_ON, "beam_off": Kind.BEAM_OFF, "wire_start": Kind.WIRE_START, "wire_stop": Kind.WIRE_STOP,
    SKIPPED: Kind.SKIPPED, **dict.fromkeys(VALUES, Kind.VALUE), **dict.fromkeys((PAUSE, DWELL), Kind.WAIT),
    **dict.fromkeys(("M0", "M1"), Kind.STOP), **dict.fromkeys(("M30", "M2", "M17", "RET"), Kind.END),
    **dict.fromkeys(("CTOL", "ADIS"), Kind.TOLERANCE),
}  # fmt: skip
# Kinds of events whose name says more behind its begin: a subprogram, a block, axes.
BY_BEGIN = {
    "call ": Kind.CALL,
    "lacks ": Kind.LACKS,
    "not along a bead ": Kind.NOT_ALONG,
    "frame lacks ": Kind.FRAME_LACKS,
    AXIS_EVENT: Kind.TABLE_AXIS,
}


@dataclass(frozen=True, eq=False)
class Events:
    """State changes in the order of execution, as columns (E,)."""

    file: Ints
    line: Ints
    row: Ints  # Motions before the event
    # Template that ends here (`beam_on`), placeholder that is set (`current_ma`), modal word, `call NAME`, or `BSPLINE` for each spline.
    name: tuple[str, ...]
    value: Floats  # Number that is set, blocks of the spline; NaN where there is none

    def __repr__(self) -> str:
        return short_text.line("Events", short_text.counted(len(self.name), "event"))

    def __len__(self) -> int:
        return len(self.name)

    @cached_property
    def _words(self) -> tuple[tuple[str, ...], Ints]:
        """Names that there are, and the place of each event's name among them."""
        place: dict[str, int] = {}
        code = np.array([place.setdefault(name, len(place)) for name in self.name], np.int64)
        return tuple(place), code

    @cached_property
    def kind(self) -> Ints:
        """Kind of each event (E,), by :class:`Kind`."""
        names, code = self._words
        begins = ((k for begin, k in BY_BEGIN.items() if name.startswith(begin)) for name in names)
        kinds = [BY_NAME.get(name, next(k, Kind.WORD)) for name, k in zip(names, begins, strict=True)]
        return np.array(kinds, np.int64)[code]

    def named(self, *wanted: str) -> Bools:
        """Events (E,) of these names."""
        names, code = self._words
        return np.array([name in wanted for name in names], np.bool_)[code]

    def said(self, event: int) -> str:
        """What the name of an event says behind its begin: the subprogram of a call."""
        name = self.name[event]
        return name.removeprefix(next((begin for begin in BY_BEGIN if name.startswith(begin)), ""))

    def chosen(self, which: Bools | Ints) -> Events:
        """Some of the events."""
        names = tuple(self.name[i] for i in np.arange(len(self))[which].tolist())
        return Events(self.file[which], self.line[which], self.row[which], names, self.value[which])

    def by_file(self) -> Iterator[Events]:
        """Events of each stay in a file, one after the other."""
        for run in np.split(np.arange(len(self)), np.flatnonzero(np.diff(self.file)) + 1):
            yield self.chosen(run)

    def latest(self, which: Bools) -> Ints:
        """Last event before each one, and before the end (E + 1,), that is marked in `which` (E,); -1 for none."""
        return np.maximum.accumulate(np.append(-1, np.where(which, np.arange(len(self)), -1)))

    def since(self, on: Bools, off: Bools) -> Bools:
        """Whether an event `on` (E,) came before each event, and before the end (E + 1,), and none `off` since."""
        return np.asarray(self.latest(on) > self.latest(off))

    @cached_property
    def beam(self) -> Bools:
        """Whether the beam is on before each event, and at the end, (E + 1,)."""
        return self.since(self.kind == Kind.BEAM_ON, self.kind == Kind.BEAM_OFF)

    @cached_property
    def wire(self) -> Bools:
        """Whether the wire runs before each event, and at the end, (E + 1,)."""
        return self.since(self.kind == Kind.WIRE_START, self.kind == Kind.WIRE_STOP)

    def set_before(self, name: str) -> Floats:
        """Value that a name has before each event, and at the end, (E + 1,); NaN before it is first set."""
        return np.append(self.value, np.nan)[self.latest(self.named(name))]

    def row_of_latest(self, which: Bools) -> Ints:
        """Motions before the last event that is marked, as :meth:`latest` has it, (E + 1,); -1 for none."""
        return np.append(self.row, -1)[self.latest(which)]

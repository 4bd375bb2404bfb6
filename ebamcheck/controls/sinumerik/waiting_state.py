"""What a waiting main program does beside waiting: the modes that it sets, what it switches, and its way out when the part is built.

Layers alone lay metal, each with a proof of its own. The program around them sets the modes of the profile before anything else,
switches nothing on, and moves once: up over all that stands and to the place where the tool is parked.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ebamcheck.checks.state_checks import TRANSFORMATION_OFF
from ebamcheck.checks.tolerances import PLACE_MM, VALUE_SHARE
from ebamcheck.controls.sinumerik.control import NAME
from ebamcheck.controls.sinumerik.reading import DIALECT
from ebamcheck.nc.codes import BEAM_VALUES
from ebamcheck.nc.conventions import safe_end_mm
from ebamcheck.nc.reader import AXES
from ebamcheck.nc.recorder import StateChange, Templates
from ebamcheck.nc.templates import checked_templates
from ebamcheck.nc.words import read_block, wanted_words
from ebamcheck.settings.config import Config

OFF = ("beam_off", "wire_stop")


class WaitingState:
    """State of the machine while a waiting main program of a part whose top is to lie at Z `top_mm` runs; each step tells its faults."""

    def __init__(self, config: Config, top_mm: float) -> None:
        known = checked_templates(config.machine, NAME)
        self.templates = Templates(known)
        self._used = {a.meaning for held in known.values() for _, actions in held for a in actions}
        self._machine = config.machine
        self._wanted = list(wanted_words(NAME, config.machine).values())
        self._least_mm = safe_end_mm(top_mm, config)
        self._most = {name: float(getattr(config.process, name)) for name in BEAM_VALUES}
        self._known: set[str] = set()
        self._values: dict[str, float] = {}
        self._place: dict[str, float] = {}

    def change(self, change: StateChange) -> Iterator[str]:
        """Do what a block of a template does."""
        for event, value in change.actions:
            if event in ("beam_on", "wire_start"):
                yield f"switches the {event.split('_')[0]} on, which layers alone do"
            elif event in OFF:
                self._known.add(event)
            else:
                self._values[event] = value
                if value > self._most.get(event, math.inf) * (1.0 + VALUE_SHARE):
                    yield f"sets {event} to {value:g}, the process has {self._most[event]:g}"

    def words(self, code: str) -> Iterator[str]:
        """Run a block of words of the control."""
        block, limit = read_block(code, DIALECT), self._machine.smoothing_tolerance_mm
        allowed = {"G0", "CTOL", *AXES, *self._wanted}
        yield from (
            f"{word} is no word of a program that waits"
            for word in (*block.codes, *block.values, *block.lists)
            if word not in allowed
        )
        if TRANSFORMATION_OFF in block.codes:
            self._known.discard(self._machine.work_offset)
        self._known |= {*block.codes, *block.values}
        tolerance = block.values.get("CTOL", limit)
        if not abs(tolerance - limit) <= VALUE_SHARE * limit:
            yield f"CTOL {tolerance:g} mm in place of {limit:g} mm"
        way = {axis: block.values[axis] for axis in AXES if axis in block.values}
        if not way:
            return
        yield from self.waits()
        if "G0" not in block.codes:
            yield "moves otherwise than by a rapid"
        if not self._place and set(way) != {"Z"}:
            yield "moves before it has risen over all that stands"
        self._place |= way
        if not self._place.get("Z", -self._least_mm) >= self._least_mm - PLACE_MM:
            yield f"goes to Z {self._place.get('Z', 0.0):g} mm, {self._least_mm:g} mm is over all that stands"

    def waits(self) -> Iterator[str]:
        """Let time go by, or a layer run."""
        lacking = next((word for word in (*self._wanted, "CTOL", *OFF) if word not in self._known), None)
        if lacking is not None:
            yield f"{lacking} is not set, or not commanded, before it waits, calls or moves"

    def calls(self) -> Iterator[str]:
        """Call a layer."""
        yield from self.waits()
        # A layer leaves values of its own.
        self._values |= dict.fromkeys(self._used & {*BEAM_VALUES, "wire_mm_s"}, math.nan)
        if self._place:
            yield "calls a layer after it has left for the place where the tool is parked"

    def ends(self) -> Iterator[str]:
        """End the program."""
        for name in (*BEAM_VALUES, "wire_mm_s"):
            if self._values.get(name, 0.0) != 0.0:
                yield f"{name} is not 0 at the end"
        x, y = self._machine.park_position_mm
        if (
            not math.dist((self._place.get("X", math.nan), self._place.get("Y", math.nan)), (x, y))
            <= 2.0 * PLACE_MM
        ):
            yield f"does not end at X {x:g} Y {y:g}, where the tool is to be parked"

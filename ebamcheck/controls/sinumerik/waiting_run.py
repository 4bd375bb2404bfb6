"""A waiting main program run block by block, as far as it needs: labels, jumps, R parameters, variables, waits, messages, calls.

What is not known here is refused, and what the program does beside waiting has rules of its own
(:mod:`ebamcheck.controls.sinumerik.waiting_state`). Nothing here is shared with what writes the program.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ebamcheck.controls.sinumerik.waiting_state import WaitingState
from ebamcheck.errors import InputError
from ebamcheck.nc.words import WordError
from ebamcheck.settings.config import Config

BLOCKS_A_POLL = 60
"""Blocks for each time that a program asks within the time-out after which one that has not ended is taken for one that never does."""

WRITTEN = (1, 2, 3, 11, 12)
"""R parameters that the other side writes, counted from ``machine.live_r``."""

BLOCK = re.compile(r"N(\d+) (?:([A-Z_][A-Z0-9_]+): )?(.+)")
_TOKEN = re.compile(r'\s*(R\d+|[A-Z_][A-Z0-9_]*|\d+\.?\d*|"[^"]*"|<<|==|<>|>=|<=|[-+*/<>(),])')
_SET = re.compile(r"(R\d+|[A-Z_][A-Z0-9_]+)=(?!=)(.+)")
_JUMP = re.compile(r"(?:IF (.+) )?GOTO([FB]) ([A-Z_][A-Z0-9_]+)")
_DEF = re.compile(r"DEF (?:INT|REAL|STRING\[(\d+)\]) ([A-Z_][A-Z0-9_]+)")

Door = Callable[["Run"], None]
"""What is on the other side: it sees the machine whenever time has gone by, and may set R parameters."""


@dataclass
class Run:
    """The machine while it runs a text."""

    door: Door
    watched: frozenset[str]
    """Parameters that the door writes: the control reads ahead unless STOPRE stands before."""
    values: dict[str, Any] = field(default_factory=dict)
    time_s: float = 0.0
    on: set[str] = field(default_factory=set)
    calls: list[tuple[str, float]] = field(default_factory=list)
    done: list[float] = field(default_factory=list)
    """Layers that were said to be done at each call."""
    room: dict[str, int] = field(default_factory=dict)
    """Characters that each string variable holds."""
    stops: list[tuple[str, float, bool]] = field(default_factory=list)
    """M0 or M30, when, and whether beam and wire were commanded off since time went by."""
    faults: list[tuple[int, str]] = field(default_factory=list)
    fresh: bool = False
    off: set[str] = field(default_factory=set)
    shown: str = ""
    line: int = 0

    def tell(self, faults: Iterator[str]) -> None:
        """Note what is wrong with the block that runs."""
        self.faults += [(self.line, what) for what in faults]

    def passes(self, seconds: float) -> None:
        """Let time go by: what was read or commanded before it is old then."""
        self.time_s += seconds
        self.fresh = False
        self.off.clear()
        self.door(self)


def run_text(
    text: str, door: Door, config: Config, most_blocks: int | None = None, top_mm: float = 0.0
) -> Run:
    """Run a text to its end; one that goes on for ever after a stop, or for `most_blocks`, is left there.

    `top_mm` is Z of the part's top, over which the program ends.

    Raises
    ------
    InputError
        For a block that is not understood, as ``LINE what``.
    """
    state = WaitingState(config, top_mm)
    first = config.machine.live_r
    counted = f"R{first}"
    run = Run(door, frozenset(f"R{first + k}" for k in WRITTEN))
    blocks = [
        (i, m[2] or "", m[3]) for i, line in enumerate(text.split("\n"), 1) if (m := BLOCK.fullmatch(line))
    ]
    labels = {label: k for k, (_, label, _) in enumerate(blocks) if label}
    run.door(run)
    machine = config.machine
    at, most = 0, int(BLOCKS_A_POLL * (machine.live_timeout_s / machine.live_poll_s + 100.0))
    most = most if most_blocks is None else most_blocks
    for _ in range(most):
        if at >= len(blocks) or (run.stops and (run.stops[-1][0] == "M30" or len(run.stops) > 1)):
            return run
        run.line, _, code = blocks[at]
        try:
            before, at = len(run.calls), _step(run, code.partition(" ;")[0].rstrip(), at, labels, state)
            run.done += [float(run.values.get(counted, 0.0))] * (len(run.calls) - before)
        except (WordError, ValueError, KeyError, TypeError, IndexError) as error:
            raise InputError(f"{run.line} {code!r} is not understood: {error}") from None
    run.faults.append((run.line, f"has not ended after {most} blocks"))
    return run


def _step(run: Run, code: str, at: int, labels: dict[str, int], state: WaitingState) -> int:
    """Run one block; return the next."""
    if jump := _JUMP.fullmatch(code):
        if jump[1] and not Expression(jump[1], run).value():
            return at + 1
        target = labels[jump[3]]
        if (target > at) != (jump[2] == "F"):
            raise ValueError(f"GOTO{jump[2]} leads the other way")
        return target
    if code == "STOPRE":
        run.fresh = True
    elif code in ("M0", "M30"):
        run.tell(state.waits() if code == "M0" else state.ends())
        run.stops.append((code, run.time_s, {"beam_off", "wire_stop"} <= run.off and not run.on))
        run.passes(1.0)
    elif found := re.fullmatch(r'MSG\((?:"([^"]*)")?\)', code):
        run.shown = found[1] or ""
    elif found := re.fullmatch(r"G4 F(=?)(.+)", code):
        seconds = float(Expression(found[2], run).value()) if found[1] else float(found[2])
        if seconds < 0.0:
            raise ValueError("waits a negative time")
        run.tell(state.waits())
        run.passes(seconds)
    elif found := re.fullmatch(r"CALL ([A-Z_][A-Z0-9_]+)", code):
        run.tell(state.calls())
        run.calls.append((str(run.values[found[1]]), run.time_s))
        run.passes(0.0)
    elif found := _DEF.fullmatch(code):
        run.values[found[2]] = "" if found[1] else 0
        run.room |= {found[2]: int(found[1])} if found[1] else {}
    elif change := state.templates.find(code):
        run.tell(state.change(change))
        for event, _ in change.actions:
            run.on |= {event} & {"beam_on", "wire_start"}
            if event in ("beam_off", "wire_stop"):
                run.off.add(event)
                run.on.discard("beam_on" if event == "beam_off" else "wire_start")
    elif (found := _SET.fullmatch(code)) and (re.fullmatch(r"R\d+", found[1]) or found[1] in run.values):
        _assign(run, found[1], Expression(found[2], run).value())
    else:
        run.tell(state.words(code))
    return at + 1


def _assign(run: Run, name: str, value: Any) -> None:
    """Give a parameter or a variable its value."""
    if name in run.watched and (run.time_s > 0.0 or run.calls):
        run.tell(iter([f"writes {name}, which the server writes: what it has released is lost"]))
    if len(str(value)) > run.room.get(name, len(str(value))):
        raise ValueError(f"{value!r} is longer than {name}")
    run.values[name] = value


class Expression:
    """An expression of the control: sums, comparisons, strings put together by ``<<``, SUBSTR and TRUNC."""

    def __init__(self, text: str, run: Run) -> None:
        self._tokens: list[str] = _TOKEN.findall(text)
        if "".join(self._tokens) != text.replace(" ", ""):
            raise ValueError(f"{text!r} is no expression")
        self._at, self._run = 0, run

    def value(self) -> Any:
        """Work it out."""
        left = self._joined()
        if self._next() in ("==", "<>", ">=", "<=", ">", "<"):
            sign, right = self._take(), self._joined()
            left = {
                "==": left == right, "<>": left != right, ">=": left >= right, "<=": left <= right,
                ">": left > right, "<": left < right,
            }[sign]  # fmt: skip
        if self._next():
            raise ValueError(f"{self._next()!r} is left over")
        return left

    def _next(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _take(self) -> str:
        self._at += 1
        return self._tokens[self._at - 1]

    def _joined(self) -> Any:
        value = self._sum()
        while self._next() == "<<":
            self._take()
            right = self._sum()
            if isinstance(right, float) and not right.is_integer():
                raise ValueError("a broken number in a name")
            value = f"{value}{right if isinstance(right, str) else int(right)}"
        return value

    def _sum(self) -> Any:
        value = self._product()
        while self._next() in ("+", "-"):
            sign, right = self._take(), self._product()
            value = value + right if sign == "+" else value - right
        return value

    def _product(self) -> Any:
        value = self._one()
        while self._next() in ("*", "/"):
            sign, right = self._take(), self._one()
            value = value * right if sign == "*" else value / right
        return value

    def _one(self) -> Any:
        token = self._take()
        if token == "-":
            return -self._one()
        if token.startswith('"'):
            return token[1:-1]
        if token[0].isdigit():
            return float(token)
        if token == "SUBSTR":
            text, start, count = self._arguments()
            return str(text)[int(start) : int(start) + int(count)]
        if token == "TRUNC":
            (number,) = self._arguments()
            return float(math.trunc(number))
        if token in self._run.watched and not self._run.fresh:
            self._run.faults.append(
                (self._run.line, f"{token} is read without STOPRE since time has gone by")
            )
        return self._run.values.get(token, 0.0) if re.fullmatch(r"R\d+", token) else self._run.values[token]

    def _arguments(self) -> list[Any]:
        found = []
        if self._take() != "(":
            raise ValueError("SUBSTR without its arguments")
        while True:
            found.append(self._joined())
            if self._take() == ")":
                return found

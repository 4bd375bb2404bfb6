"""The waiting main program judged by what it does: its text is run against doors that answer, are silent, late, or wrong.

A small machine runs the text block by block: labels, jumps, assignments of R parameters and variables, waits, messages, stops,
calls by name. What it does not know is refused, and what it does beside waiting has rules of its own
(:mod:`ebamcheck.program.controls.sinumerik.waiting_state`). It shares no code with the writer, and asks for nothing of how the loop is
written: what counts is which layers are called, when, and what is off when the program stops.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.program.checking.checks import Check, count_check
from ebamcheck.program.controls.sinumerik.waiting_state import WaitingState
from ebamcheck.program.language.words import WordError
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings

CHECK = "handshake"

BLOCKS_A_POLL = 60
"""Blocks for each time that a program asks within the time-out after which one that has not ended is taken for one that never does."""

ROUNDING_S = 1e-6
"""Of sums of times."""

LONGEST_BLOCK = 200
"""Characters of a block."""

_BLOCK = re.compile(r"N(\d+) (?:([A-Z_][A-Z0-9_]+): )?(.+)")
_TOKEN = re.compile(r'\s*(R\d+|[A-Z_][A-Z0-9_]*|\d+\.?\d*|"[^"]*"|<<|==|<>|>=|<=|[-+<>(),])')
_SET = re.compile(r"(R\d+|[A-Z_][A-Z0-9_]+)=(?!=)(.+)")
_JUMP = re.compile(r"(?:IF (.+) )?GOTO([FB]) ([A-Z_][A-Z0-9_]+)")
_DEF = re.compile(r"DEF (?:INT|STRING\[(\d+)\]) ([A-Z_][A-Z0-9_]+)")

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


def handshake_check(text: str, file: str, config: Config, top_mm: float) -> Check:
    """Judge the text of a waiting main program of a part whose top is to lie at a Z; see :func:`scenarios` for what it has to stand."""
    try:
        faults = [(f"{file}:{line}", what) for line, what in _faults(text, config, top_mm)]
    except InputError as error:
        where, _, what = str(error).partition(" ")
        faults = [(f"{file}:{where}", what)]
    return count_check(CHECK, faults, "the main program waits for released layers and for nothing else")


def _faults(text: str, config: Config, top_mm: float) -> Iterator[tuple[int, str]]:
    lines = text.split("\n")
    ends = [i for i, line in enumerate(lines, 1) if _BLOCK.fullmatch(line) and _code(line) == "M30"]
    if len(ends) != 1 or any(line.startswith("N") for line in lines[ends[0] :]):
        yield (ends[-1] if ends else len(lines)), f"{len(ends)} blocks M30: one ends the program"
        return
    for i, line in enumerate(lines, 1):
        if len(line) > LONGEST_BLOCK or not line.isascii():
            yield i, f"is no block of at most {LONGEST_BLOCK} ASCII characters"
    for name, door, wanted in scenarios(config):
        run = run_text(text, door, config, top_mm=top_mm)
        yield from run.faults[:1]
        what = wanted(run)
        if what:
            yield ends[0], f"{name}: {what}"


def _code(line: str) -> str:
    found = _BLOCK.fullmatch(line)
    return found[3] if found else ""


# -- doors -------------------------------------------------------------------------------------------


NUMBERS = (1, 2, 1)
"""Number of the program of each layer that a door releases."""

LONGER_S = 17.0
"""A wait that is longer than any other parameter is large: none may be taken for it."""


class Doors:
    """What may be on the other side of a waiting main program."""

    def __init__(self, machine: MachineSettings) -> None:
        self.done, self.released, self.number, self.wait = (f"R{machine.live_r + k}" for k in range(4))
        self.poll_s = machine.live_poll_s
        self.late_s = 3.0 * self.poll_s
        self.wait_s = self.late_s + LONGER_S

    def _releases(self, run: Run, wait_s: float, after_s: float) -> None:
        layer = int(run.values.get(self.done, 0)) + 1
        if run.calls and layer <= len(NUMBERS) and run.time_s < run.calls[-1][1] + after_s - ROUNDING_S:
            return
        if layer <= len(NUMBERS):
            run.values |= {self.number: NUMBERS[layer - 1], self.wait: wait_s}
        run.values[self.released] = layer if layer <= len(NUMBERS) else -1

    def good(self, run: Run) -> None:
        """Release each layer at once, with a long wait."""
        self._releases(run, self.wait_s, 0.0)

    def slow(self, run: Run) -> None:
        """Release each layer when its wait is long over."""
        self._releases(run, self.poll_s, self.late_s)

    def silent(self, run: Run) -> None:
        """Release nothing."""

    def old(self, run: Run) -> None:
        """Leave what a build of before left: it holds until the program has begun."""
        if not run.values:
            run.values |= {self.done: 4.0, self.released: 1.0, self.number: 9.0}

    def again(self, run: Run) -> None:
        """Release layers after a build of before."""
        self.old(run)
        if run.time_s > 0.0:
            self.good(run)

    def wrong(self, run: Run) -> None:
        """Release another layer than the next one."""
        run.values |= {self.released: int(run.values.get(self.done, 0)) + 2, self.number: 1}

    def late(self, run: Run) -> None:
        """Release layers after the time-out alone."""
        if run.stops:
            self.good(run)


def scenarios(config: Config) -> list[tuple[str, Door, Callable[[Run], str]]]:
    """Doors by name, and what is wrong with what the program did, empty if nothing."""
    machine = config.machine
    doors, stem = Doors(machine), machine.program_name[:10]

    def called(run: Run) -> str:
        return _called(run, stem, doors.wait_s, doors.wait_s + 2.0 * doors.poll_s)

    def resumed(run: Run) -> str:
        return called(run) if machine.live_late == "stop" else ""

    found: list[tuple[str, Door, Callable[[Run], str]]] = [
        ("released layers", doors.good, called),
        ("released layers after a build before", doors.again, called),
        ("a silent server", doors.silent, partial(_waited, machine=machine)),
        ("values of before", doors.old, partial(_waited, machine=machine)),
        ("another layer than the next", doors.wrong, partial(_waited, machine=machine)),
        ("a release after the time-out", doors.late, resumed),
    ]
    if doors.late_s < machine.live_timeout_s:
        most_s = doors.late_s + 2.0 * doors.poll_s
        judge = partial(_called, stem=stem, least_s=doors.poll_s, most_s=most_s)
        found.append(("layers that are released late", doors.slow, judge))
    return found


def _called(run: Run, stem: str, least_s: float, most_s: float) -> str:
    """What is wrong with the layers that were called, from `least_s` to `most_s` after each other."""
    names = [f"{stem}_K{k:04d}R{number}_L0001" for k, number in enumerate(NUMBERS, 1)]
    if [name for name, _ in run.calls] != names:
        return f"calls {', '.join(name for name, _ in run.calls) or 'nothing'}, not {', '.join(names)}"
    if run.done != list(range(len(names))):
        return f"says at its calls that {', '.join(f'{n:g}' for n in run.done)} layers are done"
    for k, ((_, before_s), (_, at_s)) in enumerate(pairwise(run.calls), 2):
        if at_s - before_s < least_s - ROUNDING_S:
            return f"calls layer {k} before its least wait of {least_s:g} s is over"
        if at_s - before_s > most_s + ROUNDING_S:
            return (
                f"calls layer {k} {at_s - before_s:g} s after the one before, and could within {most_s:g} s"
            )
    return _ended(run)


def _waited(run: Run, machine: MachineSettings) -> str:
    """What is wrong with a program to which no next layer was released."""
    if run.calls:
        return f"calls {run.calls[0][0]}, which nobody released"
    if not run.stops:
        return "never stops waiting"
    code, at_s, off = run.stops[0]
    if not machine.live_timeout_s <= at_s <= machine.live_timeout_s + 2.0 * machine.live_poll_s:
        return f"stops after {at_s:g} s, the stated time-out is {machine.live_timeout_s:g} s"
    if code != ("M0" if machine.live_late == "stop" else "M30"):
        return f"ends waiting by {code}; machine.live_late is {machine.live_late!r}"
    if not off:
        return "does not command wire and beam off when it stops waiting"
    return "" if run.shown else "stops without a message"


def _ended(run: Run) -> str:
    if not run.stops or run.stops[-1][0] != "M30":
        return "does not end when the part is built"
    return "" if run.stops[-1][2] else "does not command wire and beam off at its end"


# -- the machine -------------------------------------------------------------------------------------


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
    run = Run(door, frozenset(f"R{first + k}" for k in (1, 2, 3)))
    blocks = [
        (i, m[2] or "", m[3]) for i, line in enumerate(text.split("\n"), 1) if (m := _BLOCK.fullmatch(line))
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
    """An expression of the control: sums, comparisons, strings put together by ``<<``, and SUBSTR."""

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
        value = self._one()
        while self._next() in ("+", "-"):
            sign, right = self._take(), self._one()
            value = value + right if sign == "+" else value - right
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

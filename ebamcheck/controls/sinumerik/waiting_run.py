"""A waiting main program run block by block, as far as it needs; what is not known here is refused, and nothing shared with what
writes it.

It sets the modes of the profile before anything else, switches nothing on, and moves once, over all that stands to where the tool
is parked."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ebamcheck.checks.checks import PLACE_MM, VALUE_SHARE
from ebamcheck.checks.state_checks import TRANSFORMATION_OFF
from ebamcheck.controls.sinumerik.control import NAME
from ebamcheck.controls.sinumerik.reading import DIALECT
from ebamcheck.errors import InputError
from ebamcheck.nc.codes import BEAM_VALUES
from ebamcheck.nc.conventions import safe_end_mm
from ebamcheck.nc.reader import AXES
from ebamcheck.nc.recorder import StateChange, Templates
from ebamcheck.nc.templates import checked_templates
from ebamcheck.nc.words import WordError, read_block, wanted_words
from ebamcheck.settings.config import Config

BLOCK = re.compile(r"N(\d+) (?:([A-Z_][A-Z0-9_]+): )?(.+)")
_TOKEN = re.compile(r'\s*(R\d+|[A-Z_][A-Z0-9_]*|\d+\.?\d*|"[^"]*"|<<|==|<>|>=|<=|[-+*/<>(),])')
_SET = re.compile(r"(R\d+|[A-Z_][A-Z0-9_]+)=(?!=)(.+)")
_PARAMETER = re.compile(r"R\d+")
_JUMP = re.compile(r"(?:IF (.+) )?GOTO([FB]) ([A-Z_][A-Z0-9_]+)")
_DEF = re.compile(r"DEF (?:INT|REAL|STRING\[(\d+)\]) ([A-Z_][A-Z0-9_]+)")
# What is on the other side: it sees the machine whenever time has gone by, and may set R parameters.
Door = Callable[["Run"], None]


@dataclass
class Run:
    """The machine while it runs a text."""

    door: Door
    # Parameters that the door writes: the control reads ahead unless STOPRE stands before.
    watched: frozenset[str]
    values: dict[str, Any] = field(default_factory=dict)
    time_s: float = 0.0
    on: set[str] = field(default_factory=set)
    calls: list[tuple[str, float]] = field(default_factory=list)
    done: list[float] = field(default_factory=list)  # Layers that were said to be done at each call
    room: dict[str, int] = field(default_factory=dict)  # Characters that each string variable holds
    # M0 or M30, when, and whether beam and wire were commanded off since time went by.
    stops: list[tuple[str, float, bool]] = field(default_factory=list)
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


def run_text(text: str, door: Door, config: Config, most_blocks: int | None = None, top_mm: float = 0.0) -> Run:
    """Run a text to its end; one that goes on for ever after a stop, or for `most_blocks`, is left there.

    `top_mm` is Z of the part's top, over which the program ends. A block that is not understood is an :class:`InputError`, ``LINE
    what``."""
    state, machine = WaitingState(config, top_mm), config.machine
    counted, *written = (f"R{machine.live_r + k}" for k in (0, 1, 2, 3, 11, 12))
    run = Run(door, frozenset(written))
    found = ((i, BLOCK.fullmatch(line)) for i, line in enumerate(text.split("\n"), 1))
    blocks = [(i, m[2] or "", m[3]) for i, m in found if m]
    labels = {label: k for k, (_, label, _) in enumerate(blocks) if label}
    run.door(run)
    # So many blocks each time that it asks within the time-out: one that has not ended by then never does.
    most = most_blocks or int(60 * (machine.live_timeout_s / machine.live_poll_s + 100.0))
    at = 0
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
    elif (found := _SET.fullmatch(code)) and (_PARAMETER.fullmatch(found[1]) or found[1] in run.values):
        name, value = found[1], Expression(found[2], run).value()
        if name in run.watched and (run.time_s > 0.0 or run.calls):
            run.tell(iter([f"writes {name}, which the server writes: what it has released is lost"]))
        if len(str(value)) > run.room.get(name, len(str(value))):
            raise ValueError(f"{value!r} is longer than {name}")
        run.values[name] = value
    else:
        run.tell(state.words(code))
    return at + 1


SIGNS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.GtE: operator.ge, ast.LtE: operator.le, ast.Gt: operator.gt, ast.Lt: operator.lt,
}  # fmt: skip


class Expression:
    """An expression of the control: sums, comparisons, strings put together by ``<<``, SUBSTR and TRUNC.

    Its signs bind as those of Python do, which reads it; nothing but what is named here is worked out.
    """

    def __init__(self, text: str, run: Run) -> None:
        tokens = _TOKEN.findall(text)
        if "".join(tokens) != text.replace(" ", ""):
            raise ValueError(f"{text!r} is no expression")
        try:
            self._tree = ast.parse(" ".join("!=" if t == "<>" else t for t in tokens), mode="eval").body
        except SyntaxError:
            raise ValueError(f"{text!r} is no expression") from None
        self._run = run

    def value(self) -> Any:
        """Work it out."""
        return self._of(self._tree)

    def _of(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=str() as text):
                return text
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.Name(id=name):
                if name in self._run.watched and not self._run.fresh:
                    said = f"{name} is read without STOPRE since time has gone by"
                    self._run.faults.append((self._run.line, said))
                return self._run.values.get(name, 0.0) if _PARAMETER.fullmatch(name) else self._run.values[name]
            case ast.UnaryOp(op=ast.USub(), operand=one):
                return -self._of(one)
            case ast.BinOp(left=left, op=ast.LShift(), right=one):
                text, right = self._of(left), self._of(one)
                if isinstance(right, float) and not right.is_integer():
                    raise ValueError("a broken number in a name")
                return f"{text}{right if isinstance(right, str) else int(right)}"
            case ast.BinOp(left=left, op=sign, right=right) | ast.Compare(left=left, ops=[sign], comparators=[right]):
                return SIGNS[type(sign)](self._of(left), self._of(right))
            case ast.Call(func=ast.Name(id="SUBSTR"), args=[text, first, count]):
                start = int(self._of(first))
                return str(self._of(text))[start : start + int(self._of(count))]
            case ast.Call(func=ast.Name(id="TRUNC"), args=[number]):
                return float(math.trunc(self._of(number)))
        raise ValueError(f"{ast.unparse(node)!r} is no expression")


OFF = ("beam_off", "wire_stop")


class WaitingState:
    """State of the machine while a waiting main program of a part whose top is to lie at Z `top_mm` runs; each step tells its
    faults."""

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
        if not math.dist((self._place.get("X", math.nan), self._place.get("Y", math.nan)), (x, y)) <= 2.0 * PLACE_MM:
            yield f"does not end at X {x:g} Y {y:g}, where the tool is to be parked"

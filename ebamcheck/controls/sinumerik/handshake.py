"""The waiting main program judged by what it does: its text is run against doors that answer, are silent, late, or wrong.

What counts is which layers are called, when, which releases are taken, and what is off when the program stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise

from ebamcheck.checks.checks import count_check
from ebamcheck.controls.sinumerik.release_keys import Release, ReleaseKeys
from ebamcheck.controls.sinumerik.waiting_run import BLOCK, Door, Run, run_text
from ebamcheck.errors import InputError
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings

CHECK = "handshake"
ROUNDING_S = 1e-6  # Of sums of times
LONGEST_BLOCK = 200  # Characters of a block


def handshake_check(text: str, file: str, config: Config, top_mm: float) -> Check:
    """Judge the text of a waiting main program of a part whose top is to lie at a Z; see :class:`Doors` for what it has to
    stand."""
    try:
        faults = [(f"{file}:{line}", what) for line, what in _faults(text, config, top_mm)]
    except InputError as error:
        where, _, what = str(error).partition(" ")
        faults = [(f"{file}:{where}", what)]
    return count_check(CHECK, faults, "the main program waits for released layers and for nothing else")


def _faults(text: str, config: Config, top_mm: float) -> Iterator[tuple[int, str]]:
    lines = text.split("\n")
    ends = [i for i, line in enumerate(lines, 1) if (m := BLOCK.fullmatch(line)) and m[3] == "M30"]
    if len(ends) != 1 or any(line.startswith("N") for line in lines[ends[0] :]):
        yield (ends[-1] if ends else len(lines)), f"{len(ends)} blocks M30: one ends the program"
        return
    for i, line in enumerate(lines, 1):
        if len(line) > LONGEST_BLOCK or not line.isascii():
            yield i, f"is no block of at most {LONGEST_BLOCK} ASCII characters"
    for name, door, wanted in Doors(config.machine).scenarios():
        run = run_text(text, door, config, top_mm=top_mm)
        yield from run.faults[:1]
        what = wanted(run)
        if what:
            yield ends[0], f"{name}: {what}"


NUMBERS = (1, 2, 1)  # Number of the program of each layer that a door releases


class Doors:
    """What may be on the other side of a waiting main program."""

    def __init__(self, machine: MachineSettings) -> None:
        self._machine = machine
        self.done, self.released, self.number, self.wait, self.key, self.seal = (
            f"R{machine.live_r + k}" for k in (0, 1, 2, 3, 11, 12)
        )
        self.poll_s = machine.live_poll_s
        self.late_s = 3.0 * self.poll_s
        self.wait_s = self.late_s + 17.0  # longer than any other parameter is large: none may be taken for it
        self._keys, self._others = ReleaseKeys(1_234_567), ReleaseKeys(7_654_321)

    def _next(self, run: Run) -> int:
        return int(run.values.get(self.done, 0)) + 1

    def _put(self, run: Run, release: Release) -> None:
        names = (self.number, self.wait, self.key, self.seal, self.released)
        values = (release.number, release.wait_s, release.key, release.seal, release.released)
        run.values |= dict(zip(names, values, strict=True))

    def _releases(self, run: Run, wait_s: float, after_s: float, keys: ReleaseKeys | None = None) -> None:
        layer, keys = self._next(run), keys or self._keys
        if run.calls and layer <= len(NUMBERS) and run.time_s < run.calls[-1][1] + after_s - ROUNDING_S:
            return
        more = layer <= len(NUMBERS)
        self._put(run, keys.release(layer, NUMBERS[layer - 1], wait_s) if more else keys.built(layer - 1))

    def scenarios(self) -> list[tuple[str, Door, Callable[[Run], str]]]:
        """Doors by name, and what is wrong with what the program did, empty if nothing."""
        machine, stem = self._machine, self._machine.program_name[:10]

        def called(run: Run) -> str:
            return _called(run, stem, self.wait_s, self.wait_s + 2.0 * self.poll_s)

        def resumed(run: Run) -> str:
            return called(run) if machine.live_late == "stop" else ""

        waited = partial(_waited, machine=machine)
        once = partial(_waited, machine=machine, calls=1)
        found: list[tuple[str, Door, Callable[[Run], str]]] = [
            ("released layers", self._good, called),
            ("released layers after a build before", self._again, called),
            ("a silent server", self._silent, waited),
            ("values of before", self._old, waited),
            ("another layer than the next", self._wrong, waited),
            ("a release after the time-out", self._late, resumed),
            ("a layer's number alone", self._stray, waited),
            ("a wait that was taken off a release", self._shortened, waited),
            ("another number than was released", self._renamed, waited),
            ("the release of the layer below under the next number", self._copied, once),
            ("a release of another build", self._other_build, once),
            ("an end that nobody released", self._ended, once),
            ("values written over what was taken", self._meddled, called),
        ]
        if self.late_s < machine.live_timeout_s:
            most_s = self.late_s + 2.0 * self.poll_s
            judge = partial(_called, stem=stem, least_s=self.poll_s, most_s=most_s)
            found.append(("layers that are released late", self._slow, judge))
        return found

    def _good(self, run: Run) -> None:
        self._releases(run, self.wait_s, 0.0)

    def _slow(self, run: Run) -> None:
        self._releases(run, self.poll_s, self.late_s)

    def _silent(self, run: Run) -> None:
        pass

    def _old(self, run: Run) -> None:
        if not run.values:
            self._put(run, self._others.release(1, 9, 0.0))
            run.values[self.done] = 4.0

    def _again(self, run: Run) -> None:
        self._old(run)
        if run.time_s > 0.0:
            self._good(run)

    def _wrong(self, run: Run) -> None:
        self._put(run, self._keys.release(self._next(run) + 1, 1, 0.0))

    def _late(self, run: Run) -> None:
        if run.stops:
            self._good(run)

    def _stray(self, run: Run) -> None:
        run.values |= {self.released: self._next(run), self.number: 1}

    def _shortened(self, run: Run) -> None:
        self._good(run)
        run.values[self.wait] = 0.0

    def _renamed(self, run: Run) -> None:
        self._good(run)
        run.values[self.number] = 7

    def _copied(self, run: Run) -> None:
        self._first(run)
        run.values[self.released] = self._next(run)

    def _other_build(self, run: Run) -> None:
        self._releases(run, 0.0, 0.0, self._keys if self._next(run) == 1 else self._others)

    def _ended(self, run: Run) -> None:
        self._first(run)
        if self._next(run) > 1:
            run.values[self.released] = -1

    def _meddled(self, run: Run) -> None:
        if run.values.get(self.released) != self._next(run):
            self._good(run)
        else:
            run.values |= {self.number: 7, self.wait: 0.0}

    def _first(self, run: Run) -> None:
        if self._next(run) == 1:
            self._put(run, self._keys.release(1, NUMBERS[0], 0.0))


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
            return f"calls layer {k} {at_s - before_s:g} s after the one before, and could within {most_s:g} s"
    if not run.stops or run.stops[-1][0] != "M30":
        return "does not end when the part is built"
    return "" if run.stops[-1][2] else "does not command wire and beam off at its end"


def _waited(run: Run, machine: MachineSettings, calls: int = 0) -> str:
    """What is wrong with a program to which so many layers were released, and no next one."""
    if len(run.calls) > calls:
        return f"calls {run.calls[calls][0]}, which nobody released"
    if len(run.calls) < calls:
        return "does not call the layer that was released"
    since_s = run.calls[-1][1] if run.calls else 0.0
    if not run.stops:
        return "never stops waiting"
    code, at_s, off = run.stops[0]
    waited_s = at_s - since_s
    if not machine.live_timeout_s <= waited_s <= machine.live_timeout_s + 2.0 * machine.live_poll_s:
        return f"stops after {waited_s:g} s, the stated time-out is {machine.live_timeout_s:g} s"
    if code != ("M0" if machine.live_late == "stop" else "M30"):
        return f"ends waiting by {code}; machine.live_late is {machine.live_late!r}"
    if not off:
        return "does not command wire and beam off when it stops waiting"
    return "" if run.shown else "stops without a message"

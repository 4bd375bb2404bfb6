"""The waiting main program judged by what it does: its text is run against doors that answer, are silent, late, or wrong.

It is run block by block (:mod:`ebamcheck.controls.sinumerik.waiting_run`). The check asks for nothing of how the loop is
written: what counts is which layers are called, when, which releases are taken, and what is off when the program stops.
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
    """Judge the text of a waiting main program of a part whose top is to lie at a Z; see :func:`scenarios` for what it has to stand."""
    try:
        faults = [(f"{file}:{line}", what) for line, what in _faults(text, config, top_mm)]
    except InputError as error:
        where, _, what = str(error).partition(" ")
        faults = [(f"{file}:{where}", what)]
    return count_check(CHECK, faults, "the main program waits for released layers and for nothing else")


def _faults(text: str, config: Config, top_mm: float) -> Iterator[tuple[int, str]]:
    lines = text.split("\n")
    ends = [i for i, line in enumerate(lines, 1) if BLOCK.fullmatch(line) and _code(line) == "M30"]
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
    found = BLOCK.fullmatch(line)
    return found[3] if found else ""


NUMBERS = (1, 2, 1)  # Number of the program of each layer that a door releases
LONGER_S = 17.0  # A wait that is longer than any other parameter is large: none may be taken for it
OURS, OTHERS = 1_234_567, 7_654_321  # Keys of the last layer of a build, and of another one


class Doors:
    """What may be on the other side of a waiting main program."""

    def __init__(self, machine: MachineSettings) -> None:
        self.done, self.released, self.number, self.wait, self.key, self.seal = (
            f"R{machine.live_r + k}" for k in (0, 1, 2, 3, 11, 12)
        )
        self.poll_s = machine.live_poll_s
        self.late_s = 3.0 * self.poll_s
        self.wait_s = self.late_s + LONGER_S
        self._keys, self._others = ReleaseKeys(OURS), ReleaseKeys(OTHERS)

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
            self._put(run, self._others.release(1, 9, 0.0))
            run.values[self.done] = 4.0

    def again(self, run: Run) -> None:
        """Release layers after a build of before."""
        self.old(run)
        if run.time_s > 0.0:
            self.good(run)

    def wrong(self, run: Run) -> None:
        """Release another layer than the next one."""
        self._put(run, self._keys.release(self._next(run) + 1, 1, 0.0))

    def late(self, run: Run) -> None:
        """Release layers after the time-out alone."""
        if run.stops:
            self.good(run)

    # Others who write to the same parameters.

    def stray(self, run: Run) -> None:
        """Write the number of the next layer, and nothing else."""
        run.values |= {self.released: self._next(run), self.number: 1}

    def shortened(self, run: Run) -> None:
        """Take the wait off what was released."""
        self.good(run)
        run.values[self.wait] = 0.0

    def renamed(self, run: Run) -> None:
        """Release another number of the program than was sealed."""
        self.good(run)
        run.values[self.number] = 7

    def copied(self, run: Run) -> None:
        """Write the next layer over the release of the first one, whose key and seal still stand there."""
        self._first(run)
        run.values[self.released] = self._next(run)

    def other_build(self, run: Run) -> None:
        """Release the first layer, and have another build release the others."""
        self._releases(run, 0.0, 0.0, self._keys if self._next(run) == 1 else self._others)

    def ended(self, run: Run) -> None:
        """Release the first layer, and say that the part is built."""
        self._first(run)
        if self._next(run) > 1:
            run.values[self.released] = -1

    def meddled(self, run: Run) -> None:
        """Release each layer, and write over number and wait as soon as the program has seen it."""
        if run.values.get(self.released) != self._next(run):
            self.good(run)
        else:
            run.values |= {self.number: 7, self.wait: 0.0}

    def _first(self, run: Run) -> None:
        if self._next(run) == 1:
            self._put(run, self._keys.release(1, NUMBERS[0], 0.0))


def scenarios(config: Config) -> list[tuple[str, Door, Callable[[Run], str]]]:
    """Doors by name, and what is wrong with what the program did, empty if nothing."""
    machine = config.machine
    doors, stem = Doors(machine), machine.program_name[:10]

    def called(run: Run) -> str:
        return _called(run, stem, doors.wait_s, doors.wait_s + 2.0 * doors.poll_s)

    def resumed(run: Run) -> str:
        return called(run) if machine.live_late == "stop" else ""

    waited = partial(_waited, machine=machine)
    once = partial(_waited, machine=machine, calls=1)
    found: list[tuple[str, Door, Callable[[Run], str]]] = [
        ("released layers", doors.good, called),
        ("released layers after a build before", doors.again, called),
        ("a silent server", doors.silent, waited),
        ("values of before", doors.old, waited),
        ("another layer than the next", doors.wrong, waited),
        ("a release after the time-out", doors.late, resumed),
        ("a layer's number alone", doors.stray, waited),
        ("a wait that was taken off a release", doors.shortened, waited),
        ("another number than was released", doors.renamed, waited),
        ("the release of the layer below under the next number", doors.copied, once),
        ("a release of another build", doors.other_build, once),
        ("an end that nobody released", doors.ended, once),
        ("values written over what was taken", doors.meddled, called),
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


def _ended(run: Run) -> str:
    if not run.stops or run.stops[-1][0] != "M30":
        return "does not end when the part is built"
    return "" if run.stops[-1][2] else "does not command wire and beam off at its end"

"""The state of a build between its layers, and its door of JSON lines: a reading comes in, is judged, the next layer is made and
published.

Readings alone decide, neither the clock nor chance, so that the journal is enough to make every byte again.
"""

from __future__ import annotations

import gc
import json
import os
import select
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.json_values import plain, sha256_of_json
from ebamcheck.live import height_map, publishing
from ebamcheck.live.before import Before, Ground, check_warmth
from ebamcheck.live.height_map import Reading, Refused
from ebamcheck.live.heights import HeightRule, height_rule
from ebamcheck.live.heights_table import HeightsTable, laid_height
from ebamcheck.live.making import LayerMaker, MadeLayer, Wanted, failure_of
from ebamcheck.live.verifying import FollowedLayers

# What is tried until every gate is open: heights over the planned one, each of which leaves a plane through vertices, on which methods
# may differ; and islands and hatch as on a later layer, since another layout may leave less metal uneven
TRIES = ((1.0, 0), (0.97, 0), (1.03, 0), (1.0, 3), (1.0, 6))
MAKING = ".making."  # begin of the names of folders in which layers are made
NOT_STARTED = "nothing is published yet: send `start` first"
Answer = dict[str, Any]


@dataclass(frozen=True)
class Standing:
    """What stands and what was published on it: readings of its top are judged against these."""

    done: int
    base_mm: float
    top_mm: float
    cusp_mm: float = 0.0


class Building:
    """A build in a folder, where layers, journal and ``current.json`` lie; heights are uniform ones where no rule is given.

    A journal that is there is gone on with: its layers are made again, which proves that they still come out the same.
    """

    def __init__(self, maker: LayerMaker, folder: Path, rule: HeightRule | None = None) -> None:
        self.maker, self.folder = maker, folder
        self.rule = rule or height_rule(maker.part, maker.config)
        self.before = Before.plate(maker.part, maker.config)
        self.finished = False
        self._followed = FollowedLayers()
        self.heights = HeightsTable(folder)
        self._planned_tops_mm = self.rule.plan(0.0).tops_mm
        self.told: Answer = {}  # the last answer that became the state
        self._standing: Standing | None = None
        self._last: Reading | None = None
        self._tried: tuple[Reading, Answer | None] | None = None
        # The lock comes first: two servers on one folder would publish over each other.
        _refuse_relayered(folder)
        self.journal = publishing.Journal(folder / publishing.JOURNAL)
        # What a kill has left: nobody else makes layers here.
        for path in folder.glob(f"{MAKING}*"):
            shutil.rmtree(path, ignore_errors=True)
        try:
            if self.journal.lines:
                self._resume(publishing.read_journal(self.journal.path))
            else:
                self.journal.append({"kind": "begin", **self._of()})
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the journal; the table of heights is whole then."""
        self.heights.write(ended=True)
        self.journal.close()

    @property
    def expected_done(self) -> int:
        """Number of layers that are done when the next reading comes; 0 before anything is published."""
        return 0 if self._standing is None else self._standing.done + 1

    def start(self) -> Answer:
        """Publish the lowest layer on the plate; on a build that is under way, tell again what is published."""
        if self.told:
            return {**self.told, "again": True}
        return self._decide(Reading(0, 0.0))

    def height(self, message: dict[str, Any]) -> Answer:
        """Take a measured height, and publish the layer on it; the journal knows of one that is refused."""
        try:
            if self._standing is None and "height_map" in message:
                raise Refused("not-started", NOT_STARTED)
            warmth = height_map.warmth_of(message)
            if "height_map" in message:
                reading = height_map.map_reading(message, self.before.surface, self.maker.config, self._last)
            else:
                reading = height_map.reading_of(message)
            reading = replace(reading, warmth=warmth)
            if reading == self._last:
                return {**self.told, "again": True}
            self._judge(reading, message)
        except Refused as refused:
            self.journal.append({"kind": "refused", **refused.answer})
            return refused.answer
        return self._decide(reading)

    def _judge(self, reading: Reading, message: dict[str, Any]) -> None:
        """Refuse a reading that is not the next one, or cannot be."""
        last, standing = self._last, self._standing
        if last is None or standing is None:
            raise Refused("not-started", NOT_STARTED)
        if reading.done == last.done:
            said = (
                f"the top of {last.done} layers was measured before, at {last.height_mm:g} mm: the first reading counts"
            )
            raise Refused("repeated", said)
        if self.finished:
            raise Refused("finished", "the part is built: no layer is left")
        if reading.done != self.expected_done:
            said = f"{reading.done!s:.20} layers are said to be done, expected are {self.expected_done}"
            raise Refused("counter-jump", said)
        if "height_map" not in message and reading.height_mm != message.get("height_mm"):
            said = f"{message.get('height_mm')!r:.20} mm is taken for {reading.height_mm:g} mm"
            raise Refused("not-as-said", said)
        height_map.check_height(reading, standing.base_mm, standing.top_mm)
        if reading.warmth is not None:
            check_warmth(self.before, reading.warmth, self.maker.config)

    def status(self) -> Answer:
        """Tell what is published, and what is expected."""
        return {
            "answer": "status",
            "published": publishing.read_current(self.folder),
            "expected_done": self.expected_done,
            "finished": self.finished,
            "top_mm": self.rule.slopes.top_mm,
        }

    def _decide(self, reading: Reading) -> Answer:
        """Write a reading down, plan on it, and publish the next layer or say why not."""
        if self._tried is None or self._tried[0] != reading:
            self.journal.append(reading.entry())
            self._tried = reading, None
        answer, made = self._made(reading)
        if made is None:
            if answer["answer"] == "done":
                self._take(reading, answer, None)
            return self._noted(reading, answer)
        staged, layer, certificate = made
        try:
            entry = {"kind": "layer", **{key: certificate[key] for key in ("name", "files", "wait_s")}}
            if "temperature" in answer:
                entry["why_wait"] = f"{certificate['wait_s']:g} s: {answer['temperature']['why']}"
            journaled = partial(self.journal.append, entry)
            current = publishing.publish(self.folder, layer, certificate, before=journaled)
        except (EbamcheckError, OSError) as error:
            return self._noted(reading, _kept(reading, failure_of(error)))
        finally:
            shutil.rmtree(staged, ignore_errors=True)
        answer = {**answer, **current}
        self._take(reading, answer, layer)
        return answer

    def _noted(self, reading: Reading, answer: Answer) -> Answer:
        """Write down that no layer came of a reading; once, however often it is tried again."""
        if self._tried != (reading, answer):
            self.journal.append({"kind": str(answer["answer"]), **answer})
            self._tried = reading, answer
        return answer

    def _take(self, reading: Reading, answer: Answer, layer: MadeLayer | None) -> None:
        below = self._standing
        if below is not None:
            planned = below.done, self._planned_tops_mm, below.base_mm, below.top_mm
            self.heights.add(laid_height(*planned, reading.height_mm, below.cusp_mm))
        self._last, self.told = reading, answer
        if layer is None:
            self.finished = True
            return
        self.before = layer.after
        self._followed.take()
        cusp_mm = float(answer["cusp_mm"])
        self._standing = Standing(reading.done, layer.wanted.base_mm, layer.wanted.top_mm, cusp_mm)

    def _made(self, reading: Reading) -> tuple[Answer, tuple[Path, MadeLayer, dict[str, Any]] | None]:
        """Make the layer on a reading; the answer alone where there is none to publish."""
        base_mm = reading.height_mm
        plan = self.rule.plan(base_mm)
        top_mm = self.rule.slopes.top_mm
        early = publishing.ended_early(self.maker.height_mm, base_mm, self.maker.config)
        if not len(plan):
            return (_kept(reading, early) if early else _done(reading, top_mm, *plan.said)), None
        limits, why, broken = self.rule.outer, "", False
        self.folder.mkdir(parents=True, exist_ok=True)
        ground = Ground.of(reading, self.before, self.maker.config)
        *first, last = ground.mending
        tries = [(1.0, 0, share) for share in first] + [(*how, last) for how in TRIES]
        for number, (factor, shifted, mended) in enumerate(tries, 1):
            thickness_mm = float(plan.thickness_mm[0]) * factor
            fits = limits.least_mm <= thickness_mm <= limits.most_mm
            if factor != 1.0 and not (fits and base_mm + thickness_mm <= top_mm + 1e-9):
                continue
            name = publishing.layer_name(self.maker.config.machine.program_name, reading.done, number)
            wanted = Wanted(reading.done, base_mm, thickness_mm, name, shifted)
            staged = Path(tempfile.mkdtemp(prefix=MAKING, dir=self.folder))
            try:
                made = self.maker.make(wanted, ground.mended(mended), staged / publishing.PROGRAM)
                if made.passed:
                    # The least wait counts from the end of the layer below.
                    made = replace(made, wait_s=ground.since_s + made.wait_s)
                    told = ground.told(mended)
                    certificate = publishing.certificate_of(made, self.maker, told)
                    said = [*plan.said, *made.after.spent.to_do()]
                    if warm := self._followed.too_warm(staged / publishing.PROGRAM, certificate, made.config):
                        raise InputError(warm)
                    answer = {"answer": "published", "layers_left": len(plan), "said": said,
                              "cusp_mm": float(plan.cusp_mm[0]), "seconds": made.seconds,
                              "islands": made.islands, "tries": number, **told}  # fmt: skip
                    return answer, (staged, made, certificate)
                why = why or made.why
            except Exception as error:  # whatever a stage meets, the server stays
                why, broken = why or failure_of(error), True
            shutil.rmtree(staged, ignore_errors=True)
        if reading.done and not broken and not early:
            # What is left is less than the least layer: no other reading can come that would lead on.
            return _done(reading, top_mm, f"no layer fills the last {top_mm - base_mm:.3f} mm ({why}): leave them to "
                         "the machining allowance, or weld them up by hand"), None  # fmt: skip
        return _kept(reading, why), None

    def _of(self) -> dict[str, Any]:
        return {
            "format": publishing.JOURNAL_FORMAT,
            "part_sha256": self.maker.part.sha256,
            "settings_sha256": sha256_of_json(self.maker.config.model_dump()),
            "annealing_steps": self.maker.annealing_steps,
            "mode": self.rule.mode,
            "cusp_mm": self.rule.cusp_mm,
            "listed_mm": list(self.rule.listed_mm),
        }

    def _resume(self, entries: Iterator[dict[str, Any]]) -> None:
        """Make the layers of a journal again, one after the other, and compare their hashes."""
        first = next(entries, None)
        if first is None:
            return
        journal = self.journal.path
        if first.get("format") != publishing.JOURNAL_FORMAT:
            what = "which counted layers from 0: end that build with it, or give another folder with -o"
            raise InputError(f"{journal}: is of an earlier version of ebamcheck, {what}")
        for key, value in {"kind": "begin", **self._of()}.items():
            if first.get(key) != value:
                other = f"its {key} is {first.get(key)!r:.20}, not {value!r:.20}"
                raise InputError(f"{journal}: is of another build: {other}: give another folder with -o")
        waiting: Reading | None = None
        for entry in entries:
            kind = entry.get("kind")
            if kind == "height":
                waiting = Reading.of_entry(entry)
            elif waiting is not None and kind in ("layer", "done"):
                self._again(waiting, entry)
                waiting = None

    def _again(self, reading: Reading, entry: dict[str, Any]) -> None:
        answer, made = self._made(reading)
        layer_of_it = f"{self.journal.path}: layer {reading.done + 1}"
        if made is None:
            if answer["answer"] != entry["kind"]:
                raise InputError(f"{layer_of_it} does not come out again: {answer.get('reason')}")
            self._take(reading, answer, None)
            return
        staged, layer, certificate = made
        try:
            # A journal of an earlier version tells no wait.
            told = {"wait_s": certificate["wait_s"], **entry}
            for key, what in (("files", "other bytes"), ("wait_s", "another wait")):
                if certificate[key] != told.get(key):
                    why = "than was published: the software or a slicer is another one"
                    raise InputError(f"{layer_of_it} comes out as {what} {why}")
            # Between the journal's line and the current file a kill may have come; the layer itself is there.
            current = publishing.publish(self.folder, layer, certificate)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
        self._take(reading, {**answer, **current}, layer)


def _kept(reading: Reading, why: str) -> Answer:
    return {"answer": "kept", "done": reading.done, "height_mm": reading.height_mm, "reason": why}


def _done(reading: Reading, top_mm: float, *said: str) -> Answer:
    """The end of a build, how far it is off the top, and what is left to be done."""
    off_mm = reading.height_mm - top_mm
    return {"answer": "done", "done": reading.done, "height_mm": reading.height_mm, "off_mm": off_mm, "said": list(said)}  # fmt: skip


def _refuse_relayered(folder: Path) -> None:
    """Refuse to begin a build beside layers of `relayer`: it would come to their names, and keep its own layers back."""
    layers = folder / publishing.LAYERS
    if (folder / publishing.JOURNAL).is_file() or not layers.is_dir():
        return
    if found := sorted(path.name for path in layers.iterdir()):
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        what = "which `ebamcheck relayer` made and a build would name again"
        how = "give the build another folder with -o, or move them away"
        raise SettingsError(f"{layers}: holds {found[0]}{more}, {what}: {how}")


class Lines:
    """Lines of a file descriptor, with a time limit, in bounded memory: a longer one is cut and told as such."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._held, self._ended = descriptor, b"", False

    def next(self, wait_s: float | None) -> bytes | None:
        """Return the next line without its end; None where none came in time; raises :class:`EOFError` at the end."""
        until = None if wait_s is None else time.monotonic() + wait_s
        while b"\n" not in self._held:
            if self._ended:
                if self._held.strip():
                    line, self._held = self._held, b""
                    return line
                raise EOFError
            left = None if until is None else max(0.0, until - time.monotonic())
            ready, _, _ = select.select([self._descriptor], [], [], left)
            if not ready:
                return None
            found = os.read(self._descriptor, 65536)
            self._ended = not found
            if b"\n" not in found and len(self._held) > height_map.LONGEST_LINE:
                continue  # the rest of a line that is too long already
            self._held += found
        line, self._held = self._held.split(b"\n", 1)
        return line


def serve(building: Building, lines: Lines, out: IO[str], timeout_s: float) -> None:
    """Answer lines until the input ends, or somebody says ``stop``; after a time without one, say so once until the next."""
    said_late, between = False, BetweenLayers(building)
    while True:
        try:
            line = lines.next(None if said_late else timeout_s)
        except EOFError:
            return
        said_late = line is None
        if line is None:
            answer: Answer = {**building.status(), "answer": "late", "waited_s": timeout_s}
        else:
            answer = answer_to(building, line)
        out.write(json.dumps(plain(answer), sort_keys=True, allow_nan=False) + "\n")
        out.flush()
        between(answer)
        if answer["answer"] == "stopped":
            return


def answer_to(building: Building, line: bytes) -> Answer:
    """Answer one line; nothing that comes in ends the server."""
    try:
        message = height_map.parsed(line)
        known: dict[str, Callable[[], Answer]] = {
            "start": building.start,
            "height": lambda: building.height(message),
            "status": building.status,
            "reset": building.status,
            "stop": lambda: {"answer": "stopped"},
        }
        event: Any = message.get("event")
        if not isinstance(event, str) or event not in known:
            raise Refused("event", f"event {event!r:.20}: known are {', '.join(known)}")
        return known[event]()
    except Refused as refused:
        return refused.answer
    except Exception as error:  # a full disk, say: what was published stays
        return {"answer": "error", "reason": failure_of(error)}


class BetweenLayers:
    """What is done after each answer of a build, when nobody waits: tables are written and memory is given back.

    Python looks for cycles among half a million objects that stay, for a quarter of a second, in the middle of a layer: so what
    stays is set aside once it is loaded, and what a layer leaves is collected after it."""

    def __init__(self, building: Building) -> None:
        self._building, self._layers = building, 0

    def __call__(self, answer: Mapping[str, Any]) -> None:
        """Do it; the answer was sent already."""
        self._building.heights.write(ended=self._building.finished)
        if answer.get("answer") not in ("published", "released", "kept", "done", "built"):
            return
        gc.collect()
        self._layers += 1
        if self._layers <= 3:  # then kernels and modules are loaded
            gc.freeze()

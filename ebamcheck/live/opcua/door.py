"""The door to a control: what is seen on it decides, over and over, what is done next.

A layer is uploaded, read back and compared, and released last of all, once, to a program that is seen to wait for it. What was
released and is gone (RESET) is released again on the operator's word alone, since nobody here knows how much of it lies on the
part."""

from __future__ import annotations

import asyncio
import hashlib
import math
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.live.building import Answer, Building
from ebamcheck.live.making import failure_of
from ebamcheck.live.opcua import handshake
from ebamcheck.live.opcua.link import Link, LinkLost, NotTaken, within
from ebamcheck.live.publishing import read_journal
from ebamcheck.settings.machine import MachineSettings, OpcuaSettings

LEADS, UPLOADED, RELEASED, AGAIN = "leads", "uploaded", "released", "again"  # kinds of lines in the journal


class Telling:
    """Answers of a door, each told once, and when it tries again what was refused: the time before the next try doubles up to the
    longest."""

    def __init__(self, told: Callable[[Answer], None], retry_s: float, longest_s: float) -> None:
        self._told, self._retry_s, self._longest_s = told, retry_s, longest_s
        self._last: dict[str, str] = {}
        self._at, self._pause_s = -math.inf, retry_s

    @property
    def due(self) -> bool:
        """Whether it is time for the next try."""
        return time.monotonic() >= self._at

    def soon(self) -> None:
        """Try at once what comes next."""
        self._at, self._pause_s = -math.inf, self._retry_s

    def later(self) -> None:
        """Try again after the pause."""
        self._at = time.monotonic() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, self._longest_s)

    def say(self, kind: str, **answer: Any) -> None:
        """Tell an answer once, until another one of its kind is told."""
        text = repr(answer)
        if self._last.get(kind) != text:
            self._last[kind] = text
            self._told({"answer": kind, **answer})

    def refuse(self, code: str, reason: str) -> None:
        """Tell once that something is refused."""
        self.say("refused", code=code, reason=reason)

    def made(self, answer: Answer) -> None:
        """Tell what the build said; a layer that was kept back is told once, and tried again later."""
        if answer["answer"] == "kept":
            self.say("kept", **{key: value for key, value in answer.items() if key != "answer"})
            self.later()
            return
        self.soon()
        self._last.clear()
        self._told(answer)

    def forget(self, *kinds: str) -> None:
        """Tell the next answer of some kinds whatever it is."""
        for kind in kinds:
            self._last.pop(kind, None)


class Door:
    """Leads a build on a control; the build's journal also holds what was released, and `told` gets each answer once."""

    def __init__(
        self,
        building: Building,
        machine: MachineSettings,
        opcua: OpcuaSettings,
        told: Callable[[Answer], None],
    ) -> None:
        self._building, self._machine, self._opcua = building, machine, opcua
        self._owner = float(1 + secrets.randbelow(2**31 - 1))
        self._owners, self._claimed = {0.0}, False
        self._telling = Telling(told, opcua.retry_s, opcua.longest_retry_s)
        self._waiting = handshake.Waiting(3.0 * max(machine.live_poll_s, opcua.look_s, opcua.grid_s))
        self._measured: str | None = None
        self._done_since: tuple[int, float] | None = None
        self._released: int | None = None
        self._uploaded = ""
        self._keeps = False
        self._released_at = time.monotonic()
        self._taken_back_at: float | None = None
        self._keys = handshake.keys_of(building.folder)
        for entry in read_journal(building.journal.path):
            if entry["kind"] == LEADS:
                self._owners.add(float(entry["owner"]))
            elif entry["kind"] == UPLOADED:
                self._uploaded = str(entry["file"])
            elif entry["kind"] == RELEASED:
                self._released = int(entry["layer"]) - 1
            elif entry["kind"] == AGAIN:
                self._released = None

    async def run(self) -> Answer:
        """Lead the build to its end, over connections; SettingsError where none lets us in, or has no such nodes, before anything
        was done."""
        pause_s, ever = self._opcua.retry_s, False
        while True:
            try:
                async with Link(self._machine, self._opcua) as link:
                    self._telling.say("connected", url=self._opcua.url)
                    self._waiting.forget()
                    self._telling.forget("lost")
                    self._telling.soon()
                    while True:
                        answer = await self._look(link)
                        if answer is not None:
                            return answer
                        ever, pause_s = True, self._opcua.retry_s
                        # Something has changed on the control, or it is time to look anyway.
                        with suppress(TimeoutError):
                            await within(link.changed.wait(), self._opcua.look_s)
                            link.changed.clear()
            except Exception as error:  # whatever the connection comes to, the server stays
                # Before anything was done, this is a matter of settings and not of time.
                if isinstance(error, EbamcheckError) and not isinstance(error, LinkLost) and not ever:
                    raise SettingsError(str(error)) from None
                kept = "what was published stays; trying again"
                self._telling.say("lost", reason=failure_of(error), kept=kept)
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, self._opcua.longest_retry_s)

    async def _look(self, link: Link) -> Answer | None:
        """Look at the control, and do what follows from it; the last answer where the build is over."""
        seen = await link.seen()
        self._waiting.notice(seen.waited)
        try:
            if await self._begun() and await self._owns(link, seen) and not await self._took_back(link, seen):
                return await self._step(link, seen)
        except LinkLost:
            raise
        except Exception as error:
            # A refusal, a full disk, a fault of the software: what was published stays.
            self._telling.refuse(error.code if isinstance(error, NotTaken) else "held", failure_of(error))
            self._telling.later()
        return None

    async def _begun(self) -> bool:
        """Whether the lowest layer is published: before that nothing is led here."""
        if self._building.expected_done:
            return True
        if self._telling.due:
            self._telling.made(await asyncio.to_thread(self._building.start))
        return self._building.expected_done > 0

    async def _owns(self, link: Link, seen: handshake.Seen) -> bool:
        """Whether this is the `live` that writes: the last one that came and could go on is, and the one before notices."""
        if seen.owner == self._owner:
            return True
        leads = f"another `ebamcheck live` leads the control ({self._name('owner')} is {seen.owner:.0f})"
        if self._claimed and seen.owner != 0.0:
            self._telling.refuse(
                "two-servers", f"{leads} and has taken over: nothing is written here any more; end one of them, and start the "
                "other anew"
            )  # fmt: skip
        elif seen.owner not in self._owners and (why := self._cannot_go_on(seen)):
            self._telling.refuse(
                "two-servers", f"{leads}, and this build cannot go on there: {why}; end the other one, and set "
                f"{self._name('owner')} to 0 where it has gone already"
            )  # fmt: skip
        elif self._telling.due:
            await link.write("owner", self._owner)
            self._claimed = True
            self._note(LEADS, owner=self._owner)
            link.changed.set()
        return False

    def _cannot_go_on(self, seen: handshake.Seen) -> str:
        """Why this build can release nothing on the control as it stands; empty where it can."""
        done = self._building.expected_done - 1
        # The layer that this build released last may be done since.
        if seen.done != done and (seen.done, self._released) != (done + 1, done):
            return f"{seen.done:g} layers are done there, {done} in this build"
        if seen.released not in self._own_releases:
            return f"{seen.released:g} is released there, and not by this build"
        return ""

    @property
    def _own_releases(self) -> tuple[float, ...]:
        """What this build may have left in the variable of the layer that is released."""
        ours = () if self._released is None else (self._released + 1.0,)
        return (0.0, *ours, *((handshake.BUILT,) if self._building.finished else ()))

    async def _took_back(self, link: Link, seen: handshake.Seen) -> bool:
        """Whether somebody else has written a release, whenever it was: it is set to 0, and the program does not take it."""
        # What a build of before has left is set to 0 by the main program when it is started.
        old = self._released is None and not self._waiting.now
        if old or seen.released in self._own_releases:
            return False
        await link.write("released", 0.0)
        self._taken_back_at = time.monotonic()
        self._telling.refuse(
            "two-servers", f"{self._name('released')} was {seen.released:g}, which was not released here: it is set to 0; a main "
            "program that waits does not take it without its key"
        )  # fmt: skip
        link.changed.set()
        return True

    async def _step(self, link: Link, seen: handshake.Seen) -> Answer | None:
        building = self._building
        if building.finished:
            return await self._finish(link, seen)
        next_layer = building.expected_done - 1
        if not float(seen.done).is_integer() or seen.done < 0.0:
            said = f"the control counts {seen.done:g} layers: that is no number of layers"
            self._telling.refuse("counter", said)
        elif seen.begin_at != 0.0:
            await self._begin_again(link, seen, next_layer)
        elif seen.done == next_layer + 1:
            await self._measure(link, seen)
        elif seen.done == next_layer:
            await self._release(link, seen, next_layer)
        else:
            again = f"set {self._name('begin_at')} to the layer that is to be begun, {next_layer + 1}, or {next_layer + 2} where that one is whole"
            what = "was RESET" if seen.done == 0.0 else f"counts {seen.done:g} layers"
            said = f"the control {what}, {next_layer} layers are done: nothing is released; {again}"
            self._telling.refuse("counter-jump", said)
        return None

    def _name(self, role: str) -> str:
        return self._opcua.nodes.get(role) or f"R{self._machine.live_r + handshake.OFFSETS[role]}"

    async def _measure(self, link: Link, seen: handshake.Seen) -> None:
        """A layer is done: take its height, once it belongs to that layer and stands still."""
        done, now = int(seen.done), time.monotonic()
        if self._done_since is None or self._done_since[0] != done:
            self._done_since, self._measured = (done, now), None
        if seen.measured != done:
            if seen.measured != 0.0:
                said = f"a height is said to be of layer {seen.measured:g}, {done} layers are done"
                self._telling.refuse("counter-jump", said)
            if now - self._done_since[1] > self._opcua.late_s:
                self._telling.say("late", done=done, waited_s=self._opcua.late_s)
            return
        # Two looks have to agree: values that are written one by one are not there at once.
        await asyncio.sleep(self._opcua.grid_s)
        again = await link.seen()
        if again.reading != seen.reading:
            link.changed.set()
            return
        if self._measured == seen.reading and not (self._keeps and self._telling.due):
            return
        message: dict[str, Any] = {"event": "height", "done": done}
        message |= {"height_map": seen.map} if seen.map else {"height_mm": seen.height}
        if seen.surface_k != 0.0:
            message |= {"surface_k": seen.surface_k, "after_s": seen.after_s}
        # One that a fault of ours came in between, or on which a layer was kept back, is tried again, and less and less often.
        self._measured, self._keeps = seen.reading, True
        answer = await asyncio.to_thread(self._building.height, message)
        self._keeps = answer["answer"] == "kept"
        self._telling.made(answer)
        link.changed.set()

    async def _release(self, link: Link, seen: handshake.Seen, layer: int) -> None:
        """The layer that is published is the next one of the control: release it, unless that was done."""
        if self._released == layer:
            self._judge_release(seen, layer)
            return
        if not self._telling.due:
            return
        if not self._sees_waiting(layer + 1):
            return
        current = self._building.status()["published"]
        data, name = handshake.proved_program(self._building.folder, current, self._opcua.file_limit_mb)
        await self._put(link, name, data, str(current["sha256"]))
        release = handshake.release_of(self._keys, layer + 1, current)
        before = handshake.written_before(release)
        await link.write_all({"measured": 0.0, **handshake.told_of(current), **before})
        now = await link.seen()
        if now.owner != self._owner or now.done != layer or now.released == layer + 1:
            said = "another client wrote to the handshake meanwhile: the layer is kept back"
            raise NotTaken("two-servers", said)
        if now.number != release.number:
            said = f"the number of the program was changed to {now.number:g} by another client"
            raise NotTaken("two-servers", said)
        self._note(RELEASED, layer=layer + 1, name=current["name"], sha256=current["sha256"])
        self._released = layer
        try:
            await link.write("released", float(layer + 1))
        except NotTaken:
            # It reads back as not released, so that no program can have seen it.
            self._note(AGAIN, layer=layer + 1, why="the release was not taken")
            self._released = None
            raise
        self._released_at, self._taken_back_at = time.monotonic(), None
        self._telling.soon()
        self._telling.forget("refused", "waiting", "late", "held")
        self._telling.say("released", layer=layer + 1, name=current["name"], sha256=current["sha256"])

    def _judge_release(self, seen: handshake.Seen, layer: int) -> None:
        counts_since = self._waiting.after(max(self._released_at, self._taken_back_at or 0.0))
        if seen.released == layer + 1 and counts_since:
            self._telling.refuse(
                "not-called", f"layer {layer + 1} is released, and the main program goes on waiting: it follows the keys of "
                f"another build, or another client wrote over the release; RESET and start it, then set "
                f"{self._name('begin_at')} to {layer + 1}"
            )  # fmt: skip
        elif seen.released != layer + 1 and (self._taken_back_at is None or counts_since):
            # What was written over in the middle of the layer is of no matter: the program has taken its release.
            self._telling.refuse(
                "withdrawn", f"layer {layer + 1} was released and is so no more (RESET): look at the part, then set "
                f"{self._name('begin_at')} to {layer + 1} to have it laid from its beginning"
            )  # fmt: skip

    async def _put(self, link: Link, name: str, data: bytes, sha256: str) -> None:
        """Bring a file to the control under its new name, and read it back."""
        there = await link.download(name)
        if there == data:
            return
        if there is not None and name != self._uploaded and not self._opcua.replace:
            raise NotTaken(
                "file-exists", f"the control has another file {name}, of another build: delete it there, or set opcua.replace"
            )  # fmt: skip
        if name != self._uploaded:
            self._note(UPLOADED, file=name, sha256=sha256)
            self._uploaded = name
        await link.upload(name, data, replace=there is not None)
        found = await link.download(name)
        if found is None or hashlib.sha256(found).hexdigest() != sha256:
            sizes = f"{0 if found is None else len(found)} bytes of {len(data)}"
            said = f"{name} reads back as another file than was written ({sizes}): it is not released"
            raise NotTaken("other-file", said)

    async def _begin_again(self, link: Link, seen: handshake.Seen, layer: int) -> None:
        """The operator says at which layer the control, that was RESET, is to go on."""
        wanted = seen.begin_at
        if wanted not in (layer + 1, layer + 2):
            said = f"give {layer + 1} or, where that layer is whole, {layer + 2}"
            self._telling.refuse("begin-at", f"{self._name('begin_at')} is {wanted:g}: {said}")
            return
        if not self._sees_waiting(int(wanted)):
            return
        self._note(AGAIN, layer=int(wanted), why="the operator's word")
        self._released = None if wanted == layer + 1 else self._released
        for role, value in (("released", 0.0), ("measured", 0.0), ("done", wanted - 1.0), ("begin_at", 0.0)):
            await link.write(role, value)
        self._telling.forget("refused", "waiting")
        self._telling.say("begins-again", layer=int(wanted))
        link.changed.set()

    async def _finish(self, link: Link, seen: handshake.Seen) -> Answer | None:
        """The part is built: say so to the control."""
        if not self._telling.due:
            return None
        release = self._keys.built(self._building.expected_done)
        if (seen.released, seen.key, seen.seal) != (handshake.BUILT, release.key, release.seal):
            await link.write_all(handshake.written_before(release))
            await link.write("released", handshake.BUILT)
        await link.write("owner", 0.0)
        return {**self._building.told, "answer": "built"}

    def _sees_waiting(self, number: int) -> bool:
        """Whether the main program waits for a layer; says so where it does not."""
        if not self._waiting.now:
            reason = "the main program is not seen to wait: start it on the control"
            self._telling.say("waiting", layer=number, reason=reason)
        return self._waiting.now

    def _note(self, kind: str, **entry: Any) -> None:
        self._building.journal.append({"kind": kind, **entry})

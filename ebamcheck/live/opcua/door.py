"""The door to a control: what is seen on it decides, over and over, what is done next.

Nothing is remembered that can be seen: a value that did not arrive, a connection that broke and a server that was started anew
all come to the same next look. A layer is uploaded, read back and compared before its number is written, and is released last of
all, once, and only to a program that is seen to wait for it. What was released and is gone (RESET) is released again on the
operator's word alone, since nobody here knows how much of it lies on the part.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import secrets
import time
from collections.abc import Callable
from typing import Any

from ebamcheck.errors import EbamcheckError, SettingsError
from ebamcheck.live.building import Answer, Building
from ebamcheck.live.journal import read_journal
from ebamcheck.live.making import failure_of
from ebamcheck.live.opcua.handshake import BUILT, OFFSETS, Seen, digest, program_number
from ebamcheck.live.opcua.link import Link, LinkLost, NotTaken
from ebamcheck.live.opcua.waiting import within
from ebamcheck.settings.machine import MachineSettings
from ebamcheck.settings.opcua import OpcuaSettings

OWNERS = 2**31
"""Range of the number by which a door knows that it is the one that writes."""

UPLOADED, RELEASED, AGAIN = "uploaded", "released", "again"
"""Kinds of lines in the journal that tell what was done to the control."""


class Door:
    """Leads a build on a control.

    Parameters
    ----------
    building
        The build; its journal also holds what was released.
    told
        Called with each answer that differs from the last one of its kind.
    """

    def __init__(
        self,
        building: Building,
        machine: MachineSettings,
        opcua: OpcuaSettings,
        told: Callable[[Answer], None],
    ) -> None:
        self._building, self._machine, self._opcua = building, machine, opcua
        self._tell_all = told
        self._owner = float(1 + secrets.randbelow(OWNERS - 1))
        self._claimed = False
        self._told: dict[str, str] = {}
        self._waited, self._waits_since = math.nan, -math.inf
        self._measured: str | None = None
        self._done_since: tuple[int, float] | None = None
        self._released: int | None = None
        self._uploaded = ""
        self._retry_at, self._pause_s = -math.inf, opcua.retry_s
        self._recall()

    def _recall(self) -> None:
        """Take from the journal what was done to the control before."""
        for entry in read_journal(self._building.journal_file):
            if entry["kind"] == UPLOADED:
                self._uploaded = str(entry["file"])
            elif entry["kind"] == RELEASED:
                self._released = int(entry["layer"])
            elif entry["kind"] == AGAIN:
                self._released = None

    # -- connections -------------------------------------------------------------------------------

    async def run(self) -> Answer:
        """Lead the build to its end; connections come and go meanwhile.

        Raises
        ------
        SettingsError
            If the control lets nobody in, or has no such nodes, before anything was done on it.
        """
        pause_s, ever = self._opcua.retry_s, False
        while True:
            try:
                async with Link(self._machine, self._opcua) as link:
                    self._say("connected", url=self._opcua.url)
                    self._fresh_link()
                    while True:
                        answer = await self._look(link)
                        if answer is not None:
                            return answer
                        ever, pause_s = True, self._opcua.retry_s
                        await self._changed(link)
            except LinkLost as error:
                self._lost(str(error))
            except EbamcheckError as error:
                # Before anything was done, this is a matter of settings and not of time.
                if not ever:
                    raise SettingsError(str(error)) from None
                self._lost(str(error))
            except Exception as error:  # whatever the connection comes to, the server stays
                self._lost(failure_of(error))
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, self._opcua.longest_retry_s)

    def _lost(self, reason: str) -> None:
        self._say("lost", reason=reason, kept="what was published stays; trying again")

    def _fresh_link(self) -> None:
        self._waited, self._waits_since = math.nan, -math.inf
        self._told.pop("lost", None)
        self._retry_at = -math.inf

    async def _changed(self, link: Link) -> None:
        """Wait until something has changed on the control, or it is time to look anyway."""
        try:
            await within(link.changed.wait(), self._opcua.look_s)
        except TimeoutError:
            return
        link.changed.clear()

    # -- one look ----------------------------------------------------------------------------------

    async def _look(self, link: Link) -> Answer | None:
        """Look at the control, and do what follows from it; the last answer where the build is over."""
        seen = await link.seen()
        self._notice_waiting(seen)
        try:
            if not await self._owns(link, seen):
                return None
            return await self._step(link, seen)
        except NotTaken as error:
            self._hold(error.code, str(error))
        except LinkLost:
            raise
        except Exception as error:  # a full disk, a fault of the software: what was published stays
            self._hold("held", failure_of(error))
        return None

    async def _owns(self, link: Link, seen: Seen) -> bool:
        """Whether this server is the one that writes: the last one that came is, and the one before notices."""
        if seen.owner == self._owner:
            return True
        if self._claimed and seen.owner != 0.0:
            self._refuse(
                "two-servers", f"another server has taken over (owner {seen.owner:.0f}, not {self._owner:.0f}): nothing is "
                "written here any more; end one of them, and start the other anew"
            )  # fmt: skip
        elif time.monotonic() >= self._retry_at:
            await link.write("owner", self._owner)
            self._claimed = True
            link.changed.set()
        return False

    def _notice_waiting(self, seen: Seen) -> None:
        """A program that waits counts the time: one whose count stands still is not there, or at work."""
        now = time.monotonic()
        if not math.isnan(self._waited) and seen.waited != self._waited and seen.waited > 0.0:
            self._waits_since = now
        self._waited = seen.waited

    @property
    def _waits(self) -> bool:
        limit_s = 3.0 * max(self._machine.live_poll_s, self._opcua.look_s, self._opcua.grid_s)
        return time.monotonic() - self._waits_since <= limit_s

    async def _step(self, link: Link, seen: Seen) -> Answer | None:
        building = self._building
        if building.expected_done == 0:
            self._tell(await asyncio.to_thread(building.start))
            if building.expected_done == 0:
                self._hold("held", "the lowest layer is not published")
                return None
        if building.finished:
            return await self._finish(link, seen)
        next_layer = building.expected_done - 1
        if not float(seen.done).is_integer() or seen.done < 0.0:
            self._refuse("counter", f"the control counts {seen.done:g} layers: that is no number of layers")
        elif seen.begin_at != 0.0:
            await self._begin_again(link, seen, next_layer)
        elif seen.done == next_layer + 1:
            await self._measure(link, seen)
        elif seen.done == next_layer:
            await self._release(link, seen, next_layer)
        else:
            again = f"set {self._name('begin_at')} to the layer that is to be begun, {next_layer + 1}, or {next_layer + 2} where that one is whole"
            what = "was RESET" if seen.done == 0.0 else f"counts {seen.done:g} layers"
            self._refuse(
                "counter-jump",
                f"the control {what}, {next_layer} layers are done: nothing is released; {again}",
            )
        return None

    def _name(self, role: str) -> str:
        return self._opcua.nodes.get(role) or f"R{self._machine.live_r + OFFSETS[role]}"

    # -- heights -----------------------------------------------------------------------------------

    async def _measure(self, link: Link, seen: Seen) -> None:
        """A layer is done: take its height, once it belongs to that layer and stands still."""
        done, now = int(seen.done), time.monotonic()
        if self._done_since is None or self._done_since[0] != done:
            self._done_since, self._measured = (done, now), None
        if seen.measured != done:
            if seen.measured not in (0.0, float(done - 1)):
                self._refuse(
                    "counter-jump",
                    f"a height is said to be of layer {seen.measured:g}, {done} layers are done",
                )
            if now - self._done_since[1] > self._opcua.late_s:
                self._say("late", done=done, waited_s=self._opcua.late_s)
            return
        # Two looks have to agree: values that are written one by one are not there at once.
        await asyncio.sleep(self._opcua.grid_s)
        again = await link.seen()
        if again.reading != seen.reading:
            link.changed.set()
            return
        if self._measured == seen.reading:
            return
        message: dict[str, Any] = {"event": "height", "done": done}
        if seen.map:
            message["height_map"] = seen.map
        else:
            message["height_mm"] = None if math.isnan(seen.height) else seen.height
        if seen.surface_k != 0.0:
            message |= {"surface_k": seen.surface_k, "after_s": seen.after_s}
        self._tell(await asyncio.to_thread(self._building.height, message))
        # One that a fault of ours came in between is taken again.
        self._measured = seen.reading
        link.changed.set()

    # -- releases ----------------------------------------------------------------------------------

    async def _release(self, link: Link, seen: Seen, layer: int) -> None:
        """The layer that is published is the next one of the control: release it, unless that was done."""
        if self._released == layer:
            if seen.released != layer + 1:
                self._refuse(
                    "withdrawn", f"layer {layer + 1} was released and is so no more (RESET): look at the part, then set "
                    f"{self._name('begin_at')} to {layer + 1} to have it laid from its beginning"
                )  # fmt: skip
            return
        if seen.released == layer + 1:
            await link.write("released", 0.0)
            raise NotTaken(
                "two-servers",
                f"layer {layer + 1} was released by somebody else: it was taken back, before it was called if time allowed",
            )
        if time.monotonic() < self._retry_at:
            return
        if not self._waits:
            self._say(
                "waiting",
                layer=layer + 1,
                reason="the main program is not seen to wait: start it on the control",
            )
            return
        current = self._building.status()["published"]
        data, name = self._program(current)
        await self._put(link, name, data, str(current["sha256"]))
        await link.write("measured", 0.0)
        await link.write("number", program_number(str(current["name"])))
        await link.write("wait", round(float(current["wait_s"]), 3))
        await link.write("digest", digest(str(current["sha256"])))
        await link.write_text("name", str(current["name"]))
        await link.write_text("sha256", str(current["sha256"]))
        now = await link.seen()
        if now.owner != self._owner or now.done != layer or now.released == layer + 1:
            raise NotTaken(
                "two-servers", "another client wrote to the handshake meanwhile: the layer is kept back"
            )
        if now.number != program_number(str(current["name"])):
            raise NotTaken(
                "two-servers", f"the number of the program was changed to {now.number:g} by another client"
            )
        self._note(RELEASED, layer=layer, name=current["name"], sha256=current["sha256"])
        self._released = layer
        try:
            await link.write("released", float(layer + 1))
        except NotTaken:
            # It reads back as not released, so that no program can have seen it.
            self._note(AGAIN, layer=layer, why="the release was not taken")
            self._released = None
            raise
        self._retry_at, self._pause_s = -math.inf, self._opcua.retry_s
        self._forget("refused", "waiting", "late", "held")
        self._say("released", layer=layer + 1, name=current["name"], sha256=current["sha256"])

    def _program(self, current: dict[str, Any]) -> tuple[bytes, str]:
        path = self._building.folder / str(current["program"])
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest() != current["sha256"]:
            raise SettingsError(f"{path}: is not the file that was verified: it is not released")
        if len(data) > 1e6 * self._opcua.file_limit_mb:
            raise SettingsError(
                f"{path}: has {len(data) / 1e6:.3f} MB, over opcua.file_limit_mb {self._opcua.file_limit_mb:g}: it is not released"
            )
        return data, path.name

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
            raise NotTaken(
                "other-file",
                f"{name} reads back as another file than was written ({0 if found is None else len(found)} bytes of {len(data)}): it is not released",
            )

    async def _begin_again(self, link: Link, seen: Seen, layer: int) -> None:
        """The operator says at which layer the control, that was RESET, is to go on."""
        wanted = seen.begin_at
        if wanted not in (layer + 1, layer + 2):
            self._refuse(
                "begin-at",
                f"{self._name('begin_at')} is {wanted:g}: give {layer + 1} or, where that layer is whole, {layer + 2}",
            )
            return
        if not self._waits:
            self._say(
                "waiting",
                layer=int(wanted),
                reason="the main program is not seen to wait: start it on the control",
            )
            return
        self._note(AGAIN, layer=int(wanted) - 1, why="the operator's word")
        self._released = None if wanted == layer + 1 else self._released
        await link.write("released", 0.0)
        await link.write("measured", 0.0)
        await link.write("done", wanted - 1.0)
        await link.write("begin_at", 0.0)
        self._forget("refused", "waiting")
        self._say("begins-again", layer=int(wanted))
        link.changed.set()

    async def _finish(self, link: Link, seen: Seen) -> Answer | None:
        """The part is built: say so to the control."""
        if time.monotonic() < self._retry_at:
            return None
        if seen.released != BUILT:
            await link.write("released", BUILT)
        await link.write("owner", 0.0)
        return {**self._building.told, "answer": "built"}

    # -- what is told ------------------------------------------------------------------------------

    def _note(self, kind: str, **entry: Any) -> None:
        self._building.note({"kind": kind, **entry})

    def _tell(self, answer: Answer) -> None:
        self._told.clear()
        self._tell_all(answer)

    def _say(self, kind: str, **answer: Any) -> None:
        """Tell an answer once, until another one of its kind is told."""
        text = repr(answer)
        if self._told.get(kind) != text:
            self._told[kind] = text
            self._tell_all({"answer": kind, **answer})

    def _forget(self, *kinds: str) -> None:
        for kind in kinds:
            self._told.pop(kind, None)

    def _refuse(self, code: str, reason: str) -> None:
        self._say("refused", code=code, reason=reason)

    def _hold(self, code: str, reason: str) -> None:
        """Say why nothing is released, and try again later."""
        self._refuse(code, reason)
        self._retry_at = time.monotonic() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, self._opcua.longest_retry_s)

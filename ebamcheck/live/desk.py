"""The door of a build: one JSON object a line in, one JSON object a line out, until the input ends or somebody says stop.

Between layers, when nobody waits, tables are written and memory is given back. A server holds half a million objects that stay as
long as it runs. Python looks for cycles among all of them at once, for a quarter of a second, and not before a quarter more have
come: some hundred layers leave tens of kilobytes each meanwhile, and the search comes in the middle of one. What stays is therefore
set aside once it is loaded, and what a layer leaves is collected after it.
"""

from __future__ import annotations

import gc
import json
import os
import select
import time
from collections.abc import Callable, Mapping
from typing import IO, Any

from ebamcheck.json_values import plain
from ebamcheck.live.building import Answer, Building
from ebamcheck.live.height_map import Refused
from ebamcheck.live.making import failure_of
from ebamcheck.live.readings import LONGEST_LINE, parsed


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
            if b"\n" not in found and len(self._held) > LONGEST_LINE:
                continue  # the rest of a line that is too long already
            self._held += found
        line, self._held = self._held.split(b"\n", 1)
        return line


def serve(building: Building, lines: Lines, out: IO[str], timeout_s: float) -> None:
    """Answer lines until the input ends, somebody says ``stop``, or nobody reads the answers.

    After a time without a line the server says that it waits, once until the next line.
    """
    said_late, between = False, BetweenLayers(building)
    while True:
        try:
            line = lines.next(None if said_late else timeout_s)
        except EOFError:
            return
        if line is None:
            said_late = True
            answer: Answer = {**building.status(), "answer": "late", "waited_s": timeout_s}
        else:
            said_late = False
            answer = answer_to(building, line)
        out.write(json.dumps(plain(answer), sort_keys=True, allow_nan=False) + "\n")
        out.flush()
        between(answer)
        if answer["answer"] == "stopped":
            return


def answer_to(building: Building, line: bytes) -> Answer:
    """Answer one line; nothing that comes in ends the server."""
    try:
        message = parsed(line)
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


SETTLED = 3
"""Layers after which all that stays is loaded: kernels and modules come with the first that need them."""

WORK = ("published", "released", "kept", "done", "built")
"""Answers after which a layer's work is done."""


class BetweenLayers:
    """What is done after each answer of a build."""

    def __init__(self, building: Building) -> None:
        self._building, self._layers = building, 0

    def __call__(self, answer: Mapping[str, Any]) -> None:
        """Do it; the answer was sent already."""
        self._building.heights.write(ended=self._building.finished)
        if answer.get("answer") not in WORK:
            return
        gc.collect()
        self._layers += 1
        if self._layers <= SETTLED:
            gc.freeze()

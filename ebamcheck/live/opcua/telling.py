"""What the door tells, each thing once, and when it tries again what was refused: at once, and then less and less often."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from ebamcheck.live.building import Answer


class Telling:
    """Answers of a door.

    Parameters
    ----------
    told
        Called with each answer that differs from the last one of its kind.
    retry_s, longest_s
        Time before the next try; it doubles up to the second one.
    """

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
        """Try again after the pause, which doubles."""
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

    def hold(self, code: str, reason: str) -> None:
        """Say why nothing is released, and try again later."""
        self.refuse(code, reason)
        self.later()

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

"""A control as far as the door of a build goes: it calls what is published, lets layers grow, and sends their heights."""

from __future__ import annotations

import hashlib
import json
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ebamcheck.errors import BackendFailed
from ebamcheck.live.bed import Growth, bad_lines


@dataclass(frozen=True)
class Played:
    """One layer that was laid."""

    layer: int
    name: str
    base_mm: float
    planned_mm: float
    measured_mm: float
    answer_s: float
    islands_s: float
    cusp_mm: float
    said: str


class Server:
    """A server of a build in a process of its own, spoken to by lines."""

    def __init__(self, command: Sequence[str], cwd: Path | None = None) -> None:
        self._process = subprocess.Popen(
            list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=cwd
        )

    def ask(self, line: bytes) -> dict[str, Any]:
        """Send a line and return the answer.

        Raises
        ------
        BackendFailed
            If the server has gone.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(line.replace(b"\n", b" ") + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise BackendFailed(f"`ebamcheck live` has ended with exit code {self._process.wait()}") from None
        found = self._process.stdout.readline()
        if not found:
            raise BackendFailed(f"`ebamcheck live` has ended with exit code {self._process.wait()}")
        answer: dict[str, Any] = json.loads(found)
        return answer

    def tell(self, **message: Any) -> dict[str, Any]:
        """Send a message and return the answer."""
        return self.ask(json.dumps(message).encode())

    def kill(self) -> None:
        """End it at once, as a power cut does."""
        self._process.kill()
        self.close()

    def close(self) -> None:
        """Let it end, and wait for that."""
        if self._process.stdin is not None:
            with suppress(BrokenPipeError):
                self._process.stdin.close()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def play(
    server: Server,
    folder: Path,
    growth: Growth,
    speed: float,
    told: Callable[[Played], None] = lambda _: None,
    faults: bool = False,
    most_layers: int | None = None,
) -> dict[str, Any]:
    """Build a part: from the layer that is published on to the top.

    Parameters
    ----------
    folder
        Folder of the build, in which published programs lie.
    speed
        How many times faster than planned layers are laid.
    told
        Called with each layer.
    faults
        Send bad lines before every reading, each of which has to be refused as what it is.
    most_layers
        Stop after so many layers.

    Returns
    -------
    dict
        The last answer.

    Raises
    ------
    BackendFailed
        If the server ends, publishes a file that is not the one that it names, or takes a bad line.
    """
    answer, count = server.tell(event="start"), 0
    while answer["answer"] == "published" and (most_layers is None or count < most_layers):
        base_mm, planned_mm, layer = answer["base_mm"], answer["thickness_mm"], answer["layer"]
        path = folder / answer["program"]
        # What is called is what was named: the file is read when it is called.
        if hashlib.sha256(path.read_bytes()).hexdigest() != answer["sha256"]:
            raise BackendFailed(f"{path}: is not the file that was published for layer {layer}")
        time.sleep((answer["layer_s"] + answer["wait_s"]) / speed)
        height_mm = base_mm + growth.grown_mm(layer - 1, planned_mm)
        if faults:
            _refused(server, layer, base_mm, base_mm + planned_mm)
        begin = time.perf_counter()
        after = server.tell(event="height", done=layer, height_mm=height_mm)
        told(
            Played(
                layer, answer["name"], base_mm, planned_mm, height_mm - base_mm, time.perf_counter() - begin,
                answer["layer_s"], answer.get("cusp_mm", 0.0), "; ".join(answer.get("said", [])),
            )
        )  # fmt: skip
        answer, count = after, count + 1
    return answer


def _refused(server: Server, done: int, base_mm: float, top_mm: float) -> None:
    for code, line in bad_lines(done, base_mm, top_mm):
        answer = server.ask(line)
        if answer["answer"] != "refused" or answer["code"] != code:
            raise BackendFailed(f"`ebamcheck live` takes {line!r:.80} for {answer!r:.200}, not as {code}")

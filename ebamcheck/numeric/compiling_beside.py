"""Kernels compiled beside a command, on all cores, while it works with those that are there already.

The first kernel that a command misses starts a process that compiles those of the list that the command is to need, in the
order of the main job. The command itself goes on: what it needs next it compiles, or waits for where that process is at it
(:mod:`ebamcheck.numeric.kernel_turns`). When the command ends, the process does.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence

from ebamcheck.numeric import compiling
from ebamcheck.numeric.compiling_ahead import compile_tasks, tasks_of
from ebamcheck.numeric.kernel_cache import missing_told
from ebamcheck.numeric.kernel_list import Listed, read_list
from ebamcheck.numeric.kernels import thread_count

ROOMS = (
    "ebamcheck.numeric",
    "ebamcheck.mesh",
    "ebamcheck.layers",
    "ebamcheck.slicers",
    "ebamcheck_",
    "ebamcheck.comparison",
    "ebamcheck.curves",
    "ebamcheck.heat",
    "ebamcheck.metal",
    "ebamcheck.scan",
    "ebamcheck",
)
"""Beginnings of modules in the order in which the main job comes to their kernels."""

SLICING = ROOMS[: ROOMS.index("ebamcheck_")]
"""Those that slicing with any backend comes to, besides the backend's own."""

CHECKING = ROOMS[: ROOMS.index("ebamcheck.curves")]
"""Those that a cross-check comes to."""

LAST_WORDS_S = 1.0
"""How long a command waits at its end for what the process has said, whose own processes end by themselves."""


_active: list[_Beside] = []


@contextlib.contextmanager
def compiled_beside(listed: Listed | None = None, modules: Sequence[str] = ()) -> Iterator[None]:
    """Compile kernels beside the block, from the first one on that it misses; on one core it does so alone.

    Within such a block another one changes nothing.

    Parameters
    ----------
    listed
        Argument types by kernel, as of :func:`kernel_list.read_list`; None: the whole list.
    modules
        Beginnings of the names of modules, of which alone kernels of the list are compiled; without them, modules that are
        loaded when the first kernel is missed.
    """
    if _active or thread_count() == 1:
        yield
        return
    beside = _Beside(listed, modules)
    _active.append(beside)
    try:
        with missing_told(beside.begin):
            yield
    finally:
        _active.remove(beside)
        beside.end()


class _Beside:
    """The process beside a command; there is none until a kernel is missed."""

    def __init__(self, listed: Listed | None, modules: Sequence[str]) -> None:
        self._listed, self._modules = listed, tuple(modules)
        self._process: subprocess.Popen[str] | None = None
        self._talk: threading.Thread | None = None
        self._owner = os.getpid()

    def begin(self) -> None:
        """Start it, unless it was started before or this is a process that was forked from the command."""
        if self._process is not None or os.getpid() != self._owner:
            return
        listed = to_come(read_list().whole, self._modules) if self._listed is None else self._listed
        with contextlib.suppress(OSError):  # without it, the command compiles alone
            self._process = subprocess.Popen(
                [sys.executable, "-m", "ebamcheck.numeric.compiling_beside"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            # The list is longer than a pipe, and read only when the other interpreter has come up: the command goes on meanwhile.
            self._talk = threading.Thread(target=_talk, args=(self._process, listed), daemon=True)
            self._talk.start()

    def end(self) -> None:
        """End it; what it has not compiled by now is compiled when it is missed."""
        if self._process is None:
            return
        self._process.kill()
        self._process.wait()
        if self._talk is not None:
            self._talk.join(LAST_WORDS_S)
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):  # what could not be written any more
                self._process.stdin.close()


def to_come(listed: Listed, modules: tuple[str, ...]) -> Listed:
    """Kernels of a list that stand in modules whose names begin so; without any, in those that are loaded."""
    if modules:
        return {name: versions for name, versions in listed.items() if name.startswith(modules)}
    loaded = {compiling.name_of(kernel) for kernel in compiling.loaded_kernels()}
    return {name: versions for name, versions in listed.items() if name in loaded}


def _talk(process: subprocess.Popen[str], listed: Listed) -> None:
    """Give the process its list, and tell whoever listens here of the kernels that it begins: one a line, after those to come."""
    if process.stdin is None or process.stdout is None:
        return
    # What it said last when it was ended may be half a line.
    with contextlib.suppress(OSError, ValueError), process.stdout as lines:
        process.stdin.write(json.dumps(listed) + "\n")
        process.stdin.flush()
        to_come = json.loads(lines.readline() or "[]")
        for line in lines:
            if line.endswith("\n"):
                compiling.begun(line.strip(), to_come)


def main() -> None:
    """Compile what comes as one line on standard input, until it is done or the command ends."""
    tasks = tasks_of(json.loads(sys.stdin.readline() or "{}"))
    _say(json.dumps(list(tasks)))
    threading.Thread(target=_end_with_input, daemon=True).start()
    with compiling.heard_by(lambda _number, _most, name: _say(name)):
        compile_tasks(tasks, rooms=ROOMS)


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _end_with_input() -> None:
    # Not by the stream, whose lock the processes that are forked meanwhile would inherit.
    while os.read(sys.stdin.fileno(), 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    main()

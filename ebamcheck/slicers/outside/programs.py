"""Programs of others: find one, ask for its version, run it in a folder that is gone afterwards.

No shell, no configuration of the user, English messages, a time limit. A program that runs over it is ended together
with everything that it started; where this process itself is killed, Linux ends the program.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

from ebamcheck.backend import BackendSettings, Probe
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.scratch import scratch_folder
from ebamcheck.settings.base import Between

VERSION_LIMIT_S = 20.0  # time that a program may take to tell its version: the first start after a boot reads it from a slow disk

TAIL_BYTES = 8192  # how much of the end of a program's output is kept for messages
LONGEST_REASON = 200  # characters of a program's own words in an error message


class ProgramSettings(BackendSettings):
    """Settings of every backend that runs a program of others."""

    time_limit_s: Annotated[float, Between(0.001, 1e7)] = 600.0
    """Time that one run of the program may take."""


@dataclass(frozen=True)
class Program:
    """A program of others: its executable on the search path, or as the variable names it, and the Debian package that has it.

    `version_arguments` ask for its version, which is the first group of `version_pattern` in the answer.
    """

    name: str
    command: str
    variable: str
    package: str
    version_arguments: tuple[str, ...]
    version_pattern: str

    @property
    def hint(self) -> str:
        """How to get it, in one line."""
        return f"apt install {self.package}, or name the executable in {self.variable}"

    def find(self) -> Path | None:
        """Where it is: as its variable says, else on the search path; None where it is not."""
        wanted = os.environ.get(self.variable) or self.command
        found = shutil.which(wanted)
        return None if found is None else Path(found)

    def path(self) -> Path:
        """Where it is; raises :class:`BackendMissing` with a hint where it is not."""
        found = self.find()
        if found is None:
            raise BackendMissing(f"{self.name} is not installed; {self.hint}")
        return found

    def probe(self) -> Probe:
        """Whether it is there and answers, with its version."""
        found = self.find()
        if found is None:
            named = os.environ.get(self.variable)
            why = (
                f"{self.variable}={named} is no executable" if named else f"{self.command} is not on the PATH"
            )
            return Probe(False, why=why, hint=self.hint)
        try:
            version = _version(self, found)
        except BackendFailed as failure:
            return Probe(False, why=str(failure), hint=self.hint)
        return Probe(True, versions={self.name: version})

    def run(self, arguments: Sequence[str | Path], folder: Path, time_limit_s: float) -> str:
        """Run it in a folder, which also is its home; returns the end of what it wrote, or raises in one line, with its own last words."""
        code, said = _run([str(self.path()), *map(str, arguments)], folder, time_limit_s)
        if code is None:
            raise BackendFailed(f"{self.name} was ended: it took over {time_limit_s:g} s (time_limit_s)")
        if code:
            raise BackendFailed(f"{self.name} ended with {_exit(code)}{self._last_words(said)}")
        return said

    def failed(self, why: str, said: str = "") -> BackendFailed:
        """Make the error for a run that came to an end without a result."""
        return BackendFailed(f"{self.name} {why}{self._last_words(said)}")

    @staticmethod
    def _last_words(said: str) -> str:
        lines = [line.strip() for line in said.splitlines() if line.strip()]
        return f": {lines[-1][:LONGEST_REASON]}" if lines else ""


@cache
def _version(program: Program, path: Path) -> str:
    with scratch_folder() as folder:
        code, said = _run([str(path), *program.version_arguments], folder, VERSION_LIMIT_S)
    found = re.search(program.version_pattern, said)
    if found is None:
        what = f"took over {VERSION_LIMIT_S:g} s" if code is None else f"ended with {_exit(code)}"
        raise BackendFailed(f"{path} does not tell a version of {program.name}: it {what}")
    return found[1]


def _run(command: list[str], folder: Path, time_limit_s: float) -> tuple[int | None, str]:
    """Exit code (None: the time was up) and the end of the output."""
    output = folder / "output.txt"
    try:
        with output.open("wb") as file:
            process = subprocess.Popen(
                [*_ended_with_us(), *command],
                cwd=folder,
                env={**os.environ, "HOME": str(folder), "LC_ALL": "C"},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )
    except OSError as error:
        raise BackendFailed(f"{command[0]} does not start: {error.strerror}") from None
    code: int | None = None
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(time_limit_s)
    finally:
        _end(process)
    with output.open("rb") as file:
        file.seek(max(0, output.stat().st_size - TAIL_BYTES))
        return code, file.read().decode("utf-8", "replace")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a program's whole group, of which it is the leader: also what it started and left behind."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@cache
def _ended_with_us() -> tuple[str, ...]:
    """Command that asks Linux to end what follows it once this process is gone, where there is one."""
    path = shutil.which("setpriv")
    if path is None:
        return ()
    asked = subprocess.run([path, "--pdeathsig", "KILL", "true"], capture_output=True, check=False)
    return () if asked.returncode else (path, "--pdeathsig", "KILL")


def _exit(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    known = -code in signal.Signals.__members__.values()
    return signal.Signals(-code).name if known else f"signal {-code}"

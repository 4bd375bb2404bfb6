"""The errors that ebamcheck raises, and the exit code that each one stands for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of the command line."""

    PASS = 0
    OUT_OF_TOLERANCE = 1
    USAGE = 2
    INTERNAL = 3
    BACKEND_MISSING = 4
    NOTHING_COMPARED = 5
    DISK_FULL = 6
    MEMORY_FULL = 7
    INTERRUPTED = 130
    # The reader of the output has gone (`| head`), which a shell tells of programs in this way
    NOBODY_READS = 141


class EbamcheckError(Exception):
    """Base of every error that a user can cause and mend.

    The message is one line: what was wrong, where, with which value, and what to do.

    Parameters
    ----------
    *args
        The message.

    Examples
    --------
    >>> error = SettingsError("layer height 0 mm: give a positive number of millimetres")
    >>> isinstance(error, EbamcheckError), error.exit_code.name
    (True, 'USAGE')
    """

    exit_code: ExitCode = ExitCode.INTERNAL


class InputError(EbamcheckError):
    """A file that cannot be read as what it should be."""

    exit_code = ExitCode.USAGE


class SettingsError(EbamcheckError):
    """A setting, an argument or a configuration file that makes no sense."""

    exit_code = ExitCode.USAGE


class BackendMissing(EbamcheckError):
    """A backend that was asked for is unknown or not available on this machine."""

    exit_code = ExitCode.BACKEND_MISSING


class BackendFailed(EbamcheckError):
    """A backend crashed, hung, ran out of memory or refused the part.

    Parameters
    ----------
    *args
        The message.

    Examples
    --------
    >>> BackendFailed("mine: the part is open at 3 edges").exit_code
    <ExitCode.OUT_OF_TOLERANCE: 1>
    """

    exit_code = ExitCode.OUT_OF_TOLERANCE


class NothingCompared(EbamcheckError):
    """A run in which no layer was compared between two methods."""

    exit_code = ExitCode.NOTHING_COMPARED


class GeometryError(EbamcheckError):
    """Geometry on which a stage cannot do its work (a ring too short to fit, say)."""

    exit_code = ExitCode.OUT_OF_TOLERANCE


def behind(error: BaseException | None) -> Iterator[BaseException]:
    """Go through an error and those that led to it."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


@contextmanager
def interruptible() -> Iterator[None]:
    """Tell an interrupt in compiled code, where the interpreter raises a `SystemError`, as an interrupt."""
    try:
        yield
    except SystemError as error:
        if any(isinstance(one, KeyboardInterrupt) for one in behind(error)):
            raise KeyboardInterrupt from error
        raise

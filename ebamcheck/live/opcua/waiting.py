"""Waits with a limit that never lose a cancellation, whatever the library that is waited for does with it.

Before Python 3.12 ``asyncio.wait_for`` loses one that comes as the wait ends; asyncua loses one that comes while it takes itself
down. A loop that goes on after its own end can be waited for without end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")

WINDS_UP_S = 1.0
"""Time that something has to wind up which is waited for no longer."""


class BrokenOff(Exception):
    """What was waited for was cancelled from within: the library does so with all requests when a connection breaks."""


async def within(asked: Awaitable[T], limit_s: float) -> T:
    """Wait for a result, in a task of its own.

    Parameters
    ----------
    limit_s
        Longest time of the wait, s.

    Raises
    ------
    TimeoutError
        If it takes longer; it is cancelled then.
    BrokenOff
        If it was cancelled, and not by the one who waits.
    asyncio.CancelledError
        If the one who waits is cancelled, always.
    """
    task = asyncio.ensure_future(asked)
    try:
        await asyncio.wait([task], timeout=limit_s)
        if not task.done():
            await cancelled(task)
            raise TimeoutError
    except asyncio.CancelledError:
        await cancelled(task)
        raise
    if task.cancelled():
        raise BrokenOff
    return task.result()


async def cancelled(task: asyncio.Future[T]) -> None:
    """Cancel a task and give it a while to wind up; what it says then is of no interest."""
    task.add_done_callback(_heard)
    task.cancel()
    await asyncio.wait([task], timeout=WINDS_UP_S)


def _heard(task: asyncio.Future[T]) -> None:
    """Take an exception, so that nobody is told that it was never taken."""
    if not task.cancelled():
        task.exception()

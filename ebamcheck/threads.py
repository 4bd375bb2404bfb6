"""Work on all threads: blocks of rows by kernels that do without the interpreter lock, and items one by one."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from ebamcheck.errors import SettingsError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_Scalar = TypeVar("_Scalar", bound="np.generic[Any]")


def thread_count() -> int:
    """Threads that kernels may use: ``EBAMCHECK_THREADS``, else the cores this process may run on."""
    if wanted := os.environ.get("EBAMCHECK_THREADS", ""):
        if not (wanted.isdecimal() and int(wanted) > 0):
            raise SettingsError(f"EBAMCHECK_THREADS={wanted!r}: give a positive whole number, or unset it")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_blocks(work: Callable[[int, int], _Result], count: int, smallest: int = 1, a_thread: int = 4) -> list[_Result]:
    """Run ``work(start, stop)`` over blocks that cover ``range(count)``, `a_thread` for each thread, of `smallest` items at least;
    results in order."""
    return list(run_in_order(work, block_edges(count, smallest, a_thread)))


def run_each(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """Run ``work`` on every item, in blocks on all threads; results come in the order of the items."""
    every = list(items)
    blocks = run_blocks(lambda start, stop: [work(item) for item in every[start:stop]], len(every))
    return [result for block in blocks for result in block]


def block_edges(count: int, smallest: int = 1, a_thread: int = 4, largest: int | None = None) -> list[int]:
    """Edges of consecutive blocks that cover ``range(count)``: `a_thread` for each thread, of `smallest` to `largest` items."""
    blocks = max(1, min(thread_count() * a_thread, count // max(smallest, 1)))
    if largest is not None:
        blocks = max(blocks, -(-count // largest))
    return [count * i // blocks for i in range(blocks + 1)]


def run_in_order(work: Callable[[int, int], _Result], edges: Sequence[int]) -> Iterator[_Result]:
    """Run ``work(start, stop)`` between each of the `edges` and the next, on all threads; results come in this order."""
    threads = thread_count()
    if threads == 1 or len(edges) < 3 or getattr(_THREAD, "shares_cores", False):
        yield from map(work, edges[:-1], edges[1:])
        return
    yield from _pool(threads).map(work, edges[:-1], edges[1:])


def worker_threads(count: int | None = None) -> ThreadPoolExecutor:
    """Make a pool of threads that fill the cores: as many as kernels may use. Blocks run on the one that asks for them."""
    return ThreadPoolExecutor(count or thread_count(), initializer=_share_cores)


# `shares_cores`: this thread is one of several that fill the cores, and spreads its blocks no further
_THREAD = threading.local()


def _share_cores() -> None:
    _THREAD.shares_cores = True


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Make the threads on which blocks run: once a process, since starting them takes as long as a small block."""
    return ThreadPoolExecutor(threads, "ebamcheck-blocks", _share_cores)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)

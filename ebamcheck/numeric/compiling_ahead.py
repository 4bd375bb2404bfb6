"""Kernels compiled ahead in several processes: callees before their callers, and none of them twice.

A kernel's compilation takes the compiled code of the kernels that it calls from the cache, where it is there by then. So
it begins when all that it calls is done; of those that may begin, the one with the longest way up to the last caller does.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

from ebamcheck.numeric import compiling
from ebamcheck.numeric.kernel_compiling import only_compile
from ebamcheck.numeric.kernel_list import Listed, compile_listed, is_cached, kernel_named
from ebamcheck.numeric.kernel_stamp import seen_by
from ebamcheck.numeric.kernels import thread_count


@dataclass(frozen=True)
class Task:
    """Versions of one kernel that the cache lacks."""

    name: str
    versions: list[str]
    calls: frozenset[str]
    """Tasks that come before this one: kernels that this one calls, at any depth."""
    weight: float
    """How long it may take, in bytes of the interpreter's code."""


def compile_ahead(listed: Listed, processes: int | None = None) -> dict[str, str]:
    """Compile what the cache lacks of a list, and tell of each kernel by :func:`compiling.begun`.

    Parameters
    ----------
    listed
        Argument types by kernel, as of :func:`kernel_list.read_list`.
    processes
        How many at once; as many as kernels may use threads where it is not given.

    Returns
    -------
    why
        For each kernel that does not compile as listed, what numba says of it; it stops nothing.
    """
    return compile_tasks(tasks_of(listed), processes)


def compile_tasks(
    tasks: dict[str, Task], processes: int | None = None, rooms: Sequence[str] = ()
) -> dict[str, str]:
    """Compile tasks (:func:`tasks_of`); as :func:`compile_ahead`, which says what else is given and returned.

    Parameters
    ----------
    rooms
        Beginnings of the names of modules: kernels of the first ones, and what they call, come first.
    """
    if not tasks:
        return {}
    # Forked, as interpreters that have loaded every module; elsewhere they load what they need.
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    count = min(len(tasks), processes or thread_count())
    with ProcessPoolExecutor(count, context, initializer=_begin_to_compile) as pool:
        try:
            return _run(tasks, pool, count, rooms)
        except BrokenProcessPool as error:
            return {"": f"a compiling process ended: {error}"}


def tasks_of(listed: Listed) -> dict[str, Task]:
    """What is to be compiled, by kernel: listed, there, and not in the cache."""
    missing = {}
    for name, versions in listed.items():
        kernel = kernel_named(name)
        if kernel is None:
            continue
        if lacking := [text for text in versions if not is_cached(kernel, text)]:
            missing[name] = (kernel, lacking)
    return {
        name: Task(
            name,
            lacking,
            frozenset(seen_by(kernel.py_func) & missing.keys() - {name}),
            float(len(kernel.py_func.__code__.co_code) * len(lacking)),
        )
        for name, (kernel, lacking) in missing.items()
    }


def longest_ways(tasks: Mapping[str, Task]) -> dict[str, float]:
    """For each task, the weight of the heaviest chain of callers above it, its own weight included."""
    ways = {name: task.weight for name, task in tasks.items()}
    # Who calls more comes later: from the last callers down, each way is known when it is handed on.
    for task in sorted(tasks.values(), key=lambda task: (-len(task.calls), task.name)):
        for name in task.calls:
            ways[name] = max(ways[name], tasks[name].weight + ways[task.name])
    return ways


def first_rooms(tasks: Mapping[str, Task], rooms: Sequence[str]) -> dict[str, int]:
    """For each task, the place among `rooms` of the first one that needs it: its own, or that of a caller."""
    first = {
        name: next((i for i, room in enumerate(rooms) if name.startswith(room)), len(rooms)) for name in tasks
    }
    for task in tasks.values():
        for name in task.calls:  # at any depth
            first[name] = min(first[name], first[task.name])
    return first


def _run(
    tasks: dict[str, Task], pool: ProcessPoolExecutor, count: int, rooms: Sequence[str]
) -> dict[str, str]:
    ways, first = longest_ways(tasks), first_rooms(tasks, rooms)
    waiting = sorted(tasks, key=lambda name: (first[name], -ways[name], name))
    done: set[str] = set()
    running: dict[Future[str], str] = {}
    why: dict[str, str] = {}
    while waiting or running:
        ready = [name for name in waiting if tasks[name].calls <= done]
        if not ready and not running:
            ready = waiting[:1]  # They call each other; the first one compiles the others.
        for name in ready[: count - len(running)]:
            waiting.remove(name)
            # A process is forked at the first call, before anybody who listens may start a thread.
            running[pool.submit(compile_versions, name, tasks[name].versions)] = name
            compiling.begun(name, tasks)
        for ended in wait(running, return_when=FIRST_COMPLETED).done:
            name = running.pop(ended)
            done.add(name)
            if said := ended.result():
                why[name] = said
    return why


def _begin_to_compile() -> None:
    """Have this process tell nobody of its kernels, and end when the one that began it does, however that ends."""
    compiling.leave_to_parent()
    only_compile()
    parent = multiprocessing.parent_process()

    def wait_for_it() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_it, daemon=True).start()


def compile_versions(name: str, versions: list[str]) -> str:
    """Compile versions of a kernel into the cache; returns what went wrong, in one line, or nothing."""
    kernel = kernel_named(name)
    said = ""
    for text in versions:
        try:
            compile_listed(kernel, text)
        except Exception as error:  # Numba raises what it likes, and the list is a hint.
            said = f"({text}): {error}".partition("\n")[0]
    return said

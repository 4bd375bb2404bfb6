"""Linear algebra on the calling thread only.

Layers are spread over our own threads. If BLAS used threads of its own for each, these would wait
for each other by spinning: planning on a busy machine would take ten times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock

from threadpoolctl import OpenBLASController, ThreadpoolController, threadpool_limits

_LOCK = Lock()
_entered = 0
_limits: threadpool_limits | None = None


@cache
def _controller() -> ThreadpoolController:
    """The BLAS libraries of the process; finding them takes milliseconds."""
    return ThreadpoolController()


def _take_control() -> None:
    """Let this thread change the limit: since 3.8, threadpoolctl obeys only the first thread that did so."""
    release = getattr(OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread until the last of all threads within such a block leaves it."""
    global _entered, _limits
    with _LOCK:
        _entered += 1
        if _entered == 1:
            _take_control()
            _limits = _controller().limit(limits=1, user_api="blas")
    try:
        yield
    finally:
        with _LOCK:
            _entered -= 1
            if _entered == 0 and _limits is not None:
                _take_control()
                _limits.restore_original_limits()
                _limits = None

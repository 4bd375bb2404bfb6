"""Kernels on disk: compiled once, followed by their sources, and never in the way; and the threads that they run on."""

from __future__ import annotations

import fcntl
import os
import re
import subprocess
import sys
import threading
from concurrent.futures import Future
from pathlib import Path

import pytest

from ebamcheck import threads
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.pipeline.job import one_beside

CALLER = """
from ebamcheck.kernels import kernel
from stamped.callee import step
from stamped.constants import SCALE

@kernel
def scaled(x: float) -> float:
    return SCALE * step(x)
"""
CALLEE = """
from ebamcheck.kernels import kernel

@kernel
def step(x: float) -> float:
    return x + {step}
"""
ASK = "from stamped.caller import scaled as f; print(f(1.0), sum(f.stats.cache_hits.values()), f.stats.cache_path)"


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "stamped"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "caller.py").write_text(CALLER)
    (folder / "callee.py").write_text(CALLEE.format(step=1))
    (folder / "constants.py").write_text("SCALE = 10.0\n")
    return folder


def ask(package, **environment):
    """Value, whether it was compiled before, and the cache's folder, as a new process finds them."""
    given = {
        **os.environ,
        "PYTHONPATH": str(package.parent),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_DIR": str(package.parent / "kernels"),
        **environment,
    }
    done = subprocess.run([sys.executable, "-c", ASK], env=given, capture_output=True, text=True, check=True)
    value, hits, folder = done.stdout.split()
    return float(value), int(hits) > 0, folder


@pytest.mark.slow
def test_a_change_of_a_kernel_or_constant_below_compiles_anew(package):
    assert ask(package)[:2] == (20.0, False)
    assert ask(package)[:2] == (20.0, True)
    (package / "callee.py").write_text(CALLEE.format(step=2))
    assert ask(package)[:2] == (30.0, False)
    (package / "constants.py").write_text("SCALE = 20.0\n")
    assert ask(package)[:2] == (60.0, False)
    (package / "unrelated.py").write_text("SCALE = 30.0\n")
    assert ask(package)[:2] == (60.0, True)


@pytest.mark.slow
def test_kernels_find_a_place_where_the_home_cannot_be_written_and_none_that_others_may_write(package, tmp_path):
    (tmp_path / "temporary").mkdir()
    blocked = {
        "HOME": os.devnull,
        "XDG_CACHE_HOME": os.devnull,
        "TMPDIR": str(tmp_path / "temporary"),
        "NUMBA_CACHE_DIR": "",
    }
    value, _, folder = ask(package, **blocked)
    kept = tmp_path / "temporary" / f"ebamcheck-kernels-{os.getuid()}"
    assert (value, Path(folder).is_relative_to(kept)) == (20.0, True)
    assert ask(package, **blocked)[1]
    kept.chmod(0o777)
    assert ask(package, **blocked)[1:] == (False, "None")


WARM = "from ebamcheck.commands import warm; warm.JOBS = 'ebamcheck.version'; warm.warm_kernels()"


def warmed(tmp_path):
    """Start a process that compiles what a job without work needs."""
    return subprocess.Popen(
        [sys.executable, "-c", WARM],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    )


def test_one_process_compiles_and_the_others_wait_for_it(tmp_path):
    assert "compiling the kernels" in warmed(tmp_path).communicate()[1]
    assert warmed(tmp_path).communicate()[1] == ""
    (mark,) = tmp_path.rglob("warm-*")
    mark.unlink()
    with open(mark.parent / "compiling.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        waits = warmed(tmp_path)
        assert waits.stderr is not None
        assert "waiting for another process" in waits.stderr.readline()
        mark.touch()  # as the other process does when all is compiled
    assert waits.communicate()[1] == ""


@pytest.mark.parametrize("text", ["0", "-1", "many", "1.5"])
def test_a_wrong_number_of_threads_is_told(monkeypatch, text):
    monkeypatch.setenv("EBAMCHECK_THREADS", text)
    with pytest.raises(SettingsError, match=f"EBAMCHECK_THREADS='{text}'"):
        threads.thread_count()


@pytest.mark.parametrize("count", ["1", "3"])
def test_blocks_cover_the_range_in_order(monkeypatch, count):
    monkeypatch.setenv("EBAMCHECK_THREADS", count)
    for items in (0, 1, 7, 1000):
        blocks = threads.run_blocks(lambda a, b: list(range(a, b)), items)
        assert [i for block in blocks for i in block] == list(range(items))


def ended(error: BaseException, works: list[Future]) -> None:
    """End a block by an error while one work goes on until the other, which waits for it, is dropped."""
    released = threading.Event()
    with one_beside() as aside:
        works += [aside.submit(released.wait, 60.0), aside.submit(lambda: "begun")]
        works[1].add_done_callback(lambda _: released.set())
        raise error


@pytest.mark.parametrize("error", [InputError("no such part"), KeyboardInterrupt()])
def test_an_error_drops_what_has_not_begun_and_waits_for_what_has(error):
    works: list[Future] = []
    with pytest.raises(type(error)):
        ended(error, works)
    assert works[0].result(timeout=0.0) is True
    assert works[1].cancelled()


def test_what_went_wrong_beside_is_told_where_its_result_is_asked_for():
    text = "blade-fine.stl: no triangle"

    def lost():
        raise InputError(text)

    with one_beside() as aside:
        work = aside.submit(lost)
        with pytest.raises(InputError, match=re.escape(text)):
            work.result()


def test_an_interrupt_tells_work_that_has_begun_and_what_waits_after_it_is_dropped():
    ended, begun = threading.Event(), threading.Event()
    works: list[Future] = []

    def stops_when_told() -> bool:
        begun.set()
        return ended.wait(60.0)

    def interrupted() -> None:
        with one_beside(ended=ended) as aside:
            works.extend([aside.submit(stops_when_told), aside.submit(lambda: "begun")])
            assert begun.wait(60.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert works[0].result(timeout=0.0) is True
    assert works[1].cancelled()

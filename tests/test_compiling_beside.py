"""Kernels that several processes need: one compiles each, the others wait for it, and none waits for a dead one."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time

import pytest

from ebamcheck.numeric.compiling_ahead import Task, first_rooms
from ebamcheck.numeric.compiling_beside import CHECKING, ROOMS, SLICING, to_come
from ebamcheck.numeric.kernel_list import read_list
from ebamcheck.numeric.kernel_turns import end_turn, take_turn

KERNELS = """
from ebamcheck.numeric.kernels import kernel

@kernel
def inner(x):
    total = 0.0
    for i in range(10):
        total += x ** i
    return total

@kernel
def outer(x):
    return inner(x) + inner(2.0 * x)

@kernel
def last(x):
    return inner(x) - outer(x)

@kernel
def wrong(x):
    return x.nothing
"""
CALLS = """
import json, os, sys
from numba.core import event

class Told(event.Listener):
    def on_start(self, found):
        name = found.data["dispatcher"].py_func.__qualname__
        with open(sys.argv[1], "a") as log:
            log.write(f"{os.getpid()} {name}\\n")
    def on_end(self, found):
        pass

event.register("numba:compile", Told())
from ebamcheck_beside import kernels
print("ready", flush=True)
sys.stdin.readline()
print(kernels.outer(1.5))
"""
BESIDE = """
import json, os, sys, time
from ebamcheck.numeric import compiling
from ebamcheck.numeric.compiling_beside import compiled_beside
from ebamcheck_beside import kernels
told = []
with compiling.heard_by(lambda *given: told.append(given[2])), compiled_beside(json.loads(sys.argv[1])):
    kernels.inner(1.5)
    ends = time.monotonic() + 60.0
    while len(told) < int(sys.argv[2]) and time.monotonic() < ends:
        time.sleep(0.05)
print(json.dumps(sorted(told)))
"""


@pytest.fixture
def package(tmp_path, cache_beside_sources):
    folder = tmp_path / "ebamcheck_beside"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "kernels.py").write_text(KERNELS)
    return folder


def begun(package, code, *given, **options):
    path = os.pathsep.join([str(package.parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-c", code, *given],
        env={**os.environ, "PYTHONPATH": path, **options},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_of_two_processes_that_need_a_kernel_at_once_one_compiles_it(package):
    log = package.parent / "log"
    both = [begun(package, CALLS, str(log)) for _ in range(2)]
    for one in both:
        assert one.stdout.readline() == "ready\n"
    for one in both:
        one.stdin.write("go\n")
        one.stdin.flush()
    results = [one.communicate() for one in both]
    assert results[0] == results[1]
    assert results[0][1] == ""
    ours = [line.split()[1] for line in log.read_text().splitlines()]
    assert sorted(name for name in ours if name in ("inner", "outer")) == ["inner", "outer"]


WAITS = """
import sys
from ebamcheck.numeric.kernel_turns import take_turn
take_turn(sys.argv[1], sys.argv[2])
print("mine", flush=True)
sys.stdin.readline()
"""


def test_a_turn_is_waited_for_and_ends_with_its_process(tmp_path, package):
    first = begun(package, WAITS, str(tmp_path), "a kernel")
    assert first.stdout.readline() == "mine\n"
    second = begun(package, WAITS, str(tmp_path), "a kernel")
    other = begun(package, WAITS, str(tmp_path), "another kernel")
    assert other.stdout.readline() == "mine\n"  # nobody has that one
    assert select.select([second.stdout], [], [], 1.0)[0] == []
    first.send_signal(signal.SIGKILL)
    assert second.stdout.readline() == "mine\n"
    for one in (first, second, other):
        one.communicate()


def test_a_turn_that_is_ended_is_free(tmp_path, package):
    take_turn(str(tmp_path), "a kernel")
    end_turn(str(tmp_path), "a kernel")
    other = begun(package, WAITS, str(tmp_path), "a kernel")
    assert other.stdout.readline() == "mine\n"
    other.communicate()


FAILS = """
import sys
from ebamcheck_beside import kernels
try:
    kernels.wrong(1.5)
except Exception as error:
    print(type(error).__name__, flush=True)
sys.stdin.readline()
"""


def test_a_kernel_that_does_not_compile_keeps_nobody_waiting(package):
    first, second = (begun(package, FAILS) for _ in range(2))
    assert first.stdout.readline() == "TypingError\n"
    assert second.stdout.readline() == "TypingError\n"
    for one in (first, second):
        one.communicate()


def listed(*names):
    return json.dumps({f"ebamcheck_beside.kernels.{name}": ["float64"] for name in names})


def test_a_kernel_that_is_missed_has_those_of_the_list_compiled_beside(package):
    found = begun(package, BESIDE, listed("outer", "last"), "3", EBAMCHECK_THREADS="2")
    said, wrong = found.communicate()
    assert wrong == ""
    assert json.loads(said) == [f"ebamcheck_beside.kernels.{name}" for name in ("inner", "last", "outer")]


NESTED = """
import json, sys
from ebamcheck.numeric import compiling
from ebamcheck.numeric.compiling_beside import compiled_beside
from ebamcheck_beside import kernels
told = []
with (
    compiling.heard_by(lambda *given: told.append(given[2])),
    compiled_beside({}),
    compiled_beside(json.loads(sys.argv[1])),
):
    kernels.inner(1.5)
print(json.dumps(told))
"""


def test_the_outer_one_of_two_blocks_says_what_is_compiled(package):
    said, wrong = begun(package, NESTED, listed("outer", "last"), EBAMCHECK_THREADS="2").communicate()
    assert wrong == ""
    assert json.loads(said) == ["ebamcheck_beside.kernels.inner"]
    assert {path.name.split(".cpython")[0] for path in package.rglob("*.nbi")} == {"kernels.inner"}


def test_a_command_says_of_which_modules_it_wants_kernels():
    names = ("ebamcheck.numeric.a.k", "ebamcheck_planecut.b.k", "ebamcheck_embree.c.k", "ebamcheck.scan.d.k")
    listed = {name: ["float64"] for name in names}
    assert tuple(to_come(listed, (*SLICING, "ebamcheck_planecut"))) == names[:2]
    assert tuple(to_come(listed, CHECKING)) == names[:3]
    whole = read_list().whole
    assert list(to_come(whole, ())) == [name for name in whole if name.rpartition(".")[0] in sys.modules]
    # The rooms are those of all commands.
    assert to_come(whole, ROOMS) == whole


def test_a_list_longer_than_a_pipe_and_an_early_end_leave_no_trace(package):
    long = json.dumps({f"ebamcheck_gone.kernels.kernel_{n:08}": ["float64"] for n in range(1500)})
    found = begun(package, BESIDE, long, "1", EBAMCHECK_THREADS="2")
    said, wrong = found.communicate()
    assert wrong == ""
    assert json.loads(said) == ["ebamcheck_beside.kernels.inner"]
    assert found.returncode == 0


def test_one_core_compiles_what_is_called_and_no_more(package):
    found = begun(package, BESIDE, listed("outer", "last"), "1", EBAMCHECK_THREADS="1")
    assert json.loads(found.communicate()[0]) == ["ebamcheck_beside.kernels.inner"]
    time.sleep(0.5)
    assert {path.name.split(".cpython")[0] for path in package.rglob("*.nbi")} == {"kernels.inner"}


def test_kernels_of_the_first_rooms_and_what_they_call_come_first():
    tasks = {
        name: Task(name, [""], frozenset(calls), 1.0)
        for name, calls in {"b.own": ["c.helper"], "a.own": [], "c.helper": [], "c.own": []}.items()
    }
    assert first_rooms(tasks, ["a", "b"]) == {"a.own": 0, "b.own": 1, "c.helper": 1, "c.own": 2}

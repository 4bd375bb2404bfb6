"""Kernels compiled ahead: callees first, none twice, by a list that fits the sources and does no harm where it does not."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from numba import types

from ebamcheck.curves.sides import Sides
from ebamcheck.numeric import kernels
from ebamcheck.numeric.compiling_ahead import Task, longest_ways
from ebamcheck.numeric.kernel_list import FOR_KERNELS, kernel_named, read_list, write_list
from ebamcheck.numeric.type_text import UnknownType, text_of, types_of

KERNELS = """
from ebamcheck.numeric.kernels import kernel

@kernel
def inner(x, n):
    return x + n

@kernel
def middle(x):
    return inner(x, 1) + inner(x, 2)

@kernel
def outer(x):
    return inner(x, 3) * middle(x)

@kernel
def other(x):
    return middle(x)
"""
NAMES = ["inner", "middle", "other", "outer"]
AHEAD = """
import json, os, sys
from numba.core import event
from ebamcheck.numeric import compiling
from ebamcheck.numeric.compiling_ahead import compile_ahead

class Told(event.Listener):
    def on_start(self, found):
        name = found.data["dispatcher"].py_func.__qualname__
        with open(sys.argv[1], "a") as log:
            log.write(f"{os.getpid()} {name}\\n")
    def on_end(self, found):
        pass

event.register("numba:compile", Told())
told = []
with compiling.heard_by(lambda *given: told.append(given)):
    why = compile_ahead(json.loads(sys.argv[2]), 2)
print(json.dumps([os.getpid(), told, why]))
"""


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "ebamcheck_ahead"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "kernels.py").write_text(KERNELS)
    return folder


def ahead(package, listed):
    """Process, what was told, what went wrong, and the processes and kernels that numba compiled."""
    log = package.parent / "log"
    log.unlink(missing_ok=True)
    path = os.pathsep.join([str(package.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", AHEAD, str(log), json.dumps(listed)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    lines = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
    return *json.loads(done.stdout), [(int(pid), name) for pid, name in lines]


def of_package(*names, text="float64"):
    versions = {"inner": "float64, int64"}
    return {f"ebamcheck_ahead.kernels.{name}": [versions.get(name, text)] for name in names}


def test_each_kernel_is_compiled_once_its_callees_first(package):
    parent, told, why, compiled = ahead(package, of_package(*NAMES))
    assert why == {}
    ours = [name for _, name in compiled if name in NAMES]
    assert sorted(ours) == NAMES
    assert ours[:2] == ["inner", "middle"]
    assert parent not in {pid for pid, _ in compiled}
    assert sorted(name for _, _, name in told) == sorted(of_package(*NAMES))
    # All is there: nothing to do.
    assert ahead(package, of_package(*NAMES))[1:] == ([], {}, [])


def test_two_kernels_that_wait_for_nothing_more_are_compiled_side_by_side(package):
    compiled = ahead(package, of_package(*NAMES))[3]
    last = {pid for pid, name in compiled if name in ("outer", "other")}
    assert len(last) == 2


ANNOUNCED = """
import json, sys
from ebamcheck.commands.progress import announced
from ebamcheck.numeric.compiling_ahead import compile_ahead
with announced():
    compile_ahead(json.loads(sys.argv[1]), 2)
"""


def test_only_the_parent_tells_of_progress(package):
    path = os.pathsep.join([str(package.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", ANNOUNCED, json.dumps(of_package(*NAMES))],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    told, ended = done.stderr.splitlines()
    assert told.startswith("ebamcheck: compiling (once): kernel 1 of ")
    assert ended.startswith("ebamcheck: compiled 4 kernels within ")


@pytest.mark.slow
def test_a_stale_list_does_no_harm(package):
    stale = {
        **of_package("inner"),
        **of_package("gone"),
        **of_package("middle", text="float64, float64"),
        **of_package("other", text="ebamcheck_ahead.Gone(float64)"),
        "ebamcheck_gone.kernels.inner": ["float64"],
    }
    _, told, why, compiled = ahead(package, stale)
    assert list(why) == ["ebamcheck_ahead.kernels.middle"]
    assert [name for _, name in compiled if name == "inner"] == ["inner"]
    assert len(told) == 2
    # What the list lacks is compiled with its caller.
    assert [n for _, n in ahead(package, of_package("outer"))[3] if n in NAMES] == ["outer", "middle"]


def test_one_version_for_all_whole_numbers():
    @kernels.kernel
    def callee(values, k):
        return values[k]

    @kernels.kernel
    def caller(values, narrow):
        return callee(values, 0) + callee(values, 1) + callee(values, narrow[0])

    assert caller(np.arange(3.0), np.array([2], dtype=np.int32)) == 3.0
    assert [str(one[1]) for one in callee.signatures] == ["int64"]


def test_the_heaviest_chain_of_callers_leads():
    tasks = {
        name: Task(name, [""], frozenset(calls), weight)
        for name, calls, weight in (
            ("leaf", "", 1.0), ("idle", "", 3.0), ("low", ["leaf"], 5.0), ("high", ["leaf", "low"], 7.0),
        )
    }  # fmt: skip
    assert longest_ways(tasks) == {"leaf": 13.0, "idle": 3.0, "low": 12.0, "high": 7.0}


SIDES = types.BaseTuple.from_types([types.float64] * len(Sides._fields), Sides)


@pytest.mark.parametrize(
    "made",
    [
        types.int64, types.uint8, types.boolean, types.none, types.unicode_type, types.float32[:, ::1],
        types.Array(types.int32, 1, "A", readonly=True), types.Omitted(None), types.Omitted(1e-9),
        types.literal(-1), types.literal(True), types.UniTuple(types.int64, 2), SIDES,
        types.Tuple([types.int64, types.boolean[::1]]), types.Tuple([]),
    ],
    ids=str,
)  # fmt: skip
def test_a_type_comes_back_from_its_text(made):
    assert types_of(text_of(made)) == (made,)
    assert types_of(f"{text_of(made)}, int64") == (made, types.int64)
    assert types_of("") == ()


@pytest.mark.parametrize(
    "text", ["int65", "array(int64)", "nowhere.Thing(int64)", "1 +", "3", "int8, int65", "a[0](int64)"]
)
def test_a_text_that_is_no_type(text):
    with pytest.raises(UnknownType):
        types_of(text)


def test_a_list_comes_back(tmp_path):
    main = {"a.b.f": ["int64", "float64"], "a.c.g": [""], "a.c.h": ["for kernels: int64"]}
    others = {"a.c.h": ["int64"], "a.c.i": [""]}  # one that Python calls, too, and another one
    write_list(main, main | others, tmp_path / "list.json")
    main["a.b.f"].sort()
    assert read_list(tmp_path / "list.json") == (main, main | others)
    assert read_list(tmp_path / "none.json") == ({}, {})


def test_the_list_names_kernels_of_the_sources():
    """Where it fails: ``make kernel-list``."""
    listed = read_list().whole
    assert len(listed) > len(read_list().main) > 400
    assert [name for name in listed if kernel_named(name) is None] == []
    wrong = [
        (name, text)
        for name, found in listed.items()
        for text in found
        if len(types_of(text.removeprefix(FOR_KERNELS))) != kernel_named(name).py_func.__code__.co_argcount
    ]
    assert wrong == []


ALL = """
import json, tempfile
from pathlib import Path
from ebamcheck.commands.warm import main_job, other_jobs
from ebamcheck.numeric.compiling import loaded_kernels, name_of
from ebamcheck.numeric.kernel_list import FOR_KERNELS, read_list
from ebamcheck.numeric.type_text import text_of
def lacking(listed):
    used = {name_of(k): [", ".join(map(text_of, one)) for one in k.signatures] for k in loaded_kernels()}
    known = {k: [one.removeprefix(FOR_KERNELS) for one in found] for k, found in listed.items()}
    return [[k, one] for k, found in used.items() for one in found if one not in known.get(k, [])]
with tempfile.TemporaryDirectory() as folder:
    main_job(Path(folder))
    wanted = [lacking(read_list().main)]
    other_jobs(Path(folder))
    wanted.append(lacking(read_list().whole))
print(json.dumps(wanted))
"""


@pytest.mark.slow
def test_the_list_lacks_nothing_that_the_main_job_and_other_commands_call():
    """Where it fails: ``make kernel-list``."""
    done = subprocess.run([sys.executable, "-c", ALL], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == [[], []]


ROUND = """
import json
from ebamcheck.curves import fit
from ebamcheck.numeric.compiling import loaded_kernels, name_of
from ebamcheck.numeric.kernel_list import read_list
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_models import MODELS
part = MODELS["torus"].tessellate(0.3)
fit(slice_part(part, [-2.0, 1.0]), part=part)
listed = read_list().main
print(json.dumps([name_of(k) for k in loaded_kernels() if k.signatures and name_of(k) not in listed]))
"""


@pytest.mark.slow
def test_the_list_holds_the_kernels_of_round_parts():
    """A box has no curved region: a cone and a ring are fitted when the list is made. Where it fails: ``make kernel-list``."""
    done = subprocess.run([sys.executable, "-c", ROUND], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == []

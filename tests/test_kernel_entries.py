"""Kernels that only kernels call have no entry from Python, and long ones are called where they lie."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

SOURCE = """
import numpy as np
from ebamcheck.numeric.kernels import kernel

@kernel
def short(x):
    return {step} + x

@kernel
def long(values):
    made = values.copy()
    for i in range(len(values) - 1):
{steps}
    return made

@kernel
def root(values):
    if values[0] < 0.0:
        raise ValueError("below zero")
    return long(values)[0] + long(2.0 * values)[3]
"""
CALL = """
import numpy as np
from called.kernels import long, root, short
from ebamcheck.numeric.kernel_library import about_data
values = np.arange(10.0)[::-1].copy()
print(root(values){more})
try:
    root(-values[:3])
except ValueError as error:
    print(error)
loaded = [(kernel, version) for kernel in (root, long, short) for version in kernel.overloads.values()]
for kernel, version in loaded:
    about = version.library.about
    calls = [callee.name for callee in about.calls]
    print(kernel.__name__, about.is_entered, calls, sum(kernel.stats.cache_hits.values()))
"""
STEPS = "\n".join(
    f"        if made[i] > {k}.5:\n            made[i] = short(0.5 * made[i]) + values[i + 1] * {k}.25"
    for k in range(30)
)
"""Enough of them that the kernel is no short one."""
VALUES = [9.0 - x for x in range(10)]


def written(folder):
    """The package in a folder, none of its kernels compiled."""
    package = folder / "called"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "kernels.py").write_text(SOURCE.format(step=1.0, steps=STEPS))
    return package


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory):
    """Package whose kernels were called, and what that printed; its tests have copies."""
    package = written(tmp_path_factory.mktemp("compiled"))
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("NUMBA_CACHE_DIR", raising=False)
        return package, call(package)


@pytest.fixture
def package(compiled_once, tmp_path, cache_beside_sources):
    """Copy of the package with its compiled kernels beside it."""
    return shutil.copytree(compiled_once[0], tmp_path / "called")


def call(package, more=""):
    """Lines that a process of its own prints: results, what is raised, and what is kept of each kernel."""
    path = os.pathsep.join([str(package.parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CALL.format(more=more)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout.splitlines()


def long(values, step=1.0):
    """What the kernel of that name does, in plain Python."""
    made = list(values)
    for i in range(len(values) - 1):
        for k in range(30):
            if made[i] > k + 0.5:
                made[i] = (step + 0.5 * made[i]) + values[i + 1] * (k + 0.25)
    return made


def expected(step=1.0):
    """What `root` gives for 9, 8, ..., 0."""
    return long(VALUES, step)[0] + long([2.0 * x for x in VALUES], step)[3]


def kept(hits, step=1.0):
    return [
        str(expected(step)), "below zero",
        f"root True ['long'] {hits}", f"long False [] {hits}", f"short False [] {hits}",
    ]  # fmt: skip


def test_a_long_callee_is_called_where_it_lies_and_a_short_one_is_not(compiled_once, package):
    assert compiled_once[1] == kept(0)
    # The short one is in the code of the long one: nobody asks for it.
    assert call(package) == kept(1)[:-1]


@pytest.mark.slow
def test_python_may_call_what_has_no_entry(tmp_path, cache_beside_sources):
    package = written(tmp_path)
    first = call(package, more=", short(1.0), long(values)[0]")
    assert first[0] == f"{expected()} 2.0 {long(VALUES)[0]}"
    assert first[1:] == kept(0)[1:]
    files = {path.name.split(".cpython")[0] for path in package.rglob("*.nbi")}
    assert files == {
        "kernels.root",
        "kernels.long",
        "kernels.short",
        "kernels.long.entry",
        "kernels.short.entry",
    }
    times = {path: path.stat().st_mtime_ns for path in package.rglob("*.nbc")}
    assert call(package, more=", short(1.0), long(values)[0]")[0] == first[0]
    assert {path: path.stat().st_mtime_ns for path in package.rglob("*.nbc")} == times  # nothing compiled


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("lost", ["long", "root"])
def test_a_callee_that_was_compiled_anew_has_its_callers_compiled_too(package, lost):
    """Its name in machine code is another one: what still calls it by the old one must not run."""
    for path in package.rglob(f"kernels.{lost}.*nbi"):
        path.unlink()
    lines = call(package)
    assert lines[0] == str(expected())
    assert lines[2] == "root True ['long'] 0"
    assert call(package)[2] == "root True ['long'] 1"


@pytest.mark.slow
def test_a_change_of_a_callee_of_a_callee_counts(package):
    (package / "kernels.py").write_text(SOURCE.format(step=5.0, steps=STEPS))
    assert call(package) == kept(0, 5.0)

"""Kernels on disk: compiled once, followed by their sources, and never in the way."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from ebamcheck.errors import SettingsError
from ebamcheck.numeric import kernels

CALLER = """
from ebamcheck.numeric.kernels import kernel
from stamped.callee import step
from stamped.constants import SCALE

@kernel
def scaled(x: float) -> float:
    return SCALE * step(x)
"""
CALLEE = """
from ebamcheck.numeric.kernels import kernel

@kernel
def step(x: float) -> float:
    return x + {step}
"""
ASK = "from stamped.caller import scaled as f; print(f(1.0), sum(f.stats.cache_hits.values()), f._cache.cache_path)"


@pytest.fixture
def package(tmp_path, cache_beside_sources):
    folder = tmp_path / "stamped"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "caller.py").write_text(CALLER)
    (folder / "callee.py").write_text(CALLEE.format(step=1))
    (folder / "constants.py").write_text("SCALE = 10.0\n")
    return folder


def ask(package, **environment):
    """Value, whether it was compiled before, and the cache's folder, as a new process finds them."""
    done = subprocess.run(
        [sys.executable, "-c", ASK],
        env={**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    value, hits, folder = done.stdout.split()
    return float(value), int(hits) > 0, folder


@pytest.mark.slow
def test_a_change_anywhere_below_compiles_anew(package):
    assert ask(package)[:2] == (20.0, False)
    assert ask(package)[:2] == (20.0, True)
    (package / "callee.py").write_text(CALLEE.format(step=2))
    assert ask(package)[:2] == (30.0, False)
    (package / "constants.py").write_text("SCALE = 20.0\n")
    assert ask(package)[:2] == (60.0, False)
    (package / "unrelated.py").write_text("SCALE = 30.0\n")
    assert ask(package)[:2] == (60.0, True)


def test_what_a_kernel_does_not_see_compiles_nothing_anew(package):
    assert ask(package)[:2] == (20.0, False)
    # A name beside it, a docstring, and lines above that move it down the file.
    (package / "constants.py").write_text("SCALE = 10.0\nOTHER = 2.0\n")
    (package / "callee.py").write_text("# A remark.\n" + CALLEE.format(step=1))
    (package / "caller.py").write_text(
        '"""Said."""\n' + CALLER.replace("    return", '    """Scale."""\n    return')
    )
    assert ask(package)[:2] == (20.0, True)


@pytest.mark.slow
def test_a_constant_seen_through_a_module_counts(package):
    (package / "caller.py").write_text(
        CALLER.replace("from stamped.constants import SCALE", "from stamped import constants").replace(
            "SCALE *", "constants.SCALE *"
        )
    )
    assert ask(package)[:2] == (20.0, False)
    assert ask(package)[:2] == (20.0, True)
    (package / "constants.py").write_text("SCALE = 20.0\n")
    assert ask(package)[:2] == (40.0, False)


@pytest.mark.slow
def test_a_spoilt_file_is_compiled_anew(package):
    folder = ask(package)[2]
    for name in os.listdir(folder):
        if name.startswith("caller.scaled"):
            with open(os.path.join(folder, name), "wb"):
                pass
    assert ask(package)[:2] == (20.0, False)
    assert ask(package)[:2] == (20.0, True)


TYPED = """
from typing import NamedTuple
from ebamcheck.numeric.kernels import kernel

class {name}(NamedTuple):
    x: float

@kernel
def doubled(pair):
    return 2.0 * pair.x

def scaled(x):
    return doubled({name}(x))
scaled.stats, scaled._cache = doubled.stats, doubled._cache
"""


@pytest.mark.slow
def test_a_type_that_an_older_version_had_is_no_obstacle(package):
    """The index of the cache names the types that a kernel was compiled for."""
    (package / "caller.py").write_text(TYPED.format(name="Pair"))
    ask(package)
    assert ask(package)[:2] == (2.0, True)
    (package / "caller.py").write_text(TYPED.format(name="Couple"))
    assert ask(package)[:2] == (2.0, False)
    assert ask(package)[:2] == (2.0, True)


@pytest.mark.slow
def test_kernels_find_a_place_where_neither_code_nor_home_can_be_written(package, tmp_path):
    (tmp_path / "temporary").mkdir()
    (package / "__pycache__").write_text("a file where the folder would be")
    blocked = {"HOME": os.devnull, "XDG_CACHE_HOME": os.devnull, "TMPDIR": str(tmp_path / "temporary")}
    value, _, folder = ask(package, **blocked)
    assert (value, folder.startswith(str(tmp_path / "temporary" / "ebamcheck-kernels-"))) == (20.0, True)
    assert ask(package, **blocked)[1]
    (tmp_path / "temporary" / f"ebamcheck-kernels-{os.getuid()}").chmod(0o777)
    assert ask(package, **blocked)[1:] == (False, "None")


@pytest.mark.parametrize("text", ["0", "-1", "many", "1.5"])
def test_a_wrong_number_of_threads_is_told(monkeypatch, text):
    monkeypatch.setenv("EBAMCHECK_THREADS", text)
    with pytest.raises(SettingsError, match=f"EBAMCHECK_THREADS='{text}'"):
        kernels.thread_count()


@pytest.mark.parametrize("threads", ["1", "3"])
def test_blocks_cover_the_range_in_order(monkeypatch, threads):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    for count in (0, 1, 7, 1000):
        blocks = kernels.run_blocks(lambda a, b: list(range(a, b)), count)
        assert [i for block in blocks for i in block] == list(range(count))


SORTER = """
import numpy as np
from ebamcheck.numeric.kernels import kernel

@kernel
def places(x):
    return np.argsort(x)
"""


@pytest.mark.slow
def test_machine_code_of_two_processes_has_no_name_in_common(tmp_path, cache_beside_sources):
    # The loader takes the first of two functions of one name for both: once `sort` ran in the place of `argsort`.
    names = []
    for module in ("first", "second"):
        (tmp_path / f"{module}.py").write_text(SORTER)
        found = subprocess.run(
            [
                sys.executable,
                "-c",
                f"import numpy, {module}; print({module}.places(numpy.array([3.0, 1.0, 2.0])))",
            ],
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        assert found.stdout.strip() == "[1 2 0]"
        (compiled,) = tmp_path.rglob(f"{module}.places*.nbc")
        names.append(set(re.findall(rb"_ZN5numba4misc9quicksort\w+", compiled.read_bytes())))
        assert names[-1]
    assert not names[0] & names[1]

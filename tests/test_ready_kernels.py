"""Kernels that come compiled with the installation: taken where they fit, and passed over without a word elsewhere."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from copy import copy
from pathlib import Path

import pytest

from ebamcheck.mesh.stl import write_triangles
from ebamcheck.numeric import ready_kernels
from ebamcheck_models import CUBE

ROOT = Path(__file__).parents[1]

SOURCE = """
from ebamcheck.numeric.kernels import kernel

@kernel
def scaled(x: float) -> float:
    return {scale} * x
"""
WRITE = """
from pathlib import Path
from ebamcheck.numeric import ready_kernels
from prepared.kernels import scaled
scaled(1.0)
held = scaled._cache._cache_file
parts = [(scaled.py_func, key[0], Path(held._data_path(name)).read_bytes()) for key, name in held._load_index().items()]
print(ready_kernels.write(parts, "{level}", Path("{file}")))
"""
ASK = "from prepared.kernels import scaled as f; print(f(2.0), sum(f.stats.cache_hits.values()), f._cache.holds_any())"

needs_level = pytest.mark.skipif(
    not ready_kernels.can_run("x86-64-v3"), reason="kernels that are ready are for processors of x86-64-v3"
)


class Prepared:
    """A package with a kernel, the file of ready kernels that was written from it, and an empty cache."""

    def __init__(self, folder: Path, level: str = "x86-64-v3") -> None:
        self.folder, self.file = folder, folder / "ready.kernels"
        (folder / "prepared").mkdir()
        (folder / "prepared/__init__.py").touch()
        self.write(10.0)
        assert self.run(WRITE.format(file=self.file, level=level), "first", ready="") == "1"

    def write(self, scale: float) -> None:
        (self.folder / "prepared/kernels.py").write_text(SOURCE.format(scale=scale))

    def run(self, code: str, cache: str, ready: str | None = None) -> str:
        environment = {
            **os.environ,
            "PYTHONPATH": f"{self.folder}:{os.environ.get('PYTHONPATH', '')}",
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(self.folder / cache),
            "EBAMCHECK_READY_KERNELS": str(self.file) if ready is None else ready,
        }
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        return done.stdout.strip()

    def alter(self, change) -> None:
        """Change the index of the file."""
        held = self.file.read_bytes()
        start = ready_kernels.HEAD_BYTES + int(held[: ready_kernels.HEAD_BYTES])
        index = json.loads(held[ready_kernels.HEAD_BYTES : start])
        change(index)
        text = json.dumps(index).encode()
        self.file.write_bytes(str(len(text)).rjust(ready_kernels.HEAD_BYTES).encode() + text + held[start:])


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """A package whose kernel was compiled and written; its tests have copies."""
    return Prepared(tmp_path_factory.mktemp("prepared"))


@pytest.fixture
def prepared(once, tmp_path):
    found = copy(once)
    found.folder = shutil.copytree(once.folder, tmp_path / "prepared-here")
    found.file = found.folder / once.file.name
    return found


@needs_level
def test_a_ready_kernel_is_run_and_not_compiled(prepared):
    assert prepared.run(ASK, "empty") == "20.0 1 True"
    assert list((prepared.folder / "empty").rglob("*.nbc")) == []


@pytest.mark.slow
def test_kernels_for_any_processor_of_a_machine_are_run_on_this_one(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    prepared = Prepared(tmp_path, "generic")
    monkeypatch.delenv("NUMBA_CPU_NAME")
    monkeypatch.delenv("NUMBA_CPU_FEATURES")
    assert prepared.run(ASK, "empty") == "20.0 1 True"


@needs_level
def test_a_kernel_that_has_changed_since_is_compiled(prepared):
    prepared.write(30.0)
    assert prepared.run(ASK, "empty") == "60.0 0 True"
    assert len(list((prepared.folder / "empty").rglob("*.nbc"))) == 1


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("place", range(5))
def test_a_file_for_another_installation_is_passed_over(prepared, place):
    prepared.alter(lambda index: index["made for"].__setitem__(place, "another"))
    assert prepared.run(ASK, f"empty-{place}") == "20.0 0 True"


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("held", [b"", b"half", b" " * 14 + b"99{}", b" " * 15 + b"2[]"])
def test_a_spoilt_file_is_passed_over(prepared, held):
    prepared.file.write_bytes(held)
    assert prepared.run(ASK, "empty") == "20.0 0 True"


@pytest.mark.parametrize(("machine", "level"), ready_kernels.BUILT_FOR.items())
def test_a_wheel_is_built_for_a_class_that_is_known(machine, level):
    assert level in ready_kernels.LEVELS
    assert machine != platform.machine() or ready_kernels.can_run("generic")


def test_no_processor_is_of_an_unknown_class():
    assert not ready_kernels.can_run("x86-64-v9")


@pytest.mark.slow
@needs_level
@pytest.mark.skipif(platform.system() != "Linux", reason="wheels with kernels are for Linux")
def test_the_first_slice_of_an_installed_wheel_compiles_nothing(tmp_path):
    kernels = tmp_path / "ready.kernels"
    packages = ["ebamcheck.mesh.", "ebamcheck.layers.", "ebamcheck.numeric.", "ebamcheck_planecut."]
    made = [sys.executable, "-m", "ebamcheck.commands.ready_file", str(kernels), *packages]
    subprocess.run(made, check=True, cwd=ROOT, capture_output=True)
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(
        build, check=True, capture_output=True, env={**os.environ, "EBAMCHECK_WHEEL_KERNELS": str(kernels)}
    )
    (wheel,) = tmp_path.glob("*.whl")
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert wheel.name.endswith(f"-{python}-{python}-linux_{platform.machine()}.whl")
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = [name for name in archive.namelist() if name.endswith("/METADATA")]
        pinned = [line for line in archive.read(metadata).decode().splitlines() if "numba==" in line]
    assert len(pinned) == 1
    venv.create(tmp_path / "venv", with_pip=True)
    home = tmp_path / "venv/lib" / f"python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(
        [tmp_path / "venv/bin/python", "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel],
        check=True, env=environment,
    )  # fmt: skip
    # What it depends on is taken from here; its own files are those of the wheel.
    (home / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    part = tmp_path / "cube.stl"
    write_triangles(CUBE.tessellate(0.1).triangles, part)
    done = subprocess.run(
        [tmp_path / "venv/bin/ebamcheck", "slice", part, "-o", tmp_path / "cube.parquet"],
        capture_output=True, text=True, cwd=tmp_path,
        env={**environment, "NUMBA_CACHE_DIR": str(tmp_path / "empty")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert list((tmp_path / "empty").rglob("*.nbc")) == []

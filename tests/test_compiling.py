"""Who waits for kernels is told, once; and what is compiled already is found without loading it."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from parts import box
from rich.console import Console

from ebamcheck.commands import progress
from ebamcheck.commands.progress import Announcer, _bars, announced
from ebamcheck.numeric import compiling
from ebamcheck.plugins import registry
from ebamcheck.slicers.isolation import slice_all

KERNELS = """
from ebamcheck.numeric.kernels import kernel

@kernel
def inner(x):
    return x + 1.0

@kernel
def outer(x):
    return 2.0 * inner(x)

@kernel
def unused(x):
    return x
"""
PLUGIN = """
from ebamcheck_planecut import PlaneCut
from ebamcheck_waiting.kernels import outer

class Cut:
    def __init__(self, prepared):
        self.prepared = prepared
    def __enter__(self):
        self.prepared.__enter__()
        return self
    def __exit__(self, *given):
        return self.prepared.__exit__(*given)
    def slice(self, heights, progress=None):
        outer(1.0)
        return self.prepared.slice(heights, progress)

class Waiting(PlaneCut):
    name = "waiting"
    def prepare(self, part, settings):
        return Cut(super().prepare(part, settings))
"""
ASK = """
import json, sys
from ebamcheck.numeric import compiling
from ebamcheck_waiting.kernels import inner, outer
told = []
with compiling.heard_by(lambda *given: told.append(given)):
    before = compiling.missing()
    outer(1.0)
print(json.dumps([told, before, compiling.missing(), compiling.seconds()]))
"""
NAMES = [f"ebamcheck_waiting.kernels.{name}" for name in ("inner", "outer", "unused")]


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "plugin" / "ebamcheck_waiting"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "kernels.py").write_text(KERNELS)
    (folder / "slicer.py").write_text(PLUGIN)
    info = folder.parent / "waiting-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: waiting\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[ebamcheck.backends]\nwaiting = ebamcheck_waiting.slicer:Waiting\n"
    )
    return folder.parent


def ask(package):
    path = os.pathsep.join([str(package), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", ASK],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    told, before, after, seconds = json.loads(done.stdout)
    ours = [[n for n in names if n in NAMES] for names in (before, after)]
    return [name for _, _, name in told], *ours, seconds, told


def test_every_kernel_is_told_once_and_never_again(package):
    begun, before, after, seconds, told = ask(package)
    assert sorted(begun) == NAMES[:2]
    assert (before, after) == (NAMES, NAMES[2:])
    assert [number for number, _, _ in told] == [1, 2]
    assert all(most >= 3 for _, most, _ in told)
    assert seconds > 0.0
    assert ask(package)[:4] == ([], NAMES[2:], NAMES[2:], 0.0)
    # The source is another one: all is missing again.
    (package / "ebamcheck_waiting" / "kernels.py").write_text(KERNELS.replace("1.0", "3.0"))
    assert ask(package)[1] == NAMES


@pytest.mark.slow
def test_what_a_slicer_compiles_is_told_and_is_no_time_of_the_slicer(package, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(package), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.syspath_prepend(str(package))
    registry.forget()
    told = []
    heights = np.array([1.0, 2.0])
    try:
        settings = {"waiting": registry.slicer_settings("waiting", {})}
        with compiling.heard_by(lambda *given: told.append(given)):
            first = slice_all(box(), heights, settings, tmp_path)["waiting"]
            second = slice_all(box(), heights, settings, tmp_path)["waiting"]
    finally:
        registry.forget()
    begun = [name for _, _, name in told if name in NAMES]
    assert sorted(begun) == NAMES[:2]
    assert first.file is not None, first.why
    # It compiles for a tenth of a second and more, and cuts a box.
    assert first.compile_s > first.slice_s > 0.0
    assert second.compile_s == 0.0


@pytest.mark.slow
def test_without_a_terminal_there_is_a_line_now_and_then(capsys, monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(progress.time, "monotonic", lambda: 0.1 * next(clock))
    with announced():
        for number in range(100):
            compiling.begun(f"kernel {number}")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("ebamcheck: compiling (once): kernel 1 of at most ")
    assert lines[1].startswith("ebamcheck: compiled 100 kernels within ")
    with announced():
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("shown_anyway", [False, True])
def test_on_a_terminal_there_is_a_bar(shown_anyway):
    out = io.StringIO()
    bars = _bars(Console(file=out, force_terminal=True, width=100))
    if shown_anyway:
        bars.start()
        bars.add_task("slice", total=10)
    announcer = Announcer(bars)
    announcer.kernel(1, 118, "a")
    announcer.kernel(12, 118, "b")
    bars.refresh()
    assert "compiling (once): kernel 12 of at most 118" in out.getvalue()
    announcer.close()
    assert bars.live.is_started is shown_anyway
    assert [task.description for task in bars.tasks] == (["slice"] if shown_anyway else [])
    bars.stop()

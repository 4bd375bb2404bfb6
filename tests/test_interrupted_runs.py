"""Runs that are killed or meet with an accident: the next goes on to the same bytes, and clears away what they left."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
from unittest.mock import Mock

import numpy as np
import psutil
import pytest
import typer
from command_line import FAST, WIDE_TOML, command, ebamcheck, frame, write_stl
from finished_runs import plate_of_every_slicer
from parts import sphere
from pipeline_runs import SETTINGS, contents, gates, untimed

from ebamcheck import scratch
from ebamcheck.atomic_file import replacing
from ebamcheck.commands.command_group import guarded
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.layers.files import KeptBlocks, count_kept, read_parquet
from ebamcheck.layers.heights import layer_blocks
from ebamcheck.mesh.part import from_arrays
from ebamcheck.pipeline import check_job, cross_check, run_job
from ebamcheck.plugins import registry
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.slicers.isolation import slice_all
from ebamcheck.slicers.slicing import slice_part

OF_BLOCKS = f"slicing.backends = {FAST.split(',')}\nslicing.block_points = 1000\n"
DATED = ("finished", "seal")  # Fields of a certificate that tell when the run was made, or hold what does


def whole(folder):
    """Bytes of every file of a run but its times; of its certificate all but what is dated."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    del found["timings.json"]
    if "certificate.json" in found:
        paper = json.loads(found["certificate.json"])
        assert paper["files"].pop("timings.json")
        found["certificate.json"] = {k: v for k, v in paper.items() if k not in DATED}
    return found


def kill_at(seconds, *arguments, cwd, **environment):
    """Start a command and kill it and its process group after a time; whether it was still at work."""
    process = subprocess.Popen(
        command(*arguments),
        cwd=cwd,
        env={**os.environ, **environment},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return True
    return False


def undisturbed(job, folder, temporary):
    """Seconds that a job takes, and what it leaves."""
    start = time.monotonic()
    done = ebamcheck(job, "part.stl", "-o", "sound.run", cwd=folder, TMPDIR=str(temporary))
    assert done.returncode == 0, done.stdout + done.stderr
    return time.monotonic() - start, whole(folder / "sound.run")


def killed_and_resumed(job, folder, kills, seed):
    temporary = folder / "temporary"
    temporary.mkdir()
    seconds, sound = undisturbed(job, folder, temporary)
    chance = random.Random(seed)
    killed = 0
    for k in range(kills):
        name = f"{k // 3}.run"
        # Every third kill begins a new run: the others hit one that goes on from what the last has left.
        killed += kill_at(
            chance.uniform(0.1, 0.8) * seconds,
            job, "part.stl", "-o", name, "--resume",
            cwd=folder, TMPDIR=str(temporary),
        )  # fmt: skip
    assert killed, "not one of the runs was killed"
    for k in range(0, kills, 3):
        done = ebamcheck(job, "part.stl", "-o", f"{k // 3}.run", "--resume", cwd=folder, TMPDIR=str(temporary))
        assert done.returncode == 0, done.stdout + done.stderr
        assert whole(folder / f"{k // 3}.run") == sound
    assert list(temporary.iterdir()) == []
    assert [path.name for path in folder.glob(".*")] == []


@pytest.mark.parametrize(
    ("job", "kills", "seed"),
    [pytest.param("check", 3, 1, marks=pytest.mark.slow), pytest.param("run", 9, 0, marks=pytest.mark.long)],
)
def test_jobs_killed_at_random_moments_come_to_the_same_bytes(job, kills, seed, tmp_path):
    write_stl(frame() if job == "run" else sphere(12.0, 24, 48), tmp_path / "part.stl")
    thick = f"layers.layer_height_mm = 6.0\n{WIDE_TOML}" if job == "run" else ""
    (tmp_path / "ebamcheck.toml").write_text(OF_BLOCKS + thick)
    killed_and_resumed(job, tmp_path, kills, seed)


# -- blocks of layers ----------------------------------------------------------------------------------


@pytest.fixture
def ball():
    part = sphere(12.0, 24, 48)
    heights = np.linspace(-11.5, 11.5, 47)
    borders = layer_blocks(part, heights, 1000)
    assert borders.size > 4
    return part, heights, borders


def cut(ball, folder, keep=True):
    part, heights, borders = ball
    settings = {"planecut": registry.slicer_settings("planecut", {})}
    return slice_all(part, heights, settings, folder, borders=borders, keep_blocks=keep)["planecut"]


@pytest.mark.parametrize("spoil", ["", "truncated", "other part", "other heights"])
def test_a_block_that_is_kept_is_not_cut_again_and_one_that_does_not_fit_is(ball, tmp_path, spoil):
    part, heights, borders = ball
    file = tmp_path / "planecut.parquet"
    sound = cut(ball, tmp_path).made().read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["planecut.parquet"]
    block = read_parquet(file).block(0, int(borders[1]))
    kept = KeptBlocks(file, part.sha256, "planecut")
    # A block that says of itself that it was not cut now.
    told = block.labelled(dropped=np.full(len(block), 7))
    if spoil == "other heights":
        told = told.labelled(heights=np.concatenate([heights[:1], told.heights[1:] + 1e-9]))
    if spoil == "other part":
        told = told.labelled(part="0" * 64)
    kept.write(told)
    (path,) = kept.folder.iterdir()
    if spoil == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    found = cut(ball, tmp_path).made()
    assert count_kept(file) == 0
    if spoil:
        assert found.read_bytes() == sound
    else:
        assert read_parquet(found).dropped.tolist() == [7 * (k < borders[1]) for k in range(heights.size)]


def test_what_is_cut_as_fast_as_it_is_written_is_not_kept(ball, tmp_path):
    part, heights, borders = ball
    kept = KeptBlocks(tmp_path / "a.parquet", part.sha256, "planecut")
    for first, past in itertools.pairwise(borders[:3]):
        assert kept.is_worth(0.0), "the first takes what is loaded for it, too"
        kept.write(slice_part(part, heights[first:past], "planecut"))
    assert not kept.is_worth(0.0)
    assert kept.is_worth(60.0)


# -- temporary folders and files ---------------------------------------------------------------------------

HOLD = """
import sys, time
from pathlib import Path
from ebamcheck.atomic_file import replacing
from ebamcheck.commands.command_group import guarded
from ebamcheck.errors import ExitCode
from ebamcheck.scratch import scratch_folder
with scratch_folder(parent=Path(sys.argv[1])) as folder, replacing(Path(sys.argv[1], "table.csv")) as file:
    file.write_text("half")
    (folder / "big.npy").write_text("x")
    print("ready", flush=True)
    time.sleep(600)
"""


def hold(folder):
    """A process at work in a folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def test_what_a_killed_process_left_goes_and_what_one_at_work_has_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(scratch, "_swept", set())
    (tmp_path / "ebamcheck-mine").mkdir()
    (tmp_path / ".notes.part").write_text("of somebody else")
    dead, alive = hold(tmp_path), hold(tmp_path)
    try:
        assert len(list(tmp_path.iterdir())) == 6
        dead.kill()
        dead.communicate()
        with scratch.scratch_folder(parent=tmp_path) as folder, replacing(tmp_path / "own.csv") as file:
            file.write_text("whole")
            left = {path.name for path in tmp_path.iterdir()} - {folder.name, file.name}
        assert {"ebamcheck-mine", ".notes.part"} < left
        others = left - {"ebamcheck-mine", ".notes.part"}
        assert sorted(name.split(".")[-1].split("-")[0] for name in others) == ["part", "scratch"]
        assert any(f".{alive.pid}-" in name for name in others)
    finally:
        alive.kill()
        alive.communicate()
    monkeypatch.setattr(scratch, "_swept", set())
    with scratch.scratch_folder(parent=tmp_path), replacing(tmp_path / "own.csv") as file:
        file.write_text("again")
    assert {path.name for path in tmp_path.iterdir()} == {"ebamcheck-mine", ".notes.part", "own.csv"}


@pytest.mark.parametrize(
    ("led_to_it", "code"), [(KeyboardInterrupt, ExitCode.INTERRUPTED), (ValueError, ExitCode.INTERNAL)]
)
def test_an_interrupt_inside_compiled_code_is_an_interrupt(led_to_it, code):
    """The interpreter tells whatever is raised there as errors of its own, one behind the other."""

    def work() -> None:
        inner = SystemError("an inner call returned a result with an exception set")
        inner.__cause__ = led_to_it()
        raise SystemError("a kernel returned a result with an exception set") from inner

    with pytest.raises(typer.Exit) as end:
        guarded(work)()
    assert end.value.exit_code == code


def worker_of(process, name):
    # A worker that ends while it is looked at has no command line any more.
    with contextlib.suppress(psutil.Error):
        for child in psutil.Process(process.pid).children():
            if child.cmdline()[1:5] == ["-P", "-m", "ebamcheck.slicers.worker", name]:
                return child
    return None


@pytest.mark.slow
def test_a_killed_backend_is_told_and_the_others_are_whole(tmp_path_factory, tmp_path):
    sound, path = plate_of_every_slicer(tmp_path_factory)
    (tmp_path / "ebamcheck.toml").write_text(WIDE_TOML)
    arguments = command("run", path, "--layer-height", 6, "-o", "k.run")
    run = subprocess.Popen(arguments, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    while (victim := worker_of(run, "embree")) is None:
        assert run.poll() is None
    victim.kill()
    text = run.communicate()[0]
    assert run.returncode == 0
    assert "3 methods agree on 2 of 2 layers; lost: embree killed" in text
    backends = untimed(tmp_path / "k.run")["backends"]
    assert backends["embree"]["status"] == "killed"
    assert "SIGKILL" in backends["embree"]["why"]
    whole, found = contents(sound.folder.path), contents(tmp_path / "k.run")
    same = [n for n in whole if n.startswith("program/")]
    same += [f"layers/{n}.parquet" for n, record in backends.items() if record["status"] == "done"]
    assert len(same) > 4
    assert {n: found[n] for n in same} == {n: whole[n] for n in same}


def test_of_two_methods_one_fails(tmp_path):
    path = write_stl(from_arrays(frame().vertices, frame().faces[:-1], "open"), tmp_path / "open.stl")
    result = run_job(path, tmp_path / "open.run", SETTINGS)
    assert result.exit_code is ExitCode.OUT_OF_TOLERANCE
    assert (gates(result)["input"], gates(result)["agreement"]) == (False, False)
    manifest = result.folder.manifest()
    assert manifest["backends"]["manifold"]["status"] == "refused"
    assert manifest["backends"]["planecut"]["open_paths"] > 0
    assert "open" in manifest["gates"][0]["text"]
    assert any("manifold refused" in found["text"] for found in manifest["findings"])
    assert "NOT VALIDATED" in (result.folder.program_folder / "MAIN.MPF").read_text()


def test_a_failure_or_a_full_disk_leaves_no_run_and_the_folder_free(tmp_path, monkeypatch):
    path = write_stl(frame(), tmp_path / "a.stl")
    for name, error, raised, said in (
        ("slice_all", RuntimeError("on the way"), RuntimeError, "on the way"),
        ("compare_all", OSError(28, "No space left on device"), SettingsError, r"\.a\.run\.unfinished: cannot be written: No space"),
    ):  # fmt: skip
        with monkeypatch.context() as patch:
            patch.setattr(cross_check, name, Mock(side_effect=error))
            with pytest.raises(raised, match=said):
                check_job(path, tmp_path / "a.run", SETTINGS)
        assert not (tmp_path / "a.run").exists()
    assert check_job(path, tmp_path / "a.run", SETTINGS, resume=True).folder == RunFolder(tmp_path / "a.run")


@pytest.mark.slow
def test_a_machine_without_opengl_goes_on_with_the_others(tmp_path):
    write_stl(frame(), tmp_path / "frame.stl")
    (tmp_path / "ebamcheck.toml").write_text(WIDE_TOML)
    done = ebamcheck(
        "check", "frame.stl", "--layer-height", 6, "-o", "a.run",
        cwd=tmp_path, __EGL_VENDOR_LIBRARY_FILENAMES=os.devnull, DISPLAY="",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "backend stencil is not available" in done.stdout
    assert "libegl1" in done.stdout
    stencil = untimed(tmp_path / "a.run")["backends"]["stencil"]
    assert (stencil["status"], "libegl1" in stencil["why"]) == ("unavailable", True)
    assert (tmp_path / "a.run" / "report.html").is_file()

"""What becomes of the main job when something goes wrong: killed runs and slicers, full disks, failing parts."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess

import psutil
import pytest
from command_line import FAST, WIDE_TOML, command, ebamcheck, frame, write_stl
from finished_runs import plate_of_every_slicer, plate_of_two_layers
from pipeline_runs import SETTINGS, Listener, contents, gates, untimed

from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.mesh.part import from_arrays
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.record.run_folder import RunFolder


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A finished run with every backend there is, of a plate with a hole."""
    return plate_of_every_slicer(tmp_path_factory)


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_result(tmp_path, tmp_path_factory):
    write_stl(frame(), tmp_path / "frame.stl")
    (tmp_path / "ebamcheck.toml").write_text(
        f"slicing.backends = {FAST.split(',')}\nlayers.layer_height_mm = 6.0\n{WIDE_TOML}"
    )
    first = subprocess.Popen(command("run", "frame.stl", "-o", "a.run"), cwd=tmp_path)
    unfinished = tmp_path / ".a.run.unfinished" / "layers"
    while not list(unfinished.glob("*.parquet")):
        assert first.poll() is None
    first.kill()
    first.wait()
    assert not (tmp_path / "a.run").exists()
    second = ebamcheck("run", "frame.stl", "-o", "a.run", "--resume", cwd=tmp_path)
    assert second.returncode == 0, second.stderr
    assert "layers of the former run are kept" in second.stderr
    sound = plate_of_two_layers(tmp_path_factory)
    assert contents(tmp_path / "a.run") == contents(sound)
    assert untimed(tmp_path / "a.run") == untimed(sound)
    assert not unfinished.exists()


@pytest.mark.slow
def test_a_killed_backend_is_told_and_the_others_are_whole(plate, tmp_path):
    path = plate[1]
    (tmp_path / "ebamcheck.toml").write_text(WIDE_TOML)
    run = subprocess.Popen(
        command("run", path, "--layer-height", 6, "-o", "k.run"),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    )
    victims = []
    while not victims:
        assert run.poll() is None
        # A worker that ends while it is looked at has no command line any more.
        with contextlib.suppress(psutil.Error):
            victims = [
                p
                for p in psutil.Process(run.pid).children()
                if p.cmdline()[1:5] == ["-P", "-m", "ebamcheck.slicers.worker", "embree"]
            ]
    victims[0].kill()
    text = run.communicate()[0]
    assert run.returncode == 0
    assert "3 methods agree on 2 of 2 layers; lost: embree killed" in text
    manifest = untimed(tmp_path / "k.run")
    assert manifest["backends"]["embree"]["status"] == "killed"
    assert "SIGKILL" in manifest["backends"]["embree"]["why"]
    whole = contents(plate[0].folder.path)
    for name in ("planecut", "stencil", "manifold"):
        if manifest["backends"][name]["status"] == "done":
            assert (tmp_path / "k.run" / "layers" / f"{name}.parquet").read_bytes() == whole[
                f"layers/{name}.parquet"
            ]
    assert {n: b for n, b in contents(tmp_path / "k.run").items() if n.startswith("program/")} == {
        n: b for n, b in whole.items() if n.startswith("program/")
    }


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


@pytest.mark.slow
def test_a_report_writer_that_raises_is_a_note(tmp_path, monkeypatch):
    (tmp_path / "raising_writer.py").write_text("def write(run):\n    raise OSError('no ink')\n")
    info = tmp_path / "raising_writer-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: raising-writer\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[ebamcheck.reports]\nraising = raising_writer:write\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    listener = Listener()
    result = check_job(
        write_stl(frame(), tmp_path / "f.stl"), tmp_path / "f.run", SETTINGS, observer=listener
    )
    assert result.exit_code is ExitCode.PASS
    (note,) = listener.notes
    assert "'raising'" in note
    assert "OSError: no ink" in note


def test_the_folder_is_free_again_after_a_failure(tmp_path, monkeypatch):
    from ebamcheck.pipeline import cross_check

    def fail(*_, **__):
        raise RuntimeError("on the way")

    path = write_stl(frame(), tmp_path / "a.stl")
    with monkeypatch.context() as patch:
        patch.setattr(cross_check, "slice_all", fail)
        with pytest.raises(RuntimeError, match="on the way"):
            check_job(path, tmp_path / "a.run", SETTINGS)
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


def test_a_full_disk_is_told_with_its_place(tmp_path, monkeypatch):
    from ebamcheck.pipeline import cross_check

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cross_check, "compare_all", fail)
    with pytest.raises(
        SettingsError, match=r"\.a\.run\.unfinished: cannot be written: No space left on device"
    ):
        check_job(write_stl(frame(), tmp_path / "a.stl"), tmp_path / "a.run", SETTINGS)
    assert not (tmp_path / "a.run").exists()


@pytest.mark.slow
def test_layers_that_cannot_be_written_end_the_job_and_name_the_file(tmp_path):
    """Files of this command may not grow to what the layers take."""
    write_stl(frame(), tmp_path / "frame.stl")
    done = ebamcheck(
        "check", "frame.stl", "--layer-height", 0.005, "--backends", FAST, "-o", "a.run",
        cwd=tmp_path, limit_bytes=60_000,
    )  # fmt: skip
    assert done.returncode == 2, done.stdout + done.stderr
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("ebamcheck: error")]
    assert re.search(r"layers/\w+\.parquet: cannot be written: .*File too large", line), line
    assert not (tmp_path / "a.run").exists()
    assert not [f for f in (tmp_path / ".a.run.unfinished" / "layers").iterdir() if f.suffix == ".part"]


def test_a_check_of_methods_that_differ_ends_with_code_1_and_names_them(tmp_path):
    write_stl(frame(), tmp_path / "frame.stl")
    done = ebamcheck(
        "check", "frame.stl", "--layer-height", 6, "--backends", "planecut", "-o", "a.run", cwd=tmp_path
    )
    assert done.returncode in (1, 5), done.stdout
    assert "NOT AGREED" in done.stdout
    assert "1 method left, two are needed" in done.stdout

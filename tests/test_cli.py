"""Every command and every exit code, as a user meets them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from functools import partial

import psutil
import pytest
from command_line import FAST, WIDE_TOML, command, ebamcheck, frame, started, write_stl
from parts import box

from ebamcheck.errors import ExitCode
from ebamcheck.layers.files import read_layers
from ebamcheck.mesh.part import from_arrays
from ebamcheck.settings.config import Config, load_config

AREA_MM2 = 40.0 * 40.0 - 14.0 * 16.0


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with parts and one finished run of the command line."""
    folder = tmp_path_factory.mktemp("place")
    plate = frame()
    write_stl(plate, folder / "frame.stl")
    write_stl(box((0, 0, 0), (30, 30, 12)), folder / "box.stl")
    (folder / "ebamcheck.toml").write_text(
        f"slicing.backends = {FAST.split(',')}\nlayers.layer_height_mm = 6.0\n{WIDE_TOML}\n"
    )
    done = started("run", "frame.stl", "-o", "frame.run", "--reference", "frame.stl", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return folder


@pytest.fixture
def here(place):
    """Run a command beside the parts, unless it is told where."""
    return partial(ebamcheck, cwd=place)


def test_settings_of_a_folder_hold_and_those_that_name_no_slicer_are_told(place, here, tmp_path):
    manifest = strict((place / "frame.run" / "run.json").read_text())
    assert sorted(manifest["backends"]) == sorted(FAST.split(","))
    assert manifest["heights"] == {"count": 2, "first_mm": 3.0, "last_mm": 9.0, "layer_height_mm": 6.0}
    assert manifest["reference"]["contour"]["normal_max_mm"] == pytest.approx(0.0, abs=1e-9)
    for text, code, said in (
        ("slicing.required = ['nosuch']", 4, "unknown backend 'nosuch'"),
        ("slicing.primary = 'manifold'", 2, "leaves out 'manifold'"),
    ):
        (tmp_path / "c.toml").write_text(text)
        one_line(
            here("run", place / "frame.stl", "-c", "c.toml", "--backends", "planecut", cwd=tmp_path),
            code,
            said,
        )
        assert [entry.name for entry in tmp_path.iterdir()] == ["c.toml"]


def strict(text):
    def refuse(constant):
        raise ValueError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def one_line(done, code, *parts):
    assert done.returncode == code, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("ebamcheck: ")
    for part in parts:
        assert part in lines[0]


def test_version_help_and_start_are_there(place):
    assert re.fullmatch(r"ebamcheck \d+\.\d+\.\d+\n", started("--version", cwd=place).stdout)
    text = " ".join(ebamcheck("-h", cwd=place).stdout.split())
    for code in ("0 pass", "1 out of tolerance", "5 nothing compared", "130 interrupted"):
        assert code in text
    bare = ebamcheck(cwd=place)
    assert (bare.returncode, bare.stdout) == (2, "")
    assert bare.stderr.startswith("Usage")


def test_inspect(place, here):
    told = here("inspect", "frame.stl", "--json")
    figures = strict(told.stdout)
    assert (told.returncode, figures["verdict"], figures["facets"]) == (0, "sound", 32)
    assert figures["volume_mm3"] == pytest.approx(12 * AREA_MM2)
    text = here("inspect", "frame.stl", "--units", "cm").stdout
    assert re.search(r"^size mm +400 x 400 x 120$", text, re.MULTILINE)
    part = box((0, 0, 0), (30, 30, 12))
    write_stl(from_arrays(part.vertices, part.faces[:-1], "open"), place / "open.stl")
    told = here("inspect", "open.stl")
    assert told.returncode == 1
    assert re.search(r"^verdict +open: 3 open edges", told.stdout, re.MULTILINE)


@pytest.mark.parametrize(("change", "said"), [("open", "has open paths"), ("turned", "has no contour on any layer")])
def test_slice_warns_of_a_part_without_an_inside(place, here, change, said):
    part = frame()
    faces = part.faces[:-1] if change == "open" else part.faces[:, ::-1]
    write_stl(from_arrays(part.vertices, faces, "bad"), place / "bad.stl")
    told = here("slice", "bad.stl", "--backend", "planecut", "--layer-height", "12", "-o", "bad.cli")
    assert told.returncode == 0
    assert told.stdout.startswith("1 layer, ")
    assert said in told.stderr


def test_slice_takes_heights_direction_and_backend_settings(place, here):
    told = here(
        "slice", "frame.stl", "--backend", "planecut", "--heights", "7,3", "--direction", "1,0,0",
        "--set", "overlaps=keep", "-o", "turned.parquet",
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    layers = read_layers(place / "turned.parquet")
    assert layers.heights.tolist() == [7.0, 3.0]
    assert layers.areas() == pytest.approx([40.0 * 12.0] * 2)
    assert layers.settings["overlaps"] == "keep"


@pytest.mark.parametrize("suffix", ["cli", "svg", "dxf", "vtp", "3mf", "csv"])
def test_slices_in_every_format_compare_with_the_exact_file(place, here, suffix):
    for name in ("exact.parquet", f"of/{suffix}/other.{suffix}"):
        told = here("slice", "frame.stl", "--layer-height", "1", "-o", name)
        assert (told.returncode, told.stderr) == (0, "")
        assert told.stdout.startswith("12 layers, 24 rings, 0 open paths")
    told = here("compare", "exact.parquet", f"of/{suffix}/other.{suffix}")
    assert (told.returncode, told.stdout.splitlines()[-1]) == (0, "12 of 12 layers agree within 0.001 mm")


def test_compare(place, here):
    layers = place / "frame.run" / "layers"
    a, b = layers / "planecut.parquet", layers / "manifold.parquet"
    told = here("compare", a, b, "--json", "-o", "table.csv")
    rows = strict(told.stdout)
    assert told.returncode == 0
    assert [row["agrees"] for row in rows] == [True, True]
    assert (place / "table.csv").read_text().startswith("layer,")
    here("slice", "box.stl", "-o", "box.parquet")
    one_line(here("compare", a, "box.parquet"), 2, "are of different parts", "--any-part")
    told = here("compare", a, "box.parquet", "--any-part")
    assert told.returncode == 1
    assert "0 of 2 layers agree within 0.001 mm" in told.stdout
    here("slice", "box.stl", "--heights", "1", "-o", "a.parquet")
    one_line(here("compare", "a.parquet", "box.parquet"), 2, "'a.parquet' has 1 layer", "'box.parquet' has 2")


def test_backends(place, here):
    told = here("backends", "--json")
    found = {backend["name"]: backend for backend in strict(told.stdout)}
    assert {"planecut", "stencil", "embree", "manifold"} <= set(found)
    for backend in found.values():
        assert backend["available"] or backend["why"]
        assert backend["error_bound_mm"] > 0
    text = here("backends").stdout
    for name in found:
        assert re.search(rf"^{name} +(yes|no) ", text, re.MULTILINE)


def test_config_prints_what_is_in_force(place, here, tmp_path):
    printed = tmp_path / "printed.toml"
    printed.write_text(here("config").stdout)
    assert load_config(printed) == load_config(place / "ebamcheck.toml")
    assert here("config", "-c", printed, cwd=tmp_path).stdout == printed.read_text()
    assert strict(here("config", "--schema").stdout) == Config.model_json_schema()


def test_verify_a_run_and_a_program(place, here):
    told = here("verify", "frame.run", "--part", "frame.stl", "--json")
    assert told.returncode == 0, told.stdout
    assert all(check["passed"] for check in strict(told.stdout))
    program = place / "frame.run" / "program" / "MAIN.MPF"
    told = here("verify", program, "--part", "frame.stl")
    assert told.returncode == 0, told.stdout
    told = here("verify", program, "--part", "box.stl")
    assert told.returncode == 1
    assert "FAIL" in told.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "parts"),
    [
        (["run"], 2, ["give either the file of a part, or --plate"]),
        (["nosuch"], 2, ["No such command 'nosuch'"]),
        (["run", "frame.stl", "--layer-height", "high"], 2, ["--layer-height"]),
        (["run", "frame.stl", "--layer-height", "0"], 2, ["layers.layer_height_mm", "given 0.0"]),
        (["run", "frame.stl", "--layer-height", "nan"], 2, ["layers.layer_height_mm", "given nan"]),
        (["check", "frame.stl", "--layer-height", "1e-9"], 2, ["layers.layer_height_mm", "from 0.005 to 100 (given 1e-09)"]),
        (["run", "nosuch.stl"], 2, ["nosuch.stl: there is no such file"]),
        (["run", "."], 2, ["is a folder"]),
        (["run", "frame.stl", "-o", "box.stl"], 2, ["box.stl: is there and is no run folder"]),
        (["run", "frame.stl", "-c", "nosuch.toml"], 2, ["nosuch.toml: cannot be read"]),
        (["run", "frame.stl", "--direction", "0,0,0"], 2, ["slicing direction"]),
        (["run", "frame.stl", "--backends", "planecut,nosuch"], 4, ["unknown backend 'nosuch'", "planecut"]),
        (["slice", "frame.stl", "-o", "x.foo"], 2, ["no format of layers has the suffix '.foo'"]),
        (["frame.stl"], 2, ["'frame.stl' is no command", "`ebamcheck run frame.stl`"]),
        (["compare", "frame.run/layers/planecut.parquet", "frame.run/layers/planecut.parquet", "-o", "nosuch/x.csv"], 2, ["there is no folder nosuch"]),
        (["slice", "frame.stl", "-o", "x.cli", "--set", "pixel=1"], 2, ["backend 'planecut': pixel: unknown key", "known keys: overlaps"]),
        (["slice", "frame.stl", "-o", "x.cli", "--heights", "1,nan"], 2, ["height 1 is nan"]),
        (["compare", "frame.stl", "frame.stl"], 2, ["no format of layers has the suffix '.stl'"]),
        (["verify", "nosuch"], 2, ["nosuch: there is no such"]),
        (["verify", "frame.stl"], 2, ["name its part with --part"]),
    ],
)  # fmt: skip
def test_errors_are_one_line(place, here, arguments, code, parts):
    one_line(here(*arguments), code, *parts)


def test_debug_shows_where_an_error_came_from(place, here):
    for arguments in (["--debug", "inspect", "nosuch.stl"], ["inspect", "nosuch.stl", "--debug"]):
        told = here(*arguments)
        assert told.returncode == 2
        assert "Traceback" in told.stderr
        assert told.stderr.splitlines()[-1].startswith("ebamcheck: error: nosuch.stl")


def test_one_method_compares_nothing(place):
    told = ebamcheck("run", "frame.stl", "--backends", "planecut,planecut", "-o", "one.run", cwd=place)
    assert told.returncode == 5
    assert "1 method left, two are needed" in told.stdout
    assert "NOT VALIDATED" in (place / "one.run" / "program" / "MAIN.MPF").read_text()


def test_internal_errors_are_one_line_with_code_3(place, tmp_path):
    """A plugin's command that raises what it should not."""
    (tmp_path / "loose_plugin.py").write_text("def loose() -> None:\n    raise ValueError('two\\nlines')\n")
    info = tmp_path / "loose_plugin-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: loose-plugin\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[ebamcheck.commands]\nloose = loose_plugin:loose\ngone = nosuch:gone\n")
    told = started("loose", cwd=place, PYTHONPATH=str(tmp_path))
    assert told.returncode == 3
    (error,) = told.stderr.splitlines()
    assert error.startswith("ebamcheck: internal error: ValueError: two lines")
    told = started("--help", cwd=place, PYTHONPATH=str(tmp_path))
    assert told.returncode == 0
    assert "command 'gone' was left out" in told.stderr
    assert "loose" in told.stdout


def test_output_that_nobody_reads_is_no_error(place):
    run = subprocess.Popen(command("backends"), cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    run.stdout.close()
    assert run.stderr.read() == b""
    run.stderr.close()
    assert run.wait() == ExitCode.NOBODY_READS


@pytest.mark.parametrize("name", [b"two words'\".stl", b"line\nbreak.stl", b"gro\xdf.stl"])
def test_names_of_any_kind(place, name):
    path = os.fsencode(place) + b"/" + name
    with open(path, "wb") as file:
        file.write((place / "frame.stl").read_bytes())
    told = started("inspect", os.fsdecode(name), "--json", cwd=place, PYTHONIOENCODING="ascii")
    assert (told.returncode, strict(told.stdout)["verdict"]) == (0, "sound")
    one_line(ebamcheck("inspect", os.fsdecode(b"no-" + name), cwd=place), 2, "there is no such file")


def workers(process):
    return [p for p in psutil.Process(process.pid).children() if "ebamcheck.slicers.worker" in p.cmdline()]


@pytest.mark.parametrize(
    ("number", "leaves"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 130, marks=pytest.mark.slow), (signal.SIGKILL, -9)],
)
def test_an_interrupted_run_leaves_no_worker_and_no_half_run(place, number, leaves):
    run = subprocess.Popen(
        command("run", "frame.stl", "-o", "cut.run"),
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    started = []
    while not started:
        assert run.poll() is None
        started = workers(run)
    run.send_signal(number)
    told = run.communicate()[1]
    assert run.returncode == leaves
    assert psutil.wait_procs(started, timeout=20)[1] == []
    assert not (place / "cut.run").exists()
    if leaves == 130:
        assert told == "ebamcheck: interrupted; what was finished is kept for --resume\n"

"""What a command loads before it works, and what its help shows: an example that it takes, and names that the shell completes."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys

import pytest
import typer
from command_line import command

from ebamcheck import installed
from ebamcheck.commands.command_group import GROUPS
from ebamcheck.commands.main import app
from ebamcheck.errors import BackendFailed
from ebamcheck.installed import entry_points
from ebamcheck.layers.files import read_layers
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.plugins import registry
from ebamcheck.slicers.cutting import fits_here, may_run_here
from ebamcheck.slicers.isolation import slice_all
from ebamcheck.slicers.outcome import Limits
from ebamcheck.slicers.slicing import slice_to_file
from ebamcheck_models import CUBE

RUN = """
from ebamcheck.commands.main import main
sys.argv = ["ebamcheck", *{arguments!r}]
try:
    main()
except SystemExit:
    pass
"""


def commanded(*arguments: str) -> str:
    return RUN.format(arguments=arguments)


ISOLATION = "ebamcheck.slicers.isolation"
NUMERIC = {"numpy", "numba", "pandas", "scipy", "shapely", "pyarrow", "pydantic", "matplotlib"}
HEAVY = {"pandas", "ebamcheck.pipeline", "ebamcheck.slicers.slicing", "ebamcheck.curves", "ebamcheck.scan"}
LATER = {
    "scipy.linalg",
    "scipy.spatial",
    "ebamcheck.scan",
    "ebamcheck.curves",
    "ebamcheck.pipeline.finishing",
}
DRAWING = "import ebamcheck.saving, ebamcheck.showing.plotting, ebamcheck.runs"

# What is run, what it loads and what it does not.
LOADED = {
    "the package": ("import ebamcheck", "ebamcheck", NUMERIC),
    "plots, before one is drawn": (DRAWING, "ebamcheck.showing.plotting", {"matplotlib"}),
    "the paper's command": ("import ebamcheck_reports.paper", "ebamcheck_reports.paper", {"numpy"}),
    "--version": (commanded("--version"), "ebamcheck", NUMERIC),
    "--help": (commanded("--help"), "ebamcheck", NUMERIC | {"ebamcheck.live", "ebamcheck_reports.paper"}),
    "slice by its own kernels": (
        commanded("slice", "cube.stl", "-o", "a.parquet"), "numpy",
        {"pandas", "rich", "shapely", "psutil", "trimesh", "OpenGL", "networkx", ISOLATION},
    ),
    "slice by another": (commanded("slice", "cube.stl", "--backend", "embree", "-o", "b.parquet"), ISOLATION, set()),
    "the slicers of a run": ("import ebamcheck.pipeline.run", "ebamcheck.pipeline.cross_check", LATER),
    "the default slicer": (
        "from ebamcheck.plugins import registry; registry.default_backend()", "ebamcheck_stencil.slicer",
        {"ebamcheck_stencil.crossings", "ebamcheck_stencil.openings", "ebamcheck_prusa.images", "ebamcheck_cura.gcode"},
    ),
    "a run that a preflight stops": (commanded("run", "cube.stl", "--place", "5000,0"), "ebamcheck.preflight", HEAVY),
    "a preflight": (commanded("preflight", "cube.stl"), "ebamcheck.preflight", HEAVY),
}  # fmt: skip


@pytest.mark.parametrize("what", LOADED)
def test_no_more_is_loaded_than_is_needed(what, tmp_path):
    code, wanted, unwanted = LOADED[what]
    write_triangles(CUBE.tessellate(0.1).triangles, tmp_path / "cube.stl")
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\nprint('loaded:', *sys.modules)"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    loaded = set(done.stdout.splitlines()[-1].split())
    assert wanted in loaded
    assert sorted(loaded & unwanted) == []


def test_here_and_in_a_process_of_its_own_the_file_is_the_same(tmp_path):
    cube = CUBE.tessellate(0.1)
    here = slice_to_file(cube, [1.0, 2.0, 3.5], tmp_path / "here.parquet", "planecut")
    settings = {"planecut": registry.slicer_settings("planecut", {})}
    apart = slice_all(cube, read_layers(tmp_path / "here.parquet").heights, settings, tmp_path)["planecut"]
    assert (tmp_path / "here.parquet").read_bytes() == apart.made().read_bytes()
    for name in ("rings", "open_paths", "points", "error_bound_mm"):
        assert getattr(here, name) == getattr(apart, name)
    assert may_run_here("planecut")
    assert not may_run_here("embree")


def test_memory_and_time_are_limited_here_as_well(tmp_path):
    cube = CUBE.tessellate(0.1)
    assert fits_here(cube, 4_000_000, Limits())
    assert not fits_here(cube, 4_000_000, Limits(memory_mb=1000.0))
    with pytest.raises(BackendFailed, match=r"'planecut' timed out: took over 1e-09 s"):
        slice_to_file(cube, [1.0], tmp_path / "cube.parquet", limits=Limits(time_s=1e-9))
    assert list(tmp_path.iterdir()) == []


def test_plugins_that_are_installed_meanwhile_are_found(tmp_path, monkeypatch):
    names = {point.name for point in entry_points("ebamcheck.controls")}
    assert "sinumerik-840d-sl" in names
    monkeypatch.syspath_prepend(str(tmp_path))
    assert {point.name for point in entry_points("ebamcheck.controls")} == names
    info = tmp_path / "late-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: late\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[ebamcheck.controls]\nlate = nowhere:NOTHING\n")
    found = {point.name: point for point in entry_points("ebamcheck.controls")}
    assert set(found) == names | {"late"}
    assert installed.name_and_version(found["late"].dist) == ("late", "1.0")


# -- help and completion -----------------------------------------------------------------------------

EXAMPLE = re.compile(r"Examples?: ((?:.|\n)*?)(?:\n\n|\Z)")
GROUP = typer.main.get_command(app)


def commands(group, context, path=()):
    """All commands and sub-commands by their path, each with its context."""
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        inner = found.make_context(name, [], parent=context, resilient_parsing=True)
        if hasattr(found, "list_commands"):
            yield from commands(found, inner, (*path, name))
        yield (*path, name), found, inner


ALL = {
    path: (found, inner)
    for path, found, inner in commands(GROUP, GROUP.make_context("ebamcheck", [], resilient_parsing=True))
}


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_every_command_has_an_example_that_it_takes(path):
    found, context = ALL[path]
    shown = EXAMPLE.search(found.get_help(context))
    assert shown, f"{' '.join(path)} --help shows no example"
    for example in " ".join(shown[1].split()).split("; "):
        words = shlex.split(example)
        assert words[: len(path) + 1] == ["ebamcheck", *path]
        # Wrong options, missing arguments and words that are no number raise here.
        found.make_context(path[-1], words[len(path) + 1 :])


def test_the_help_lists_commands_by_group_with_what_each_says_of_itself():
    context = typer.Context(GROUP, info_name="ebamcheck", max_content_width=300, terminal_width=300)
    shown = GROUP.get_help(context)
    listed = " ".join(shown.split())
    narrow = GROUP.get_help(typer.Context(GROUP, info_name="ebamcheck", terminal_width=80))
    # What a first user needs comes first, and is not cut short.
    first = narrow.partition("Start here:")[2].partition("\nMake:")[0]
    assert re.findall(r"^  (\w+) .*", first, re.MULTILINE) == [*GROUPS["Start here"]]
    assert "..." not in first
    assert "Plug-ins" not in shown, "give each command of the house a group"
    assert {"run", "slice", "config", "warm", "sign", "regress", "paper", "scan"} <= set(GROUP.list_commands(context))
    for name in GROUP.list_commands(context):
        assert f"{name} {GROUP.get_command(context, name).get_short_help_str(60).removesuffix('...')}" in listed


def test_the_shell_completes_commands_and_options(tmp_path):
    def shown(*arguments, **environment):
        done = subprocess.run(
            command(*arguments),
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout.split()

    for words, wanted in (("sl", "slice"), ("reg", "regress"), ("run --fo", "--force")):
        given = {"COMP_WORDS": f"ebamcheck {words}", "COMP_CWORD": str(1 + words.count(" "))}
        assert shown(_EBAMCHECK_COMPLETE="complete_bash", **given) == [wanted]
    shell = {"HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    shown("--install-completion", "bash", **shell)
    assert "ebamcheck" in (tmp_path / ".bashrc").read_text()

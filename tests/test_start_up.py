"""What a command loads before it works: no more than it needs, in no more processes than it needs."""

from __future__ import annotations

import ast
import os
import re
import shlex
import subprocess
import sys

import pytest
import typer

from ebamcheck.commands.main import app
from ebamcheck.layers.files import read_layers
from ebamcheck.mesh.stl import write_triangles
from ebamcheck.slicers.cutting import fits_here, may_run_here
from ebamcheck.slicers.isolation import slice_all
from ebamcheck.slicers.outcome import Limits
from ebamcheck.slicers.slicing import slice_to_file
from ebamcheck_models import CUBE

LOADED = """
import sys
from ebamcheck.commands.main import main
sys.argv = ["ebamcheck", *sys.argv[1:]]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print("loaded:", *sys.modules)
"""


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    path = tmp_path_factory.mktemp("part") / "cube.stl"
    write_triangles(CUBE.tessellate(0.1).triangles, path)
    return path


def loaded(*arguments) -> set[str]:
    """Modules that a command has loaded when it ends."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *map(str, arguments)], capture_output=True, text=True, check=True
    )
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_help_loads_no_command():
    assert loaded("--help").isdisjoint(
        {"numpy", "numba", "pandas", "ebamcheck.live", "ebamcheck_reports.paper"}
    )


def test_the_list_of_commands_says_what_each_of_them_says_of_itself():
    group = typer.main.get_command(app)
    context = typer.Context(group, info_name="ebamcheck", max_content_width=300, terminal_width=300)
    listed = " ".join(group.get_help(context).split())
    for name in group.list_commands(context):
        told = group.get_command(context, name).get_short_help_str(60).removesuffix("...")
        assert told
        assert f"{name} {told}" in listed, name


def test_slice_loads_what_it_needs(part, tmp_path):
    found = loaded("slice", part, "-o", tmp_path / "cube.parquet")
    heavy = {"pandas", "rich", "shapely", "psutil", "trimesh", "OpenGL", "networkx"}
    assert sorted(found & heavy) == []
    assert "ebamcheck.slicers.isolation" not in found, "its own kernels need no process of their own"


def test_the_slicers_of_a_run_do_not_wait_for_the_stages_after_them():
    told = "import sys, ebamcheck.pipeline.run; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    found = set(done.stdout.split())
    assert "ebamcheck.pipeline.cross_check" in found
    assert (
        not {
            "scipy.linalg",
            "scipy.spatial",
            "ebamcheck.scan",
            "ebamcheck.curves",
            "ebamcheck.pipeline.finishing",
        }
        & found
    )


def test_slice_gives_other_backends_a_process_of_their_own(part, tmp_path):
    found = loaded("slice", part, "--backend", "embree", "-o", tmp_path / "cube.parquet")
    assert "ebamcheck.slicers.isolation" in found
    assert not may_run_here("embree")


def test_here_and_in_a_process_of_its_own_the_file_is_the_same(tmp_path):
    cube, heights = CUBE.tessellate(0.1), [1.0, 2.0, 3.5]
    outcome = slice_to_file(cube, heights, tmp_path / "here.parquet", "planecut")
    from ebamcheck.plugins import registry

    settings = {"planecut": registry.slicer_settings("planecut", {})}
    apart = slice_all(cube, read_layers(tmp_path / "here.parquet").heights, settings, tmp_path)["planecut"]
    assert (tmp_path / "here.parquet").read_bytes() == apart.made().read_bytes()
    assert (outcome.rings, outcome.open_paths, outcome.points) == (
        apart.rings,
        apart.open_paths,
        apart.points,
    )
    assert outcome.error_bound_mm == apart.error_bound_mm


def test_a_part_that_may_come_near_the_limit_of_memory_is_watched_from_outside():
    cube = CUBE.tessellate(0.1)
    assert fits_here(cube, 4_000_000, Limits())
    assert not fits_here(cube, 4_000_000, Limits(memory_mb=1000.0))


def test_time_here_is_limited_as_well(tmp_path):
    from ebamcheck.errors import BackendFailed

    with pytest.raises(BackendFailed, match=r"'planecut' timed out: took over 1e-09 s"):
        slice_to_file(CUBE.tessellate(0.1), [1.0], tmp_path / "cube.parquet", limits=Limits(time_s=1e-9))
    assert list(tmp_path.iterdir()) == []


OTHERS = "import sys; from ebamcheck.plugins import registry; registry.default_backend(); print(sorted(sys.modules))"


def test_the_default_slicer_is_found_without_the_kernels_of_the_others():
    done = subprocess.run([sys.executable, "-c", OTHERS], capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stdout))
    assert "ebamcheck_stencil.slicer" in loaded
    others = {"ebamcheck_stencil.crossings", "ebamcheck_stencil.draw_once", "ebamcheck_embree.rays"}
    assert loaded & others == set()


# -- Every command says what it does by an example that fits its options; the shell completes names --


EXAMPLE = re.compile(r"Examples?: ((?:.|\n)*?)(?:\n\n|\Z)")

GROUP = typer.main.get_command(app)


def commands(group, context, path=()):
    """All commands and sub-commands by their path, each with its context."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None, name
        inner = command.make_context(name, [], parent=context, resilient_parsing=True)
        if hasattr(command, "list_commands"):
            yield from commands(command, inner, (*path, name))
        yield (*path, name), command, inner


ALL = {
    path: (command, inner)
    for path, command, inner in commands(GROUP, GROUP.make_context("ebamcheck", [], resilient_parsing=True))
}


def test_the_walk_meets_every_command():
    assert {"run", "slice", "config", "warm", "sign", "regress", "paper", "scan"} <= {path[0] for path in ALL}


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_every_command_has_an_example_that_it_takes(path):
    command, context = ALL[path]
    found = EXAMPLE.search(command.get_help(context))
    assert found, f"{' '.join(path)} --help shows no example"
    for example in " ".join(found[1].split()).split("; "):
        words = shlex.split(example)
        assert words[: len(path) + 1] == ["ebamcheck", *path]
        # Wrong options, missing arguments and words that are no number raise here.
        command.make_context(path[-1], words[len(path) + 1 :])


def complete(words, **environment):
    start = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"
    return subprocess.run(
        [sys.executable, "-c", start],
        env={**os.environ, "_EBAMCHECK_COMPLETE": "complete_bash", "COMP_WORDS": words,
             "COMP_CWORD": str(len(words.split(" ")) - 1), **environment},
        capture_output=True, text=True, check=False,
    ).stdout.split()  # fmt: skip


def test_the_shell_completes_commands_and_options():
    assert complete("ebamcheck sl") == ["slice"]
    assert complete("ebamcheck reg") == ["regress"]
    assert complete("ebamcheck run --fo") == ["--force"]


def test_completion_can_be_shown_and_installed(tmp_path):
    start = "from ebamcheck.commands.main import main; import sys; sys.argv[0] = 'ebamcheck'; main()"
    environment = {**os.environ, "HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    shown = subprocess.run(
        [sys.executable, "-c", start, "--show-completion", "bash"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "_EBAMCHECK_COMPLETE=complete_bash" in shown.stdout
    subprocess.run(
        [sys.executable, "-c", start, "--install-completion", "bash"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "ebamcheck" in (tmp_path / ".bashrc").read_text()

"""README.md, ARCHITECTURE.md and docs/ say what is there, and all that is there."""

from __future__ import annotations

import ast
import doctest
import importlib.util
import inspect
import itertools
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer
from pydantic import BaseModel

import ebamcheck
import ebamcheck.testing
from ebamcheck.backend import Slicer
from ebamcheck.commands.main import app
from ebamcheck.errors import ExitCode
from ebamcheck.mesh.part_source import PlateEntry
from ebamcheck.nc.control import Control
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import Model
from ebamcheck.result import Check
from ebamcheck.settings.base import explanations
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import MATERIALS
from ebamcheck_models import BLADE, CUBE, write_stl

ROOT = Path(__file__).parents[1]
README, ARCHITECTURE = ROOT / "README.md", ROOT / "ARCHITECTURE.md"
DOCS = ROOT / "docs"
MAP, COMMAND_PAGE, PLUGIN_PAGE = DOCS / "map.md", DOCS / "commands.md", DOCS / "extending.md"
LIMITS = DOCS / "limits.md"
PAGES = sorted(DOCS.glob("*.md"))
DOCUMENTS = [README, ARCHITECTURE, ROOT / "CHANGELOG.md", *PAGES]
SOURCES = ("ebamcheck", "backends", "reference_models", "reports")
LARGEST_PICTURE_BYTES = 400_000  # Pictures live in the repository for ever

# Last words of the names of settings that have a unit
UNITS = (
    "mm", "deg", "s", "h", "kg", "mm_s", "mm_min", "w", "mm_s2", "mm_s3", "kv", "ma", "mb", "mm2", "m3", "j_mm3", "px", "k", "w_mk", "j_kg", "j_kgk",
)  # fmt: skip

# Numbers that have none, or whose pairs have two
WITHOUT_UNIT = {
    "seed", "hole", "live_r", "direction", "defocus", "conductivity_by_temperature", "heat_capacity_by_temperature", "power_schedule",
    # Counts.
    "most_layers", "passes", "most_passes", "most_points", "most_islands", "stride", "annealing_steps", "ramp_steps", "decimals", "rays_per_call",
    "block_points", "slabs", "processes", "bspline_shift",
    # Shares of a length, an area, a power; factors.
    "bead_spacing", "layer_over_bead", "least_coverage", "mass_tolerance", "outside_share", "inside_tolerance", "edge_tolerance", "gap_width",
    "least_known", "melt_mixing", "evidence_share", "travel_share", "ramp_power", "melting_efficiency", "dilution", "emissivity", "absorptivity",
    "curvature_share", "dip_share",
}  # fmt: skip

GROUP = typer.main.get_group(app)
CONTEXT = GROUP.make_context("ebamcheck", [], resilient_parsing=True)
COMMANDS = {name: GROUP.get_command(CONTEXT, name) for name in GROUP.list_commands(CONTEXT)}


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def code(path: Path) -> str:
    """Lines of code blocks, and what stands in backticks with the rest of its table row, one a line."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text(path), re.DOTALL | re.MULTILINE)
    prose = re.sub(r"^```.*?^```", "", text(path), flags=re.DOTALL | re.MULTILINE)
    first_cells = re.findall(r"^\| `([^`\n]+`.*)", prose, re.MULTILINE)
    spans = re.findall(r"`([^`\n]+)`", prose)
    return "\n".join([*blocks, *first_cells, *spans])


def settings() -> Iterator[tuple[str, str, type[BaseModel]]]:
    """Where each setting stands, its name, and the section that it belongs to."""
    for section, info in Config.model_fields.items():
        assert isinstance(info.annotation, type)
        for name in info.annotation.model_fields:
            yield section, name, info.annotation
    for backend, slicer in registry.slicers().items():
        for name in slicer.Settings.model_fields:
            yield f"slicing.settings.{backend}", name, slicer.Settings


def is_number(annotation: object) -> bool:
    return re.search(r"\b(float|int)\b", str(annotation)) is not None


# -- the map of rooms --------------------------------------------------------------------------------


def test_the_map_is_made_from_the_docstrings():
    spec = importlib.util.spec_from_file_location("make_map", DOCS / "make_map.py")
    assert spec is not None
    assert spec.loader is not None
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    assert text(MAP) == maker.module_map(), "make map"


def test_the_architecture_names_every_room():
    picture = text(ARCHITECTURE).partition("## The rooms")[2].partition("## One layer")[0]
    rooms = {path.parent.name for path in (ROOT / "ebamcheck").glob("*/__init__.py")}
    assert rooms - set(re.findall(r"\b[a-z_]+\b", picture)) == set()


def test_constants_of_the_tolerance_table_exist():
    sources = "\n".join(text(path) for path in (ROOT / "ebamcheck").rglob("*.py"))
    named = re.findall(r"^\| `([A-Z_]+)`", text(LIMITS), re.MULTILINE)
    assert named
    assert [name for name in named if not re.search(rf"^{name} = ", sources, re.MULTILINE)] == []


# -- settings ----------------------------------------------------------------------------------------


def test_every_setting_says_what_it_is():
    silent = [f"{where}.{name}" for where, name, section in settings() if name not in explanations(section)]
    assert silent == [], "give each of them a docstring"


def test_every_number_among_the_settings_has_a_unit_in_its_name():
    bare = [
        f"{where}.{name}"
        for where, name, section in settings()
        if is_number(section.model_fields[name].annotation)
        and name not in WITHOUT_UNIT
        and not name.endswith(tuple(f"_{unit}" for unit in UNITS))
    ]
    assert bare == [], "name the unit, or say here why there is none"


# -- entry points, commands, exit codes ---------------------------------------------------------------


def test_every_group_command_and_exit_code_is_documented():
    project = tomllib.loads(text(ROOT / "pyproject.toml"))["project"]
    groups = {*project["entry-points"], registry.CHECKS, MATERIALS}
    assert len(groups) >= 8
    for document in (PLUGIN_PAGE, ARCHITECTURE):
        assert {g for g in groups if f"`{g}`" not in text(document)} == set(), document.name
    assert {name for name in COMMANDS if f"`ebamcheck {name}" not in text(COMMAND_PAGE)} == set()
    table = re.findall(r"^\| (\d+) \| \S", text(COMMAND_PAGE), re.MULTILINE)
    assert sorted(int(code) for code in table) == sorted(ExitCode)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_what_a_document_names_is_there(document: Path):
    shown = text(document)
    files = re.findall(rf"`((?:{'|'.join(SOURCES)}|tests)/[\w/.-]+\.\w+)`?", shown)
    assert [name for name in files if not (ROOT / name).exists()] == []
    if document.name != "python.md":  # where `layers` is a variable
        keys = rf"`((?:{'|'.join(Config.model_fields)})\.(?!py`|csv`|parquet`|json`)\w+)`"
        assert set(re.findall(keys, shown)) <= {f"{where}.{name}" for where, name, _ in settings()}
    lines = re.findall(r"^(?:\$ )?ebamcheck ([a-z]+)([^\n`]*.*)", code(document), re.MULTILINE)
    assert {name for name, _ in lines} <= set(COMMANDS)
    for name, rest in lines:
        known = {option for parameter in COMMANDS[name].params for option in parameter.opts}
        assert set(re.findall(r"(?<![\w-])(--[a-z-]+)", rest)) - {"--help"} <= known, name
    targets = set(re.findall(r"^([a-z-]+):", text(ROOT / "Makefile"), re.MULTILINE))
    assert set(re.findall(r"(?:`|^)make ([a-z-]+)", shown, re.MULTILINE)) <= targets
    for link in re.findall(r"\]\(((?!https://)[^)\s]+)\)", shown):
        name, _, anchor = link.partition("#")
        target = document.parent / name if name else document
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target), link


# -- examples: of the README, of the page on Python, of public names, of the tutorials ----------------


@pytest.mark.parametrize(
    ("page", "block", "least"), [(README, r"```python\n(.*?)```", 6), (DOCS / "python.md", r"```pycon\n(.*?)```", 40)]
)  # fmt: skip
def test_the_examples_of_a_page_show_what_it_says(page, block, least, tmp_path, monkeypatch):
    tolerance = re.search(r"ebamcheck_models blade --tolerance (\S+) -o blade\.stl", text(README))
    assert tolerance
    write_stl(BLADE.tessellate(float(tolerance[1])), tmp_path / "blade.stl")
    ebamcheck.save(CUBE.tessellate(0.1), tmp_path / "bracket.stl")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    blocks = [
        found
        for found in re.findall(block, text(page), re.DOTALL)
        if importlib.util.find_spec("matplotlib") or "plot" not in found
    ]
    lines = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, page.name, str(page), 0)
    assert len(lines.examples) >= least
    said: list[str] = []
    failed = doctest.DocTestRunner().run(lines, out=said.append).failed
    assert not failed, "".join(said)


PUBLIC = {
    name: found
    for module in (ebamcheck, ebamcheck.testing)
    for name in module.__all__
    if callable(found := getattr(module, name))
}

PROTOCOLS = (Slicer, Model, Control, Check)  # What strangers write classes and values of


@pytest.mark.parametrize("found", [*PUBLIC.values(), *PROTOCOLS], ids=lambda found: found.__name__)
def test_a_public_name_says_what_it_takes_gives_and_raises_and_shows_it(found: Any):
    said = inspect.getdoc(found) or ""
    assert doctest.DocTestParser().get_examples(said), "no example: `make test` runs them"
    if found in PROTOCOLS:
        return
    headings = {line for line, under in itertools.pairwise(said.splitlines()) if under and under == "-" * len(line)}
    assert headings & {"Parameters", "Attributes"}
    if inspect.isfunction(found):
        assert "Returns" in headings
        assert "Raises" in headings or "raise " not in inspect.getsource(found)
        described = said.partition("Parameters\n")[2].partition("\n\n")[0]
        heads = {n.strip(" *") for line in re.findall(r"^\S.*", described, re.MULTILINE) for n in line.split(",")}
        taken = inspect.signature(found).parameters.values()
        assert {one.name for one in taken if one.kind is not one.VAR_KEYWORD} <= heads


def commands(page: str) -> list[str]:
    """Lines of the shell blocks: those that stand alone between fences without a language."""
    every = re.findall(r"^```(\w*)\n(.*?)^```", text(DOCS / page), re.DOTALL | re.MULTILINE)
    return [line for language, block in every if not language for line in block.splitlines()]


def run(line: str, folder: Path) -> None:
    words = [word for word in shlex.split(line) if word not in ("python", "-m")]
    ended = subprocess.run([sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, f"{line}\n{ended.stdout}{ended.stderr}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "file", "left_out", "count", "then"),
    [
        ("first-own-part.md", "plate.toml", (), 7, ["ebamcheck preflight --plate plate.toml"]),
        # Kernels and baselines are what all other tests are about, and an image takes an engine and a network.
        ("in-ci.md", "cell3.toml", ("ebamcheck warm", "ebamcheck regress", "podman"), 5, []),
    ],
)
def test_the_commands_of_a_tutorial_run_in_their_order(page, file, left_out, count, then, tmp_path):
    plates = re.findall(r"^```toml\n(.*?)^```", text(DOCS / page), re.DOTALL | re.MULTILINE)
    settings_of_ci = "[slicing]\nbackends = ['planecut', 'manifold']\n"
    (tmp_path / file).write_text(plates[0] if file == "plate.toml" else settings_of_ci)
    write_stl(CUBE.tessellate(0.1), tmp_path / "part.stl")
    lines = [line for line in commands(page) if not line.startswith(left_out)]
    assert len(lines) == count
    for line in [*lines, *then]:
        run(line, tmp_path)


def test_the_profile_of_your_machine_can_work(tmp_path: Path):
    profile = re.findall(r"^```toml\n(.*?)^```", text(DOCS / "your-machine.md"), re.DOTALL | re.MULTILINE)[0]
    write_stl(CUBE.tessellate(0.1), tmp_path / "part.stl")
    (tmp_path / "ebamcheck.toml").write_text(profile)
    run("ebamcheck preflight part.stl -c ebamcheck.toml --place 300,0", tmp_path)


def test_the_version_has_an_entry_in_the_changelog():
    assert f"## [{ebamcheck.__version__}]" in text(ROOT / "CHANGELOG.md")


# -- TOML and Python of the pages ---------------------------------------------------------------------


def blocks(language: str) -> list[object]:
    return [
        pytest.param(block, id=f"{page.stem}-{number}")
        for page in PAGES
        for number, block in enumerate(re.findall(rf"^```{language}\n(.*?)^```", text(page), re.DOTALL | re.MULTILINE))
    ]


@pytest.mark.parametrize("block", blocks("toml"))
def test_settings_and_plates_of_the_pages_are_valid(block: str):
    table = tomllib.loads(block)
    if "project" in table:
        known = {registry.CONTROLS, registry.CHECKS, MATERIALS, "ebamcheck.backends"}
        assert set(table["project"]["entry-points"]) <= known
    elif "parts" in table:
        for entry in table["parts"]:
            PlateEntry.model_validate(entry)
    else:
        Config.model_validate(table)


@pytest.mark.parametrize("block", blocks("python"))
def test_the_python_of_the_pages_names_what_is_there(block: str):
    for node in ast.walk(ast.parse(block)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ebamcheck."):
            module = importlib.import_module(node.module or "")
            assert [name.name for name in node.names if not hasattr(module, name.name)] == []


def test_the_check_of_the_page_judges_a_program():
    (block,) = [
        b for b in re.findall(r"```python\n(.*?)```", text(DOCS / "your-control.md"), re.DOTALL) if "Check(" in b
    ]
    names: dict[str, Any] = {}
    exec(block, names)
    short = SimpleNamespace(kind=np.zeros(10), files=[Path("MAIN.MPF")])
    long = SimpleNamespace(kind=np.zeros(1_000_001), files=[Path("MAIN.MPF")])
    assert [names["long_program"](program, Config()).passed for program in (short, long)] == [True, False]


# -- links, pictures, machines ------------------------------------------------------------------------


def anchors(path: Path) -> set[str]:
    """Anchors of a page's headings, as Markdown renderers make them."""
    headings = re.findall(r"^#+ (.*)$", text(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def test_every_page_is_linked():
    linked = {link for page in (README, DOCS / "index.md") for link in re.findall(r"\]\(([\w./-]+)", text(page))}
    names = {Path(link).name for link in linked}
    assert {page.name for page in PAGES} - names <= {"index.md"}


def test_every_picture_is_small_and_shown():
    folders = [ROOT / "reports" / name for name in ("pictures", "benchmarks", "live")]
    shown = {
        (document.parent / link).resolve().relative_to(ROOT).as_posix()
        for document in (README, *PAGES)
        for link in re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text(document))
    }
    pictures = {path for folder in folders for path in folder.iterdir() if path.suffix in (".svg", ".png")}
    assert {path.relative_to(ROOT).as_posix() for path in pictures} == shown
    assert [path.name for path in pictures if path.stat().st_size > LARGEST_PICTURE_BYTES] == []


def test_the_site_builds_without_a_warning(tmp_path: Path):
    if importlib.util.find_spec("material") is None:
        pytest.skip("mkdocs-material is not installed (extra `docs`)")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr
    site = tmp_path / "site"
    assert {path.stem for path in PAGES} <= {path.stem for path in site.glob("*.html")}


@pytest.mark.parametrize(
    "path", [*DOCUMENTS, *(ROOT / "reports" / "pictures").glob("*.svg")], ids=lambda path: path.name
)
def test_documents_name_no_place_on_a_machine_and_no_package_registry(path: Path):
    places = re.findall(r"(?<![\w.:/)])/(?:work|tmp|home|root|opt|usr|var|mnt|Users)/\S*", text(path))
    hosts = re.findall(r"pypi|pythonhosted|/simple/|index-url", text(path), re.IGNORECASE)
    assert (places, hosts) == ([], [])

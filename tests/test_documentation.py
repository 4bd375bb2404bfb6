"""README.md and ARCHITECTURE.md say what is there, and all that is there."""

from __future__ import annotations

import doctest
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from pydantic import BaseModel
from typer.testing import CliRunner

import ebamcheck
from ebamcheck.commands.main import app
from ebamcheck.errors import ExitCode
from ebamcheck.plugins import registry
from ebamcheck.settings.config import Config

ROOT = Path(__file__).parents[1]
README, ARCHITECTURE = ROOT / "README.md", ROOT / "ARCHITECTURE.md"
DOCUMENTS = [README, ARCHITECTURE, ROOT / "CHANGELOG.md"]
SOURCES = ("ebamcheck", "backends", "reference_models", "reports")

LARGEST_PICTURE_BYTES = 400_000
"""Pictures live in the repository for ever."""

UNITS = (
    "mm",
    "deg",
    "s",
    "mm_s",
    "mm_s2",
    "mm_s3",
    "kv",
    "ma",
    "mb",
    "mm2",
    "m3",
    "j_mm3",
    "px",
    "k",
    "w_mk",
    "j_kg",
    "j_kgk",
)
"""Last words of the names of settings that have a unit."""

WITHOUT_UNIT = {
    "direction",  # only its direction counts
    "bead_spacing",  # over the bead width
    "layer_over_bead",  # over the height of one bead
    "least_coverage",  # fraction of an area
    "mass_tolerance",  # of the metal of a part
    "outside_share",  # of the metal
    "inside_tolerance",  # of the height of a layer
    "edge_tolerance",  # of the height of a layer
    "gap_width",  # over the bead width
    "seed",
    "most_layers",  # counts
    "most_points",
    "most_islands",
    "stride",  # islands
    "conductivity_by_temperature",  # pairs of K and W/(m K)
    "heat_capacity_by_temperature",  # pairs of K and J/(kg K)
    "melt_mixing",  # factor of the conductivity
    "evidence_share",  # of the bead width, and of the layer height
    "travel_share",  # of another order's travel
    "annealing_steps",
    "ramp_power",  # share of the power
    "ramp_steps",
    "power_schedule",  # heights in mm and shares of the power
    "melting_efficiency",
    "dilution",
    "emissivity",
    "absorptivity",
    "decimals",
    "rays_per_call",
    "block_points",
    "processes",
    "bspline_shift",
    "curvature_share",  # of the acceleration
    "dip_share",  # of the feed
}

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


def mapped_modules() -> set[str]:
    """Modules that the map names: a heading with the folder, one list item a module."""
    found = set()
    folder = ""
    for line in text(ARCHITECTURE).splitlines():
        if heading := re.match(r"#+ ", line):
            named = re.match(r"### `([\w/]+)/`", line)
            folder = named[1] if named else ""
            assert heading
        elif folder and (item := re.match(r"- `(\w+\.py)`: \S", line)):
            found.add(f"{folder}/{item[1]}")
    return found


def modules() -> set[str]:
    """Modules in the tree; what a package is, its heading says."""
    return {
        path.relative_to(ROOT).as_posix()
        for source in SOURCES
        for path in (ROOT / source).rglob("*.py")
        if path.name != "__init__.py"
    }


def test_every_module_is_on_the_map():
    assert not modules() - mapped_modules(), "add them to the map of rooms in ARCHITECTURE.md"


def test_the_map_names_no_module_that_is_gone():
    assert not mapped_modules() - modules(), "take them off the map of rooms in ARCHITECTURE.md"


def test_every_package_has_a_heading():
    packages = {
        path.parent.relative_to(ROOT).as_posix() for s in SOURCES for path in (ROOT / s).rglob("*.py")
    }
    headings = set(re.findall(r"^### `([\w/]+)/`", text(ARCHITECTURE), re.MULTILINE))
    assert packages == headings


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_that_are_named_exist(document: Path):
    named = re.findall(rf"`((?:{'|'.join(SOURCES)}|tests)/[\w/.-]+\.\w+)`?", text(document))
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_constants_of_the_tolerance_table_exist():
    sources = "\n".join(text(path) for path in (ROOT / "ebamcheck").rglob("*.py"))
    named = re.findall(r"^\| `([A-Z_]+)`", text(ARCHITECTURE), re.MULTILINE)
    assert named
    assert [name for name in named if not re.search(rf"^{name} = ", sources, re.MULTILINE)] == []


# -- settings ----------------------------------------------------------------------------------------


def test_every_setting_says_what_it_is():
    silent = [
        f"{where}.{name}" for where, name, section in settings() if not section.model_fields[name].description
    ]
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


def test_settings_that_documents_name_exist():
    known = {f"{where}.{name}" for where, name, _ in settings()}
    sections = "|".join(Config.model_fields)
    for document in DOCUMENTS:
        named = set(re.findall(rf"`((?:{sections})\.(?!py`|csv`|parquet`|json`)\w+)`", text(document)))
        assert named <= known


# -- entry points, commands, exit codes ---------------------------------------------------------------


def test_every_entry_point_group_is_documented():
    project = tomllib.loads(text(ROOT / "pyproject.toml"))["project"]
    asked_for = {
        group
        for path in (ROOT / "ebamcheck").rglob("*.py")
        for group in re.findall(
            r'"(ebamcheck\.(?:backends|models|controls|reports|commands|orders))"', text(path)
        )
    }
    groups = set(project["entry-points"]) | asked_for
    assert len(groups) >= 5
    for document in (README, ARCHITECTURE):
        assert {g for g in groups if f"`{g}`" not in text(document)} == set(), document.name


def test_every_command_is_documented():
    assert {name for name in COMMANDS if f"`ebamcheck {name}" not in text(README)} == set()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_and_options_of_the_documents_exist(document: Path):
    for name, arguments, rest in re.findall(
        r"^(?:\$ )?ebamcheck ([a-z]+)([^\n`]*)(.*)", code(document), re.MULTILINE
    ):
        assert name in COMMANDS, f"{document.name} names a command that is not there: ebamcheck {name}"
        known = {option for parameter in COMMANDS[name].params for option in parameter.opts}
        used = set(re.findall(r"(?<![\w-])(--[a-z-]+)", arguments + rest)) - {"--help"}
        assert used <= known, name


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_explains_itself(name: str):
    shown = CliRunner().invoke(app, [name, "--help"])
    assert shown.exit_code == 0
    assert "Usage:" in shown.output


def test_exit_codes_are_those_of_the_table():
    table = re.findall(r"^\| (\d+) \| \S", text(README), re.MULTILINE)
    assert sorted(int(code) for code in table) == sorted(ExitCode)


def test_make_targets_that_are_named_exist():
    targets = set(re.findall(r"^([a-z-]+):", text(ROOT / "Makefile"), re.MULTILINE))
    for document in DOCUMENTS:
        assert set(re.findall(r"(?:`|^)make ([a-z-]+)", text(document), re.MULTILINE)) <= targets


# -- the README's Python ------------------------------------------------------------------------------


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from ebamcheck_models import BLADE, write_stl

    tolerance = re.search(r"ebamcheck_models blade --tolerance (\S+) -o blade\.stl", text(README))
    assert tolerance
    write_stl(BLADE.tessellate(float(tolerance[1])), tmp_path / "blade.stl")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", text(README), re.DOTALL)
    lines = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, "README.md", str(README), 0)
    assert len(lines.examples) > 5
    said: list[str] = []
    failed = doctest.DocTestRunner().run(lines, out=said.append).failed
    assert not failed, "".join(said)


def test_the_version_has_an_entry_in_the_changelog():
    assert f"## [{ebamcheck.__version__}]" in text(ROOT / "CHANGELOG.md")


# -- links, pictures, machines ------------------------------------------------------------------------


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_and_pictures_are_there(document: Path):
    links = re.findall(r"\]\(([^)#\s]+)", text(document))
    local = [link for link in links if not link.startswith("https://")]
    assert [link for link in local if not (ROOT / link).is_file()] == []


def test_every_picture_is_small_and_shown():
    folders = [ROOT / "reports" / name for name in ("pictures", "benchmarks")]
    shown = set(re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text(README)))
    pictures = {path for folder in folders for path in folder.iterdir() if path.suffix in (".svg", ".png")}
    assert {path.relative_to(ROOT).as_posix() for path in pictures} == shown
    assert [path.name for path in pictures if path.stat().st_size > LARGEST_PICTURE_BYTES] == []


def spoken() -> list[Path]:
    return [*DOCUMENTS, *(ROOT / "reports" / "pictures").glob("*.svg")]


@pytest.mark.parametrize("path", spoken(), ids=lambda path: path.name)
def test_documents_name_no_place_on_a_machine_and_no_package_registry(path: Path):
    places = re.findall(r"(?<![\w.:/)])/(?:work|tmp|home|root|opt|usr|var|mnt|Users)/\S*", text(path))
    hosts = re.findall(r"pypi|pythonhosted|/simple/|index-url", text(path), re.IGNORECASE)
    assert (places, hosts) == ([], [])

"""What a wheel holds: the packages by their prefixed names, all of their files, entry points that load."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from configparser import ConfigParser
from email import message_from_string
from email.message import Message
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PACKAGES = {
    "ebamcheck": "ebamcheck",
    "ebamcheck_planecut": "backends/ebamcheck_planecut",
    "ebamcheck_slic3r": "backends/ebamcheck_slic3r",
    "ebamcheck_cura": "backends/ebamcheck_cura",
    "ebamcheck_prusa": "backends/ebamcheck_prusa",
    "ebamcheck_trimesh": "backends/ebamcheck_trimesh",
    "ebamcheck_stencil": "backends/ebamcheck_stencil",
    "ebamcheck_embree": "backends/ebamcheck_embree",
    "ebamcheck_manifold": "backends/ebamcheck_manifold",
    "ebamcheck_models": "reference_models/ebamcheck_models",
    "ebamcheck_reports": "reports/ebamcheck_reports",
    "ebamcheck_viewer": "reports/viewer/ebamcheck_viewer",
}
"""Names that an installation puts into site-packages, and where they come from."""

GROUPS = {
    "console_scripts",
    "ebamcheck.backends",
    "ebamcheck.commands",
    "ebamcheck.models",
    "ebamcheck.controls",
    "ebamcheck.materials",
    "ebamcheck.orders",
    "ebamcheck.reports",
}

LOAD_ALL = """
import sys
from importlib.metadata import distributions
(found,) = [d for d in distributions(path=[sys.argv[1]]) if d.name == "ebamcheck"]
for point in found.entry_points:
    point.load()
    print(point.group, point.name, sys.modules[point.module].__file__, sep="\t")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def names(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as archive:
        return [name for name in archive.namelist() if not name.endswith("/")]


def read(wheel: Path, ending: str) -> str:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(f".dist-info/{ending}")]
        return archive.read(name).decode("utf-8")


def metadata(wheel: Path) -> Message:
    return message_from_string(read(wheel, "METADATA"))


def test_top_level_names_are_the_packages_and_nothing_else(names: list[str]):
    top = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert top == set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_file_of_a_package_is_in_the_wheel(package: str, names: list[str]):
    source = ROOT / PACKAGES[package]
    files = {
        f"{package}/{path.relative_to(source).as_posix()}"
        for path in source.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert f"{package}/__init__.py" in files
    assert {name for name in names if name.startswith(f"{package}/")} == files


def test_type_checkers_see_the_types(names: list[str]):
    assert "ebamcheck/py.typed" in names


def test_licence_and_metadata(wheel: Path, names: list[str]):
    found = metadata(wheel)
    assert found["Requires-Python"] == ">=3.11"
    assert found["License-Expression"] == "Apache-2.0"
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    assert read(wheel, "licenses/LICENSE") == (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert (ROOT / "README.md").read_text(encoding="utf-8").strip() in found.get_payload()  # type: ignore[operator]


def test_the_version_is_that_of_the_code(wheel: Path):
    import ebamcheck

    assert metadata(wheel)["Version"] == ebamcheck.__version__


def test_test_tools_are_an_extra(wheel: Path):
    needed = metadata(wheel).get_all("Requires-Dist", [])
    tools = [line for line in needed if line.startswith(("pytest", "mypy", "ruff", "hypothesis", "build"))]
    assert tools
    assert all("extra == 'test'" in line for line in tools)


@pytest.mark.slow
def test_every_entry_point_loads_from_the_wheel_alone(wheel: Path, tmp_path: Path):
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    # Before the checkout that an editable installation puts on the path.
    there = {**os.environ, "PYTHONPATH": str(site)}
    ran = subprocess.run(
        [sys.executable, "-c", LOAD_ALL, str(site)],
        env=there,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    loaded = [line.split("\t") for line in ran.stdout.splitlines()]
    assert {group for group, _, _ in loaded} == GROUPS
    assert all(Path(file).is_relative_to(site) for _, _, file in loaded)
    declared = ConfigParser(delimiters=("=",))
    declared.optionxform = str  # type: ignore[assignment, method-assign]
    declared.read_string(read(wheel, "entry_points.txt"))
    assert len(loaded) == sum(len(declared[group]) for group in declared.sections())


def test_groups_are_those_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"console_scripts", *project["entry-points"]} == GROUPS


def test_setup_asks_the_code_what_it_can_answer():
    setup = (ROOT / ".ci" / "setup").read_text()
    asked = re.findall(r"/bin/python\" -c '([^']+)'", setup)
    assert asked
    for code in asked:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert (done.returncode in (0, 1), done.stderr) == (True, ""), code


@pytest.mark.parametrize(
    ("target", "extras"), [("demo", []), ("setup", ["test", "docs"]), ("docs", ["test", "docs"])]
)
def test_a_target_installs_the_extras_that_it_needs(target, extras):
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))
    }
    done = subprocess.run(
        ["make", "-n", "-B", target], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    asked = re.findall(r"^\.ci/setup \.venv ?(\S*)$", done.stdout, re.MULTILINE)
    assert asked == [",".join(extras)]
    optional = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(extras) <= set(optional)

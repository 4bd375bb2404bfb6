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
from pathlib import Path

import pytest

import ebamcheck

ROOT = Path(__file__).parents[1]

# Names that an installation puts into site-packages, and where they come from
PACKAGES = {
    "ebamcheck": ROOT / "ebamcheck",
    **{path.name: path for room in ("backends", "reference_models", "reports", "reports/viewer") for path in (ROOT / room).glob("ebamcheck_*")},
}  # fmt: skip

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


def test_the_wheel_holds_the_packages_all_of_their_files_and_nothing_else(names: list[str]):
    files = {
        f"{package}/{path.relative_to(source).as_posix()}"
        for package, source in PACKAGES.items()
        for path in source.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert len(PACKAGES) == 12
    assert {f"{package}/__init__.py" for package in PACKAGES} | {"ebamcheck/py.typed"} <= files
    assert {name for name in names if ".dist-info/" not in name} == files


def test_licence_version_and_metadata(wheel: Path):
    found = message_from_string(read(wheel, "METADATA"))
    assert found["Requires-Python"] == ">=3.11"
    assert found["License-Expression"] == "Apache-2.0"
    assert found["Version"] == ebamcheck.__version__
    assert read(wheel, "licenses/LICENSE") == (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert (ROOT / "README.md").read_text(encoding="utf-8").strip() in str(found.get_payload())
    needed = found.get_all("Requires-Dist", [])
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
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {group for group, _, _ in loaded} == {"console_scripts", *project["entry-points"]}
    assert all(Path(file).is_relative_to(site) for _, _, file in loaded)
    declared = ConfigParser(delimiters=("=",))
    declared.optionxform = str  # type: ignore[assignment, method-assign]
    declared.read_string(read(wheel, "entry_points.txt"))
    assert len(loaded) == sum(len(declared[group]) for group in declared.sections())


def test_setup_asks_the_code_what_it_can_answer():
    setup = (ROOT / ".ci" / "setup").read_text()
    asked = re.findall(r"/bin/python\" -c '([^']+)'", setup)
    assert asked
    for code in asked:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert (done.returncode in (0, 1), done.stderr) == (True, ""), code


@pytest.mark.parametrize(("target", "extras"), [("demo", []), ("setup", ["test", "docs"]), ("docs", ["test", "docs"])])
def test_a_target_installs_the_extras_that_it_needs(target, extras):
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    done = subprocess.run(
        ["make", "-n", "-B", target], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    asked = re.findall(r"^\.ci/setup \.venv ?(\S*)$", done.stdout, re.MULTILINE)
    assert asked == [",".join(extras)]
    optional = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(extras) <= set(optional)

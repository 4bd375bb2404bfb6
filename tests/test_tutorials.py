"""The tutorials: the commands of a page run in its order, with the settings and plates that the page shows."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from ebamcheck_models import CUBE, write_stl

DOCS = Path(__file__).parents[1] / "docs"


def blocks(page: str, language: str = "") -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(page: str) -> list[str]:
    """Lines of the shell blocks: those that stand alone between fences without a language."""
    every = re.findall(r"^```(\w*)\n(.*?)^```", (DOCS / page).read_text("utf-8"), re.DOTALL | re.MULTILINE)
    return [line for language, block in every if not language for line in block.splitlines()]


def run(line: str, folder: Path) -> None:
    words = shlex.split(line)
    words = words[2:] if words[:2] == ["python", "-m"] else words
    ended = subprocess.run(
        [sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, f"{line}\n{ended.stdout}{ended.stderr}"


@pytest.mark.slow
def test_first_own_part(tmp_path: Path):
    (plate,) = blocks("first-own-part.md", "toml")
    (tmp_path / "plate.toml").write_text(plate)
    lines = commands("first-own-part.md")
    assert len(lines) == 7
    for line in [*lines, "ebamcheck preflight --plate plate.toml"]:
        run(line, tmp_path)


def test_the_profile_of_your_machine_can_work(tmp_path: Path):
    profile = blocks("your-machine.md", "toml")[0]
    write_stl(CUBE.tessellate(0.1), tmp_path / "part.stl")
    (tmp_path / "ebamcheck.toml").write_text(profile)
    run("ebamcheck preflight part.stl -c ebamcheck.toml --place 300,0", tmp_path)


@pytest.mark.slow
def test_in_ci(tmp_path: Path):
    write_stl(CUBE.tessellate(0.1), tmp_path / "part.stl")
    (tmp_path / "cell3.toml").write_text("[slicing]\nbackends = ['planecut', 'manifold']\n")
    # Kernels and baselines are what all other tests are about, and an image takes an engine and a network.
    others = ("ebamcheck warm", "ebamcheck regress", "podman")
    lines = [line for line in commands("in-ci.md") if not line.startswith(others)]
    assert len(lines) == 5
    for line in lines:
        run(line, tmp_path)

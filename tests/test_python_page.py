"""docs/python.md: every block of the page that walks through the Python interface runs, and shows what the page says."""

from __future__ import annotations

import doctest
import re
from importlib.util import find_spec
from pathlib import Path

import pytest

import ebamcheck
from ebamcheck_models import CUBE

PAGE = Path(__file__).parents[1] / "docs" / "python.md"

NEEDS = {"pyplot": "matplotlib", "plot(": "matplotlib"}
"""What in a block asks for a package that is an extra."""


def blocks() -> list[str]:
    return re.findall(r"^```pycon\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def absent(block: str) -> set[str]:
    return {package for word, package in NEEDS.items() if word in block and find_spec(package) is None}


def test_every_block_of_the_page_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    ebamcheck.save(CUBE.tessellate(0.1), "bracket.stl")
    found = blocks()
    assert len(found) > 10
    names: dict[str, object] = {}
    runner = doctest.DocTestRunner()
    for number, block in enumerate(found):
        if not absent(block):
            test = doctest.DocTestParser().get_doctest(block, names, f"block {number}", str(PAGE), None)
            runner.run(test, clear_globs=False)
            names.update(test.globs)
    assert runner.summarize(verbose=False).failed == 0, capsys.readouterr().out


def test_the_page_names_every_public_name() -> None:
    text = PAGE.read_text(encoding="utf-8")
    named = set(re.findall(r"ebamcheck\.(\w+)", text))
    wanted = {
        "Config",
        "EbamcheckError",
        "Run",
        "Slicing",
        "check",
        "compare",
        "fit",
        "inspect",
        "layer_heights",
        "load",
    }
    assert wanted | {"load_config", "run", "save", "slice"} <= named & set(ebamcheck.__all__)


@pytest.mark.parametrize("package", sorted(set(NEEDS.values())))
def test_blocks_that_need_an_extra_were_run(package: str) -> None:
    pytest.importorskip(package, reason=f"{package} is an extra and is not installed")
    assert [block for block in blocks() if package in absent(block)] == []

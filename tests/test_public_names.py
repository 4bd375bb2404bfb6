"""Every public name says what it takes, what it gives and what it raises, and shows it in an example, which `make test` runs."""

from __future__ import annotations

import doctest
import inspect
import itertools
from collections.abc import Iterator
from typing import Any

import pytest

import ebamcheck
import ebamcheck.testing
from ebamcheck.backend import Slicer
from ebamcheck.nc.control import Control
from ebamcheck.plugins.registry import Model
from ebamcheck.result import Check

PROTOCOLS = (Slicer, Model, Control, Check)
"""What strangers write classes and values of."""


def public() -> Iterator[tuple[str, Any]]:
    for module in (ebamcheck, ebamcheck.testing):
        for name in module.__all__:
            found = getattr(module, name)
            if callable(found):
                yield name, found


PUBLIC = dict(public())


def headings(found: Any) -> set[str]:
    """Sections of a docstring in the style of numpy."""
    lines = (inspect.getdoc(found) or "").splitlines()
    return {line for line, under in itertools.pairwise(lines) if under and under == "-" * len(line)}


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_a_public_name_says_what_it_takes_and_gives(name):
    found = PUBLIC[name]
    told = headings(found)
    assert told & {"Parameters", "Attributes"}, f"{name}: no Parameters"
    if inspect.isfunction(found):
        assert "Returns" in told, f"{name}: no Returns"
        parameters = [
            n for n, p in inspect.signature(found).parameters.items() if p.kind is not p.VAR_KEYWORD
        ]
        text = (inspect.getdoc(found) or "").partition("Parameters\n")[2].partition("\n\n")[0]
        heads = {
            n.strip(" *") for line in text.splitlines() if not line.startswith(" ") for n in line.split(",")
        }
        assert set(parameters) <= heads, f"{name}: {sorted(set(parameters) - heads)} are not explained"


@pytest.mark.parametrize(
    "found",
    [*PUBLIC.values(), *PROTOCOLS],
    ids=lambda found: f"{found.__module__}.{found.__name__}",
)
def test_a_public_name_shows_an_example(found):
    assert doctest.DocTestParser().get_examples(inspect.getdoc(found) or ""), f"{found}: no example"


def test_what_raises_says_so():
    """Functions that raise by themselves name it under Raises."""
    silent = []
    for name, found in PUBLIC.items():
        if (
            inspect.isfunction(found)
            and "raise " in inspect.getsource(found)
            and "Raises" not in headings(found)
        ):
            silent.append(name)
    assert silent == []

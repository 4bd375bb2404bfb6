"""The outside slicers, and what stands for a program where none is installed."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from ebamcheck.slicers.outside.lattices import Program
from ebamcheck_cura import Cura
from ebamcheck_prusa import Prusa
from ebamcheck_slic3r import Slic3r
from ebamcheck_trimesh import TrimeshSections

WITNESSES: list[Any] = [Slic3r(), Cura(), Prusa(), TrimeshSections()]
PROGRAMS: list[Any] = WITNESSES[:3]
INTERPRETER = Program(
    "Python", sys.executable, "NO_SUCH_VARIABLE", "python3", ("--version",), r"Python (\S+)"
)


def available(witness: Any) -> None:
    """Skip the test where this machine cannot run a witness."""
    probe = witness.probe()
    if not probe.available:
        pytest.skip(f"{witness.name} is not available: {probe.why}; {probe.hint}")


def named(witness: Any) -> str:
    return str(witness.name)

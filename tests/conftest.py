"""Fixtures of the whole suite."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# A run of the suite repeats the one before it; `--hypothesis-profile=search` looks for new examples.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search")
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def corpus() -> Path:
    """Folder of the mesh corpus; tests that need it skip where there is none."""
    folder = os.environ.get("EBAMCHECK_CORPUS", "")
    if not folder:
        pytest.skip("EBAMCHECK_CORPUS names no folder: the mesh corpus is not part of the project")
    return Path(folder)

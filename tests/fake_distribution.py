"""Distributions as a stranger would install them: a module, its metadata and its entry points, found by every process."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from ebamcheck.plugins import registry


def install(
    folder: Path,
    name: str,
    points: Mapping[str, Mapping[str, str]],
    modules: Mapping[str, str] | None = None,
    version: str = "1",
) -> Path:
    """Write a distribution into a folder: entry points by group and name, and modules by name."""
    for module, text in (modules or {}).items():
        (folder / f"{module}.py").write_text(text, encoding="utf-8")
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in found.items())
        for group, found in points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))
    return folder


def environment(folder: Path, *more: str) -> dict[str, str]:
    """Variables under which a process finds what is installed in a folder, and keeps what it learns of it there."""
    found = [str(folder), *more, os.environ.get("PYTHONPATH", "")]
    return {
        "PYTHONPATH": os.pathsep.join(path for path in found if path),
        "XDG_CACHE_HOME": str(folder / "cache"),
    }


def found_here(folder: Path, patch: pytest.MonkeyPatch, *more: str) -> None:
    """Have this process and those that it starts find what is installed in a folder."""
    for name, value in environment(folder, *more).items():
        patch.setenv(name, value)
    patch.syspath_prepend(str(folder))
    registry.forget()

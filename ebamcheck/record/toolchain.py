"""What a run was made with: source, dependencies, interpreter, system and drawing library, as a certificate tells it."""

from __future__ import annotations

import functools
import hashlib
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import ebamcheck.version

GIT_TIMEOUT_S = 10.0
"""A checkout that git cannot look through in this time has an unknown state."""

UNKNOWN = "unknown"

_NAME = re.compile(r"[A-Za-z0-9._-]+")


def software(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Identity of everything that took part in a run whose record is `manifest`.

    Returns
    -------
    dict
        ``ebamcheck`` (version), ``source`` (``commit``, ``dirty``: "yes", "no" or "unknown", and ``sha256`` of the
        package's files), ``python``, ``system``, ``dependencies`` (every distribution that is required, directly or
        not, with its version) and ``backends`` (device and versions that each of them told).
    """
    return {
        "ebamcheck": manifest["ebamcheck"],
        "source": source_state(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.platform()}, {' '.join(platform.libc_ver())}".rstrip(", "),
        "dependencies": dict(dependencies()),
        "backends": {
            name: {"device": found["device"], "versions": found["versions"]}
            for name, found in manifest["backends"].items()
        },
    }


@functools.cache
def source_state() -> dict[str, str]:
    """Commit of the checkout that this package is run from, whether it differs from it, and the hash of its files.

    An installed package has no commit; its files have a hash all the same.
    """
    root = Path(ebamcheck.__file__).resolve().parent.parent
    return {"commit": commit(), "dirty": _dirty(root), "sha256": source_sha256()}


@functools.cache
def source_sha256() -> str:
    """SHA-256 over names and contents of the package's Python files, in the order of their names."""
    folder = Path(ebamcheck.__file__).resolve().parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        data = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(data)}\0".encode())
        digest.update(data)
    return digest.hexdigest()


def commit() -> str:
    """Commit of the checkout that this package is run from; empty for an installed one."""
    found = _git(Path(ebamcheck.__file__).resolve().parent.parent, "rev-parse", "HEAD")
    return (found or "").strip()


@functools.cache
def dependencies() -> Mapping[str, str]:
    """Version of every distribution that ebamcheck requires, and that these require in turn, by name."""
    found: dict[str, str] = {}
    waiting = ["ebamcheck"]
    while waiting:
        name = waiting.pop()
        try:
            distribution = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        key = distribution.metadata["Name"].lower().replace("_", "-")
        if key in found:
            continue
        found[key] = distribution.version
        waiting += [_required(line) for line in distribution.requires or () if "extra ==" not in line]
    found.pop("ebamcheck", None)
    return dict(sorted(found.items()))


def _required(line: str) -> str:
    """Name of the distribution that a line of requirements asks for."""
    name = _NAME.match(line)
    return name[0] if name else ""


def _dirty(root: Path) -> str:
    """Whether files under version control differ from the commit, or there are new ones among the sources."""
    found = _git(root, "status", "--porcelain", "--", "ebamcheck", "backends", "reports", "pyproject.toml")
    return UNKNOWN if found is None else "yes" if found.strip() else "no"


def _git(root: Path, *arguments: str) -> str | None:
    """Output of git in a checkout; None where there is no checkout, no git, or no answer."""
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    try:
        done = subprocess.run(
            [git, "-C", str(root), *arguments],
            capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout

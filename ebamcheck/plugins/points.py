"""Entry points by origin: the house's own, those of others, and which of two with one name counts."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

from ebamcheck.installed import name_and_version

HOUSE = "ebamcheck"
"""The distribution whose plugins are imported in this process; every other one's are a stranger's."""

CODE_SUFFIXES = (".py", ".so", ".pyd", ".pth")
"""Files whose change makes what is known of a plugin stale."""

MOST_FILES = 5000
"""Files of a plugin that are looked at; of a larger one nothing is kept."""


@dataclass(frozen=True)
class BrokenPlugin:
    """A plugin that was left out, and why."""

    group: str
    name: str
    value: str
    distribution: str
    why: str

    def __str__(self) -> str:
        """One line for a warning."""
        whose = f"{self.value}, of {self.distribution}" if self.distribution else self.value
        return f"plugin {self.name!r} of {self.group} ({whose}) was left out: {self.why}"


def distribution_of(point: EntryPoint) -> tuple[str, str]:
    """Name and version of the distribution that a plugin comes with; empty where they cannot be read."""
    dist = getattr(point, "dist", None)
    return ("", "") if dist is None else name_and_version(dist)


def is_house(point: EntryPoint) -> bool:
    """Whether a plugin is shipped in this distribution."""
    return distribution_of(point)[0].lower().replace("_", "-") == HOUSE


def broken(point: EntryPoint, why: str) -> BrokenPlugin:
    """A plugin that was left out."""
    name, version = distribution_of(point)
    return BrokenPlugin(point.group, point.name, point.value, f"{name} {version}".strip(), why)


def sorted_out(points: Iterable[EntryPoint]) -> tuple[dict[str, EntryPoint], list[BrokenPlugin]]:
    """One plugin a name, by name; and those that bear the name of another one.

    The house's own comes first, whatever is installed; of strangers the one whose distribution comes first by name.
    """
    ranked = sorted(
        ((not is_house(p), distribution_of(p), str(p.value), str(p.name), i, p) for i, p in enumerate(points))
    )
    found: dict[str, EntryPoint] = {}
    left_out = []
    for *_, point in ranked:
        first = found.setdefault(point.name, point)
        if first is not point:
            owner = distribution_of(first)[0] or "another plugin"
            left_out.append(broken(point, f"its name is that of a plugin of {owner}"))
    return dict(sorted(found.items())), left_out


def code_stamp(point: EntryPoint) -> str:
    """Hash of names, sizes and times of the files of a plugin's package; nothing is imported.

    Empty where they cannot be told: what is known of such a plugin is not kept.
    """
    top = str(point.value).split(":")[0].split(".")[0].strip()
    try:
        spec = importlib.util.find_spec(top)
    except Exception:  # finders of others may raise anything
        return ""
    if spec is None:
        return "none"
    files: list[Path] = []
    if spec.origin and Path(spec.origin).is_file():
        files.append(Path(spec.origin))
    for folder in spec.submodule_search_locations or ():
        for file in Path(folder).rglob("*"):
            if file.suffix in CODE_SUFFIXES:
                files.append(file)
            if len(files) > MOST_FILES:
                return ""
    lines = []
    for file in sorted(set(files)):
        with suppress(OSError):
            status = file.stat()
            lines.append(f"{file} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest() if lines else ""

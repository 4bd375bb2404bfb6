"""A build checked after the fact: its journal, the files that it published, and each layer from its text, part and settings alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ebamcheck.errors import EbamcheckError, InputError
from ebamcheck.json_values import json_text, sha256_of_file
from ebamcheck.live.journal import read_journal
from ebamcheck.live.publishing import CERTIFICATE, JOURNAL, LAYERS, PROGRAM, SETTINGS, write_synced
from ebamcheck.pipeline.verify import verify
from ebamcheck.settings.config import load_config

VERIFIED = "verified.json"
"""What was found, in the folder of the build."""

FEWEST_CHECKS = 40
"""A program that was read at all has more checks than these."""


@dataclass(frozen=True)
class VerifiedLayer:
    """One published layer: its name, checks made, and what is wrong, in words; empty where nothing is."""

    name: str
    checks: int
    why: str
    files: dict[str, str]

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.why


def is_build(folder: Path) -> bool:
    """Whether a folder is that of a build."""
    return (folder / JOURNAL).is_file()


def holds_layers(folder: Path) -> bool:
    """Whether a folder is that of a build, or holds layers that `ebamcheck relayer` made, each by itself."""
    return is_build(folder) or any((folder / LAYERS).glob(f"*/{CERTIFICATE}"))


def published(folder: Path) -> list[dict[str, Any]]:
    """Entries of the journal of the layers that were published, in order; the journal is checked line by line.

    Where there is no build, the certificates of the layers, by name: they have the hashes of the files, too.
    """
    if not is_build(folder):
        return [_certified(path) for path in sorted((folder / LAYERS).glob(f"*/{CERTIFICATE}"))]
    return [entry for entry in read_journal(folder / JOURNAL) if entry.get("kind") == "layer"]


def _certified(path: Path) -> dict[str, Any]:
    """Name and hashes of a layer, of its certificate; the name is that of its folder."""
    try:
        files = json.loads(path.read_text(encoding="utf-8"))["files"]
        return {"name": path.parent.name, "files": {str(name): str(sha256) for name, sha256 in files.items()}}
    except (ValueError, TypeError, KeyError, AttributeError):
        raise InputError(f"{path}: is no certificate of a layer") from None


def verify_build(
    folder: Path, part: Path, told: Callable[[VerifiedLayer], None] = lambda layer: None
) -> list[VerifiedLayer]:
    """Verify every published layer of a build, and write down what was found.

    Raises
    ------
    InputError
        If the journal is damaged, or the part cannot be read.
    """
    if not part.is_file():
        raise InputError(f"{part}: cannot be read: there is no such file")
    found = []
    for entry in published(folder):
        found.append(_verified(folder, entry, part))
        told(found[-1])
    write_synced(folder / VERIFIED, json_text([asdict(layer) for layer in found]))
    return found


def _verified(folder: Path, entry: dict[str, Any], part: Path) -> VerifiedLayer:
    name, files = str(entry["name"]), dict(entry["files"])
    told_by = "the journal" if is_build(folder) else f"its {CERTIFICATE}"
    place = folder / LAYERS / name
    for file, sha256 in files.items():
        path = place / PROGRAM / file
        if not path.is_file() or sha256_of_file(path) != sha256:
            return VerifiedLayer(name, 0, f"{path}: is not the file that {told_by} names", files)
    try:
        checks = verify(place / PROGRAM, part, load_config(place / SETTINGS))
    except EbamcheckError as error:
        return VerifiedLayer(name, 0, str(error), files)
    wrong = [check.in_words() for check in checks if not check.passed]
    if len(checks) < FEWEST_CHECKS and not wrong:
        wrong = [f"{len(checks)} checks alone could be made"]
    return VerifiedLayer(name, len(checks), "; ".join(wrong), files)


def read_verified(folder: Path) -> dict[str, VerifiedLayer]:
    """What was found before, by name, of layers whose files are still those; nothing where nobody has verified."""
    try:
        rows = json.loads((folder / VERIFIED).read_text(encoding="utf-8"))
        found = {str(row["name"]): VerifiedLayer(**row) for row in rows}
    except FileNotFoundError:
        return {}
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{folder / VERIFIED}: is not what `ebamcheck verify` writes") from None
    return found

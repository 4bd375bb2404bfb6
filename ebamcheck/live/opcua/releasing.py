"""What is brought to a control to release a layer: its file, the values of the handshake, and the keys that nobody else has."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import replacing
from ebamcheck.controls.sinumerik.release_keys import PRIME, Release, ReleaseKeys, drawn_key
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.live.opcua.handshake import digest, program_number

KEY_FILE = "release.key"
"""In the folder of a build: the key from which those of all its layers follow; its owner alone may read it."""


def keys_of(folder: Path) -> ReleaseKeys:
    """Keys of a build; drawn when it is first led on a control.

    Raises
    ------
    InputError
        If the file of the key holds none.
    """
    path = folder / KEY_FILE
    if not path.is_file():
        with replacing(path) as temporary:
            temporary.touch()
            temporary.chmod(0o600)
            with temporary.open("w", encoding="utf-8") as file:
                file.write(f"{drawn_key()}\n")
                file.flush()
                os.fsync(file.fileno())
    text = path.read_text(encoding="utf-8", errors="replace").strip()
    if not (text.isascii() and text.isdigit() and 1 < int(text) < PRIME):
        raise InputError(
            f"{path}: holds no key of a build: delete it, start the main program anew, and begin where it stopped"
        )
    return ReleaseKeys(int(text))


def proved_program(folder: Path, current: Mapping[str, Any], limit_mb: float) -> tuple[bytes, str]:
    """Text and name of the program that is published, as it was verified.

    Raises
    ------
    SettingsError
        If it was changed, or is larger than the control takes.
    """
    path = folder / str(current["program"])
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != current["sha256"]:
        raise SettingsError(f"{path}: is not the file that was verified: it is not released")
    if len(data) > 1e6 * limit_mb:
        raise SettingsError(
            f"{path}: has {len(data) / 1e6:.3f} MB, over opcua.file_limit_mb {limit_mb:g}: it is not released"
        )
    return data, path.name


def release_of(keys: ReleaseKeys, layer: int, current: Mapping[str, Any]) -> Release:
    """Values that release the layer that is published, `layer` from 1."""
    return keys.release(layer, program_number(str(current["name"])), round(float(current["wait_s"]), 3))


def written_before(release: Release) -> dict[str, float]:
    """Values that stand before the layer itself is released, by role."""
    return {
        "number": float(release.number),
        "wait": release.wait_s,
        "key": float(release.key),
        "seal": float(release.seal),
    }


def told_of(current: Mapping[str, Any]) -> dict[str, float | str]:
    """What is told of a layer beside what releases it, by role."""
    sha256 = str(current["sha256"])
    return {"digest": digest(sha256), "name": str(current["name"]), "sha256": sha256}

"""The handshake with a control: its nodes, what was seen in them, and what releases a layer: file, values and keys.

Of the R parameters from ``machine.live_r`` on, the first six, key and seal are the waiting main program's, the others of `live` and
who measures."""

from __future__ import annotations

import hashlib
import math
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import replacing
from ebamcheck.controls.sinumerik.release_keys import PRIME, Release, ReleaseKeys, drawn_key
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.settings.machine import ROLES, WARMTH_ROLES, MachineSettings, OpcuaSettings

# R parameter of each role, counted from `machine.live_r`; the fifth is the program's own
OFFSETS = dict(zip(ROLES, (0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12), strict=True))
BUILT = -1.0  # in ``released``: the part is built
KEY_FILE = "release.key"  # in the folder of a build: the key from which those of all its layers follow; its owner alone may read it


def node_ids(machine: MachineSettings, opcua: OpcuaSettings) -> dict[str, str]:
    """Node of every role.

    >>> node_ids(MachineSettings(), OpcuaSettings())["height"]
    'ns=2;s=/Channel/Parameter/R[u1,106]'
    """
    numbers = {role: str(machine.live_r + offset) for role, offset in OFFSETS.items()}
    return {role: opcua.r_node.replace("{r}", number) for role, number in numbers.items()} | opcua.nodes


def file_path(machine: MachineSettings, opcua: OpcuaSettings, name: str) -> str:
    """Place of a program on the control."""
    return f"{opcua.folder.replace('{directory}', machine.workpiece_directory)}/{name}"


@dataclass(frozen=True)
class Seen:
    """Values of the handshake as they were read at once; NaN for one that is no number, None for a height that the control does not
    give."""

    done: float
    released: float
    number: float
    wait: float
    waited: float
    height: float | None
    measured: float
    begin_at: float
    owner: float
    digest: float
    key: float
    seal: float
    map: str = ""
    surface_k: float = 0.0
    after_s: float = 0.0

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Seen:
        """Take values as they came."""
        name = values.get("map")
        numbers: dict[str, Any] = {role: _number(values.get(role)) for role in ROLES}
        numbers["height"] = None if values.get("height") is None else numbers["height"]
        warmth = {role: _number(values.get(role, 0.0)) for role in WARMTH_ROLES}
        return cls(**numbers, **warmth, map=name.strip() if isinstance(name, str) else "")

    @property
    def reading(self) -> str:
        """What was measured, to be compared: heights that are no numbers are alike, too."""
        return repr((self.done, self.measured, self.height, self.map))


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value)


class Waiting:
    """Whether the main program is seen to wait: its count of the time goes on; one that stands still is noticed after a time, s."""

    def __init__(self, noticed_s: float) -> None:
        self._noticed_s = noticed_s
        self.forget()

    def forget(self) -> None:
        """Begin to look anew."""
        self._waited, self._since = math.nan, -math.inf

    def notice(self, waited: float) -> None:
        """Take the count as it is now."""
        if not math.isnan(self._waited) and waited != self._waited and waited > 0.0:
            self._since = time.monotonic()
        self._waited = waited

    @property
    def now(self) -> bool:
        """Whether it waits."""
        return time.monotonic() - self._since <= self._noticed_s

    def after(self, moment_s: float) -> bool:
        """Whether it still waited when a moment of the clock, and the time to notice it, were over."""
        return self._since > moment_s + self._noticed_s


def keys_of(folder: Path) -> ReleaseKeys:
    """Keys of a build; drawn when it is first led on a control."""
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
        said = "holds no key of a build: delete it, start the main program anew, and begin where it stopped"
        raise InputError(f"{path}: {said}")
    return ReleaseKeys(int(text))


def proved_program(folder: Path, current: Mapping[str, Any], limit_mb: float) -> tuple[bytes, str]:
    """Text and name of the program that is published, as it was verified, and no larger than the control takes."""
    path = folder / str(current["program"])
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != current["sha256"]:
        raise SettingsError(f"{path}: is not the file that was verified: it is not released")
    if len(data) > 1e6 * limit_mb:
        size = f"{len(data) / 1e6:.3f} MB, over opcua.file_limit_mb {limit_mb:g}"
        raise SettingsError(f"{path}: has {size}: it is not released")
    return data, path.name


def release_of(keys: ReleaseKeys, layer: int, current: Mapping[str, Any]) -> Release:
    """Values that release the layer that is published, `layer` from 1; the number of its program ends its name."""
    name = str(current["name"])
    number = re.search(r"R(\d+)$", name)
    if number is None:
        raise InputError(f"the name {name!r} of a layer does not end with its number")
    return keys.release(layer, int(number[1]), round(float(current["wait_s"]), 3))


def written_before(release: Release) -> dict[str, float]:
    """Values that stand before the layer itself is released, by role."""
    values = {"number": release.number, "wait": release.wait_s, "key": release.key, "seal": release.seal}
    return {role: float(value) for role, value in values.items()}


def told_of(current: Mapping[str, Any]) -> dict[str, float | str]:
    """What is told of a layer beside what releases it, by role."""
    sha256 = str(current["sha256"])
    # As many digits of it as an R parameter holds without rounding.
    return {"digest": float(int(sha256[:12], 16)), "name": str(current["name"]), "sha256": sha256}

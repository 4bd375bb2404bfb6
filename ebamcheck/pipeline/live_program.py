"""The main program of a run that waits between layers, beside the whole one: written, and judged by what it does."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ebamcheck.errors import SettingsError
from ebamcheck.nc.control import control
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED
from ebamcheck.result import Check, check_record
from ebamcheck.settings.config import Config

FOLDER = "live"
"""Folder of the program within a run."""

NAME = "handshake"


def check_waits(config: Config) -> None:
    """Refuse a control for which no main program that waits is written."""
    name = config.machine.control
    if not control(name).waiting:
        raise SettingsError(
            f"--live: for machine.control {name!r} there is no main program that waits between layers"
        )


def write_live(
    run: Path, config: Config, top_mm: float, validated: bool, header: Mapping[str, str]
) -> dict[str, Any]:
    """Write the waiting main program into a run folder and judge its text; its record.

    It says validated where the whole program does and the check passes. Its layers are no part of it: each is released with a
    proof of its own.
    """
    own = control(config.machine.control)
    name, text = own.load("waiting")(config, top_mm, header)
    check: Check = own.load("handshake")(text, name, config, top_mm)
    if validated and check.passed:
        text = text.replace(NOT_VALIDATED, VALIDATED, 1)
    (run / FOLDER).mkdir(exist_ok=True)
    (run / FOLDER / name).write_text(text, encoding="ascii", newline="\n")
    sha256 = hashlib.sha256(text.encode("ascii")).hexdigest()
    return {
        "name": name,
        "sha256": sha256,
        "validated": validated and check.passed,
        "check": check_record(check),
    }


def live_checked_again(run: Path, record: Mapping[str, Any], config: Config, top_mm: float) -> list[Check]:
    """Judge the waiting main program of a run again, of a part whose top is to lie at a Z; nothing for a run without one."""
    live = record.get(FOLDER)
    if live is None:
        return []
    path = run / FOLDER / str(live["name"])
    try:
        text = path.read_bytes().decode("ascii")
    except (OSError, UnicodeDecodeError) as error:
        return [Check.fault(NAME, f"{FOLDER}/{live['name']}", f"cannot be read: {error}")]
    check: Check = control(config.machine.control).load("handshake")(text, path.name, config, top_mm)
    said = f"\n{VALIDATED}\n" in text
    if check.passed and said and not record["validated"]:
        text = "says validated, the whole program does not"
        check = Check.fault(NAME, f"{path.name}:1", text)
    return [check]

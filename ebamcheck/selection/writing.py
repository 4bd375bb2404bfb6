"""A machine's section of ``ebamcheck.toml``: written into the user's file, comments and order kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from ebamcheck import __version__
from ebamcheck.atomic_file import replacing
from ebamcheck.errors import SettingsError
from ebamcheck.json_values import plain
from ebamcheck.regular_file import regular_file
from ebamcheck.selection.trial import Choice, Trial

FIGURE_DIGITS = 4
"""Significant digits of the figures kept: provenance, not input."""


def write_choice(
    path: Path, machine: str, choice: Choice, trials: Sequence[Trial], circumstances: Mapping[str, Any]
) -> None:
    """Write ``[machines."NAME"]`` with primary, required and provenance, whole or not at all.

    Parameters
    ----------
    path
        Settings file, made where there is none; in a ``pyproject.toml`` the section goes under ``[tool.ebamcheck]``.
    machine
        Name of the machine; its section takes the place of a former one, all others stay.
    choice, trials
        What was chosen, and the figures behind it.
    circumstances
        Part, layers and tolerance of the trials.

    Raises
    ------
    SettingsError
        If the file is not TOML, holds something else at that key, or cannot be written.
    """
    document = _read(path)
    root: Any = document
    keys = ["tool", "ebamcheck"] if path.name == "pyproject.toml" else []
    for key in [*keys, "machines"]:
        root = _table(root, key, path, is_super=True)
    section = _table(root, machine, path)
    section["primary"] = choice.primary
    section["required"] = list(choice.required)
    section["provenance"] = provenance(choice, trials, circumstances)
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="")


def provenance(choice: Choice, trials: Sequence[Trial], circumstances: Mapping[str, Any]) -> dict[str, Any]:
    """What the choice rests on, without a date: circumstances, and figures and versions of every backend."""
    backends = {
        trial.name: {
            "reason": choice.reasons[trial.name],
            "device": trial.device,
            "versions": dict(trial.versions),
            **{
                name: float(f"{value:.{FIGURE_DIGITS}g}")
                for name, value in (
                    ("bound_mm", trial.bound_mm), ("measured_mm", trial.measured_mm), ("seconds", trial.seconds),
                )
                if value == value
            },
        }
        for trial in trials
    }  # fmt: skip
    made: dict[str, Any] = plain({"ebamcheck": __version__, **circumstances, "backends": backends})
    return made


def _read(path: Path) -> tomlkit.TOMLDocument:
    try:
        # Line ends as they are: the user's file stays theirs but for one section.
        return (
            tomlkit.parse(regular_file(path, SettingsError).read_bytes().decode("utf-8"))
            if path.exists()
            else tomlkit.document()
        )
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, TOMLKitError) as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None


def _table(parent: Any, key: str, path: Path, is_super: bool = False) -> Any:
    if key not in parent:
        parent[key] = tomlkit.table(is_super)
    found = parent[key]
    if not isinstance(found, Table | tomlkit.container.OutOfOrderTableProxy):
        raise SettingsError(
            f"{path}: {key!r} must be a table, as in [machines.NAME]: rename what stands there"
        )
    return found

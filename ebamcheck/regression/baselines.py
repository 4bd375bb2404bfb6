"""Baselines: the accuracy that was accepted, one JSON file a model.

An entry's key is backend and settings hash; machine, renderer and versions are told, and never compared.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError
from ebamcheck.json_values import plain, read_json
from ebamcheck.regression.measurement import MEASURED, REFUSED, Measured

FORMAT_VERSION = 1

STORED = (MEASURED, REFUSED)
"""What a baseline may hold: a refusal with its reason is an accepted answer, a crash never is."""

UpdateMode = Literal["failed", "all"]


@dataclass(frozen=True, order=True)
class Key:
    """What one figure belongs to."""

    model: str
    backend: str
    settings_hash: str

    def __str__(self) -> str:
        return f"{self.model} {self.backend} {self.settings_hash}"


@dataclass(frozen=True)
class Entry:
    """One backend's accuracy on one model under one choice of settings."""

    key: Key
    settings: Mapping[str, Any]
    """Settings that are not the defaults."""
    measured: Measured
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Mesh, machine, renderer and versions."""

    @property
    def title(self) -> str:
        """Model, backend and settings, for a reader."""
        given = ", ".join(f"{name}={value}" for name, value in self.settings.items())
        return f"{self.key.model} {self.key.backend}" + (f" ({given})" if given else "")

    def record(self) -> dict[str, Any]:
        """The entry as strict JSON holds it."""
        measured = self.measured
        return {
            "backend": self.key.backend,
            "settings": dict(self.settings),
            "status": measured.status,
            "why": measured.why,
            "metrics": dict(measured.metrics),
            "layers": {name: list(column) for name, column in measured.columns.items()},
            "metadata": dict(self.metadata),
        }


def read_baselines(folder: Path, models: Iterable[str]) -> dict[Key, Entry]:
    """Read the baselines of the models named; a model without a file has none.

    Raises
    ------
    InputError
        If a file is not what :func:`write_baselines` writes.
    """
    found: dict[Key, Entry] = {}
    for model in models:
        path = _file(folder, model)
        if path.is_file():
            found.update({entry.key: entry for entry in _read(path, model)})
    return found


def _read(path: Path, model: str) -> list[Entry]:
    try:
        values = read_json(path)
        if values["format"] != FORMAT_VERSION:
            raise InputError(
                f"{path}: has format {values['format']!r}, this version reads {FORMAT_VERSION}: "
                "write it anew with --update-baseline=all"
            )
        return [_entry(model, name, record) for name, record in values["entries"].items()]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: is no baseline ({type(error).__name__}: {error}): restore it") from None


def _entry(model: str, name: str, record: Mapping[str, Any]) -> Entry:
    backend, _, settings_hash = name.rpartition(" ")
    measured = Measured(record["status"], record["why"], record["metrics"], record["layers"])
    return Entry(Key(model, backend, settings_hash), record["settings"], measured, record["metadata"])


def write_baselines(folder: Path, entries: Iterable[Entry], models: Iterable[str]) -> list[Path]:
    """Write the files of the models named, each whole or not at all; one without entries goes.

    Returns
    -------
    list of Path
        Files that changed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    by_model: dict[str, list[Entry]] = {model: [] for model in models}
    for entry in sorted(entries, key=lambda e: e.key):
        if entry.key.model in by_model:
            by_model[entry.key.model].append(entry)
    changed = []
    for model, held in by_model.items():
        path = _file(folder, model)
        text = _text(model, held)
        if not held:
            if path.is_file():
                path.unlink()
                changed.append(path)
        elif not path.is_file() or path.read_text(encoding="utf-8") != text:
            with replacing(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
            changed.append(path)
    return changed


def _file(folder: Path, model: str) -> Path:
    return folder / f"{model}.json"


def _text(model: str, entries: Iterable[Entry]) -> str:
    values = {
        "format": FORMAT_VERSION,
        "model": model,
        "entries": {f"{e.key.backend} {e.key.settings_hash}": e.record() for e in entries},
    }
    return strict_json(values) + "\n"


def strict_json(value: Any, indent: int = 0) -> str:
    """Strict JSON with sorted keys and one line for each column of numbers, so that a change is a readable diff.

    Examples
    --------
    >>> print(strict_json({"b": [1.5, 2.0], "a": {}}))
    {
      "a": {},
      "b": [1.5, 2.0]
    }
    """
    pad = "  " * (indent + 1)
    if isinstance(value, Mapping) and value:
        rows = [f"{json.dumps(str(k))}: {strict_json(value[k], indent + 1)}" for k in sorted(value)]
        return "{\n" + ",\n".join(pad + row for row in rows) + "\n" + pad[2:] + "}"
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        items = [pad + strict_json(item, indent + 1) for item in value]
        return "[\n" + ",\n".join(items) + "\n" + pad[2:] + "]"
    return json.dumps(plain(value), sort_keys=True, allow_nan=False, ensure_ascii=False)

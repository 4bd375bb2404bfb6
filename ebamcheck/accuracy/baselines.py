"""Baselines, the accuracy that was accepted, one JSON file a model; and what got worse than they are, by how much, and where.

An entry's key is backend and settings hash; machine, renderer and versions are told, and never compared.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ebamcheck.accuracy.measurement import (
    LAYER_COLUMNS,
    MEASURED,
    METRICS,
    NAMES,
    REFUSED,
    Measured,
    Tolerance,
    Tolerances,
)
from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError
from ebamcheck.json_values import plain, read_json

FORMAT_VERSION = 1
STORED = (MEASURED, REFUSED)  # a refusal with its reason is an accepted answer, a crash never is
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
    settings: Mapping[str, Any]  # settings that are not the defaults
    measured: Measured
    metadata: Mapping[str, Any] = field(default_factory=dict)  # mesh, machine, renderer and versions

    @property
    def title(self) -> str:
        """Model, backend and settings, for a reader."""
        given = ", ".join(f"{name}={value}" for name, value in self.settings.items())
        return f"{self.key.model} {self.key.backend}" + (f" ({given})" if given else "")

    def record(self) -> dict[str, Any]:
        """The entry as strict JSON holds it."""
        measured = dict(vars(self.measured))
        layers = {name: list(column) for name, column in measured.pop("columns").items()}
        known = {"settings": dict(self.settings), "metadata": dict(self.metadata), "layers": layers}
        return {"backend": self.key.backend, **measured, **known}


def read_baselines(folder: Path, models: Iterable[str]) -> dict[Key, Entry]:
    """Read the baselines of the models named; a model without a file has none."""
    paths = {model: folder / f"{model}.json" for model in models}
    found = [entry for model, path in paths.items() if path.is_file() for entry in _read(path, model)]
    return {entry.key: entry for entry in found}


def _read(path: Path, model: str) -> list[Entry]:
    try:
        values, found = read_json(path), []
        if values["format"] != FORMAT_VERSION:
            what = f"this version reads {FORMAT_VERSION}: write it anew with --update-baseline=all"
            raise InputError(f"{path}: has format {values['format']!r}, {what}")
        for name, record in values["entries"].items():
            backend, _, settings_hash = name.rpartition(" ")
            measured = Measured(record["status"], record["why"], record["metrics"], record["layers"])
            key = Key(model, backend, settings_hash)
            found.append(Entry(key, record["settings"], measured, record["metadata"]))
        return found
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: is no baseline ({type(error).__name__}: {error}): restore it") from None


def write_baselines(folder: Path, entries: Iterable[Entry], models: Iterable[str]) -> list[Path]:
    """Write the files of the models named, each whole or not at all; one without entries goes. Returns the files that changed."""
    folder.mkdir(parents=True, exist_ok=True)
    held, changed = list(entries), []
    for model in dict.fromkeys(models):
        path = folder / f"{model}.json"
        mine = {f"{e.key.backend} {e.key.settings_hash}": e.record() for e in held if e.key.model == model}
        text = strict_json({"format": FORMAT_VERSION, "model": model, "entries": mine}) + "\n"
        if (path.read_text(encoding="utf-8") if path.is_file() else None) == (text if mine else None):
            continue
        if mine:
            with replacing(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
        else:
            path.unlink()
        changed.append(path)
    return changed


def strict_json(value: Any, indent: int = 0) -> str:
    """Strict JSON with sorted keys and one line for each column of numbers, so that a change is a readable diff.

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


Verdict = Literal["same", "worse", "better", "new", "vanished", "failed", "not run"]


@dataclass(frozen=True)
class Place:
    """One layer on which a value grew."""

    layer: int  # counted from 1
    z_mm: float
    x_mm: float | None
    y_mm: float | None
    old: float
    new: float

    def __str__(self) -> str:
        at = "" if self.x_mm is None or self.y_mm is None else f", at ({self.x_mm:g}, {self.y_mm:g}) mm"
        return f"layer {self.layer}, z = {self.z_mm:g} mm{at}: {self.old:g} -> {self.new:g}"


@dataclass(frozen=True)
class Growth:
    """How a column of the layers grew beyond its tolerance."""

    column: str
    count: int
    compared: int
    largest: float
    mean: float
    places: tuple[Place, ...]

    def __str__(self) -> str:
        by = f"at most by {self.largest:g}, on average by {self.mean:g}"
        return f"{self.column}: {self.count} of {self.compared} layers worse, {by}"


@dataclass(frozen=True)
class Change:
    """One metric that changed by more than its tolerance."""

    metric: str
    old: float
    new: float
    allowed: float
    # The layers behind it; None where no column explains it, or the layers cannot be matched
    growth: Growth | None = None

    @property
    def worse(self) -> bool:
        """Whether it grew."""
        return self.new > self.old or self.growth is not None

    def lines(self) -> list[str]:
        """The change in words: the figure, the layers behind it, the first places."""
        by = f"{self.new - self.old:+g}, tolerance {self.allowed:g}"
        lines = [f"{self.metric} {self.old:g} -> {self.new:g} ({by})"]
        if self.growth is not None:
            more = self.growth.count - len(self.growth.places)
            lines += [f"  {self.growth}", *(f"    {place}" for place in self.growth.places)]
            lines += [f"    and {more} more"] if more > 0 else []
        return lines


@dataclass(frozen=True)
class Difference:
    """One entry against its baseline."""

    key: Key
    title: str
    verdict: Verdict
    why: str = ""
    changes: tuple[Change, ...] = ()

    @property
    def fails(self) -> bool:
        """Whether it makes the report fail."""
        return self.verdict in ("worse", "failed", "vanished")

    def lines(self) -> list[str]:
        """The difference in words."""
        head = f"{self.verdict.upper()}  {self.title}" + (f": {self.why}" if self.why else "")
        shown = [change for change in self.changes if change.worse == (self.verdict == "worse")]
        return [head, *(f"  {line}" for change in shown for line in change.lines())]

    def record(self) -> dict[str, Any]:
        """The difference as strict JSON holds it."""
        told = {"title": self.title, "verdict": self.verdict, "why": self.why}
        return vars(self.key) | told | {"changes": [asdict(change) for change in self.changes]}


def differences(
    entries: Mapping[Key, Entry],
    baselines: Mapping[Key, Entry],
    not_run: Mapping[str, str],
    tolerances: Tolerances,
) -> list[Difference]:
    """Hold every entry against its baseline; one difference for each key of either, in their order.

    `not_run` has the backends that are not available here, and why: their baselines are neither met nor missed.
    """
    gone = "it is in the baselines, but nothing measures it any more; --update-baseline=failed takes it out"
    found = []
    for key in sorted({*entries, *baselines}):
        if key in entries:
            found.append(_held(entries[key], baselines.get(key), tolerances))
        elif key.backend in not_run:
            found.append(Difference(key, baselines[key].title, "not run", not_run[key.backend]))
        else:
            found.append(Difference(key, baselines[key].title, "vanished", gone))
    return found


def _held(new: Entry, old: Entry | None, tolerances: Tolerances) -> Difference:
    now, told = new.measured, partial(Difference, new.key, new.title)
    why = "" if now.status == MEASURED else f"{now.status}: {now.why}"
    if now.status not in STORED:
        return told("failed", why)
    if old is None:
        return told("new", why)
    if now.status != (was := old.measured.status):
        verdict: Verdict = "better" if now.status == MEASURED else "worse"
        return told(verdict, f"was {was}, is {now.status}: {now.why or 'measured'}")
    changes = tuple(_changes(new, old, tolerances))
    if any(change.worse for change in changes):
        return told("worse", _circumstances(new, old), changes)
    return told("better" if changes else "same", "", changes)


def _circumstances(new: Entry, old: Entry) -> str:
    """What else changed since the baseline: the mesh, the versions, the renderer."""
    was, now = old.metadata, new.metadata
    names = (name for name in ("mesh_sha256", "versions", "renderer") if name in was)
    changed = [f"{name} {was[name]} -> {now.get(name)}" for name in names if was[name] != now.get(name)]
    return f"changed with it: {'; '.join(changed)}" if changed else ""


def _changes(new: Entry, old: Entry, tolerances: Tolerances) -> list[Change]:
    """Metrics, then columns whose loss on single layers no metric shows."""
    backend = new.key.backend
    now, before = new.measured.metrics, old.measured.metrics
    column_of = {metric.name: metric.column for metric in METRICS}
    grown = {name: _growth(new, old, name, tolerances.of(backend, name)) for name in LAYER_COLUMNS}
    changes: list[Change] = []
    explained = set()
    for name in (name for name in NAMES if name in now and name in before):
        allowed = tolerances.of(backend, name).allowed(before[name])
        if abs(now[name] - before[name]) <= allowed:
            continue
        column = column_of.get(name, "") if now[name] > before[name] else ""
        explained.add(column)
        changes.append(Change(name, before[name], now[name], allowed, grown.get(column)))
    for column, growth in grown.items():
        if growth is not None and column not in explained:
            place = growth.places[0]
            allowed = tolerances.of(backend, column).allowed(place.old)
            changes.append(Change(column, place.old, place.new, allowed, growth))
    return changes


def _growth(new: Entry, old: Entry, column: str, tolerance: Tolerance) -> Growth | None:
    """Layers on which the absolute value of a column grew by more than its tolerance; None where there is none."""
    now, before = new.measured.columns, old.measured.columns
    heights = now.get("z_mm", ()), before.get("z_mm", ())
    if column not in before or len(heights[0]) != len(heights[1]) or not np.allclose(*heights, 0.0, 1e-6):
        return None
    was, became = before[column], now[column]
    pairs = zip(was, became, strict=True)
    grown = [k for k, (a, b) in enumerate(pairs) if abs(b) > abs(a) + tolerance.allowed(a)]
    if not grown:
        return None
    by = [abs(became[k]) - abs(was[k]) for k in grown]
    places = tuple(
        Place(int(now["layer"][k]) + 1, now["z_mm"][k], now["x_mm"][k], now["y_mm"][k], was[k], became[k])
        for k in grown[:3]
    )
    return Growth(column, len(grown), len(became), max(by), math.fsum(by) / len(by), places)

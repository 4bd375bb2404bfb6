"""The history of accuracy: an SQLite file with one row for each figure of each distinct result.

A result is recorded when it differs from all before it; seen again, it is only counted. So the history of an
unchanged tree does not grow, and the trend shows changes, not runs. Dates stand here and in no report.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from ebamcheck import __version__
from ebamcheck.errors import InputError
from ebamcheck.pipeline.run_folder import sha256_of_json
from ebamcheck.regression.baselines import Key
from ebamcheck.regression.job import Regression

HISTORY = "history.sqlite"

SCHEMA = """
CREATE TABLE IF NOT EXISTS results (
    result INTEGER PRIMARY KEY,
    sha256 TEXT NOT NULL UNIQUE,
    ebamcheck TEXT NOT NULL,
    first_seen TEXT NOT NULL,
    last_seen TEXT NOT NULL,
    times_seen INTEGER NOT NULL
);
CREATE TABLE IF NOT EXISTS figures (
    result INTEGER NOT NULL REFERENCES results (result),
    model TEXT NOT NULL,
    backend TEXT NOT NULL,
    settings_hash TEXT NOT NULL,
    metric TEXT NOT NULL,
    value REAL NOT NULL,
    PRIMARY KEY (result, model, backend, settings_hash, metric)
) WITHOUT ROWID;
"""


@dataclass(frozen=True)
class Trend:
    """One metric of one entry over the results recorded."""

    key: Key
    metric: str
    results: tuple[int, ...]
    values: tuple[float, ...]


def record(path: Path, regression: Regression) -> int:
    """Add what was measured to a history file, which is made where there is none; return the result's number.

    Raises
    ------
    InputError
        If the file is no history or cannot be written.
    """
    figures = [
        (*(key.model, key.backend, key.settings_hash), metric, value)
        for key, entry in regression.entries.items()
        for metric, value in entry.measured.metrics.items()
    ]
    versions = {str(key): entry.metadata for key, entry in regression.entries.items()}
    sha256 = sha256_of_json({"figures": figures, "metadata": versions})
    now = datetime.now(UTC).isoformat(timespec="seconds")
    with _opened(path) as database:
        found = database.execute("SELECT result FROM results WHERE sha256 = ?", (sha256,)).fetchone()
        if found is not None:
            database.execute(
                "UPDATE results SET last_seen = ?, times_seen = times_seen + 1 WHERE result = ?",
                (now, found[0]),
            )
            return int(found[0])
        result = database.execute(
            "INSERT INTO results (sha256, ebamcheck, first_seen, last_seen, times_seen) VALUES (?, ?, ?, ?, 1)",
            (sha256, __version__, now, now),
        ).lastrowid
        database.executemany(
            "INSERT INTO figures VALUES (?, ?, ?, ?, ?, ?)", [(result, *row) for row in figures]
        )
        return int(result or 0)


def trends(path: Path, metric: str) -> list[Trend]:
    """Trend of a metric for every entry that the history holds, by key."""
    query = (
        "SELECT model, backend, settings_hash, result, value FROM figures WHERE metric = ? "
        "ORDER BY model, backend, settings_hash, result"
    )
    rows: dict[Key, list[tuple[int, float]]] = {}
    with _opened(path) as database:
        for model, backend, settings_hash, result, value in database.execute(query, (metric,)):
            rows.setdefault(Key(model, backend, settings_hash), []).append((result, value))
    return [
        Trend(key, metric, tuple(r for r, _ in points), tuple(v for _, v in points))
        for key, points in rows.items()
    ]


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a history file; what the block does is kept whole or not at all."""
    try:
        with closing(sqlite3.connect(path)) as database:
            database.executescript(SCHEMA)
            with database:
                yield database
    except sqlite3.Error as error:
        raise InputError(
            f"{path}: is no history that can be used ({error}): name another with --history"
        ) from None

"""Regression report of accuracy: measures slicers, compares with baselines, keeps a history, writes a page and ``junit.xml``."""

from __future__ import annotations

import platform
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from ebamcheck import __version__
from ebamcheck.accuracy import measurement
from ebamcheck.accuracy.baselines import (  # fmt: skip
    FORMAT_VERSION,
    STORED,
    Difference,
    Entry,
    Key,
    UpdateMode,
    differences,
    read_baselines,
    write_baselines,
)
from ebamcheck.atomic_file import replacing
from ebamcheck.errors import BackendMissing, ExitCode, InputError, SettingsError
from ebamcheck.json_values import sha256_of_json
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import models as installed_models
from ebamcheck.scratch import scratch_folder
from ebamcheck.showing import junit
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck.showing.markup import Markup, element, join, text
from ebamcheck.slicers.isolation import Limits, slice_all

UPDATED_BY_FAILED = ("worse", "new", "vanished")  # by ``--update-baseline=failed``
Note = Callable[[str], None]


@dataclass(frozen=True)
class Regression:
    """Entries, baselines and differences of one report."""

    baselines: Path
    entries: Mapping[Key, Entry]
    held: Mapping[Key, Entry]  # baselines of the models and backends asked for
    differences: Sequence[Difference]
    tolerances: measurement.Tolerances
    # Seconds by entry; they stand in ``timings.json`` and nowhere else
    timings: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def compared(self) -> int:
        """Number of entries that were compared with a baseline."""
        return sum(d.verdict in ("same", "worse", "better") for d in self.differences)

    @property
    def exit_code(self) -> ExitCode:
        """1 where something got worse, 5 where nothing could be compared, else 0."""
        if any(d.fails for d in self.differences):
            return ExitCode.OUT_OF_TOLERANCE
        return ExitCode.PASS if self.compared else ExitCode.NOTHING_COMPARED

    def record(self) -> dict[str, Any]:
        """The report as strict JSON holds it: everything but timings."""
        return {
            "format": FORMAT_VERSION,
            "ebamcheck": __version__,
            "exit_code": int(self.exit_code),
            "compared": self.compared,
            "differences": [difference.record() for difference in self.differences],
            "entries": [{**vars(e.key), **e.record()} for e in self.entries.values()],
        }


def run_regression(
    folder: Path,
    models: Sequence[str] = (),
    backends: Sequence[str] = (),
    tolerances: measurement.Tolerances | None = None,
    limits: Limits | None = None,
    note: Note = lambda text: None,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Regression:
    """Measure models x backends x settings, and compare them with the baselines of a folder; without names the every-day models and
    the available backends.

    `settings` of a backend go on top of those of the matrix, and are held against the same baselines; `note` tells of them.
    """
    matrix, tolerances = measurement.read_matrix(folder), tolerances or measurement.Tolerances()
    chosen = measurement.chosen_models(matrix, models)
    usable, not_run = _usable(backends)
    for name, why in not_run.items():
        note(f"backend {name} is left out: {why}")
    given = {name: values for name, values in (settings or {}).items() if values}
    for name, values in given.items():
        registry.slicer_settings(name, values)
        if name in usable:
            told = ", ".join(f"{key} = {value}" for key, value in values.items())
            note(f"backend {name} runs with {told}, and is held against the baselines of its settings in the matrix")
    entries: dict[Key, Entry] = {}
    timings: dict[str, Mapping[str, float]] = {}
    for name, model in chosen.items():
        note(f"model {name}")
        truth = measurement.truth_of(model, matrix.case(name).tolerance_mm, matrix.case(name).layers)
        for entry, seconds in _measure(name, truth, matrix, usable, limits or Limits(), given):
            entries[entry.key] = entry
            timings[str(entry.key)] = seconds
    judged = list(chosen)
    if not models and folder.is_dir():
        # Without a choice, models that are no longer installed count, too.
        gone = {path.stem for path in folder.glob("*.json")} - installed_models().keys()
        judged += sorted(gone)
    before = read_baselines(folder, judged)
    held = {key: entry for key, entry in before.items() if not backends or key.backend in backends}
    found = differences(entries, held, not_run, tolerances)
    return Regression(folder, dict(sorted(entries.items(), key=lambda item: item[0])), held, found, tolerances, timings)


def _usable(names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    if names:
        return [registry.available_slicer(name).name for name in dict.fromkeys(names)], {}
    probes = {name: registry.probe(name) for name in registry.house_slicers()}
    usable = [name for name, probe in probes.items() if probe.available]
    not_run = {name: "; ".join(filter(None, (p.why, p.hint))) for name, p in probes.items() if not p.available}
    if not usable:
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    return usable, not_run


def _measure(
    model: str,
    truth: measurement.Truth,
    matrix: measurement.Matrix,
    backends: Sequence[str],
    limits: Limits,
    given: Mapping[str, Mapping[str, Any]],
) -> Iterator[tuple[Entry, Mapping[str, float]]]:
    case = matrix.case(model)
    for subjects in measurement.rounds(matrix, model, backends):
        settings = {
            name: registry.slicer_settings(name, {**subject.given, **given.get(name, {})})
            for name, subject in subjects.items()
        }
        with scratch_folder() as folder:
            outcomes = slice_all(truth.part, truth.heights, settings, folder, limits)
            for name, subject in subjects.items():
                start = time.perf_counter()
                probe, key = outcomes[name].probe, Key(model, name, subject.settings_hash(case))
                metadata = {
                    "case": case.model_dump(),
                    "facets": len(truth.part.faces),
                    "mesh_sha256": truth.part.sha256,
                    "machine": f"{platform.system()} {platform.machine()}",
                    "renderer": probe.device,
                    "versions": {
                        "ebamcheck": __version__,
                        "python": platform.python_version(),
                        **probe.versions,
                    },
                }
                measured = measurement.measure_outcome(truth, outcomes[name])
                seconds = {"prepare_s": outcomes[name].prepare_s, "slice_s": outcomes[name].slice_s}
                seconds["measure_s"] = time.perf_counter() - start
                yield Entry(key, subject.given, measured, metadata), seconds


def updated(regression: Regression, mode: UpdateMode) -> list[Path]:
    """Write the baselines of entries that got worse, are new or vanished, or of all but crashes and what could not run; returns the
    files that changed."""
    wanted = UPDATED_BY_FAILED if mode == "failed" else (*UPDATED_BY_FAILED, "same", "better")
    touched = [d.key for d in regression.differences if d.verdict in wanted]
    files = sorted({key.model for key in touched})
    stored = read_baselines(regression.baselines, files)
    for key in touched:
        entry = regression.entries.get(key)
        if entry is None:
            stored.pop(key, None)
        elif entry.measured.status in STORED:
            stored[key] = entry
    return write_baselines(regression.baselines, stored.values(), files)


def accepted(regression: Regression) -> Regression:
    """Return the report once its differences are accepted as the new baselines; failures stay."""
    taken = (*UPDATED_BY_FAILED, "better")
    kept = [replace(d, verdict="same") if d.verdict in taken else d for d in regression.differences]
    return replace(regression, differences=kept)


def default_baselines(given: Path | None, setting: str) -> Path:
    """Folder of the baselines: the one given, the one set, or ``reports/baselines`` of a checkout."""
    if given is not None or setting:
        return given or Path(setting)
    shipped = Path("reports", "baselines")
    for folder in (Path.cwd(), *Path.cwd().parents):
        if (folder / shipped).is_dir():
            return folder / shipped
    what = "name the folder of the baselines with --baselines"
    raise SettingsError(f"there is no {shipped} here or above: {what}")


TREND_METRICS = ("depth_max_mm", "area_error_mean_mm2")  # one of shape, one of size
WIDTH_PX, HEIGHT_PX = 640, 150
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 74, 14, 12, 26

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:72em;margin:2em auto;padding:0 1em;color:#1a1a1a;background:#fff}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}th,td{padding:.2em .6em;border-bottom:1px solid #ddd}
th{text-align:left}td.n{text-align:right}pre{background:#f5f5f5;padding:.8em;overflow-x:auto}
.scroll{overflow-x:auto}.bad{color:#b3261e;font-weight:600}.good{color:#1a7f37}.key{margin-right:1.2em}
svg{max-width:100%;height:auto}text{font:11px system-ui,sans-serif;fill:#444}
"""


def write_page(regression: Regression, history: Path, folder: Path) -> None:
    """Write ``regress.html``, whole or not at all."""
    title = "Accuracy against the baselines"
    failing = sum(d.fails for d in regression.differences)
    verdict = join([element("span", "no entry got worse", class_="good"), f", {regression.compared} were compared"])
    if failing:
        verdict = element("span", f"{failing} of {len(regression.differences)} entries failed", class_="bad")
    what = ". Every entry is one slicer under one choice of settings on one model whose sections are known exactly."
    told = [element("pre", "\n".join(d.lines())) for d in regression.differences if d.verdict != "same"]
    meanings = {**{metric.name: metric.what for metric in measurement.METRICS}, **measurement.WHOLE}
    glossary = [element("tr", element("td", name), element("td", what)) for name, what in meanings.items()]
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", f"ebamcheck: {title.lower()}"),
        element("style", Markup(STYLE)),
    )
    charts = []
    for metric in TREND_METRICS:
        charts.append(element("h3", metric.replace("_", " ")))
        by_model = groupby(trends(history, metric), key=lambda trend: trend.key.model)
        charts += [_chart(model, list(found), metric) for model, found in by_model]
    body = element(
        "body",
        element("h1", title),
        element("p", verdict, what),
        *([element("h2", "What changed"), *told] if told else []),
        element("h2", "Accuracy now"),
        _figures(regression, list(meanings)),
        element("h2", "What the figures mean"),
        element("table", element("tbody", *glossary)),
        element("h2", "Trend"),
        element("p", "One point a distinct result of the history; a result seen again adds none."),
        *charts,
    )
    with replacing(folder / "regress.html") as temporary:
        temporary.write_text(f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n", encoding="utf-8")


def _figures(regression: Regression, names: Sequence[str]) -> Markup:
    rows = []
    for verdict in (d for d in regression.differences if d.key in regression.entries):
        entry = regression.entries[verdict.key]
        measured = entry.measured
        cells = [element("td", f"{measured.status}: {measured.why}", colspan=len(names))]
        if measured.status == measurement.MEASURED:
            cells = [element("td", f"{measured.metrics[name]:.4g}", class_="n") for name in names]
        mark = element("td", verdict.verdict, class_="bad" if verdict.fails else "good")
        rows.append(element("tr", element("td", entry.title), mark, *cells))
    heads = (element("th", name.replace("_", " ")) for name in ("entry", "verdict", *names))
    table = element("table", element("thead", element("tr", *heads)), element("tbody", *rows))
    return element("div", table, class_="scroll")


def _chart(model: str, lines: Sequence[Trend], metric: str) -> Markup:
    last = max(max(line.results) for line in lines)
    most = max(max(line.values) for line in lines) or 1.0
    bottom, right = HEIGHT_PX - BOTTOM_PX, WIDTH_PX - RIGHT_PX
    drawn, keys = [], []
    for rank, line in enumerate(lines):
        colour, dashes = COLOURS[rank % len(COLOURS)], DASHES[rank % len(DASHES)]
        points = [
            f"{LEFT_PX + (result - 1) / max(last - 1, 1) * (right - LEFT_PX):.1f},{bottom - value / most * (bottom - TOP_PX):.1f}"
            for result, value in zip(line.results, line.values, strict=True)
        ]
        path, dots = "M" + "L".join(points), "".join(f"M{point}h0" for point in points)
        drawn += [
            element("path", d=path, fill="none", stroke=colour, stroke_width=1.6, stroke_dasharray=dashes),
            element("path", d=dots, stroke=colour, stroke_width=5, stroke_linecap="round"),
        ]
        named = f"\u25a0 {line.key.backend} {line.key.settings_hash}"
        keys.append(element("span", named, class_="key", style=f"color:{colour}"))
    svg = element(
        "svg",
        element("title", f"{metric} of {model}"),
        element("path", d=f"M{LEFT_PX},{TOP_PX}V{bottom}H{right}", stroke="#777", fill="none"),
        text(LEFT_PX - 6, TOP_PX + 8, f"{most:.4g}", text_anchor="end"),
        text(LEFT_PX - 6, bottom, "0", text_anchor="end"),
        text(LEFT_PX, HEIGHT_PX - 8, "1"),
        text(right, HEIGHT_PX - 8, f"result {last}", text_anchor="end"),
        *drawn,
        viewBox=f"0 0 {WIDTH_PX} {HEIGHT_PX}",
        role="img",
    )
    return join([element("h4", model), svg, element("div", *keys)])


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
    """Add what was measured to a history file, which is made where there is none; return the result's number."""
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
        database.executemany("INSERT INTO figures VALUES (?, ?, ?, ?, ?, ?)", [(result, *row) for row in figures])
        return int(result or 0)


def trends(path: Path, metric: str) -> list[Trend]:
    """Trend of a metric for every entry that the history holds, by key."""
    query = (
        "SELECT model, backend, settings_hash, result, value FROM figures WHERE metric = ? "
        "ORDER BY model, backend, settings_hash, result"
    )
    with _opened(path) as database:
        rows = database.execute(query, (metric,)).fetchall()
    by_key = [(Key(*of), list(points)) for of, points in groupby(rows, key=lambda row: row[:3])]
    return [Trend(key, metric, *zip(*(row[3:] for row in points), strict=True)) for key, points in by_key]


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a history file; what the block does is kept whole or not at all."""
    try:
        with closing(sqlite3.connect(path)) as database:
            database.executescript(SCHEMA)
            with database:
                yield database
    except sqlite3.Error as error:
        what = f"is no history that can be used ({error}): name another with --history"
        raise InputError(f"{path}: {what}") from None


def write_junit(regression: Regression, folder: Path) -> Path:
    """Write one suite with one case per entry; its times are 0, ``timings.json`` holds the true ones."""
    name, path = "ebamcheck.regress", folder / "junit.xml"
    cases = [_case(name, difference) for difference in regression.differences]
    junit.write_junit(junit.junit(name, {name: cases}), path)
    return path


def _case(suite: str, difference: Difference) -> junit.Case:
    key = difference.key
    settings = difference.title.removeprefix(f"{key.model} {key.backend}").strip()
    case = partial(junit.Case, f"{suite}.{key.backend}", f"{key.model} {settings}".strip())
    if difference.verdict in ("new", "not run"):
        return case("skipped", difference.why or "there is no baseline to hold it against")
    if not difference.fails:
        return case()
    lines = difference.lines()
    kind: junit.Kind = "error" if difference.verdict == "failed" else "failure"
    return case(kind, lines[0], difference.verdict, "\n".join(lines))

"""One regression report: measure, hold against the baselines, keep the history; its page and its ``junit.xml``."""

from __future__ import annotations

import platform
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

from junitparser.xunit2 import JUnitXml

from ebamcheck import __version__
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
from ebamcheck.accuracy.measurement import (
    MEASURED,
    METRICS,
    WHOLE,
    Case,
    Matrix,
    Subject,
    Tolerances,
    Truth,
    chosen_models,
    measure_outcome,
    read_matrix,
    rounds,
    truth_of,
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
from ebamcheck.slicers.isolation import Limits, Outcome, slice_all

CHECKOUT_BASELINES = Path("reports", "baselines")

UPDATED_BY_FAILED = ("worse", "new", "vanished")  # by ``--update-baseline=failed``

Note = Callable[[str], None]


@dataclass(frozen=True)
class Regression:
    """What a report came to."""

    baselines: Path
    entries: Mapping[Key, Entry]
    held: Mapping[Key, Entry]  # baselines of the models and backends asked for
    differences: Sequence[Difference]
    tolerances: Tolerances
    timings: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Seconds by entry; they stand in ``timings.json`` and nowhere else."""

    @property
    def compared(self) -> int:
        """Entries that were held against a baseline."""
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
            "entries": [
                {"model": e.key.model, "settings_hash": e.key.settings_hash, **e.record()}
                for e in self.entries.values()
            ],
        }


def run_regression(
    folder: Path,
    models: Sequence[str] = (),
    backends: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    limits: Limits | None = None,
    note: Note = lambda text: None,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Regression:
    """Measure models x backends x settings and hold them against the baselines of a folder; where these are missing every entry is new.

    Without names: every model of every day and every backend that is available. `note` gets a line for each model begun, each backend left out
    and each that is measured under other `settings`, which go on top of those of the matrix and are held against the same baselines.
    """
    matrix = read_matrix(folder)
    chosen = chosen_models(matrix, models)
    usable, not_run = _usable(backends)
    for name, why in not_run.items():
        note(f"backend {name} is left out: {why}")
    given = {name: values for name, values in (settings or {}).items() if values}
    for name, values in given.items():
        registry.slicer_settings(name, values)
        if name in usable:
            told = ", ".join(f"{key} = {value}" for key, value in values.items())
            note(
                f"backend {name} runs with {told}, and is held against the baselines of its settings in the matrix"
            )
    entries: dict[Key, Entry] = {}
    timings: dict[str, Mapping[str, float]] = {}
    for name, model in chosen.items():
        note(f"model {name}")
        truth = truth_of(model, matrix.case(name).tolerance_mm, matrix.case(name).layers)
        for entry, seconds in _measure(name, truth, matrix, usable, limits or Limits(), given):
            entries[entry.key] = entry
            timings[str(entry.key)] = seconds
    held = {
        key: entry
        for key, entry in read_baselines(folder, _models_held(folder, chosen, models)).items()
        if not backends or key.backend in backends
    }
    found = differences(entries, held, not_run, tolerances or Tolerances())
    ordered = {key: entries[key] for key in sorted(entries)}
    return Regression(folder, ordered, held, found, tolerances or Tolerances(), timings)


def _usable(names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    if names:
        return [registry.available_slicer(name).name for name in dict.fromkeys(names)], {}
    usable, not_run = [], {}
    for name in registry.house_slicers():
        probe = registry.probe(name)
        if probe.available:
            usable.append(name)
        else:
            not_run[name] = f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}"
    if not usable:
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    return usable, not_run


def _models_held(folder: Path, chosen: Mapping[str, object], named: Sequence[str]) -> list[str]:
    """Models whose baselines count: those chosen; without a choice those no longer installed, too."""
    if named or not folder.is_dir():
        return list(chosen)
    installed = installed_models()
    return [*chosen, *(path.stem for path in sorted(folder.glob("*.json")) if path.stem not in installed)]


def _measure(
    model: str,
    truth: Truth,
    matrix: Matrix,
    backends: Sequence[str],
    limits: Limits,
    given: Mapping[str, Mapping[str, Any]],
) -> list[tuple[Entry, Mapping[str, float]]]:
    case = matrix.case(model)
    found: list[tuple[Entry, Mapping[str, float]]] = []
    for subjects in rounds(matrix, model, backends):
        settings = {
            name: registry.slicer_settings(name, {**subject.given, **given.get(name, {})})
            for name, subject in subjects.items()
        }
        with scratch_folder() as folder:
            outcomes = slice_all(truth.part, truth.heights, settings, folder, limits)
            for name, subject in subjects.items():
                start = time.perf_counter()
                entry = _entry(model, truth, case, subject, outcomes[name])
                seconds = {
                    "prepare_s": outcomes[name].prepare_s,
                    "slice_s": outcomes[name].slice_s,
                    "measure_s": time.perf_counter() - start,
                }
                found.append((entry, seconds))
    return found


def _entry(model: str, truth: Truth, case: Case, subject: Subject, outcome: Outcome) -> Entry:
    key = Key(model, subject.backend, subject.settings_hash(case))
    metadata = {
        "case": case.model_dump(),
        "facets": len(truth.part.faces),
        "mesh_sha256": truth.part.sha256,
        "machine": f"{platform.system()} {platform.machine()}",
        "renderer": outcome.probe.device,
        "versions": {"ebamcheck": __version__, "python": platform.python_version(), **outcome.probe.versions},
    }
    return Entry(key, subject.given, measure_outcome(truth, outcome), metadata)


def updated(regression: Regression, mode: UpdateMode) -> list[Path]:
    """Write the baselines anew: those that failed, are new or vanished, or all that were measured; returns the files that changed.

    Crashes and entries that could not run here stay as they were.
    """
    verdicts = {d.key: d.verdict for d in regression.differences}
    touched = [
        key
        for key, verdict in verdicts.items()
        if verdict in UPDATED_BY_FAILED or (mode == "all" and verdict in ("same", "better"))
    ]
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
    kept = [
        replace(d, verdict="same") if d.verdict in UPDATED_BY_FAILED or d.verdict == "better" else d
        for d in regression.differences
    ]
    return replace(regression, differences=kept)


def default_baselines(given: Path | None, setting: str) -> Path:
    """Folder of the baselines: the one given, the one set, or ``reports/baselines`` of a checkout."""
    if given is not None:
        return given
    if setting:
        return Path(setting)
    for folder in (Path.cwd(), *Path.cwd().parents):
        if (folder / CHECKOUT_BASELINES).is_dir():
            return folder / CHECKOUT_BASELINES
    raise SettingsError(
        f"there is no {CHECKOUT_BASELINES} here or above: name the folder of the baselines with --baselines"
    )


PAGE = "regress.html"

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


def write_page(regression: Regression, history: Path, folder: Path) -> Path:
    """Write the page, whole or not at all."""
    path = folder / PAGE
    with replacing(path) as temporary:
        temporary.write_text(document(regression, history), encoding="utf-8")
    return path


def document(regression: Regression, history: Path) -> str:
    """Build the page."""
    title = "Accuracy against the baselines"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", f"ebamcheck: {title.lower()}"),
        element("style", Markup(STYLE)),
    )
    body = element(
        "body",
        element("h1", title),
        _intro(regression),
        *_changes(regression.differences),
        element("h2", "Accuracy now"),
        _figures(regression),
        element("h2", "What the figures mean"),
        _glossary(),
        element("h2", "Trend"),
        element("p", "One point a distinct result of the history; a result seen again adds none."),
        *(_trends(history, metric) for metric in TREND_METRICS),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def _intro(regression: Regression) -> Markup:
    failing = sum(d.fails for d in regression.differences)
    if failing:
        verdict = element("span", f"{failing} of {len(regression.differences)} entries failed", class_="bad")
    else:
        good = element("span", "no entry got worse", class_="good")
        verdict = join([good, f", {regression.compared} were compared"])
    what = ". Every entry is one slicer under one choice of settings on one model whose sections are known exactly."
    return element("p", verdict, what)


def _changes(differences: Sequence[Difference]) -> Iterable[Markup]:
    told = [d for d in differences if d.verdict != "same"]
    if told:
        yield element("h2", "What changed")
    for difference in told:
        yield element("pre", "\n".join(difference.lines()))


def _figures(regression: Regression) -> Markup:
    names = [metric.name for metric in METRICS] + list(WHOLE)
    verdicts = {d.key: d for d in regression.differences}
    rows = []
    for key, entry in regression.entries.items():
        verdict, measured = verdicts[key], entry.measured
        if measured.status == MEASURED:
            cells = [element("td", f"{measured.metrics[name]:.4g}", class_="n") for name in names]
        else:
            cells = [element("td", f"{measured.status}: {measured.why}", colspan=len(names))]
        mark = element("td", verdict.verdict, class_="bad" if verdict.fails else "good")
        rows.append(element("tr", element("td", entry.title), mark, *cells))
    heads = (element("th", name.replace("_", " ")) for name in ("entry", "verdict", *names))
    table = element("table", element("thead", element("tr", *heads)), element("tbody", *rows))
    return element("div", table, class_="scroll")


def _glossary() -> Markup:
    meanings = {**{metric.name: metric.what for metric in METRICS}, **WHOLE}
    rows = (element("tr", element("td", name), element("td", what)) for name, what in meanings.items())
    return element("table", element("tbody", *rows))


def _trends(history: Path, metric: str) -> Markup:
    by_model = groupby(trends(history, metric), key=lambda trend: trend.key.model)
    charts = [_chart(model, list(found), metric) for model, found in by_model]
    return join([element("h3", metric.replace("_", " ")), *charts])


def _chart(model: str, lines: Sequence[Trend], metric: str) -> Markup:
    last = max(max(line.results) for line in lines)
    most = max(max(line.values) for line in lines) or 1.0
    bottom, right = HEIGHT_PX - BOTTOM_PX, WIDTH_PX - RIGHT_PX
    svg = element(
        "svg",
        element("title", f"{metric} of {model}"),
        element("path", d=f"M{LEFT_PX},{TOP_PX}V{bottom}H{right}", stroke="#777", fill="none"),
        text(LEFT_PX - 6, TOP_PX + 8, f"{most:.4g}", text_anchor="end"),
        text(LEFT_PX - 6, bottom, "0", text_anchor="end"),
        text(LEFT_PX, HEIGHT_PX - 8, "1"),
        text(right, HEIGHT_PX - 8, f"result {last}", text_anchor="end"),
        *(_line(line, k, last, most) for k, line in enumerate(lines)),
        viewBox=f"0 0 {WIDTH_PX} {HEIGHT_PX}",
        role="img",
    )
    keys = element("div", *(_legend(line, k) for k, line in enumerate(lines)))
    return join([element("h4", model), svg, keys])


def _line(line: Trend, rank: int, last: int, most: float) -> Markup:
    span = max(last - 1, 1)
    points = [
        (
            LEFT_PX + (result - 1) / span * (WIDTH_PX - LEFT_PX - RIGHT_PX),
            HEIGHT_PX - BOTTOM_PX - value / most * (HEIGHT_PX - TOP_PX - BOTTOM_PX),
        )
        for result, value in zip(line.results, line.values, strict=True)
    ]
    path = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dots = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in points)
    colour, dashes = COLOURS[rank % len(COLOURS)], DASHES[rank % len(DASHES)]
    drawn = element("path", d=path, fill="none", stroke=colour, stroke_width=1.6, stroke_dasharray=dashes)
    return join([drawn, element("path", d=dots, stroke=colour, stroke_width=5, stroke_linecap="round")])


def _legend(line: Trend, rank: int) -> Markup:
    named = f"\u25a0 {line.key.backend} {line.key.settings_hash}"
    return element("span", named, class_="key", style=f"color:{COLOURS[rank % len(COLOURS)]}")


# -- history ---------------------------------------------------------------------------------------

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


# -- test results ----------------------------------------------------------------------------------

JUNIT = "junit.xml"

NAME = "ebamcheck.regress"

SKIPPED = ("new", "not run")  # nothing to hold it against, or it could not run


def write_junit(regression: Regression, folder: Path) -> Path:
    """Write the file, whole or not at all; its times are 0, the true ones stand in ``timings.json``."""
    path = folder / JUNIT
    junit.write_junit(junit_document(regression), path)
    return path


def junit_document(regression: Regression) -> JUnitXml:
    """Build one suite, one case an entry."""
    return junit.junit(NAME, {NAME: [_case(difference) for difference in regression.differences]})


def _case(difference: Difference) -> junit.Case:
    key = difference.key
    settings = difference.title.removeprefix(f"{key.model} {key.backend}").strip()
    classname, name = f"{NAME}.{key.backend}", f"{key.model} {settings}".strip()
    if difference.verdict in SKIPPED:
        why = difference.why or "there is no baseline to hold it against"
        return junit.Case(classname, name, "skipped", why)
    if not difference.fails:
        return junit.Case(classname, name)
    head, *_ = lines = difference.lines()
    kind: junit.Kind = "error" if difference.verdict == "failed" else "failure"
    return junit.Case(classname, name, kind, head, difference.verdict, "\n".join(lines))

"""The tables of the faults, in Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields

from benchmarks.faults.planting import Result
from benchmarks.faults.subjects import CONTROLS

COLUMNS = tuple(f.name for f in fields(Result) if f.name not in ("notes", "run_checks", "text_checks"))
CHANGES = ("metal", "motion", "state", "record")
NAMED = 3
"""Checks that are named of a kind: those that tell its faults at the right line most often."""

LISTED = 400
"""Missed faults that are named; more are counted."""


def as_csv(results: Iterable[Result]) -> str:
    """One row a fault."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for result in results:
        row = [getattr(result, name) for name in COLUMNS]
        writer.writerow([_plain(value) for value in row])
    return text.getvalue()


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    return int(value) if isinstance(value, bool) else value


def as_markdown(results: Sequence[Result], honest: Sequence[tuple[str, str]] | None, seed: int, planned: int) -> str:
    """Totals by what is changed, figures by kind and control, what is missed, and what cannot be seen."""
    kinds = list(dict.fromkeys(r.kind for r in results))
    cut = f" ({len(results)} of {planned} were judged)" if len(results) < planned else ""
    said = (
        f"By `python -m benchmarks.faults --seed {seed}`: {len(results)} faults of {len(kinds)} kinds in finished programs of "
        f"{len({r.part for r in results})} small parts{cut}, hashes and certificate worked out anew. *Run*: `verify RUN`. *Text*: "
        "`verify PROGRAM --part` with all comments taken out, of the faults that a text can show. A fault is found if a check "
        "fails that passes for the sound program; its line is right within 3."
    )
    lines = [
        "# Planted faults",
        "",
        said,
        "",
        *_summary(results),
        "",
        *_false_alarms(honest),
        "## By kind",
        "",
        *_by_kind(results, kinds),
        "",
        *_missed("Missed by the verification of the run", [r for r in results if r.run_missed]),
        *_missed("Missed by text and part", [r for r in results if r.text_missed]),
        *_unseen(results),
    ]
    return "\n".join(lines) + "\n"


def _share(some: Sequence[Result], hit: Callable[[Result], bool]) -> str:
    if not some:
        return "-"
    return f"{sum(map(hit, some))} of {len(some)}"


def _summary(results: Sequence[Result]) -> list[str]:
    head = "| changes | control | planted | run finds | right line | text finds | right line |"
    lines = [head, "|---|---|--:|--:|--:|--:|--:|"]
    for control in ("all", *CONTROLS):
        for changes in ("all", *CHANGES):
            some = [r for r in results if control in ("all", r.control) and changes in ("all", r.changes)]
            if some and (control == "all" or changes == "all"):
                lines.append(f"| {changes} | {control} | {len(some)} | {_figures(some)} |")
    return lines


def _figures(some: Sequence[Result]) -> str:
    seen = [r for r in some if not r.unseen]
    found, text_found = [r for r in some if r.run_found], [r for r in seen if r.text_found]
    return " | ".join(
        (
            _share(some, lambda r: r.run_found),
            _share(found, lambda r: bool(r.run_by)),
            _share(seen, lambda r: r.text_found),
            _share(text_found, lambda r: bool(r.text_by)),
        )
    )


def _by_kind(results: Sequence[Result], kinds: Sequence[str]) -> list[str]:
    head = "| kind | changes | " + " | ".join(f"{c}: run, text" for c in CONTROLS) + " | right line: run, text | by |"
    lines = [head, "|---|---|" + "---|" * (len(CONTROLS) + 2)]
    for kind in kinds:
        some = [r for r in results if r.kind == kind]
        cells = []
        for control in CONTROLS:
            mine = [r for r in some if r.control == control]
            seen = [r for r in mine if not r.unseen]
            run, text = sum(r.run_found for r in mine), sum(r.text_found for r in seen)
            cells.append(f"{run}/{len(mine)}, {f'{text}/{len(seen)}' if seen else '-'}" if mine else "")
        found, seen = [r for r in some if r.run_found], [r for r in some if r.text_found and not r.unseen]
        right = f"{sum(bool(r.run_by) for r in found)}/{len(found)}, {sum(bool(r.text_by) for r in seen)}/{len(seen)}"
        by = Counter(name for r in some for name in (*r.run_by, *r.text_by)).most_common(NAMED)
        finders = ", ".join(name for name, _ in by)
        lines.append(f"| {kind} | {some[0].changes} | {' | '.join(cells)} | {right} | {finders} |")
    return lines


def _false_alarms(honest: Sequence[tuple[str, str]] | None) -> list[str]:
    if honest is None:
        return []
    bad = [(name, said) for name, said in honest if said]
    lines = ["## Honest runs", "", f"{len(bad)} of {len(honest)} raise a false alarm.", ""]
    lines += [f"- {name}: {said}" for name, said in bad]
    return [*lines, ""] if bad else lines


def _missed(title: str, some: Sequence[Result]) -> list[str]:
    lines = [f"## {title}: {len(some)}", ""]
    lines += [f"- `{r.name}` ({r.part}, {r.where}): {r.what}" for r in some[:LISTED]]
    return [*lines, ""] if some else lines


def _unseen(results: Sequence[Result]) -> list[str]:
    reasons: dict[str, list[str]] = {}
    for r in results:
        if r.unseen and r.kind not in reasons.setdefault(r.unseen, []):
            reasons[r.unseen].append(r.kind)
    lines = ["## What text and part cannot show", ""]
    return lines + [f"- {', '.join(kinds)}: {reason}." for reason, kinds in reasons.items()]

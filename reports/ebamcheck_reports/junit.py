"""``junit.xml`` (xunit2) for build servers: a test case per gate, finding, pair of backends, program check and backend.

A method that crashed, hung or was killed is an error. One that is not available or refused the part is skipped,
as the run is too: whether enough methods are left is what the agreement gate says. A finding that is a fault is a failure;
a warning is skipped with its text, since it neither passes nor fails; a note passes, and says its text. What is proved and
what is left to a person stands in the properties of every suite. All times are 0: the true ones stand in ``timings.json``, so that
the same run gives the same bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from junitparser.xunit2 import JUnitXml

from ebamcheck.record.run_folder import RunFolder
from ebamcheck.result import in_words
from ebamcheck.showing.junit import Case, Kind, junit, write_junit
from ebamcheck_reports import words
from ebamcheck_reports.markup import counted, place
from ebamcheck_reports.run_data import RunData

NAME = "junit.xml"


def write(run: RunFolder) -> list[str]:
    """Write the file into the run folder and return its name."""
    write_junit(document(RunData(run)), run.path / NAME)
    return [NAME]


def document(run: RunData) -> JUnitXml:
    """Build the suites and their cases."""
    part = run.part_of("part")
    properties = {
        "part": str(part["name"]),
        "part sha256": str(part["sha256"] or part["mesh_sha256"]),
        "settings sha256": str(run.manifest["settings_sha256"]),
        "ebamcheck": str(run.manifest["ebamcheck"]),
        "exit code": str(run.manifest["exit_code"]),
        **{head.lower(): "; ".join(clauses) for head, clauses in run.statement.parts() if clauses},
    }
    cases = {
        "gates": _gates,
        "findings": _findings,
        "backends": _backends,
        "agreement": _pairs,
        "program": _checks,
    }
    return junit("ebamcheck", {f"ebamcheck.{name}": list(of(run)) for name, of in cases.items()}, properties)


def _gates(run: RunData) -> Iterator[Case]:
    for gate in run.gates:
        text = f"{gate['text']} (figure {gate['figure']}, limit {gate['limit']} {gate['unit']})"
        outcome: Kind = "" if gate["passed"] else "failure"
        yield Case("ebamcheck.gate", gate["name"], outcome, text, "gate")
    for name in run.missing_gates:
        yield Case("ebamcheck.gate", name, "skipped", "not reached: there was no contour to go on with")


def _findings(run: RunData) -> Iterator[Case]:
    outcomes: dict[str, Kind] = {"fault": "failure", "warning": "skipped"}
    told: Counter[str] = Counter()
    for found in run.findings:
        name = f"{found['code']} {found['place']}".strip()
        told[name] += 1
        name += f" #{told[name]}" if told[name] > 1 else ""
        text = f"{found['severity']}: {in_words(found)}"
        if found["figure"] is not None:
            text += f" (figure {found['figure']}, limit {found['limit']} {found['unit']})"
        yield Case("ebamcheck.finding", name, outcomes.get(found["severity"], ""), text, "finding", text)


def _backends(run: RunData) -> Iterator[Case]:
    for name, record in run.backends.items():
        status = record["status"]
        if status == "done":
            yield Case(_class(name), "slice")
        else:
            outcome: Kind = "error" if status in words.LOST else "skipped"
            yield Case(_class(name), "slice", outcome, f"{status}: {record['why'] or 'no reason was given'}", status)


def _class(backend: str) -> str:
    return f"ebamcheck.backend.{backend}"


def _pairs(run: RunData) -> Iterator[Case]:
    for pair in run.pairs:
        classname, name = _class(pair["a"]), f"agrees with {pair['b']}"
        if not pair["gated"] or not run.compared:
            yield Case(classname, name, "skipped", "no layer on which both can be compared")
        elif pair["agree"] == pair["gated"]:
            yield Case(classname, name)
        else:
            message = (
                f"{counted(pair['gated'] - pair['agree'], 'layer')} of {pair['gated']} disagree: depth at most "
                f"{pair['max_depth_mm']} mm, limit {pair['limit_mm']} mm"
            )
            both = {pair["a"], pair["b"]}
            found = [_disagreement(f) for f in run.disagreements if {f["backend"], f["against"]} == both]
            yield Case(classname, name, "failure", message, "disagreement", "\n".join([message, *found]))


def _disagreement(finding: Mapping[str, Any]) -> str:
    return (
        f"layer {finding['layer']}, z = {finding['height_mm']:.3f} mm: {finding['backend']} against {finding['against']}, "
        f"{finding['metric']} {finding['value']}, limit {finding['limit']}, at {place(finding['x_mm'], finding['y_mm'])} mm, "
        f"likely cause: {finding.get('cause_text') or finding['cause']}"
    )


def _checks(run: RunData) -> Iterator[Case]:
    for check in run.checks:
        where = f" at {check['where']}" if check["where"] else ""
        text = f"{check['text']}{where} (value {check['value']}, limit {check['limit']} {check['unit']})"
        outcome: Kind = "" if check["passed"] else "failure"
        yield Case("ebamcheck.program", check["name"], outcome, text, "check")

"""``junit.xml`` (xunit2) for build servers: one test case a gate, a finding, a pair of backends, a check of the program, a backend.

A method that crashed, hung or was killed is an error. One that is not available or refused the part is skipped,
as the run is too: whether enough methods are left is what the agreement gate says. A finding that is a fault is a failure;
a warning is skipped with its text, since it neither passes nor fails; a note passes, and says its text. What is proved and
what is left to a person stands in the properties of every suite. It holds no times: they stand in ``timings.json``, so that
the same run gives the same bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal
from xml.etree import ElementTree

from ebamcheck.atomic_file import replacing
from ebamcheck.findings import in_words
from ebamcheck.pipeline.run_folder import RunFolder
from ebamcheck_reports import words
from ebamcheck_reports.figures import counted, place
from ebamcheck_reports.markup import clean
from ebamcheck_reports.run_data import RunData

NAME = "junit.xml"


@dataclass(frozen=True)
class Case:
    """One test case: no outcome means that it passed."""

    classname: str
    name: str
    outcome: Literal["", "failure", "error", "skipped"] = ""
    message: str = ""
    type: str = ""
    details: str = ""


def write(run: RunFolder) -> list[str]:
    """Write the file into the run folder and return its name."""
    root = document(RunData(run))
    ElementTree.indent(root)
    with replacing(run.path / NAME) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
        temporary.write_bytes(temporary.read_bytes() + b"\n")
    return [NAME]


def document(run: RunData) -> ElementTree.Element:
    """Build the tree of suites and cases."""
    suites = {
        "gates": list(_gates(run)),
        "findings": list(_findings(run)),
        "backends": list(_backends(run)),
        "agreement": list(_pairs(run)),
        "program": list(_checks(run)),
    }
    every = [case for cases in suites.values() for case in cases]
    root = ElementTree.Element("testsuites", {"name": "ebamcheck", **_counts(every)})
    for name, cases in suites.items():
        if not cases:
            continue
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            {"name": f"ebamcheck.{name}", **_counts(cases), "skipped": _count(cases, "skipped")},
        )
        _properties(suite, run)
        for case in cases:
            _add(suite, case)
    return root


def _properties(suite: ElementTree.Element, run: RunData) -> None:
    part = run.part_of("part")
    values = {
        "part": part["name"],
        "part sha256": part["sha256"] or part["mesh_sha256"],
        "settings sha256": run.manifest["settings_sha256"],
        "ebamcheck": run.manifest["ebamcheck"],
        "exit code": run.manifest["exit_code"],
        **{head.lower(): "; ".join(clauses) for head, clauses in run.statement.parts() if clauses},
    }
    parent = ElementTree.SubElement(suite, "properties")
    for name, value in values.items():
        ElementTree.SubElement(parent, "property", {"name": name, "value": clean(str(value))})


def _add(suite: ElementTree.Element, case: Case) -> None:
    names = {"classname": clean(case.classname), "name": clean(case.name)}
    node = ElementTree.SubElement(suite, "testcase", names)
    if case.outcome:
        said = ElementTree.SubElement(node, case.outcome, {"message": clean(case.message)})
        if case.outcome != "skipped":
            said.set("type", case.type)
        said.text = clean(case.details or case.message)
    elif case.details:
        ElementTree.SubElement(node, "system-out").text = clean(case.details)


def _counts(cases: list[Case]) -> dict[str, str]:
    return {
        "tests": str(len(cases)),
        "failures": _count(cases, "failure"),
        "errors": _count(cases, "error"),
    }


def _count(cases: list[Case], outcome: str) -> str:
    return str(sum(case.outcome == outcome for case in cases))


# -- cases -----------------------------------------------------------------------------------------


def _gates(run: RunData) -> Iterator[Case]:
    for gate in run.gates:
        text = f"{gate['text']} (figure {gate['figure']}, limit {gate['limit']} {gate['unit']})"
        outcome: Literal["", "failure"] = "" if gate["passed"] else "failure"
        yield Case("ebamcheck.gate", gate["name"], outcome, text, "gate")
    for name in run.missing_gates:
        yield Case("ebamcheck.gate", name, "skipped", "not reached: there was no contour to go on with")


def _findings(run: RunData) -> Iterator[Case]:
    outcomes: dict[str, Literal["", "failure", "skipped"]] = {"fault": "failure", "warning": "skipped"}
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
            message = f"{status}: {record['why'] or 'no reason was given'}"
            yield Case(
                _class(name),
                "slice",
                "error" if status in words.LOST else "skipped",
                message,
                status,
            )


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
            found = [
                _disagreement(f)
                for f in run.disagreements
                if {f["backend"], f["against"]} == {pair["a"], pair["b"]}
            ]
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
        outcome: Literal["", "failure"] = "" if check["passed"] else "failure"
        yield Case("ebamcheck.program", check["name"], outcome, text, "check")

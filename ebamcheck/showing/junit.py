"""Test results as JUnit XML (xunit2), as build servers read them: suites of cases, without times, so that the same results give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from ebamcheck.atomic_file import replacing
from ebamcheck.showing.markup import clean

Kind = Literal["", "failure", "error", "skipped"]


@dataclass(frozen=True)
class Case:
    """One test case: no outcome means that it passed."""

    classname: str
    name: str
    outcome: Kind = ""
    message: str = ""
    type: str = ""
    details: str = ""


def junit(
    name: str, suites: Mapping[str, Sequence[Case]], properties: Mapping[str, str] | None = None
) -> ElementTree.Element:
    """Build the tree of suites and cases.

    Parameters
    ----------
    name
        Name of the whole.
    suites
        Cases by suite; suites without cases are left out.
    properties
        Names and values that stand in every suite.
    """
    every = [case for cases in suites.values() for case in cases]
    root = ElementTree.Element("testsuites", {"name": name, **_counts(every)})
    for suite_name, cases in suites.items():
        if not cases:
            continue
        heads = {"name": suite_name, **_counts(cases), "skipped": _count(cases, "skipped")}
        suite = ElementTree.SubElement(root, "testsuite", heads)
        if properties:
            parent = ElementTree.SubElement(suite, "properties")
            for key, value in properties.items():
                ElementTree.SubElement(parent, "property", {"name": clean(key), "value": clean(value)})
        for case in cases:
            _add(suite, case)
    return root


def write_junit(root: ElementTree.Element, path: Path) -> None:
    """Write the file, whole or not at all."""
    ElementTree.indent(root)
    with replacing(path) as temporary:
        temporary.write_bytes(ElementTree.tostring(root, "utf-8", xml_declaration=True) + b"\n")


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


def _counts(cases: Sequence[Case]) -> dict[str, str]:
    return {
        "tests": str(len(cases)),
        "failures": _count(cases, "failure"),
        "errors": _count(cases, "error"),
    }


def _count(cases: Sequence[Case], outcome: Kind) -> str:
    return str(sum(case.outcome == outcome for case in cases))

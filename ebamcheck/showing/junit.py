"""Test results as JUnit XML (xunit2), as build servers read them: suites of cases.

All times are 0: they stand elsewhere, so that the same results give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from junitparser import Error, Failure, Skipped
from junitparser.xunit2 import JUnitXml, TestCase, TestSuite

from ebamcheck.atomic_file import replacing
from ebamcheck.showing.markup import clean

Kind = Literal["", "failure", "error", "skipped"]
_RESULTS = {"failure": Failure, "error": Error, "skipped": Skipped}


@dataclass(frozen=True)
class Case:
    """One test case: no outcome means that it passed."""

    classname: str
    name: str
    outcome: Kind = ""
    message: str = ""
    type: str = ""
    details: str = ""


def junit(name: str, suites: Mapping[str, Sequence[Case]], properties: Mapping[str, str] | None = None) -> JUnitXml:
    """Build the suites and their cases, with properties that stand in every suite; suites without cases are left out."""
    whole = JUnitXml(name)
    for suite_name, cases in suites.items():
        if not cases:
            continue
        suite = TestSuite(suite_name)
        for key, value in (properties or {}).items():
            suite.add_property(clean(key), clean(value))
        suite.add_testcases([_test_case(case) for case in cases])
        whole.add_testsuite(suite)
    whole.update_statistics()
    return whole


def write_junit(whole: JUnitXml, path: Path) -> None:
    """Write the file, whole or not at all."""
    with replacing(path) as temporary:
        whole.write(str(temporary), pretty=True)


def _test_case(case: Case) -> TestCase:
    made = TestCase(clean(case.name), clean(case.classname))
    if case.outcome:
        result = _RESULTS[case.outcome](clean(case.message), case.type if case.outcome != "skipped" else None)
        result.text = clean(case.details or case.message)
        made.result = result
    elif case.details:
        made.system_out = clean(case.details)
    return made

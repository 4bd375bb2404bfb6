"""``junit.xml`` of a regression report: one case an entry, the backend in its class name."""

from __future__ import annotations

from pathlib import Path

from junitparser.xunit2 import JUnitXml

from ebamcheck.regression.difference import Difference
from ebamcheck.regression.job import Regression
from ebamcheck.showing import junit

JUNIT = "junit.xml"

NAME = "ebamcheck.regress"

SKIPPED = ("new", "not run")
"""Verdicts on entries that there was nothing to hold against, or that could not run."""


def write_junit(regression: Regression, folder: Path) -> Path:
    """Write the file, whole or not at all; its times are 0, the true ones stand in ``timings.json``."""
    path = folder / JUNIT
    junit.write_junit(document(regression), path)
    return path


def document(regression: Regression) -> JUnitXml:
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

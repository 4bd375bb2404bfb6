"""``junit.xml`` of a regression report: one case an entry, the backend in its class name."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from ebamcheck.atomic_file import replacing
from ebamcheck.regression.difference import Difference
from ebamcheck.regression.job import Regression

JUNIT = "junit.xml"

NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot hold."""

SKIPPED = ("new", "not run")
"""Verdicts on entries that there was nothing to hold against, or that could not run."""


def write_junit(regression: Regression, folder: Path) -> Path:
    """Write the file, whole or not at all; it holds no times, they stand in ``timings.json``."""
    root = document(regression)
    ElementTree.indent(root)
    path = folder / JUNIT
    with replacing(path) as temporary:
        temporary.write_bytes(ElementTree.tostring(root, "utf-8", xml_declaration=True) + b"\n")
    return path


def document(regression: Regression) -> ElementTree.Element:
    """Build the tree: one suite, one case an entry."""
    cases = regression.differences
    counts = {
        "tests": str(len(cases)),
        "failures": str(sum(d.fails and d.verdict != "failed" for d in cases)),
        "errors": str(sum(d.verdict == "failed" for d in cases)),
    }
    root = ElementTree.Element("testsuites", {"name": "ebamcheck.regress", **counts})
    skipped = str(sum(d.verdict in SKIPPED for d in cases))
    suite = ElementTree.SubElement(
        root, "testsuite", {"name": "ebamcheck.regress", **counts, "skipped": skipped}
    )
    for difference in cases:
        _add(suite, difference)
    return root


def _add(suite: ElementTree.Element, difference: Difference) -> None:
    names = {"classname": f"ebamcheck.regress.{difference.key.backend}", "name": _name(difference)}
    case = ElementTree.SubElement(suite, "testcase", names)
    if difference.verdict in SKIPPED:
        ElementTree.SubElement(
            case, "skipped", {"message": _clean(difference.why or "there is no baseline to hold it against")}
        )
    elif difference.fails:
        head, *_ = lines = difference.lines()
        kind = "error" if difference.verdict == "failed" else "failure"
        said = ElementTree.SubElement(case, kind, {"message": _clean(head), "type": difference.verdict})
        said.text = _clean("\n".join(lines))


def _name(difference: Difference) -> str:
    settings = difference.title.removeprefix(f"{difference.key.model} {difference.key.backend}").strip()
    return _clean(f"{difference.key.model} {settings}".strip())


def _clean(text: str) -> str:
    return NOT_IN_XML.sub("\ufffd", text)

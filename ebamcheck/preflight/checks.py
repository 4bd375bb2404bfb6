"""One check of the preflight: what was looked at, with figure, limit and remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ebamcheck.findings import Finding

Level = Literal["pass", "warning", "fault"]

RUN, CHECK = "run", "check"
"""Jobs: all the way to a program, or slicing and comparison alone."""

EVERY = (RUN, CHECK)


@dataclass(frozen=True)
class PreflightCheck:
    """One check.

    Parameters
    ----------
    name
        What was looked at.
    level
        ``pass``, ``warning`` (to be looked at) or ``fault`` (this cannot come to a good end).
    text
        What is the case, without a full stop.
    figure, limit, unit
        What was found, and what it is held against; None where nothing was measured.
    remedy
        What to do about it.
    stops
        Jobs that a fault ends before they begin. Others go on, and their gates tell.
    """

    name: str
    level: Level
    text: str
    figure: float | None = None
    limit: float | None = None
    unit: str = ""
    remedy: str = ""
    stops: tuple[str, ...] = ()


def of_finding(name: str, finding: Finding, stops: tuple[str, ...] = ()) -> PreflightCheck:
    """Check that says what a finding says; a note passes."""
    return PreflightCheck(
        name,
        "pass" if finding.severity == "note" else finding.severity,
        finding.text,
        finding.figure,
        finding.limit,
        finding.unit,
        finding.remedy,
        stops if finding.severity == "fault" else (),
    )

"""Run the whole kit, all checks by name, against one slicer, and tell the outcome."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ebamcheck.backend import Slicer
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import models as installed_models
from ebamcheck.showing.short_text import text_table
from ebamcheck.testing import accuracy, laws, protocol
from ebamcheck.testing.subject import NO_LAYER, Figure, Raised, Subject, violations

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Check:
    """One check: a function from a subject to figures; those over their limit are violations.

    Parameters
    ----------
    name, summary, find
        As the table of ``ebamcheck conform`` shows them, and the function.

    Examples
    --------
    >>> from ebamcheck_models import CUBE
    >>> from ebamcheck_planecut import PlaneCut
    >>> def area(subject):
    ...     off = abs(subject.cut(CUBE.tessellate(0.1), [1.0]).areas()[0] - 400.0)
    ...     return [Figure("area", "cube", 0, off, 1e-9, "mm2 off")]
    >>> Check("area", "the area of a cube", area).run(Subject(PlaneCut))[0].violated
    False
    """

    name: str
    summary: str
    find: Callable[[Subject], list[Figure]]

    def __str__(self) -> str:
        return self.name.replace(" ", "-")

    def run(self, subject: Subject) -> list[Figure]:
        """Figures of a subject; whatever the slicer raises is a violation like any other."""
        try:
            return self.find(subject)
        except Raised as error:
            # The traceback is the slicer's own, for those who write it (--debug).
            LOGGER.debug("%s: %s", self.name, error, exc_info=error.__cause__)
            return [Figure(self.name, error.model, NO_LAYER, 1.0, 0.0, str(error))]
        except Exception as error:
            LOGGER.debug("%s", self.name, exc_info=error)
            text = f"it raised {type(error).__name__}: {' '.join(str(error).split())}"
            return [Figure(self.name, "error", NO_LAYER, 1.0, 0.0, text)]


def _check(function: Callable[[Subject], list[Figure]]) -> Check:
    summary = (function.__doc__ or "").strip().splitlines()[0]
    return Check(function.__name__.replace("_", " "), summary, function)


# Every check, in the order in which they are run and shown
CHECKS = (*map(_check, (*protocol.CHECKS, *accuracy.CHECKS)), *(Check(*law) for law in laws.LAWS))

SHOWN_SHARE = 0.005  # shares of a limit under this are mere rounding and shown as a plain pass


@dataclass(frozen=True)
class Outcome:
    """What one check found."""

    check: str
    summary: str
    figures: tuple[Figure, ...]

    @property
    def violations(self) -> list[Figure]:
        """Figures over their limit."""
        return violations(self.figures)

    @property
    def worst(self) -> Figure | None:
        """The figure that is the largest share of its limit, or further over it; None without figures."""
        return max(self.figures, key=_share, default=None)

    @property
    def verdict(self) -> str:
        """``pass``, ``FAIL``, or ``-`` where the check does not concern the slicer."""
        if not self.figures:
            return "-"
        return "FAIL" if self.violations else "pass"

    def cell(self) -> str:
        """The verdict, with the number of violations or the largest share of a limit."""
        if self.violations:
            return f"FAIL ({len(self.violations)} of {len(self.figures)})"
        share = 0.0 if self.worst is None else _share(self.worst)
        return f"{self.verdict} ({share:.2f})" if share >= SHOWN_SHARE else self.verdict


@dataclass(frozen=True)
class Conformance:
    """What the kit found out about one slicer under one choice of settings.

    Parameters
    ----------
    subject, outcomes
        Slicer and settings in words, and what each check found.

    Examples
    --------
    >>> found = Conformance("mine", (Outcome("bound", "stays within it", (Figure("bound", "cube", 0, 2.0, 1.0),)),))
    >>> found.passed, len(found.violations)
    (False, 1)
    """

    subject: str
    outcomes: tuple[Outcome, ...]

    @property
    def passed(self) -> bool:
        """Whether no figure is over its limit."""
        return not any(outcome.violations for outcome in self.outcomes)

    @property
    def violations(self) -> list[Figure]:
        """All figures over their limit."""
        return [figure for outcome in self.outcomes for figure in outcome.violations]

    def table(self) -> str:
        """Text for a terminal: one line a check, then every violation."""
        columns = [(o, "" if o.worst is None else _place(o.worst)) for o in self.outcomes]
        rows = [[o.check, o.cell(), len(o.figures), place, o.summary] for o, place in columns]
        told = [f"  {figure}" for figure in self.violations]
        head = f"{self.subject}: {'conforms' if self.passed else f'{len(told)} violations'}"
        table = text_table(["check", "verdict", "figures", "nearest its limit", ""], rows)
        return "\n".join([head, table, *told])

    def to_json(self) -> dict[str, Any]:
        """Return the same as plain values."""
        return {
            "subject": self.subject,
            "passed": self.passed,
            "checks": [
                {
                    "check": o.check,
                    "summary": o.summary,
                    "verdict": o.verdict,
                    "figures": len(o.figures),
                    "worst": None if o.worst is None else vars(o.worst),
                    "violations": [vars(figure) for figure in o.violations],
                }
                for o in self.outcomes
            ],
        }


def conform(
    name: str,
    models: Sequence[str] | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Conformance:
    """Run every check against an installed slicer.

    Parameters
    ----------
    name, models, settings
        Name in the registry; reference models to cut, by default all that are installed; the slicer's settings.
    progress
        Called with 1 after each check; there are ``len(CHECKS)``.

    Returns
    -------
    Conformance
        One outcome a check.

    Raises
    ------
    BackendMissing, SettingsError
        If the slicer is unknown or cannot run on this machine; if a model is unknown or a setting is wrong.

    Examples
    --------
    >>> conform("nosuch")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ebamcheck.errors.BackendMissing: unknown backend 'nosuch': ...
    """
    registry.available_slicer(name)
    # Its author asks for it: it runs in this process, a stranger's, too.
    slicer = registry.loaded_slicer(name)
    registry.slicer_settings(name, settings or {})
    return examine(Subject(slicer, settings, installed_models(models)), progress=progress)


def conform_control(name: str, machine: Mapping[str, Any] | None = None) -> Conformance:
    """Run every check of controls against an installed control, under settings of the machine section."""
    from ebamcheck.testing.control_checks import ControlSubject, control_figures

    subject = ControlSubject(name, machine or {})
    subject.config({})
    found = ((check, summary, tuple(figures)) for check, summary, figures in control_figures(subject))
    return Conformance(f"control {subject}", tuple(Outcome(*outcome) for outcome in found))


def examine(
    subject: Subject | Slicer | type[Slicer],
    checks: Iterable[Check] = CHECKS,
    progress: Callable[[int], None] | None = None,
) -> Conformance:
    """Run checks against a subject, or a slicer that need not be installed.

    Parameters
    ----------
    subject, checks, progress
        The slicer, its class, or one with settings and models; what to run; what is called with 1 after each check.

    Returns
    -------
    Conformance
        One outcome a check.

    Examples
    --------
    >>> from ebamcheck_planecut import PlaneCut
    >>> found = examine(PlaneCut, [check for check in CHECKS if check.name == "settings"])
    >>> found.passed, [outcome.verdict for outcome in found.outcomes]
    (True, ['pass'])
    """
    examined = subject if isinstance(subject, Subject) else Subject(subject)
    outcomes = []
    for check in checks:
        outcomes.append(Outcome(check.name, check.summary, tuple(check.run(examined))))
        if progress is not None:
            progress(1)
    return Conformance(str(examined), tuple(outcomes))


def markdown_table(found: Sequence[Conformance]) -> str:
    """Checks as rows and slicers as columns; in brackets the largest share of a limit that was needed.

    Parameters
    ----------
    found
        What was found out about each, by the same checks.

    Returns
    -------
    str
        A table in Markdown.

    Examples
    --------
    >>> one = Outcome("bound", "stays within it", (Figure("bound", "cube", 0, 0.5, 1.0),))
    >>> print(markdown_table([Conformance("mine", (one,))]))
    | check | mine |
    |---|---|
    | bound | pass (0.50) |
    """
    head = ["check", *(c.subject for c in found)]
    outcomes = zip(*(c.outcomes for c in found), strict=True)
    rows = [[row[0].check, *(outcome.cell() for outcome in row)] for row in outcomes]
    first, *rest = ["| " + " | ".join(row) + " |" for row in [head, *rows]]
    return "\n".join([first, "|" + "---|" * len(head), *rest])


def _share(figure: Figure) -> float:
    if figure.limit > 0.0:
        return figure.value / figure.limit
    return float("inf") if figure.violated else 0.0


def _place(figure: Figure) -> str:
    return f"{figure.value:.3g} of {figure.limit:.3g}, {figure.model}" if figure.limit > 0.0 else ""

"""The test kit as pytest classes, one for slicers and one for controls; the only module of the kit that imports pytest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import pytest

from ebamcheck.backend import Slicer
from ebamcheck.plugins.registry import models as installed_models
from ebamcheck.testing.conformance import CHECKS, Check
from ebamcheck.testing.control_checks import CONTROL_CHECKS, ControlSubject
from ebamcheck.testing.subject import Figure, Subject, violations


class SlicerSuite:
    """Derive a class whose name begins with ``Test``, name the slicer, and pytest runs the whole kit on it.

    Attributes
    ----------
    slicer, settings, models
        The slicer under test, its class or an instance; choices of its settings that are tested, one after another; names of the
        reference models that it cuts, None for all that are installed.

    Examples
    --------
    >>> from ebamcheck_planecut import PlaneCut
    >>> class TestPlaneCut(SlicerSuite):
    ...     slicer = PlaneCut
    ...     models = ("cube",)
    """

    slicer: ClassVar[Slicer | type[Slicer]]
    settings: ClassVar[Sequence[Mapping[str, Any]]] = ({},)
    models: ClassVar[Sequence[str] | None] = None

    @pytest.fixture(scope="class")
    @classmethod
    def subjects(cls) -> list[Subject]:
        """One subject for each choice of settings; skips where this machine cannot run the slicer."""
        found = [Subject(cls.slicer, chosen, installed_models(cls.models)) for chosen in cls.settings]
        probe = found[0].slicer.probe()
        if not probe.available:
            pytest.skip(f"{found[0].slicer.name} is not available: {probe.why}")
        return found

    @pytest.mark.parametrize("check", CHECKS, ids=str)
    def test_conformance(self, subjects: list[Subject], check: Check) -> None:
        """Fail with every figure that is over its limit."""
        broken = [f"{subject}: {figure}" for subject in subjects for figure in violations(check.run(subject))]
        if broken:
            pytest.fail(f"{check.name}: {check.summary}\n" + "\n".join(broken), pytrace=False)


class ControlSuite:
    """Derive a class whose name begins with ``Test``, name the control, and pytest runs all checks of controls on it.

    Attributes
    ----------
    control, machine
        Name of the control under test, as its entry point has it, and settings of the machine section.

    Examples
    --------
    >>> class TestPlain(ControlSuite):
    ...     control = "plain-gcode"
    """

    control: ClassVar[str]
    machine: ClassVar[Mapping[str, Any]] = {}

    @pytest.fixture(scope="class")
    @classmethod
    def subject(cls) -> ControlSubject:
        """The control, with curves and plan of a small stack."""
        return ControlSubject(cls.control, cls.machine)

    @pytest.mark.parametrize("check", CONTROL_CHECKS, ids=lambda check: check.__name__.replace("_", "-"))
    def test_conformance(self, subject: ControlSubject, check: Callable[[ControlSubject], list[Figure]]) -> None:
        """Fail with every figure that is over its limit."""
        if not subject.control.is_read and check is not CONTROL_CHECKS[0]:
            pytest.skip(f"programs of {subject} are not read back")
        broken = [str(figure) for figure in violations(check(subject))]
        if broken:
            pytest.fail("\n".join(broken), pytrace=False)

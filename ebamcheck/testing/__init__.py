"""The conformance kit: write a slicer, derive one class, and know whether it can be trusted; docs/your-slicer.md says what is
checked.

A slicer keeps the protocol of :mod:`ebamcheck.backend` and is registered under the entry point group ``ebamcheck.backends``. To
test it, put this into a test file of its package and run pytest; without pytest, once it is installed: ``ebamcheck conform
my-slicer``::

    from ebamcheck.testing import SlicerSuite
    from my_slicer import MySlicer

    class TestMySlicer(SlicerSuite):
        slicer = MySlicer
        settings = ({}, {"pixel_mm": 0.2})   # optional: the choices of settings to test
        models = ("cube", "torus")           # optional: the reference models; default: all installed

A :class:`BackendFailed` is an answer where the part is open or its shells overlap; on any other solid it is a violation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebamcheck.errors import BackendFailed
from ebamcheck.names_on_demand import on_demand
from ebamcheck.testing.conformance import CHECKS, Check, Conformance, conform, examine, markdown_table
from ebamcheck.testing.subject import Figure, Subject, violations

if TYPE_CHECKING:
    from ebamcheck.testing.suite import ControlSuite, SlicerSuite

__all__ = [
    "CHECKS",
    "BackendFailed",
    "Check",
    "Conformance",
    "ControlSuite",
    "Figure",
    "SlicerSuite",
    "Subject",
    "conform",
    "examine",
    "markdown_table",
    "violations",
]


# They load when they are asked for, so that the command line needs no pytest.
__getattr__ = on_demand(__name__, {"ControlSuite": "suite", "SlicerSuite": "suite"})

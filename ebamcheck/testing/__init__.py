"""The conformance kit: write a slicer, derive one class, and know whether it can be trusted.

A slicer is a class that keeps the protocol of :mod:`ebamcheck.backend`, registered under the entry point
group ``ebamcheck.backends``. To test it, put this into a test file of its package::

    from ebamcheck.testing import SlicerSuite
    from my_slicer import MySlicer

    class TestMySlicer(SlicerSuite):
        slicer = MySlicer
        settings = ({}, {"pixel_mm": 0.2})   # optional: the choices of settings to test
        models = ("cube", "torus")           # optional: the reference models; default: all installed

and run pytest. Without pytest, once it is installed: ``ebamcheck conform my-slicer``.

What is checked, in this order (each check is a plain function, see :data:`CHECKS`):

protocol
    Attributes and signatures; settings that refuse unknown keys; a probe that never raises; blocks of layers
    in any order, bit for bit the same; canonical form and orientation; empty layers; labels; progress.
promise
    With r = ``error_bound_mm``: the exact section eroded by r lies in the result, and the result in the
    section dilated by r, on solids, on walls, slits, posts, pores and wedges about as thin as r, and on the
    reference models. A bound more than three times the worst case found is idle, and fails as well. Round
    sections lie to no side, topology is right, and an exact slicer's points lie on the exact contours.
rules
    Planes through vertices and faces, overlapping shells and open surfaces, as the class declares them.
laws
    Moving, turning, mirroring and scaling a part does the same to its sections; the order of facets and
    vertices and subdivision do nothing; areas integrate to the volume; rings follow the Euler number.

The exact section of a mesh that the kit compares with is computed here by plain means
(:mod:`ebamcheck.testing.solids`), from your part alone: no other slicer takes part.

A :class:`BackendFailed` is an answer where the part is open or its shells overlap; on any other solid it
is a violation. Every violation names the check, solid, layer, value, limit and place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ebamcheck.errors import BackendFailed
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


def __getattr__(name: str) -> Any:
    """Load the pytest class when it is asked for, so that the command line needs no pytest."""
    if name in ("ControlSuite", "SlicerSuite"):
        from ebamcheck.testing import suite

        return getattr(suite, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""All checks of the kit, by name."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from ebamcheck.testing import accuracy, laws, protocol
from ebamcheck.testing.figures import NO_LAYER, Figure
from ebamcheck.testing.subject import Raised, Subject

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Check:
    """One check: a function from a subject to figures; those over their limit are violations.

    Parameters
    ----------
    name, summary
        As the table of ``ebamcheck conform`` shows them.
    find
        The function.

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


CHECKS: tuple[Check, ...] = tuple(
    _check(function)
    for function in (
        protocol.attributes,
        protocol.signatures,
        protocol.settings,
        protocol.probe,
        protocol.context,
        protocol.blocks,
        protocol.canonical_form,
        protocol.orientation,
        protocol.out_of_range,
        protocol.labels,
        protocol.progress,
        protocol.declared_bound,
        protocol.open_surfaces,
        accuracy.bound_held,
        accuracy.bound_attacked,
        accuracy.bound_not_idle,
        accuracy.no_shift,
        accuracy.topology,
        accuracy.points_on_contours,
        accuracy.coplanar_planes,
        accuracy.inside_rule,
        accuracy.touching_bodies,
        accuracy.reference_models,
        laws.translation,
        laws.rotation,
        laws.mirror,
        laws.scale,
        laws.upside_down,
        laws.large_offset,
        laws.facet_order,
        laws.vertex_order,
        laws.subdivision,
        laws.union_of_parts,
        laws.volume,
        laws.ring_parity,
    )
)
"""Every check, in the order in which they are run and shown."""

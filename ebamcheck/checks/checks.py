"""How checks of a program are made together, and how the worst place of many becomes one check."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.kernels import run_in_order
from ebamcheck.numeric.rings import Bools, Ints
from ebamcheck.result import Check as Check

CheckGroup = Callable[[], Sequence[Check]]  # Checks that are made together


def checks_of(groups: Sequence[CheckGroup]) -> list[Check]:
    """Make all groups of checks, on all threads; results come in the order of the groups.

    The last group begins first: the long ones stand at the end.
    """
    last = len(groups) - 1
    found = list(run_in_order(lambda k, _: groups[last - k](), range(len(groups) + 1)))
    return [check for group in reversed(found) for check in group]


def count_check(name: str, places: list[tuple[str, str]], good: str) -> Check:
    """Check that there is no fault; `places` are (where, what) of those there are, in order."""
    if not places:
        return Check(name, True, 0.0, 0.0, "faults", "", good)
    where, what = places[0]
    more = f" (and {len(places) - 1} more)" if len(places) > 1 else ""
    return Check(name, False, float(len(places)), 0.0, "faults", where, what + more)


def row_faults(nc: NCProgram, rows: Bools | Ints, what: str) -> list[tuple[str, str]]:
    """Places of motions that are wrong for the same reason."""
    index = np.flatnonzero(rows) if np.asarray(rows).dtype == np.bool_ else np.asarray(rows)
    return [(nc.where(int(row)), what) for row in index]


def lines_of(nc: NCProgram, rows: Ints) -> list[tuple[int, int]]:
    """File and line, from 1, of motions: each once, in the order of the text."""
    lines = 1 + int(nc.line[rows].max(initial=0))
    file, line = np.divmod(np.unique(nc.file[rows].astype(np.int64) * lines + nc.line[rows]), lines)
    return list(zip(file.tolist(), line.tolist(), strict=True))


def worst_check(
    name: str, nc: NCProgram, rows: Ints, values: ArrayLike, limit: float, unit: str, what: str
) -> Check:
    """Check that no value is over the limit; one that is no number is over any."""
    values = np.asarray(values, dtype=np.float64)
    if not values.size:
        return Check(name, True, 0.0, limit, unit, "", f"{what}: nothing to check")
    known = np.where(np.isnan(values), np.inf, values)
    worst = int(np.argmax(known))
    value = float(known[worst])
    told = f"at most {value:.6g} {unit}" if np.isfinite(value) else "not known"
    return Check(name, value <= limit, value, limit, unit, nc.where(int(rows[worst])), f"{what}: {told}")


def event_faults(nc: NCProgram, *rules: tuple[Bools, str | Callable[[int], str]]) -> list[tuple[str, str]]:
    """Places of events that break a rule, in their order, and what there is to say of each.

    Parameters
    ----------
    rules
        Which events (E,) break it, and a text into which their ``name``, ``value`` and what they ``said`` behind their begin are
        filled, or a function of the event. Of an event that breaks several, the first rule is named first.
    """
    found = sorted((i, n) for n, (which, _) in enumerate(rules) for i in np.flatnonzero(which).tolist())
    return [(nc.where_event(i), _said(nc, i, rules[n][1])) for i, n in found]


def _said(nc: NCProgram, event: int, text: str | Callable[[int], str]) -> str:
    if callable(text):
        return text(event)
    events = nc.events
    return text.format(name=events.name[event], value=events.value[event], said=events.said(event))

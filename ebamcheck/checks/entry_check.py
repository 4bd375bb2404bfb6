"""Check of a program that begins at a layer: what it commands is the end of the whole program, which was proved.

Nothing of the part is judged anew. The motions from its layer on are those of the whole, value by value; its way there comes from above
all that stands; and its first blocks establish a state of their own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ebamcheck.checks.checks import PLACE_MM, count_check
from ebamcheck.checks.header_checks import Truth, status_check
from ebamcheck.checks.state_checks import machine_state_checks
from ebamcheck.checks.text_checks import text_checks
from ebamcheck.nc.codes import BEAM_VALUES
from ebamcheck.nc.motions import RAPID, NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

COLUMNS = ("kind", "feed_mm_min", "beam", "wire", "power_w", "wire_mm_s")
VALUES = (*BEAM_VALUES, "wire_mm_s")
GEOMETRY = ("end", "coefficients", "arc")


def entry_check(
    whole: NCProgram, entry: NCProgram, layer: int, z_mm: float, config: Config, validated: bool
) -> Check:
    """Check a program that begins at a layer, from 1, against the whole one; it is to be called `validated` as that is."""
    faults = list(_faults(whole, entry, layer, z_mm, config, Truth(validated)))
    good = f"{len(entry)} motions from layer {layer} on are those of the whole program"
    return count_check("entry", faults, good)


def _faults(
    whole: NCProgram, entry: NCProgram, layer: int, z_mm: float, config: Config, truth: Truth
) -> Iterator[tuple[str, str]]:
    made = (status_check(entry, truth), *text_checks(entry, config), *machine_state_checks(entry, config))
    for check in made:
        if not check.passed:
            yield check.where, f"{check.name}: {check.text}"
    main = f"{entry.files[0].name}:1"
    laid = np.flatnonzero(entry.deposit)
    if len(entry) > len(whole) or not laid.size:
        yield main, f"{len(entry)} motions, the whole program has {len(whole)}"
        return
    offset = len(whole) - len(entry)
    before = np.flatnonzero(whole.deposit[:offset])
    first, lower = int(laid[0]), before.size and not whole.end[before[-1], 2] < z_mm - PLACE_MM
    if not abs(entry.end[first, 2] - z_mm) <= PLACE_MM or lower:
        yield entry.where(first), f"begins at Z {entry.end[first, 2]:g}, layer {layer} lies at {z_mm:g}"
    # First motion that is another than that of the whole program; places that nothing has given yet are left to the way in.
    alike = np.ones(len(entry), np.bool_)
    for name in COLUMNS:
        alike &= _same(getattr(entry, name), getattr(whole, name)[offset:])
    unknown = ~np.isfinite(entry.start).all(axis=1)
    for name in GEOMETRY:
        mine, other = getattr(entry, name), getattr(whole, name)[offset:]
        same = _same(mine, other).reshape(len(entry), -1)
        given = ~np.isnan(mine).reshape(len(entry), -1)
        alike &= np.where(unknown, (same | ~given).all(axis=1), same.all(axis=1))
    # The wire's speed of before is set anew with the first bead.
    idle = ~entry.wire & ~whole.wire[offset:] & ~entry.beam
    same_way = (entry.kind == whole.kind[offset:]) & (idle & (entry.kind == RAPID))
    alike |= same_way & _same(entry.end, whole.end[offset:]).all(axis=1)
    alike |= same_way & unknown
    for row in np.flatnonzero(~alike)[:1].tolist():
        yield entry.where(row), "is another motion, or at other values, than in the whole program"
    yield from _other_events(whole, entry, offset, first)
    # What the way to the first bead does that is no rise, travel and descent by rapids, beam and wire off.
    way = np.arange(first)
    rise = z_mm + config.machine.clearance_mm
    bad = (entry.kind[way] != RAPID) | entry.beam[way] | entry.wire[way]
    for row in way[bad][:1].tolist():
        yield entry.where(row), "the way to the first bead is none of rapids with beam and wire off"
    if not way.size or not entry.end[0, 2] >= rise or not np.isnan(entry.end[0, :2]).all():
        yield entry.beginning, f"does not begin with a rise to Z {rise:g} or above, from wherever the tool is"
    low = np.fmin(entry.start[way[1:], 2], entry.end[way[1:], 2]) < rise
    start, end = entry.start[way[1:], :2], entry.end[way[1:], :2]
    aside = ~((start == end) & (end == entry.start[first, :2])).all(axis=1)
    for row in way[1:][low & aside][:1].tolist():
        yield entry.where(row), f"goes below Z {rise:g} elsewhere than over the first bead"
    if not _same(entry.start[first], whole.start[first + offset]).all():
        what = "the first bead begins at another place than in the whole program, or at one that nothing has given"
        yield entry.where(first), what


def _other_events(whole: NCProgram, entry: NCProgram, offset: int, first: int) -> Iterator[tuple[str, str]]:
    """First wait, switch or value from the first bead on that the whole program does not have there, or has otherwise."""
    # Motions alone tell nothing of waits, without which the part is too warm where the next bead comes.
    at = [np.flatnonzero(nc.events.row >= row) for nc, row in ((entry, first), (whole, first + offset))]
    for name in VALUES:
        # What was set last before the motion; NaN where nothing was.
        both = ((entry, first), (whole, first + offset))
        mine, other = (nc.events.chosen(nc.events.row <= row).set_before(name)[-1:] for nc, row in both)
        if not _same(mine, other).all():
            what = f"{name} is {mine[0]:g} at the first bead, {other[0]:g} in the whole program"
            yield entry.where(first), what
    count = min(at[0].size, at[1].size)
    a, b = entry.events.chosen(at[0][:count]), whole.events.chosen(at[1][:count])
    alike = (a.row + offset == b.row) & _same(a.value, b.value)
    alike &= np.array([one == two for one, two in zip(a.name, b.name, strict=True)], np.bool_)
    if not alike.all():
        i = int(np.argmin(alike))
        told = f"{a.name[i]} {a.value[i]:g}, in the whole program {b.name[i]} {b.value[i]:g}"
        yield entry.where_event(int(at[0][i])), f"has {told} there, or at another motion"
    elif at[0].size > count:
        i = int(at[0][count])
        yield entry.where_event(i), f"has {entry.events.name[i]} in place of nothing"
    elif at[1].size > count:
        place = entry.where_event(int(at[0][-1]) if count else 0)
        yield place, f"lacks {whole.events.name[at[1][count]]} in place of nothing"


def _same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((a == b) | (np.isnan(a) & np.isnan(b)) if a.dtype.kind == "f" else a == b)

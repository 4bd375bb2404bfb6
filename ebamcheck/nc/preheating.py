"""Preheating subprograms taken out of a program that was read: they lay no bead, and have checks of their own."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from ebamcheck.nc.codes import FOCUS
from ebamcheck.nc.files import layer_of_preheat
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Bools, Ints

OFF = ("beam_off", "wire_stop")  # Commands that come before a scan
# Columns with a row for each motion.
OF_MOTIONS = (
    "file", "line", "layer", "kind", "start", "end", "coefficients", "arc", "feed_mm_min", "beam", "wire", "power_w",
    "wire_mm_s", "ring", "island", "turn", "goes_on",
)  # fmt: skip


def without_preheating(nc: NCProgram, in_layers: bool = False) -> NCProgram:
    """Return a program with the motions and events of its preheating scans apart.

    A scan is told by the file that it stands in, or, where scans stand `in_layers`, by the focus: from where it is set out to where
    it is taken back. What runs there stays in the order in which it runs; positions of the rest begin where the scan before left
    the tool.
    """
    if in_layers:
        return _by_focus(nc)
    stem = nc.files[0].name.rpartition(".")[0]
    of_file = [layer_of_preheat(stem, file.name.rpartition(".")[0]) for file in nc.files]
    if all(layer is None for layer in of_file):
        return nc
    layer = np.array([-1 if found is None else found for found in of_file], np.int64)
    apart = layer[nc.file] >= 0
    scans = rows_of(nc, apart, layer[nc.events.file] >= 0)
    scans = replace(scans, layer=layer[scans.file], layer_files=())
    return replace(rows_of(nc, ~apart, layer[nc.events.file] < 0), preheating=scans)


def _by_focus(nc: NCProgram) -> NCProgram:
    """Scans told by the focus, each with the commands right before it that switch beam and wire off."""
    e, focus = nc.events, nc.events.named(FOCUS)
    out = focus & (e.value != 0.0)
    within = e.since(out, focus & ~out)
    # What comes next, but for the commands that switch off.
    others = np.flatnonzero(~e.named(*OFF))
    ahead = np.append(others, len(e) - 1)[np.searchsorted(others, np.arange(len(e)))]
    before = e.named(*OFF) & (out & ~within[:-1])[ahead] & (e.file == e.file[ahead])
    events = before | out | within[:-1]
    motions = within[np.searchsorted(e.row, np.arange(len(nc)), side="right")]
    if not events.any():
        return nc
    scans = replace(rows_of(nc, motions, events), layer_files=())
    return replace(rows_of(nc, ~motions, ~events), preheating=scans)


def rows_of(nc: NCProgram, motions: Bools, events: Bools) -> NCProgram:
    """Some motions and some events of a program, each event before the motion that it came before."""
    assert {field.name for field in fields(nc)} >= set(OF_MOTIONS)
    kept = {name: getattr(nc, name)[motions] for name in OF_MOTIONS}
    before: Ints = np.concatenate([[0], np.cumsum(motions)]).astype(np.int64)
    found = nc.events.chosen(events)
    found = replace(found, row=before[found.row])
    table = None if nc.table is None else nc.table.rows(motions)
    return replace(nc, events=found, table=table, **kept)

"""The state before each event of a program, against a run through its events one by one."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from limit_cases import cube
from limits_of_heat import preheated

from ebamcheck.checks.checks import event_faults
from ebamcheck.checks.preheating import preheat_checks
from ebamcheck.nc.timeline import Events, Kind

NAMES = (
    "beam_on", "beam_off", "wire_start", "wire_stop", "current_ma", "power_w", "layer_pause_s", "dwell_s", "M0", "G64",
    "call PART_L0001", "lacks M71", "not along a bead H1={current_ma}", "frame lacks X Y", "table axis A", "RET", "CTOL",
)  # fmt: skip


def chance(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 200))
    names = tuple(str(name) for name in rng.choice(NAMES, count))
    return Events(
        rng.integers(0, 3, count), np.arange(count), np.sort(rng.integers(0, 50, count)), names, rng.uniform(0.0, 9.0, count)
    )  # fmt: skip


PROGRAMS = [
    *map(chance, range(20)),
    cube().nc.events,
    preheated().nc.events,
    preheated().nc.preheating.events,
]


@pytest.mark.parametrize("events", PROGRAMS)
def test_the_state_before_each_event_is_that_of_a_run_through_them(events):
    beam = wire = False
    known, lit, states = {}, -1, []
    for i, name in enumerate([*events.name, ""]):
        states.append((beam, wire, known.get("current_ma"), lit))
        if not name:
            break
        beam = name == "beam_on" or (beam and name != "beam_off")
        wire = name == "wire_start" or (wire and name != "wire_stop")
        lit = int(events.row[i]) if name == "beam_on" else lit
        known[name] = float(events.value[i])
    current = [None if np.isnan(v) else v for v in events.set_before("current_ma").tolist()]
    rows = events.row_of_latest(events.kind == Kind.BEAM_ON).tolist()
    found = zip(events.beam.tolist(), events.wire.tolist(), current, rows, strict=True)
    assert list(found) == states


@pytest.mark.parametrize("events", PROGRAMS)
def test_files_are_stayed_in_one_after_the_other(events):
    runs = list(events.by_file())
    assert [name for run in runs for name in run.name] == list(events.name)
    assert all(np.unique(run.file).size <= 1 for run in runs)
    assert all(a.file[0] != b.file[0] for a, b in pairwise(runs))


def test_every_event_has_a_kind_and_says_what_stands_behind_its_begin():
    events = Events(*np.zeros((3, len(NAMES)), np.int64), NAMES, np.full(len(NAMES), np.nan))
    assert [Kind(kind).name for kind in events.kind] == [
        "BEAM_ON", "BEAM_OFF", "WIRE_START", "WIRE_STOP", "VALUE", "VALUE", "WAIT", "WAIT", "STOP", "WORD",
        "CALL", "LACKS", "NOT_ALONG", "FRAME_LACKS", "TABLE_AXIS", "END", "TOLERANCE",
    ]  # fmt: skip
    said = [events.said(i) for i in range(len(events))]
    assert said[9:16] == ["G64", "PART_L0001", "M71", "H1={current_ma}", "X Y", "A", "RET"]
    assert events.named("RET", "M0", "no such word").sum() == 2


def test_faults_come_in_the_order_of_the_text_and_of_the_rules():
    nc = cube().nc
    on = nc.events.kind == Kind.BEAM_ON
    first, second = np.flatnonzero(on)[:2].tolist()
    only = np.arange(len(on)) == second
    faults = event_faults(nc, (only, "{name} alone"), (on, lambda i: f"at {i}"))
    assert faults[:3] == [
        (nc.where_event(first), f"at {first}"),
        (nc.where_event(second), "beam_on alone"),
        (nc.where_event(second), f"at {second}"),
    ]
    assert len(faults) == on.sum() + 1


def test_a_program_that_calls_nothing_is_told_that_its_plate_is_not_preheated():
    subject = preheated()
    events = subject.nc.events
    nc = replace(subject.nc, events=events.chosen(events.kind != Kind.CALL))
    found = {check.name: check for check in preheat_checks(nc, subject.config, None)}
    assert not found["preheat calls"].passed
    assert found["preheat calls"].text.startswith("the base plate is not preheated")

"""The one table of beads against two definitions of a bead by themselves, motion by motion, and its columns against loops."""

from __future__ import annotations

import numpy as np
import pytest
from limit_cases import cube, program_of
from limits_of_heat import preheated
from small_parts import SHAPES, made

from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.program import read_program


def begins_by_beam(nc):
    """First motions of beads as the beam lays them: it is switched on, or the layer or the role changes."""
    lit, before, found = rows_of(nc, "beam_on"), None, []
    for row in np.flatnonzero(nc.deposit).tolist():
        role = (nc.layer[row], nc.ring[row], nc.island[row])
        if before is None or row != before[0] + 1 or row in lit or role != before[1]:
            found.append(row)
        before = row, role
    return found


def begins_by_metal(nc):
    """First motions of beads as metal lies: beam or wire are switched on, or the height changes."""
    switched, before, found = rows_of(nc, "beam_on") | rows_of(nc, "wire_start"), None, []
    for row in np.flatnonzero(nc.beam | nc.wire).tolist():
        if before is None or row != before + 1 or row in switched or nc.end[row, 2] != nc.end[before, 2]:
            found.append(row)
        before = row
    return found


def rows_of(nc, event):
    return {int(row) for row, name in zip(nc.events.row, nc.events.name, strict=True) if name == event}


def differences(nc):
    """How many beads begin elsewhere by the table than by each of the two definitions."""
    found = set(nc.beads.first.tolist())
    laid = set(nc.beads.among(np.flatnonzero(nc.deposit)).first.tolist())
    return len(found ^ set(begins_by_metal(nc))), len(laid ^ set(begins_by_beam(nc)))


@pytest.mark.parametrize("shape", SHAPES)
def test_both_definitions_find_the_same_beads_in_sound_programs(shape, tmp_path):
    part = made(shape)
    nc = read_program(write_program(part.beads, part.plan, part.config, tmp_path).main, part.config)
    assert len(nc.beads) > 4
    assert differences(nc) == (0, 0)


def test_both_definitions_find_the_same_beads_of_scans_and_of_layers_below_them():
    nc = preheated().nc
    assert differences(nc) == (0, 0)
    assert differences(nc.preheating) == (0, 0)


def test_definitions_differ_where_the_wire_starts_within_a_bead_or_its_height_changes():
    sound = program_of([[[(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]]])
    middle = int(np.flatnonzero(sound.nc.deposit)[1])
    assert differences(sound.nc) == (0, 0)
    assert differences(sound.with_event(middle, "wire_start").nc) == (0, 1)
    # It rises in one motion and falls back in the next.
    assert differences(sound.with_ends(middle, 0.1, 2).nc) == (0, 2)


def test_columns_are_those_of_the_motions_of_each_bead():
    nc = cube().nc
    for beads in (nc.beads, nc.beads.among(np.flatnonzero(nc.deposit & (nc.ring >= 0)))):
        length, power = nc.lengths[beads.rows], nc.power_w[beads.rows]
        middle, whole = beads.middles(length)
        for k in range(len(beads)):
            mine = np.flatnonzero(beads.bead == k)
            assert beads.rows[mine].tolist() == list(range(beads.first[k], beads.last[k] + 1))
            assert beads.total(length)[k] == pytest.approx(whole[k])
            assert whole[k] == pytest.approx(length[mine].sum())
            assert middle[mine] == pytest.approx(np.cumsum(length[mine]) - 0.5 * length[mine])
            assert beads.greatest(power)[k] == power[mine].max()
        assert set(beads.spread(np.arange(len(beads)), len(nc))[beads.rows]) == set(range(len(beads)))


def test_a_bead_is_several_where_others_of_its_motions_part_it():
    nc = cube().nc
    rows = np.arange(nc.beads.first[0], nc.beads.last[0] + 1)
    assert len(nc.beads.among(rows)) == 1
    assert len(nc.beads.among(np.delete(rows, 1))) == 2
    assert len(nc.beads.among(rows[:0])) == 0
    assert nc.beads.among(rows[:0]).total(np.zeros(0)).size == 0


@pytest.mark.parametrize("shape", ["block with a channel", "two spheres"])
def test_chords_join_the_ends_of_motions_and_keep_to_their_step(shape, tmp_path):
    part = made(shape)
    nc = read_program(write_program(part.beads, part.plan, part.config, tmp_path).main, part.config)
    rows = np.flatnonzero(nc.deposit)[::3]
    owner, chords = nc.chords(rows, 0.5)
    assert (nc.kind[rows] > 1).any()
    assert owner.tolist() == sorted(owner.tolist())
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    last = np.append(first[1:], owner.size) - 1
    assert owner[first].tolist() == rows.tolist()
    assert (chords[first, :2] == nc.start[rows, :2]).all()
    assert chords[last, 2:] == pytest.approx(nc.end[rows, :2], abs=1e-6)
    inner = np.setdiff1d(np.arange(owner.size), first)
    assert (chords[inner, :2] == chords[inner - 1, 2:]).all()
    length = np.hypot(*(chords[:, 2:] - chords[:, :2]).T)
    curved = nc.kind[owner] > 1
    assert length[curved].max() <= 0.5 + 1e-9
    assert (np.bincount(owner)[rows[nc.kind[rows] <= 1]] == 1).all(), "a straight motion is one chord"
    assert np.bincount(owner, length, minlength=len(nc))[rows] == pytest.approx(nc.lengths[rows], rel=2e-3)
    rows, owner = rows[nc.kind[rows] > 1], owner[curved]
    index, points = nc.lines(rows, 0.5)
    assert points.shape == (owner.size + rows.size, 2)
    assert (np.bincount(index) == np.bincount(np.searchsorted(rows, owner)) + 1).all()

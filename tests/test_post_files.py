"""Files of the post-processors: stamped and deterministic, nothing written over, a table for a heat simulator."""

from __future__ import annotations

import numpy as np
import pytest
from nc_stack import hatch, make_curves, make_plan, stack
from posted_curves import CONTROLS, TEXT_CONTROLS, TOLERANCE_MM, away, curve_points, smooth_curves, wrote

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.program import mark_validated, read_program
from ebamcheck.settings.config import Config

# -- decimals --------------------------------------------------------------------------------------


def test_decimals_follow_the_tolerances():
    auto = Config().machine
    assert auto.printed_decimals == 6
    assert auto.model_copy(update={"line_tolerance_mm": 1e-5}).printed_decimals == 7
    assert Config().changed(machine={"decimals": 4}).machine.printed_decimals == 4


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("control", CONTROLS)
def test_every_post_is_stamped_and_deterministic(control, tmp_path):
    curves, plan = stack(count=2)
    files, _ = wrote(tmp_path, {"control": control}, curves, plan, "one")
    again, _ = wrote(tmp_path, {"control": control}, curves, plan, "two")
    assert files.sha256 == again.sha256
    assert not files.validated
    assert sum(files.blocks.values()) > 10
    before = {name: (files.folder / name).read_bytes() for name in files.names}
    stamped = mark_validated(files)
    for name in files.names:
        after = (files.folder / name).read_bytes()
        assert after != before[name]
        assert after == before[name].replace(b"; NOT VALIDATED", b"; VALIDATED", 1)
    assert mark_validated(stamped, False).sha256 == files.sha256
    wrote(tmp_path, {"control": control}, curves, plan, "one")  # takes the place of its own


@pytest.mark.parametrize("control", CONTROLS)
def test_no_post_writes_over_other_files(control, tmp_path):
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "Path.txt").write_text("Mode of transport\ntrain\n")
    with pytest.raises(SettingsError, match=r"Path\.txt"):
        wrote(tmp_path, {"control": control}, smooth_curves())


def test_an_unknown_control_is_refused_by_name(tmp_path):
    with pytest.raises(SettingsError, match="linuxcnc"):
        wrote(tmp_path, {"control": "heidenhain"}, smooth_curves())


# -- heat simulator --------------------------------------------------------------------------------


def test_the_path_of_a_heat_simulator_is_that_of_the_beads(tmp_path):
    curves, plan = smooth_curves(), make_plan([0.8], [(0, hatch(-10, -10, 3, 12.0))])
    path = wrote(tmp_path, {"control": "3dthesis"}, curves, plan, "3dthesis")[0].main
    assert path.name == "Path.txt"
    thesis = np.loadtxt(path, skiprows=1)
    assert thesis[0, 0] == 1  # it begins with a spot
    assert (thesis[:, 5] > 0).all()
    line = thesis[:, 0] == 0
    assert (thesis[line, 4] == 1).all()
    assert (thesis[~line, 4] == 0).all()
    assert (thesis[line, 5] == 0.01).all()  # 10 mm/s in m/s
    assert (~line).sum() == 4  # three contours, and one hatch whose turns are under beam
    whole = np.vstack([curve_points(curves, p, 4000) for p in range(4)])
    ring = thesis[: np.flatnonzero(~line)[1], 1:3]
    assert away(ring, whole) < 1e-4  # the chords of the dense curve
    assert away(whole[::40], ring) < TOLERANCE_MM
    jump = np.linalg.norm(np.diff(thesis[:, 1:4], axis=0), axis=1)[~line[1:]]
    assert thesis[~line, 5][1:] == pytest.approx(jump / 100.0, rel=1e-6)


@pytest.mark.parametrize("control", CONTROLS[3:])
def test_path_tables_are_no_programs(control, tmp_path):
    files, config = wrote(tmp_path, {"control": control}, smooth_curves())
    with pytest.raises(InputError, match=r":1:1: the path table of a heat simulator"):
        read_program(files.main, config)


def test_a_stack_without_layers_is_a_file_that_does_nothing(tmp_path):
    for control in CONTROLS:
        files, config = wrote(tmp_path, {"control": control}, make_curves([], [], []))
        if control in TEXT_CONTROLS:
            assert not read_program(files.main, config).deposit.any()

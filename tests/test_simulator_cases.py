"""Cases of heat simulators: whole folders, read again by small readers of their formats that share nothing with us."""

from __future__ import annotations

import os
from itertools import pairwise

import numpy as np
import pytest
from nc_stack import stack

from ebamcheck.controls.thesis import case_post, heat_path
from ebamcheck.errors import SettingsError
from ebamcheck.nc.control import simulators
from ebamcheck.program import write_program
from ebamcheck.settings.config import Config
from ebamcheck.writing.bead_ends import driven_path

FILES = {
    *("Path.txt", "ParamInput.txt", "Mode.txt", "Material.txt", "Beam.txt", "Domain.txt", "Output.txt"),
    *("Settings.txt", "run.sh"),
}
"""What 3DThesis opens, by its own sources and tutorials."""

PROCESS = {"ramp_up_mm": 3.0, "layer_pause_s": 7.0}


def config(control, **process):
    return Config().changed(machine={"control": control}, process={**PROCESS, **process})


@pytest.fixture(params=simulators())
def control(request):
    return request.param


def wrote(tmp_path, control, layer=1, **process):
    settings = config(control, **process)
    files = case_post(control)(*stack(), settings, tmp_path / control, layer=layer)
    return files, settings


# -- readers -----------------------------------------------------------------------------------------


def thesis_groups(path):
    """Groups of keywords as 3DThesis's Init.cpp reads them: words by blanks, the rest of a line is skipped."""
    found, lines = {}, iter(path.read_text().splitlines())
    for line in lines:
        word = line.split()[:1]
        if word and word[0].isalpha():
            assert next(lines).split()[0] == "{"
            group = found.setdefault(word[0], {})
            for inner in lines:
                if inner.split()[0] == "}":
                    break
                key, value = inner.split()[:2]
                group[key] = value
    return found


def path_of(files, power_w):
    """Mode, X, Y, Z in mm, W of the beam, and parameter of every row."""
    rows = np.array([[float(v) for v in line.split()] for line in files.main.read_text().splitlines()[1:]])
    rows[:, 4] *= power_w
    return rows


def integrated(rows):
    """Length with the beam on, mm; time, s; energy of the beam, J: row by row, as a simulator moves."""
    length = clock = energy = 0.0
    place = rows[0, 1:4]
    for mode, *to, power, parameter in rows:
        way = float(np.linalg.norm(np.subtract(to, place)))
        lasted = parameter if mode == 1 else way / (1e3 * parameter)
        length += way if power > 0 else 0.0
        clock += lasted
        energy += power * lasted
        place = to
    return length, clock, energy


# -- laws --------------------------------------------------------------------------------------------


def test_a_case_is_whole_and_marked(tmp_path, control):
    files, _ = wrote(tmp_path, control)
    names = {p.relative_to(files.folder).as_posix() for p in files.folder.rglob("*") if p.is_file()}
    assert names == FILES == set(files.names)
    for name in names:
        head = (files.folder / name).read_text().splitlines()[:3]
        assert any(line.endswith("; NOT VALIDATED") for line in head), name
        assert "@status@" not in (files.folder / name).read_text()
    assert os.access(files.folder / "run.sh", os.X_OK)


@pytest.mark.parametrize("layer", [None, 0, 2])
def test_the_path_has_length_time_and_energy_of_the_plan(tmp_path, control, layer):
    files, settings = wrote(tmp_path, control, layer)
    power_w = settings.process.power_w
    length, clock, energy = integrated(path_of(files, power_w))
    # Straight from the tracks: what the program lays, its ways between, and its pauses.
    path = driven_path(*stack(), settings, 6, "all chords", settings.machine.line_tolerance_mm)
    track = np.repeat(np.arange(len(path.start)), np.diff(path.track_starts))
    of_track = np.repeat(np.arange(len(path.z)), np.diff(path.layer_starts))
    chosen = np.flatnonzero(of_track == layer) if layer is not None else np.arange(len(path.start))
    mine = np.isin(track, chosen)
    laid = np.linalg.norm(path.end - path.segment_start, axis=1)
    assert length == pytest.approx(laid[mine].sum(), rel=1e-6)
    speed = settings.process.travel_speed_mm_s
    assert energy == pytest.approx(power_w * (laid * path.power)[mine].sum() / speed, rel=1e-6)
    ends = path.end[path.track_starts[1:] - 1]
    jumps = 0.0
    for before, now in pairwise(chosen):
        way = np.append(path.start[now] - ends[before], path.z[of_track[now]] - path.z[of_track[before]])
        jumps += np.linalg.norm(way) / settings.machine.rapid_mm_s
        jumps += settings.process.layer_pause_s * (of_track[now] - of_track[before])
    assert clock == pytest.approx(laid[mine].sum() / speed + jumps, rel=1e-6)
    assert heat_path(*stack(), settings).of_layer(layer).end_s[-1] == pytest.approx(clock, rel=1e-6)


def test_beam_and_metal_are_those_of_the_settings(tmp_path):
    settings = Config()
    thesis = {p.name: p for p in wrote(tmp_path, "3dthesis")[0].folder.iterdir()}
    names = thesis_groups(thesis["ParamInput.txt"])
    assert {*names["Simulation"].values(), *names["Options"].values()} <= {*thesis, "ebamcheck"}
    beam, metal = thesis_groups(thesis["Beam.txt"]), thesis_groups(thesis["Material.txt"])["Constants"]
    power = float(beam["Intensity"]["Power"]) * float(beam["Intensity"]["Efficiency"])
    assert power == pytest.approx(settings.process.power_w * settings.material.absorptivity)
    deviation_m = float(beam["Shape"]["Width_X"]) / np.sqrt(6.0)  # its README: sqrt(6) standard deviations
    assert deviation_m == pytest.approx(0.25e-3 * settings.process.bead_width_mm)
    material, process = settings.material, settings.process
    assert [float(metal[k]) for k in ("k", "c", "p", "T_0")] == pytest.approx(
        [
            material.conductivity_w_mk,
            material.heat_capacity_j_kgk,
            material.density_kg_m3,
            process.ambient_temperature_k,
        ]
    )


def test_the_path_lies_in_the_block(tmp_path, control):
    files, settings = wrote(tmp_path, control)
    places = 1e-3 * path_of(files, 1.0)[:, 1:4]
    axes = thesis_groups(files.folder / "Domain.txt")
    low, high = (np.array([float(axes[a][end]) for a in "XYZ"]) for end in ("Min", "Max"))
    assert (places.min(axis=0)[:2] - low[:2] > 3e-3 * settings.process.bead_width_mm).all()
    assert (high[:2] - places.max(axis=0)[:2] > 3e-3 * settings.process.bead_width_mm).all()
    assert high[2] == pytest.approx(places[:, 2].max())
    assert low[2] < places[:, 2].min() - 1e-3 * settings.process.base_plate_mm


def test_one_layer_begins_where_its_first_bead_does(tmp_path, control):
    files, settings = wrote(tmp_path, control, 2)
    rows = path_of(files, 1.0)
    assert rows[0, 0] == 1
    assert rows[0, 4] == 0
    assert rows[0, 5] < 1e-3  # no travel from the layer below, and no pause before it
    assert np.ptp(rows[:, 3]) == 0
    whole = heat_path(*stack(), settings)
    assert whole.layer.max() == 2
    assert np.allclose(rows[:, 1:4], whole.rows[whole.layer == 2, 1:4], atol=2e-6)


def test_a_layer_that_is_not_there_is_refused(tmp_path, control):
    with pytest.raises(SettingsError, match=r"--layer 4: the path has no bead there; its layers are 1 to 3"):
        wrote(tmp_path, control, 3)
    assert not (tmp_path / control).exists()
    with pytest.raises(SettingsError, match="linuxcnc takes a whole program"):
        case_post("linuxcnc")


def test_a_case_is_replaced_whole_but_results_are_kept(tmp_path, control):
    files, settings = wrote(tmp_path, control)
    before = files.main.read_bytes()
    wrote(tmp_path, control, 0)
    assert files.main.read_bytes() != before
    results = files.folder / "Data"
    results.mkdir()
    (results / "T.csv").write_text("x,y,z,T\n")
    with pytest.raises(SettingsError, match=r"holds Data/T\.csv, which is no program"):
        write_program(*stack(), settings, files.folder)

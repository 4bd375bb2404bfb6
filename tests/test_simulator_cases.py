"""Cases of heat simulators: whole folders, read again by small readers of their formats that share nothing with us."""

from __future__ import annotations

import json
import os
import re
import shlex
from itertools import pairwise

import numpy as np
import pytest
from nc_stack import stack

from ebamcheck.errors import SettingsError
from ebamcheck.program import write_program
from ebamcheck.program.language.control import simulators
from ebamcheck.program.simulators.heat_paths import case_post, heat_path
from ebamcheck.program.toolpath.bead_ends import driven_path
from ebamcheck.settings.config import Config

FILES = {
    "3dthesis": {
        *("Path.txt", "ParamInput.txt", "Mode.txt", "Material.txt", "Beam.txt", "Domain.txt", "Output.txt"),
        *("Settings.txt", "run.sh"),
    },
    "adamantine": {"scan_path.txt", "input.info", "run.sh"},
    "additivefoam": {
        *("constant/scanPath", "constant/heatSourceDict", "constant/transportProperties", "constant/g"),
        *("constant/thermoPath", "system/blockMeshDict", "system/controlDict", "system/decomposeParDict"),
        *("system/fvSchemes", "system/fvSolution", "0/T", "0/U", "0/alpha.solid", "0/p_rgh", "Allrun"),
    },
}
"""What each program opens, by its own sources and tutorials."""

SCRIPTS = {"3dthesis": "run.sh", "adamantine": "run.sh", "additivefoam": "Allrun"}

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


def info(text):
    """Read a tree in Boost's INFO format."""
    tokens = [t for line in text.splitlines() for t in [*shlex.split(line.split(";")[0]), "\n"]]
    at = 0

    def block():
        nonlocal at
        tree, key = {}, None
        while at < len(tokens):
            token = tokens[at]
            at += 1
            if token == "{":
                tree[key] = block()
            elif token == "}":
                return tree
            elif token != "\n":
                key = token
                if tokens[at] != "\n":
                    tree[key] = tokens[at]
                    at += 1
        return tree

    return block()


def foam(text):
    """Tokens of an OpenFOAM dictionary as nested lists, which fails where brackets do not match."""
    text = re.sub(r"//.*", "", text)
    tokens = re.findall(r'"[^"]*"|[{}();\[\]]|[^\s{}();\[\]]+', text)
    stack_ = [[]]
    pairs = {"{": "}", "(": ")", "[": "]"}
    open_ = []
    for token in tokens:
        if token in pairs:
            open_.append(pairs[token])
            stack_.append([])
        elif token in pairs.values():
            assert open_.pop() == token
            inner = stack_.pop()
            stack_[-1].append(inner)
        else:
            stack_[-1].append(token)
    assert not open_
    return stack_[0]


def after(tokens, word):
    """What follows a word, however deep."""
    for n, token in enumerate(tokens):
        if token == word:
            return tokens[n + 1]
        if isinstance(token, list) and (found := after(token, word)) is not None:
            return found
    return None


def path_of(files, control, power_w):
    """Mode, X, Y, Z in mm, W of the beam, and parameter of every row, each file by the rule of its program."""
    lines = files.main.read_text().splitlines()
    if control == "adamantine":
        assert len(lines) - 3 == int(lines[1])
        lines = lines[2:]
    rows = np.array([[float(v) for v in line.split()] for line in lines[1:]])
    if control != "3dthesis":
        rows[:, 1:4] *= 1e3
    if control != "additivefoam":
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
    assert names == FILES[control] == set(files.names)
    for name in names:
        head = (files.folder / name).read_text().splitlines()[:3]
        assert any(line.endswith("; NOT VALIDATED") for line in head), name
        assert "@status@" not in (files.folder / name).read_text()
    assert os.access(files.folder / SCRIPTS[control], os.X_OK)


@pytest.mark.parametrize("layer", [None, 0, 2])
def test_the_path_has_length_time_and_energy_of_the_plan(tmp_path, control, layer):
    files, settings = wrote(tmp_path, control, layer)
    power_w = settings.process.power_w
    length, clock, energy = integrated(path_of(files, control, power_w))
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


def test_a_lost_row_is_seen(tmp_path, control):
    files, settings = wrote(tmp_path, control)
    rows = path_of(files, control, settings.process.power_w)
    end = np.flatnonzero(rows[:, 0] == 1)[-1] - 1  # of a bead
    whole, less = integrated(rows), integrated(np.delete(rows, end, axis=0))
    assert all(abs(a - b) > 1e-6 * a for a, b in zip(whole, less, strict=True))


def test_all_simulators_get_the_same_beam_and_metal(tmp_path):
    power = Config().process.power_w * Config().material.absorptivity
    found = {}
    thesis = {p.name: p for p in wrote(tmp_path, "3dthesis")[0].folder.iterdir()}
    names = thesis_groups(thesis["ParamInput.txt"])
    assert {*names["Simulation"].values(), *names["Options"].values()} <= {*thesis, "ebamcheck"}
    beam, metal = thesis_groups(thesis["Beam.txt"]), thesis_groups(thesis["Material.txt"])["Constants"]
    found["3dthesis"] = (
        float(beam["Intensity"]["Power"]) * float(beam["Intensity"]["Efficiency"]),
        float(beam["Shape"]["Width_X"]) / np.sqrt(6.0),  # its README: sqrt(6) standard deviations
        *(float(metal[k]) for k in ("k", "c", "p", "T_0")),
    )
    tree = info((wrote(tmp_path, "adamantine")[0].folder / "input.info").read_text())
    source, solid = tree["sources"]["beam_0"], tree["materials"]["material_0"]["solid"]
    found["adamantine"] = (
        float(source["max_power"]) * float(source["absorption_efficiency"]),
        0.5 * float(source["diameter"]) / np.sqrt(2.0 * np.log(10.0)),  # a tenth at its edge
        *(float(solid[k]) for k in ("thermal_conductivity_x", "specific_heat", "density")),
        float(tree["materials"]["initial_temperature"]),
    )
    case = wrote(tmp_path, "additivefoam")[0].folder
    heat = foam((case / "constant/heatSourceDict").read_text())
    metal = foam((case / "constant/transportProperties").read_text())
    words = (case / "0/T").read_text()
    found["additivefoam"] = (
        Config().process.power_w * float(after(heat, "eta")),
        float(after(heat, "dimensions")[0]) / 2.0,  # exp(-2 r^2 / d^2)
        float(after(metal, "kappa")[0]),
        float(after(metal, "Cp")[0]),
        float(re.search(r"rho \[[^]]*\] (\S+);", (case / "constant/transportProperties").read_text())[1]),
        float(re.search(r"internalField uniform (\S+);", words)[1]),
    )
    assert found["3dthesis"][0] == pytest.approx(power)
    assert found["3dthesis"][1] == pytest.approx(0.25e-3 * Config().process.bead_width_mm)
    for name in simulators()[1:]:
        assert found[name] == pytest.approx(found["3dthesis"], rel=1e-6), name


def test_the_path_lies_in_the_block(tmp_path, control):
    files, settings = wrote(tmp_path, control)
    places = 1e-3 * path_of(files, control, 1.0)[:, 1:4]
    if control == "3dthesis":
        axes = thesis_groups(files.folder / "Domain.txt")
        low, high = (np.array([float(axes[a][end]) for a in "XYZ"]) for end in ("Min", "Max"))
    elif control == "adamantine":
        sides = info((files.folder / "input.info").read_text())["geometry"]
        low = np.array([float(sides[f"{n}_origin"]) for n in ("length", "width", "height")])
        high = low + [float(sides[n]) for n in ("length", "width", "height")]
    else:
        corners = np.array(
            after(foam((files.folder / "system/blockMeshDict").read_text()), "vertices"), float
        )
        low, high = corners.min(axis=0), corners.max(axis=0)
    # Lateral walls of 3DThesis are no walls, those of the others keep a distance of some beads.
    assert (places.min(axis=0)[:2] - low[:2] > 3e-3 * settings.process.bead_width_mm).all()
    assert (high[:2] - places.max(axis=0)[:2] > 3e-3 * settings.process.bead_width_mm).all()
    assert high[2] == pytest.approx(places[:, 2].max())
    assert low[2] < places[:, 2].min() - 1e-3 * settings.process.base_plate_mm


def test_times_of_a_case_are_those_of_its_path(tmp_path):
    for control, file, pattern in (
        ("adamantine", "input.info", r"duration (\S+)"),
        ("additivefoam", "system/controlDict", r"endTime (\S+);"),
    ):
        files, settings = wrote(tmp_path, control)
        clock = integrated(path_of(files, control, settings.process.power_w))[1]
        assert float(re.search(pattern, (files.folder / file).read_text())[1]) == pytest.approx(clock)


@pytest.mark.parametrize(("base", "kind"), [("cooled", "fixedValue"), ("insulated", "zeroGradient")])
def test_the_base_is_that_of_the_process(tmp_path, base, kind):
    files, _ = wrote(tmp_path, "additivefoam", base=base)
    boundary = after(foam((files.folder / "0/T").read_text()), "boundaryField")
    assert after(boundary, "bottom")[1] == kind


def test_one_layer_begins_where_its_first_bead_does(tmp_path, control):
    files, settings = wrote(tmp_path, control, 2)
    rows = path_of(files, control, 1.0)
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


def test_same_settings_make_the_same_bytes(tmp_path, control):
    hashes = [dict(wrote(tmp_path / str(n), control)[0].sha256) for n in range(2)]
    assert json.dumps(hashes[0]) == json.dumps(hashes[1])

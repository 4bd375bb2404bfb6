"""A tilt table: the program turns it and sets the frame; the reader follows both to the part, and every fault in them is found."""

import json
import re
import shutil

import numpy as np
import pytest
from command_line import FAST, ebamcheck, write_stl
from scipy.spatial.transform import Rotation
from test_turned_layers import angle

from ebamcheck.checks import table as table_checks
from ebamcheck.json_values import sha256_of_file
from ebamcheck.nc import templates
from ebamcheck.program import read_program
from ebamcheck.settings.config import load_config
from ebamcheck.verification.verify import verify
from ebamcheck.writing import table as table_text

TABLE = """[machine]
park_mm = [-150.0, 12.0]
travel_min_mm = [-1000.0, -1000.0, -200.0]
[[machine.rotary]]
name = "B"
axis = [0, 1, 0]
point_mm = [10.0, 0.0, -40.0]
min_deg = -110
max_deg = 110
sign = -1
[[machine.rotary]]
name = "C1"
axis = [0, 0, 1]
point_mm = [12.0, 10.0, 0.0]
min_deg = -360
max_deg = 360
"""
LAYER = "MAIN_K0021R1"
SUB = f"{LAYER}_L0001.SPF"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run on a machine with a table of two axes, and a layer of the arm, turned up."""
    folder = tmp_path_factory.mktemp("table")
    write_stl(angle(), folder / "angle.stl")
    (folder / "table.toml").write_text(TABLE)
    done = ebamcheck("run", "angle.stl", "-o", "angle.run", "--backends", FAST, "-c", "table.toml", cwd=folder)
    assert (folder / "angle.run" / "run.json").is_file(), done.stdout + done.stderr
    done = relayer(folder, folder / "o")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def relayer(place, out, direction="1,0,0", layer=21, height=21.7, run="angle.run"):
    return ebamcheck(
        "relayer", place / run, "--layer", layer, "--measured-z", height, "--direction", direction, "-o", out, "--json",
        "--part", place / "angle.stl", cwd=place,
    )  # fmt: skip


class TurnedText:
    """Program of the turned layer as lines, to plant faults in, and what verify then says of it."""

    def __init__(self, place, folder):
        self.place, self.folder = place, folder / "program"
        shutil.copytree(place / "o" / "layers" / LAYER / "program", self.folder)
        self.config = load_config(place / "o" / "layers" / LAYER / "settings.toml")
        self.lines = (self.folder / SUB).read_text().split("\n")

    def find(self, pattern, nth=0):
        return [i for i, line in enumerate(self.lines) if re.search(pattern, line)][nth]

    def edit(self, pattern, replacement, nth=0):
        i = self.find(pattern, nth)
        changed = re.sub(pattern, replacement, self.lines[i])
        assert changed != self.lines[i]
        self.lines[i] = changed

    def drop(self, pattern, nth=0):
        return self.lines.pop(self.find(pattern, nth))

    def failed(self):
        (self.folder / SUB).write_text("\n".join(self.lines))
        checks = verify(self.folder, self.place / "angle.stl", self.config)
        return {check.name: check for check in checks if not check.passed}


# -- a layer on the table ----------------------------------------------------------------------------


def test_a_turned_layer_turns_the_table_sets_the_frame_and_takes_both_back(place, tmp_path):
    certificate = json.loads((place / "o" / "layers" / LAYER / "layer.json").read_text())
    table = certificate["table"]
    assert table["positions_deg"] == {"B": 90.0, "C1": 0.0}
    text = TurnedText(place, tmp_path)
    kept = [re.sub(r"^N\d+ ", "", line) for line in text.lines]
    begin, end = kept.index("; TABLE TURNED"), kept.index("; TABLE TURNED BACK")
    zero = " ".join(f"{name}{value:.6f}" for name, value in zip("XYZ", table["frame_zero_mm"], strict=True))
    assert kept[begin + 1 : begin + 5] == [
        "G0 B90.000000",
        "G0 C1=0.000000",
        f"TRANS {zero}",
        "AROT Z0.000000",
    ]
    assert kept[end + 1] == "TRANS"
    assert kept[end + 3 : end + 5] == ["G0 C1=0.000000", "G0 B0.000000"]
    assert text.failed() == {}


def test_the_tool_is_where_the_turned_part_is(place, tmp_path):
    """By SciPy: each place of a bead, as the axes drive it, turned back with the table, lies on the arm as it was built."""
    text = TurnedText(place, tmp_path)
    nc = read_program(text.folder, text.config)
    beads = nc.machine.end[nc.machine.beam & (nc.machine.kind != 0)]
    # B turns the other way (sign -1), so 90 degrees are -90 about +Y; what it turned is turned back.
    point = np.array([10.0, 0.0, -40.0])
    x, y, z = (Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).apply(beads - point) + point).T
    # The arm reaches from 20 to 45 mm along X, and its layers lie across X: 21.7 mm stand, and a layer of 1.66 mm comes.
    assert x == pytest.approx(np.full(len(x), nc.end[nc.beam, 2][0]), abs=1e-3)
    assert (x > 21.7).all()
    assert (x < 25.0).all()
    assert 0.0 < y.min() < y.max() < 24.0
    assert 45.0 < z.min() < z.max() < 60.0
    # A program of the part alone knows nothing of the table: its coordinates are those of the turned part.
    assert len(nc) < len(nc.machine)
    assert np.isfinite(nc.end).all()


def test_a_direction_up_gives_the_same_bytes(place, tmp_path):
    outs = []
    for name, direction in (("a", ()), ("b", ("--direction", "0,0,1")), ("c", ("--direction", "0,0,2"))):
        done = ebamcheck(
            "relayer",
            place / "angle.run",
            "--layer",
            4,
            "--measured-z",
            5.1,
            *direction,
            "-o",
            tmp_path / name,
            cwd=tmp_path,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        outs.append({p.name: sha256_of_file(p) for p in (tmp_path / name / "layers").rglob("*") if p.is_file()})
    assert outs[0] == outs[1] == outs[2]
    assert len(outs[0]) == 4


def test_what_the_table_cannot_do_is_one_line(place, tmp_path):
    done = relayer(place, tmp_path / "o", "-1,0,-1")
    assert done.returncode == 2
    assert "the table cannot turn the direction" in done.stderr
    assert "B -110 .. 110 deg" in done.stderr
    assert done.stderr.count("\n") == 1
    run = shutil.copytree(place / "angle.run", tmp_path / "angle.run")
    manifest = json.loads((run / "run.json").read_text())
    for control in ("linuxcnc", "plain-gcode", "fanuc"):
        manifest["settings"]["machine"]["control"] = control
        (run / "run.json").write_text(json.dumps(manifest))
        done = relayer(place, tmp_path / "o", run=run)
        assert done.returncode == 2, done.stdout
        assert f"machine.control {control!r}" in done.stderr
        assert "tilt table (machine.rotary)" in done.stderr
        assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
    manifest["settings"]["machine"] |= {
        "control": "sinumerik-840d-sl",
        "travel_max_mm": [1000.0, 1000.0, 70.0],
    }
    (run / "run.json").write_text(json.dumps(manifest))
    done = relayer(place, tmp_path / "o", run=run)
    assert done.returncode == 2
    assert "the table turns below Z" in done.stderr


# -- planted faults ----------------------------------------------------------------------------------


def _swap(text, first, second):
    i, j = text.find(first), text.find(second)
    text.lines[i], text.lines[j] = text.lines[j], text.lines[i]


FAULTS = {
    "wrong sign of an angle": (lambda t: t.edit("B90.000000", "B-90.000000"), "frame"),
    "an angle a tenth off": (lambda t: t.edit("B90.000000", "B90.100000"), "frame"),
    "an angle that is lost": (lambda t: t.drop("G0 B90"), "frame"),
    "frame missing": (lambda t: (t.drop("TRANS X"), t.drop("AROT")), "frame"),
    "turn of the frame missing": (lambda t: t.edit("AROT Z0.000000", "AROT Z90"), "frame"),
    "zero of the frame on a wrong pivot": (lambda t: t.edit("TRANS X-30.000000", "TRANS X-30.500000"), "frame"),
    "wrong height of the frame": (lambda t: t.edit("Z-50.000000", "Z-49.990000"), "frame"),
    "frame not taken back": (lambda t: t.drop(r"TRANS$", 1), "frame taken back"),
    "table not turned back": (lambda t: t.drop("G0 B0"), "frame taken back"),
    "second table not turned back": (lambda t: (t.edit("C1=0.0", "C1=5.0"), t.drop("C1=0.0")), "frame taken back"),
    "axis beyond its limit": (lambda t: t.edit("B90.000000", "B270.000000"), "table limits"),
    "below the safe height": (lambda t: t.edit(r"G0 Z85[.\d]+", "G0 Z70.000000"), "table height"),
    "turned before it rises": (lambda t: _swap(t, r"G0 Z85", "G0 B90"), "table height"),
    "turned back over the part": (lambda t: t.edit(r"(X-150.*) Z85[.\d]+", r"\1 Z30.000000"), "table height"),
    "a way beside the frame that gives no height": (lambda t: t.edit(r"(X-150.*) Z85[.\d]+", r"\1"), "frame taken back"),
    "beam on while it turns": (lambda t: t.edit("M61", "M60"), "table turns"),
    "beam not commanded off": (lambda t: t.drop("M61"), "table turns"),
    "wire not commanded off": (lambda t: t.drop("M63"), "table turns"),
    "two axes at once": (lambda t: (t.edit("G0 C1=0.0", "G0 C1=5.0"), t.edit("G0 B90.000000", "G0 B90 C1=5.0")), "table turns"),
    "the tool moves while it turns": (lambda t: t.edit("G0 B90.000000", "G0 B90.000000 X5"), "table turns"),
    "turned at feed": (lambda t: t.edit("G0 B90.000000", "G1 B90.000000 F600"), "table turns"),
    "turned under a bead": (lambda t: t.lines.insert(t.find("F600") + 1, "N261 B80"), "table turns"),
    "an axis that is not commanded": (lambda t: t.drop("G0 C1=0.0"), "table turns"),
    "the tool moves to X0 while it turns": (lambda t: t.edit("G0 B90.000000", "G0 B90.000000 X0"), "table turns"),
    "down to the bead across what stands": (lambda t: t.edit(r"(G0 X-57.000000 Y3.000000) Z135[.\d]+", r"\1 Z23.364286"), "table height"),
    "aside on the way up": (lambda t: t.edit(r"G0 Z85", "G0 X0 Y0 Z85"), "table height"),
    "a way through the plate": (lambda t: t.lines.insert(t.find("; ISLAND 1"), "N375 G0 X10 Y12"), "beam over what stands"),
    "the head into the plate": (lambda t: t.lines.insert(t.find("; ISLAND 1"), "N375 G0 X-12 Y22\nN376 G0 Z26\nN377 G0 Z43.364286"), "head over what stands"),
    "a frame under a bead": (lambda t: t.lines.insert(t.find("F600") + 1, "N261 ATRANS X0.5"), "frame"),
}  # fmt: skip


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_table_or_frame_is_found(place, tmp_path, fault):
    plant, name = FAULTS[fault]
    text = TurnedText(place, tmp_path)
    plant(text)
    found = text.failed()
    assert name in found, found
    assert found[name].where.split(":")[0] == SUB or found[name].where.startswith(f"{LAYER}.MPF")


def test_a_wrong_frame_moves_the_metal_off_its_place(place, tmp_path):
    """Not its own check alone: what table and frame do to the path goes into those of the path and of the metal."""
    text = TurnedText(place, tmp_path)
    text.edit("TRANS X-30.000000", "TRANS X-30.500000")
    assert {"frame", "section"} <= set(text.failed())
    text.edit("TRANS X-30.500000", "TRANS X-36.000000")
    assert {"frame", "section", "beads inside", "metal outside"} <= set(text.failed())
    text.edit("TRANS X-36.000000 Y0.000000 Z-50.000000", "TRANS X-30.000000 Y0.000000 Z-52.000000")
    assert {"frame", "layer heights"} <= set(text.failed())


def test_limits_of_travel_are_those_of_the_axes(place, tmp_path):
    """The turned layer lies at Z -26 in the work offset, and at 23 on the part."""
    text = TurnedText(place, tmp_path)
    machine = {"travel_min_mm": (-1000.0, -1000.0, -20.0)}
    text.config = text.config.changed(machine=machine)
    found = text.failed()
    assert "beyond the limits" in found["travel"].text
    assert found["travel"].value == pytest.approx(50.0 - 23.364 - 20.0, abs=0.01)


@pytest.mark.parametrize("kept", [slice(8), slice(8, None)])
def test_a_box_that_writer_and_check_share_is_held_against_the_mesh(place, tmp_path, monkeypatch, kept):
    """Corners of part or plate that are lost before the program is written and before its heights are checked."""
    known = templates.carried_corners
    for module in (table_text, table_checks):
        monkeypatch.setattr(module, "carried_corners", lambda config: known(config)[kept] * [1.0, 1.0, 0.5])
    done = relayer(place, tmp_path / "o")
    failed = json.loads(done.stdout)["gates"]
    assert done.returncode == 1
    assert any("table over what stands" in gate["text"] for gate in failed)


def test_a_part_that_stands_otherwise_than_the_settings_say_is_found(place, tmp_path):
    text = TurnedText(place, tmp_path)
    known = text.config.part.on_table
    shift = (known.shift_mm[0] + 0.2, *known.shift_mm[1:])
    text.config = text.config.changed(part={"on_table": {**known.model_dump(), "shift_mm": shift}})
    found = text.failed()
    assert found["mounting"].value == pytest.approx(0.2)
    assert "frame" in found
    text.config = text.config.changed(part={"on_table": {**known.model_dump(), "high_mm": (45.0, 24.0, 30.0)}})
    assert "mounting" in text.failed()


def test_a_machine_whose_pivot_lies_elsewhere_does_not_pass_the_program(place, tmp_path):
    """The same text on a table whose line was measured 0.3 mm higher, or turns the other way: beads would lie beside the part."""
    text = TurnedText(place, tmp_path)
    rotary = text.config.model_dump()["machine"]["rotary"]
    for change in ({"point_mm": (10.0, 0.0, -39.7)}, {"sign": 1}, {"axis": (0.01, 1.0, 0.0)}):
        text.config = text.config.changed(machine={"rotary": ({**rotary[0], **change}, rotary[1])})
        assert "frame" in text.failed(), change


def test_a_table_that_turns_in_a_program_of_no_turned_part_is_found(place, tmp_path):
    text = TurnedText(place, tmp_path)
    text.config = text.config.changed(part={"on_table": None})
    assert "frame" in text.failed()
    # And the other way: a part that is to be turned, and a text that turns nothing.
    text = TurnedText(place, tmp_path / "n")
    begin, end = text.find("TABLE TURNED$"), text.find("TABLE TURNED BACK")
    del text.lines[end : end + 5], text.lines[begin : begin + 6]
    assert "turns no table" in text.failed()["frame"].text


def test_frames_and_rotary_axes_are_refused_on_a_machine_without_a_table(place, tmp_path):
    text = TurnedText(place, tmp_path)
    text.config = text.config.changed(machine={"rotary": ()}, part={"on_table": None})
    found = text.failed()
    assert list(found) == ["readable"] or "readable" in found

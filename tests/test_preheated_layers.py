"""Preheating of layers that are released one by one: the scan is part of the layer's file, and its text alone is judged."""

import json
import shutil
from dataclasses import replace

import pytest
import shapely
from command_line import FAST, ebamcheck, write_stl
from parts import box
from planted_faults import drop, edit
from program_text import Text
from slicers_here import runs_cut_here as runs_cut_here

from ebamcheck.checks.preheating import preheat_checks
from ebamcheck.live.before import Before
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.live.relaying import finished_run
from ebamcheck.mesh.files import load
from ebamcheck.program import read_program
from ebamcheck.settings.config import Config
from ebamcheck.verification.verify import verify

MACHINE = {"set_focus": ["H5={defocus} ; focus"]}
LAYERS = {
    "when": "layers", "defocus": 20.0, "current_ma": 150.0, "target_k": 645.0, "over_k": 100.0, "spot_mm": 40.0,
    "spacing_mm": 20.0, "soak_s": 10.0, "evenness_k": 400.0,
}  # fmt: skip
SECTION = shapely.box(0, 0, 150, 150)
UPPER = "MAIN_K0002R1"
SUB = f"{UPPER}_L0001.SPF"
RISE_S = 0.2


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder, the lowest two layers of a wide box that is preheated layer by layer, and their maker's settings."""
    folder = tmp_path_factory.mktemp("warm")
    part = write_stl(box(upper=(150, 150, 5)), folder / "box.stl")
    config = Config().changed(preheat=LAYERS, machine=MACHINE, process={"current_ma": 60.0})

    with LayerMaker(load(part), config) as maker:
        before, layers = Before.cold(config), []
        for k, base_mm in enumerate((0.0, 1.7)):
            wanted = Wanted(k, base_mm, 1.65, f"MAIN_K{k + 1:04d}R1")
            layers.append(maker.make(wanted, before, folder / wanted.name / "program"))
            assert layers[-1].passed, layers[-1].why
            before = layers[-1].after
    return folder, layers


def scan_of(layer):
    text = (layer.files.folder / layer.files.names[1]).read_text()
    return text, text.count("; PASS")


def test_a_released_layer_brings_its_scan_along_in_one_file(made):
    _, (lowest, upper) = made
    for layer in made[1]:
        assert len(layer.files.names) == 2
        text, passes = scan_of(layer)
        assert passes >= 1
        # The scan, the focus back, and then the first bead.
        assert text.index("H5=20") < text.index("; PASS 1") < text.index("H5=0") < text.index("RING 0")
        assert "G4 F10" in text[text.index("; PASS 1") : text.index("H5=0")]
        names = {check.name for check in layer.checks}
        assert {
            "preheat calls",
            "preheat state",
            "preheat path",
            "preheat count",
            "preheat temperature",
        } <= names
    # The plate is scanned around the section, what stands within it: half a spot inside.
    ways = [read_program(layer.files.folder, layer.config).preheating for layer in made[1]]
    assert ways[0].end[1:, 0].max() > 150.0
    assert 20.0 - 1e-6 <= ways[1].end[1:, 0].min() < ways[1].end[1:, 0].max() <= 130.0 + 1e-6
    assert lowest.deposit_s > lowest.after.last.time_s + 10.0
    assert upper.deposit_s > upper.after.last.time_s + 10.0


def test_the_layer_begins_on_the_heat_of_its_scan(made):
    """Without it, the same layer would begin colder than the target, in the plan as in the text."""
    _, (lowest, upper) = made
    nc = read_program(upper.files.folder, upper.config)
    before = lowest.after.rested(upper.wait_s + RISE_S).part.column
    assert before.surface_k < 645.0
    warm = {c.name: c for c in preheat_checks(nc, upper.config, [SECTION], before, SECTION)}
    assert all(check.passed for check in warm.values())
    assert warm["preheat temperature"].value >= 645.0
    # Its text alone does not tell how warm the part is: what it does tell is judged.
    alone = [check.name for check in preheat_checks(nc, upper.config, [SECTION])]
    assert alone == ["preheat calls", "preheat state", "preheat path", "preheat lines"]


def test_a_published_layer_verifies_from_its_text(made, tmp_path):
    folder, layers = made
    for layer in layers:
        shutil.copytree(layer.files.folder, tmp_path / layer.wanted.name)
        checks = verify(tmp_path / layer.wanted.name, folder / "box.stl", layer.config)
        assert all(check.passed for check in checks), [c.in_words() for c in checks if not c.passed]


def beam_not_off(text):
    first = text.find(SUB, "H5=20")
    text.lines[SUB] = [line for i, line in enumerate(text.lines[SUB]) if not (i < first and "M61" in line)]


def after_beads(text):
    lines = text.lines[SUB]
    first, last = text.find(SUB, "MSG..PREHEATING"), text.find(SUB, "H5=0")
    scan = lines[first : last + 1]
    del lines[first : last + 1]
    lines[-2:-2] = scan


ON = "M60 ; beam on"


def said(word):
    """A word before a way under the beam; it holds for the beads behind the scan, too."""
    return edit(SUB, ON, f"{word}\nN171 {ON}")


FAULTS = {
    "another work offset": (said("G55"), "preheat state"),
    "another acceleration": (said("BRISK"), "preheat state"),
    "a wide tolerance": (said("CTOL=5"), "preheat state"),
    "a stop": (said("M1"), "preheat state"),
    "a transformation switched off, and the offset with it": (said("TRAFOOF"), "preheat state"),
    "the wire runs while it preheats": (
        edit(SUB, ON, f"{ON}\nN171 H3=33 ; wire speed, mm/s\nN172 M62 ; wire on"),
        "preheat state",
    ),
    "half out of focus": (edit(SUB, r"H5=20 ", "H5=10 "), "preheat state"),
    "beads in the place of a scan": (drop(SUB, r"H5=20 "), "wire"),
    "the focus is not taken back": (drop(SUB, r"H5=0 "), "preheat state"),
    "the beam is not commanded off before": (beam_not_off, "preheat state"),
    "a greater current": (edit(SUB, r"H2=150 ", "H2=250 "), "preheat state"),
    "beside what stands": (edit(SUB, r"G1 X130.000000", "G1 X148.000000"), "preheat path"),
    "the tool at the part": (edit(SUB, r"G0 Z21.700000", "G0 Z2.700000"), "preheat path"),
    "after its layer": (after_beads, "preheat calls"),
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_scan_of_a_layer_is_found_from_its_text(name, made, tmp_path):
    plant, wanted = FAULTS[name]
    folder, (_, upper) = made
    shutil.copytree(upper.files.folder, tmp_path / "program")
    text = Text(tmp_path / "program")
    plant(text)
    text.save()
    checks = verify(tmp_path / "program", folder / "box.stl", upper.config)
    failed = {check.name: check for check in checks if not check.passed}
    if name == "beads in the place of a scan":
        assert failed
        assert not {"preheat state", wanted}.isdisjoint(failed)
        return
    assert wanted in failed, list(failed)
    assert failed[wanted].where.startswith(SUB)


def more(text):
    first, last = text.find(SUB, "; PASS 1$"), text.find(SUB, "G4 F10")
    text.lines[SUB][first:first] = 3 * text.lines[SUB][first:last]


def none_at_all(text):
    first, last = text.find(SUB, "MSG..PREHEATING"), text.find(SUB, "H5=0")
    del text.lines[SUB][first : last + 1]


@pytest.mark.parametrize(
    ("plant", "wanted"),
    [
        (more, "preheat count"),
        (none_at_all, "preheat temperature"),
        (edit(SUB, "G4 F10", "G4 F3000"), "preheat temperature"),
    ],
)
def test_how_often_and_how_warm_is_judged_where_the_heat_is_known(plant, wanted, made, tmp_path):
    _, (lowest, upper) = made
    shutil.copytree(upper.files.folder, tmp_path / "program")
    text = Text(tmp_path / "program")
    plant(text)
    text.save()
    before = lowest.after.rested(upper.wait_s + RISE_S).part.column
    checks = preheat_checks(read_program(tmp_path / "program", upper.config), upper.config, [SECTION], before, SECTION)
    assert wanted in {check.name for check in checks if not check.passed}


# -- runs and builds ---------------------------------------------------------------------------------

PLATE = """[machine]
set_focus = ["H5={defocus} ; focus"]
[preheat]
when = "plate"
defocus = 20.0
current_ma = 10
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box on a plate that is preheated, with a main program that waits."""
    folder = tmp_path_factory.mktemp("plate")
    write_stl(box(upper=(36, 30, 6.7)), folder / "box.stl")
    (folder / "plate.toml").write_text(PLATE)
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, "-c", "plate.toml", "--live", cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
def test_a_run_that_preheats_has_a_main_program_that_waits_and_verifies(place):
    waiting = (place / "box.run" / "live" / "MAIN_LIVE.MPF").read_text()
    assert "; VALIDATED" in waiting
    assert "_P0001" not in waiting  # after a RESET it would scan what stands
    assert (place / "box.run" / "program" / "MAIN_P0001.SPF").is_file()
    done = ebamcheck("verify", place / "box.run", "--part", place / "box.stl", cwd=place)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_a_build_preheats_the_plate_with_its_first_layer_and_plays_again(place, tmp_path):
    arguments = ("machine", place / "box.run", "--drift", "0.05", "--speed", "1000000", "-o", tmp_path / "o")
    done = ebamcheck(*arguments, cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    layers = sorted((tmp_path / "o" / "layers").glob("*"))
    scans = [(layer / "program" / f"{layer.name}_L0001.SPF").read_text().count("; PASS") for layer in layers]
    assert scans[0] >= 1
    assert scans[1:] == [0] * (len(layers) - 1)
    first = json.loads((layers[0] / "layer.json").read_text())
    assert first["layer_s"] > 30.0
    done = ebamcheck("verify", tmp_path / "o", "--part", place / "box.stl", cwd=place)
    assert done.returncode == 0, done.stdout
    done = ebamcheck("live", place / "box.run", "--replay", tmp_path / "o" / "journal.jsonl", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"{len(layers)} layers made again" in done.stdout


@pytest.mark.slow
def test_a_layer_made_again_knows_the_preheated_plate(place, tmp_path):
    found = finished_run(place / "box.run")
    warm = found.before(1)
    cold = replace(found, config=found.config.changed(preheat={"when": "off"})).before(1)
    # Waits within the layer are spread over it here, where the plan has them before single beads: its `leave_k` is no measure.
    assert warm.surface_k > cold.surface_k + 10.0
    done = ebamcheck("relayer", place / "box.run", "--layer", 1, "--measured-z", 0.0, "-o", tmp_path / "o", cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "in place of MAIN_L0001.SPF and of MAIN_P0001, the scan before it" in done.stdout
    layer = next((tmp_path / "o" / "layers").iterdir())
    assert "; PASS 1" in (layer / "program" / f"{layer.name}_L0001.SPF").read_text()


@pytest.mark.slow
def test_a_program_of_a_run_may_hold_its_scans_in_its_layers(place):
    (place / "in.toml").write_text(PLATE + 'scan_in = "layer"\n')
    done = ebamcheck("run", "box.stl", "-o", "in.run", "--backends", FAST, "-c", "in.toml", cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    program = place / "in.run" / "program"
    assert not list(program.glob("*_P*"))
    own, within = (
        (place / run / "program" / file).read_text().split("\n")
        for run, file in (("box.run", "MAIN_P0001.SPF"), ("in.run", "MAIN_L0001.SPF"))
    )
    ways = [[line.split(" ", 1)[1] for line in lines if " G1 " in line] for lines in (own, within)]
    assert ways[0] == ways[1][: len(ways[0])]
    text = Text(program)
    first, last = text.find("MAIN_L0001.SPF", "MSG..PREHEATING"), text.find("MAIN_L0001.SPF", "H5=0")
    del text.lines["MAIN_L0001.SPF"][first : last + 1]
    text.save()
    failed = {check.name: check for check in verify(program, place / "box.stl") if not check.passed}
    assert "the base plate is not preheated" in failed["preheat calls"].text

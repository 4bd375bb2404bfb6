"""The program that begins at a layer: written and proved with the run, a gate like others, and worked out again."""

from __future__ import annotations

import re
import shutil

import pytest
from command_line import ebamcheck, write_stl
from parts import box, join
from slicers_here import slicers_here

from benchmarks.faults.judging import reseal
from benchmarks.faults.subjects import CONTROLS, SUBJECTS
from ebamcheck.errors import ExitCode
from ebamcheck.json_values import sha256_of_file
from ebamcheck.pipeline import run_job
from ebamcheck.pipeline.entry_program import entry_of_whole
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.verification.verify import verify, verify_run

PLAIN = CONTROLS[-1]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of a small part, one for each control, with a program from layer 2 on."""
    folder = tmp_path_factory.mktemp("entry")
    part = write_stl(box((0, 0, 0), (24, 24, 5)), folder / "cube.stl")
    known = {}

    def run(control):
        if control not in known:
            config = SUBJECTS["cube"].config(control)
            with slicers_here():
                known[control] = run_job(part, folder / control, config, from_layer=2), part
        return known[control]

    return run


def copied(made, tmp_path):
    """A copy of a run whose files may be changed, its part, and the file of its entry program."""
    result, part = made(PLAIN)
    copy = tmp_path / "run"
    shutil.copytree(result.folder.path, copy)
    return copy, part, copy / "entry" / result.manifest["program"]["entry"]["files"][0]["name"]


def failed(run, part, hashed=True):
    """Checks that fail when a run is verified whose hashes were made anew, as an attacker would."""
    record = RunFolder(run).manifest()
    for file in record["program"]["entry"]["files"] if hashed else ():
        file["sha256"] = sha256_of_file(run / "entry" / file["name"])
    RunFolder(run).write_manifest(record)
    reseal(run, "MAIN.gcode")
    return {c.name: c for c in verify_run(run, part) if not c.passed}


@pytest.mark.parametrize("control", CONTROLS)
def test_a_run_writes_and_proves_a_program_from_a_layer_on(made, control):
    result, part = made(control)
    entry = result.manifest["program"]["entry"]
    assert entry["validated"]
    assert entry["layer"] == 2
    folder = result.folder.path / "entry"
    assert "; ENTRY: AT LAYER 2 OF 3" in (folder / entry["files"][0]["name"]).read_text()
    assert all("NOT VALIDATED" not in path.read_text() for path in folder.iterdir())
    assert {gate.name: gate.passed for gate in result.gates}["entry"]
    checks = {c.name: c for c in verify_run(result.folder.path, part)}
    assert checks["entry"].passed
    assert checks["gate entry"].passed
    assert all(c.passed for c in checks.values())


@pytest.mark.parametrize("control", CONTROLS)
def test_what_post_says_of_a_program_from_a_layer_on_works(made, control, tmp_path):
    result, _ = made(control)
    run = result.folder.path
    said = ebamcheck("post", run, "--from-layer", 2, "-o", "rest", cwd=tmp_path).stdout
    asked = re.search(r"`ebamcheck (verify [^`]*)`", said)[1].split()
    done = ebamcheck(*asked, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "from layer 2 on are those of the whole program" in done.stdout
    laid = next(p for p in sorted((tmp_path / "rest").iterdir(), reverse=True) if "G1 X" in p.read_text())
    laid.write_text(re.sub(r"(?m)^((?:N\d+ )?G1 X-?\d+\.)", r"\g<1>1", laid.read_text(), count=1))
    spoiled = ebamcheck(*asked, "--quick", cwd=tmp_path)
    assert spoiled.returncode == 1
    assert "FAIL  entry" in spoiled.stdout


def test_without_the_whole_program_the_first_thing_told_is_what_is_missing(made, tmp_path):
    result, part = made(PLAIN)
    ebamcheck("post", result.folder.path, "--from-layer", 2, "-o", "rest", cwd=tmp_path)
    checks = verify(tmp_path / "rest", part, SUBJECTS["cube"].config(PLAIN))
    first = next(check for check in checks if not check.passed)
    assert first.name == "entry"
    assert "layer 2 of 3" in first.text
    assert "--whole" in first.text


@pytest.mark.parametrize(
    ("pattern", "by"),
    [(r"^G1 X(-?\d+)\.", r"G1 X\g<1>1."), (r"^G0 Z\d+", "G0 Z1"), (r"F600", "F601"), ("; VALIDATED", "; NOT VALIDATED")],
)  # fmt: skip
def test_an_entry_program_that_differs_from_the_whole_shuts_its_gate(made, tmp_path, pattern, by):
    copy, part, main = copied(made, tmp_path)
    main.write_text(re.sub(pattern, by, main.read_text(), count=1, flags=re.MULTILINE))
    found = failed(copy, part)
    assert "recorded as passed, found shut" in found["gate entry"].text
    assert not found["verdict"].passed


@pytest.mark.parametrize(
    ("pattern", "by", "said"),
    [
        (r"^G4 .*\n(?=; ISLAND)", "", "in the whole program"),
        (r"^(G4 [PSF])\d+(?=.*\n; ISLAND)", r"\g<1>1", "in the whole program"),
        (r"^G0 X\S+ Y\S+\n(?=G0 Z)", "", "elsewhere than over the first bead"),
        (r"^(G0 X)\S+( Y\S+)\n(G0 Z.*\n)", r"\g<1>9\2\n\3G0 X3 Y3\n", "another motion"),
    ],
    ids=["a wait is lost", "a wait is shortened", "no way to the first bead", "down elsewhere"],
)  # fmt: skip
def test_waits_and_the_way_to_the_first_bead_are_those_of_the_whole(made, tmp_path, pattern, by, said):
    """Motions alone do not tell that the part has cooled, nor that the tool goes down where it was."""
    copy, _, main = copied(made, tmp_path)
    config = SUBJECTS["cube"].config(PLAIN)
    assert entry_of_whole(main, copy, config).passed
    text = re.sub(pattern, by, main.read_text(), count=1, flags=re.MULTILINE)
    assert text != main.read_text()
    main.write_text(text)
    check = entry_of_whole(main, copy, config)
    assert not check.passed
    assert said in check.text


def test_an_entry_program_of_other_bytes_is_found_where_its_motions_are_the_same(made, tmp_path):
    copy, part, main = copied(made, tmp_path)
    main.write_text(main.read_text().replace("; ENTRY: AT LAYER 2", "; ENTRY: AT LAYER 1"))
    assert "bytes are not those recorded" in failed(copy, part, hashed=False)["entry"].text


def test_a_layer_without_beads_is_no_entry_and_shuts_the_gate(tmp_path):
    """Two plates with a gap: nothing is laid on the layer at which the program is to begin."""
    gap = join(box((0, 0, 0), (24, 24, 3)), box((0, 0, 6), (24, 24, 9)))
    part = write_stl(gap, tmp_path / "gap.stl")
    config = SUBJECTS["cube"].config(PLAIN)
    config = config.changed(layers={"heights_mm": (0.75, 2.25, 4.5, 6.75, 8.25)})
    with slicers_here():
        result = run_job(part, tmp_path / "run", config, from_layer=3)
    gates = {gate.name: gate for gate in result.gates}
    assert not gates["entry"].passed
    assert result.exit_code is ExitCode.OUT_OF_TOLERANCE
    assert not result.manifest["program"]["entry"]["validated"]
    assert not any("; VALIDATED" in path.read_text() for path in (RunFolder(tmp_path / "run").path / "entry").iterdir())

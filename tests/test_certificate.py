"""Verification from text and part alone: the certificate, and faults that are found without the plan."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from command_line import frame, write_stl
from finished_runs import FOUR_MM, certified_plate
from parts import box
from slicers_here import slicers_here

from ebamcheck.json_values import sha256_of_file, write_json
from ebamcheck.mesh.part import from_arrays
from ebamcheck.pipeline import run_job
from ebamcheck.pipeline.cross_check import witness_backend
from ebamcheck.plugins import registry
from ebamcheck.record.certificate import CERTIFICATE, RELEASE, read_certificate
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.verification.verify import settings_beside, verify, verify_against_part
from ebamcheck_reports import html
from ebamcheck_reports.run_data import GATES

MAIN, SECOND = "MAIN.MPF", "MAIN_L0002.SPF"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A finished run of a plate with a hole, with its certificate, and the part's file."""
    return certified_plate(tmp_path_factory)


@pytest.fixture
def copy(made, tmp_path):
    """A copy of the run and the part, to spoil."""
    shutil.copytree(made[0], tmp_path / "copy.run")
    shutil.copy(made[1], tmp_path / "frame.stl")
    return RunFolder(tmp_path / "copy.run"), tmp_path / "frame.stl"


def failures(run, part, settings=FOUR_MM):
    checks = verify_against_part(run.path / "program" / MAIN, part, settings)
    return {c.name: c for c in checks if not c.passed}


def test_the_certificate_says_what_was_made_from_what_and_by_what(copy):
    run, part = copy
    found = read_certificate(run.path / CERTIFICATE)
    assert (found["part"]["sha256"], found["part"]["units"]) == (sha256_of_file(part), "mm")
    for file in found["programs"]:
        assert sha256_of_file(run.path / "program" / file["name"]) == file["sha256"]
    assert found["validated"] is True
    assert [gate["name"] for gate in found["gates"]] == list(GATES)
    assert {"metal", "interpass temperature"} <= {c["name"] for c in found["checks"]}
    assert found["release"] == RELEASE
    assert found["smoothing"]["tolerance_mm"] == FOUR_MM.machine.smoothing_tolerance_mm
    assert found["not_proved"]
    there = {p.relative_to(run.path).as_posix() for p in run.path.rglob("*") if p.is_file()}
    assert set(found["files"]) == there - {CERTIFICATE}
    assert {"run.json", "report.html", "junit.xml"} <= there
    made_by = found["software"]
    # What is required by what is required counts, too: llvmlite comes with numba.
    assert {"numpy", "numba", "llvmlite", "shapely", "manifold3d"} <= set(made_by["dependencies"])
    assert made_by["dependencies"]["numpy"] == np.__version__
    assert re.fullmatch(r"([0-9a-f]{40})?", made_by["source"]["commit"])
    assert made_by["source"]["dirty"] in ("yes", "no", "unknown")
    assert re.fullmatch(r"[0-9a-f]{64}", made_by["source"]["sha256"])
    assert set(made_by["backends"]) == {"planecut", "manifold"}
    assert "Linux" in made_by["system"]


def test_a_run_of_a_version_without_some_settings_is_shown(copy):
    run, _ = copy
    manifest = run.manifest()
    del manifest["settings"]["process"]["layer_pause_s"]
    del manifest["settings"]["machine"]["layer_pause"]
    del manifest["program"]["totals"]["pause_s"]
    write_json(manifest, run.path / "run.json")
    (run.path / CERTIFICATE).unlink()
    html.write(run)
    page = (run.path / "report.html").read_text()
    assert "cannot be shown" not in page
    assert "time at constant feed" in page


def test_a_changed_byte_is_named(copy):
    run, part = copy
    path = run.path / "program" / SECOND
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"; ISLAND", b"; iSLAND", 1))
    assert failures(run, part)["program unchanged"].where == f"{SECOND}:1"
    path.write_bytes(whole)
    data = bytearray(part.read_bytes())
    data[10] ^= 1
    part.write_bytes(data)
    assert set(failures(run, part)) == {"part unchanged", "header"}


def test_other_settings_are_named(copy):
    run, part = copy
    other = FOUR_MM.changed(slicing={"time_limit_s": 500.0})
    # The header states the hash of all settings; one that no line of it contradicts is told by the certificate alone.
    assert set(failures(run, part, other)) == {"settings unchanged"}
    other = FOUR_MM.changed(machine={"name": "another"})
    assert set(failures(run, part, other)) == {"settings unchanged", "profile unchanged", "header"}


def test_a_program_in_a_run_is_verified_with_the_settings_of_the_run(copy):
    run, part = copy
    assert settings_beside(run.path / "program" / MAIN) == FOUR_MM
    checks = verify(run.path / "program" / MAIN, part)
    assert [c for c in checks if not c.passed] == []


def test_a_program_without_its_run_asks_for_its_settings(made, tmp_path):
    program = shutil.copytree(made[0] / "program", tmp_path / "alone") / MAIN
    lines = program.read_text().splitlines()
    program.write_text("\n".join([*lines[:20], "R10=40", *lines[20:], ""]))
    (found,) = [c for c in verify(program, made[1]) if not c.passed]
    assert found.text.startswith("unknown word 'R10=40'; no run lies beside the program, so the default settings")
    assert "--config" in found.text
    (found,) = [c for c in verify(program, made[1], FOUR_MM) if not c.passed]
    assert found.text == "unknown word 'R10=40'"


def test_the_witness_is_another_exact_slicer_and_no_more_are_asked_than_needed(monkeypatch):
    """A probe may set up a driver or start another program."""
    asked, probe = [], registry.probe
    monkeypatch.setattr(registry, "probe", lambda name: asked.append(name) or probe(name))
    assert witness_backend("manifold") != "manifold"
    assert witness_backend("") == witness_backend("planecut")
    asked.clear()
    found = witness_backend("planecut")
    exact = [n for n in registry.house_slicers() if n != "planecut" and registry.slicer(n).exact]
    available = [name for name in exact if probe(name).available]
    assert found == max(available, key=lambda name: registry.slicer(name).priority)
    assert min(registry.slicer(name).priority for name in asked) == registry.slicer(found).priority
    assert set(asked) <= set(exact)


# -- found from text and part alone (all kinds: test_program_faults, test_faults) -----------------------


def test_a_moved_hole_is_found_from_text_and_part_alone(copy, tmp_path):
    run, part = copy
    (run.path / CERTIFICATE).unlink()
    assert failures(run, part) == {}
    shifted = frame().vertices.copy()
    inner = (shifted[:, 0] > 1) & (shifted[:, 0] < 39)
    shifted[inner, 0] += 1.0
    other = write_stl(from_arrays(shifted, frame().faces, "moved"), tmp_path / "moved.stl")
    assert {"section", "smooth section"} <= set(failures(run, other))


# File, what is replaced in it, by what, the check that finds it, and the line that it names.
FAULTS = {
    "sign flipped": (SECOND, r"G1 X(\d)", r"G1 X-\1", "smooth section", None),
    "layers swapped": (MAIN, r"(MAIN_L000)1\n((?:.*\n)*?.*MAIN_L000)2\n", r"\g<1>2\n\g<2>1\n", "layer heights", MAIN),
    "block twice": (SECOND, r"(N\d+ G1 X\S+ Y\S+\n)", r"\1\1", "repeated blocks", SECOND),
    "cut off": (SECOND, r"(?s)(RING.*?\n.*?\n).*", r"\1", "end of program", SECOND),
    "wrong power": ("MAIN_L0001.SPF", r"(?s)(H2=.*?H2=)\S+", r"\g<1>20", "power", "MAIN_L0001.SPF"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_from_text_and_part_alone(copy, name):
    run, part = copy
    (run.path / CERTIFICATE).unlink()
    file, pattern, by, check, where = FAULTS[name]
    path = run.path / "program" / file
    text, count = re.subn(pattern, by, path.read_text(), count=1)
    assert count
    path.write_text(text)
    found = failures(run, part)
    assert check in found, {c.name: (c.where, c.text) for c in found.values()}
    assert where is None or found[check].where.startswith(f"{where}:")


def test_a_missing_hatch_line_is_found_from_text_and_part_alone(tmp_path):
    part = write_stl(box((0, 0, 0), (90, 70, 8)), tmp_path / "block.stl")
    with slicers_here():
        run = run_job(part, tmp_path / "block.run", FOUR_MM).folder
    path = run.path / "program" / SECOND
    lines = path.read_text().split("\n")
    turns = [i for i, line in enumerate(lines) if "; TURN" in line]

    # The turn to a line that another turn follows, and the line: the tool goes straight on to the next. Where a line is
    # under two and a half spacings long, that way covers most of its place, and what stays bare is under the limit of a gap.
    def length(i):
        ends = [re.search(r"X(\S+) Y(\S+)", lines[k]).groups() for k in (i, i + 1)]
        return np.linalg.norm(np.subtract(*np.array(ends, dtype=float)))

    least_mm = 2.5 * FOUR_MM.process.hatch_spacing_mm
    for nth in (0, 6):
        i = [i for i in turns if i + 2 in turns and length(i) > least_mm][nth]
        path.write_text("\n".join([*lines[:i], *lines[i + 2 :]]))
        found = failures(run, part)
        # By the turn that has become too long, or by what it leaves bare, not by its hash alone.
        told = [found[name] for name in ("gaps", "turns", "hatch spacing", "hatch lines") if name in found]
        assert told, {c.name: (c.where, c.text) for c in found.values()}
        assert told[0].where.startswith(f"{SECOND}:")

"""Verification of finished runs: one changed byte, a lost file, other settings, another part."""

from __future__ import annotations

import json
import os
import shutil

import pytest
from command_line import frame, write_stl
from finished_runs import THICK, plate_of_every_slicer
from parts import box

from ebamcheck.errors import InputError
from ebamcheck.mesh.part import from_arrays
from ebamcheck.verification.verify import verify, verify_against_part, verify_run


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A finished run with every backend there is, of a plate with a hole."""
    return plate_of_every_slicer(tmp_path_factory)


@pytest.fixture
def copy(plate, tmp_path):
    """A copy of the finished run, to spoil."""
    return shutil.copytree(plate[0].folder.path, tmp_path / "copy.run")


def test_an_untouched_run_verifies(plate):
    checks = verify_run(plate[0].folder.path, plate[1])
    assert all(check.passed for check in checks)
    assert {"settings unchanged", "part unchanged", "file unchanged", "gate program"} <= {
        c.name for c in checks
    }


@pytest.mark.parametrize(
    "name", ["program/MAIN.MPF", "program/MAIN_L0002.SPF", "layers/planecut.parquet", "scan.csv"]
)
def test_verify_finds_one_changed_byte(copy, name):
    data = bytearray((copy / name).read_bytes())
    data[len(data) // 2] ^= 1
    (copy / name).write_bytes(data)
    assert [c.where for c in verify_run(copy) if not c.passed] == [name]


def test_verify_finds_other_settings_a_lost_file_and_another_part(copy, plate):
    other = write_stl(box(), copy.parent / "other.stl")
    assert [c.name for c in verify_run(copy, other) if not c.passed] == ["part unchanged"]
    os.remove(copy / "beads.parquet")
    assert [(c.where, c.text) for c in verify_run(copy) if not c.passed] == [
        ("beads.parquet", "the file is missing")
    ]
    record = json.loads((copy / "run.json").read_text())
    record["settings"]["process"]["bead_width_mm"] = 7.0
    (copy / "run.json").write_text(json.dumps(record))
    assert "settings unchanged" in [c.name for c in verify_run(copy) if not c.passed]
    del record["files"]
    (copy / "run.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"run\.json: is not whole: files: Field required"):
        verify_run(copy)


@pytest.mark.parametrize("name", ["run.json", "timings.json", "certificate.json"])
def test_a_record_nested_beyond_reading_is_refused(copy, name):
    (copy / name).write_text("[" * 100_000)
    with pytest.raises(InputError, match=rf"{name}: cannot be read"):
        verify_run(copy)


def test_a_program_without_its_run_asks_for_its_settings(plate, tmp_path):
    program = shutil.copytree(plate[0].folder.program_folder, tmp_path / "alone") / "MAIN.MPF"
    lines = program.read_text().splitlines()
    program.write_text("\n".join([*lines[:20], "R10=40", *lines[20:], ""]))
    (found,) = [c for c in verify(program, plate[1]) if not c.passed]
    assert found.text.startswith(
        "unknown word 'R10=40'; no run lies beside the program, so the default settings"
    )
    assert "--config" in found.text
    (found,) = [c for c in verify(program, plate[1], THICK) if not c.passed]
    assert found.text == "unknown word 'R10=40'"


def test_verify_a_program_against_a_part_finds_a_moved_hole(plate, tmp_path):
    program = plate[0].folder.program_folder / "MAIN.MPF"
    assert all(check.passed for check in verify_against_part(program, plate[1], THICK))
    shifted = frame().vertices.copy()
    inner = (shifted[:, 0] > 1) & (shifted[:, 0] < 39)
    shifted[inner, 0] += 1.0
    other = write_stl(from_arrays(shifted, frame().faces, "moved"), tmp_path / "moved.stl")
    assert not all(check.passed for check in verify_against_part(program, other, THICK))

"""Forged records and certificates: names that lead elsewhere, keys of no use, files that a control would load, a late change."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import fields
from pathlib import Path

import pytest
from command_line import ebamcheck
from finished_runs import certified_plate
from sealed_runs import copied, failed, resealed, two_keys

from ebamcheck.comparison.naming import Disagreement
from ebamcheck.errors import ExitCode, InputError
from ebamcheck.json_values import json_text, read_json, sha256_of_file
from ebamcheck.record.certificate import CERTIFICATE, find_certificate, find_record, write_sealed
from ebamcheck.record.certificate_checks import refuse_unfit
from ebamcheck.record.form import CheckForm, DisagreementForm, FindingForm, GateForm
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.record.signing import SIGNATURES, make_key, sign, signature_check
from ebamcheck.result import Check, check_record, finding_records, gate_record
from ebamcheck.settings.config import validated
from ebamcheck.verification.verify import settings_beside, verify, verify_run


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return certified_plate(tmp_path_factory)


@pytest.fixture
def run(made, tmp_path):
    return copied(made, tmp_path)


def place(found, path):
    """The table that holds the last step of a path, and that step."""
    *steps, last = path
    for step in steps:
        found = found[step]
    return found, last


def changed(run, name, path, value):
    """Write another value into the record or certificate of a run."""
    found = read_json(run / name)
    table, last = place(found, path)
    table[last] = value
    (run / name).write_text(json_text(found))


ELSEWHERE = "../../../../../../etc/hostname"

RECORDS = {
    "its own layers as witness": (("program", "witness"), "../layers/planecut", "no name of a slicer"),
    "another file as witness": (("program", "witness"), "/etc/hostname", "no name of a slicer"),
    "a slicer that did not run as witness": (("program", "witness"), "trimesh", "no slicer of this run"),
    "layers of nobody": (("primary",), "nobody", "no slicer of this run"),
    "a program elsewhere": (("program", "files", 0, "name"), ELSEWHERE, "no plain file name"),
    "a program in a folder": (("program", "files", 0, "name"), "a/MAIN.MPF", "no plain file name"),
    "a file elsewhere": (("files", ELSEWHERE), "0" * 64, "no name of a file inside"),
    "a file by its full name": (("files", "/etc/hostname"), "0" * 64, "no name of a file inside"),
    "a file by a detour": (("files", "layers/../run.json"), "0" * 64, "no name of a file inside"),
    "a file with an escape": (("files", "a\x1b[2J"), "0" * 64, "no name of a file inside"),
    "layers elsewhere": (("backends", "planecut", "file"), ELSEWHERE, "no name of a file inside"),
    "a part elsewhere": (("part", "source"), ELSEWHERE, "no plain file name"),
    "a slicer with a path": (("backends", "../x"), {}, "no name of a slicer"),
    "an unknown key": (("blessed",), True, "Extra inputs"),
    "an unknown key of a gate": (("gates", 0, "blessed"), True, "Extra inputs"),
    "an unknown key of the program": (("program", "blessed"), True, "Extra inputs"),
    "a figure that is a text": (("gates", 0, "figure"), "0", "gates.0.figure"),
    "a verdict that is a number": (("program", "validated"), 1, "program.validated"),
    "no hash": (("program", "files", 0, "sha256"), "missing", "program.files.0.sha256"),
    "no files of the program": (("program", "files"), [], "program.files"),
    "an exit code of its own": (("exit_code",), 9, "exit_code"),
    "a code of a finding": (("findings", 0, "code"), "all-is-well", "no code of a finding"),
    "totals without wire": (("program", "totals"), {}, "program.totals"),
    "a time of no length": (("program", "totals", "pause_s"), "NaN", "program.totals.pause_s"),
    "another format": (("format",), 1, "not a run of format 2: make it again"),
}


@pytest.mark.parametrize("what", RECORDS)
def test_a_record_of_another_form_is_refused_in_one_line(run, what):
    path, value, said = RECORDS[what]
    changed(run, MANIFEST, path, value)
    for read in (
        lambda: verify_run(run, quick=True),
        lambda: RunFolder(run).manifest(),
        lambda: refuse_unfit(RunFolder(run)),
    ):
        with pytest.raises(InputError, match=said) as found:
            read()
        assert "\n" not in str(found.value)


CERTIFICATES = {
    "a file elsewhere": (("files", ELSEWHERE), "0" * 64, "no name of a file inside"),
    "a program elsewhere": (("programs", 0, "name"), ELSEWHERE, "no plain file name"),
    "a witness elsewhere": (("witness",), "../layers/planecut", "no name of a slicer"),
    "a primary elsewhere": (("primary",), "/etc/hostname", "no name of a slicer"),
    "an unknown key": (("blessed",), True, "Extra inputs"),
    "an unknown key of the release": (("release", "blessed"), "yes", "Extra inputs"),
    "a lot of lots": (("release", "lots"), {"wire": {"a": "b"}}, "release.lots.wire"),
    "no release": (("release",), {}, "release"),
    "a verdict in words": (("validated",), "yes", "validated"),
}


@pytest.mark.parametrize("what", CERTIFICATES)
def test_a_certificate_of_another_form_is_refused_in_one_line(run, what):
    path, value, said = CERTIFICATES[what]
    found = read_json(run / CERTIFICATE)
    table, last = place(found, path)
    table[last] = value
    write_sealed(run / CERTIFICATE, found)
    with pytest.raises(InputError, match=said):
        verify_run(run, quick=True)


@pytest.mark.parametrize("name", [MANIFEST, CERTIFICATE, "timings.json"])
@pytest.mark.parametrize("nasty", ["twice", "digits", "nested", "infinite"])
def test_json_that_is_none_of_ours_ends_with_code_2(run, name, nasty):
    text = (run / name).read_text().rstrip()[1:]
    first = text.split(":", 1)[0].strip()
    begin = {
        "twice": f"{first}: 1, ",
        "digits": f'"a": {"9" * 5000}, ',
        "nested": f'"a": {"[" * 900}{"]" * 900}, ',
        "infinite": '"a": Infinity, ',
    }
    (run / name).write_text("{" + begin[nasty] + text)
    for command in (("verify", run, "--quick"), ("report", run)):
        if (command[0], name) == ("report", CERTIFICATE):
            continue  # the report says so in its section
        told = ebamcheck(*command, cwd=run.parent)
        assert (told.returncode, told.stderr.count("\n")) == (ExitCode.USAGE, 1), told.stderr


def test_no_file_is_opened_that_the_folder_does_not_hold(run, tmp_path):
    """A name inside of the folder may still be a link that leads out of it."""
    (tmp_path / "secret").write_bytes((run / "scan.csv").read_bytes())
    (run / "scan.csv").unlink()
    (run / "scan.csv").symlink_to(tmp_path / "secret")
    os.chmod(tmp_path / "secret", 0)
    assert "leads out of the run folder" in failed(run, quick=True)["file unchanged"].text


@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_what_takes_the_place_of_a_file_is_no_file(run, kind):
    (run / "scan.csv").unlink()
    os.mkfifo(run / "scan.csv") if kind == "pipe" else (run / "scan.csv").mkdir()
    assert "is no regular file" in failed(run, quick=True)["file unchanged"].text


OTHERS = {
    "a link": lambda path: path.symlink_to("aside"),
    "a link, to itself": lambda path: path.symlink_to(path.name),
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
}


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("name", [MANIFEST, CERTIFICATE, "timings.json"])
def test_what_takes_the_place_of_record_or_certificate_is_told_in_one_line(run, name, other):
    (run / name).rename(run / "aside")
    OTHERS[other](run / name)
    said = f"{name}: is {other.partition(',')[0]}, not a file"
    found_from = {MANIFEST: find_record, CERTIFICATE: find_certificate}.get(name, settings_beside)
    for read in (
        lambda: verify(run, quick=True),
        lambda: refuse_unfit(RunFolder(run)),
        lambda: found_from(run / "program"),
    ):
        with pytest.raises(InputError, match=said) as found:
            read()
        assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    "name", ["program/MAIN.MPF", "beads.parquet", "program", "layers", "new", SIGNATURES]
)
def test_a_link_to_itself_is_a_fault_of_the_run(run, name):
    if (run / name).exists():
        (run / name).rename(run.parent / "aside")
    (run / name).symlink_to(run / name)
    told = ebamcheck("verify", run, "--quick", cwd=run.parent)
    assert told.returncode in (ExitCode.OUT_OF_TOLERANCE, ExitCode.USAGE), told.stderr
    assert told.stderr.count("\n") <= 1


# -- files that a control loads --------------------------------------------------------------------------

LOADED = [
    "_N_MAIN_L0005_SPF",
    "MAIN_L0005.MPF",
    "GUD7.DEF",
    "MAIN.INI",
    "main_l0001.spf",
    "CYCLE832.CPF",
    "X.TEA",
]


def listed(run, name):
    """A forger's list of files, and seal, which know the file."""
    found = read_json(run / MANIFEST)
    found["files"][name] = sha256_of_file(run / name)
    (run / MANIFEST).write_text(json_text(found))
    resealed(run)


@pytest.mark.parametrize("name", LOADED)
def test_a_file_that_a_control_would_load_is_a_fault_of_the_run(run, name):
    (run / "program" / name).write_text("M17\n")
    resealed(run)
    found = failed(run, quick=True)["file unchanged"]
    assert (found.where, found.text) == (f"program/{name}", "the record does not know this file")
    listed(run, f"program/{name}")
    assert f"{name} is never called" in failed(run, quick=True)["subprograms"].text


@pytest.mark.parametrize("name", LOADED)
def test_a_file_that_a_control_would_load_is_a_fault_of_the_program_by_itself(made, tmp_path, name):
    folder = shutil.copytree(made[0] / "program", tmp_path / "program")
    (folder / name).write_text("M17\n")
    config = RunFolder(made[0]).manifest()["settings"]
    checks = verify(folder / "MAIN.MPF", made[1], validated(config, "x"))
    assert [c.name for c in checks if not c.passed] == ["subprograms"]


@pytest.mark.parametrize(
    "name", [".DS_Store", "program/.DS_Store", "layers/Thumbs.db", "signatures/.directory"]
)
def test_what_a_file_manager_leaves_is_named_and_ignored(run, name):
    (run / name).parent.mkdir(exist_ok=True)
    (run / name).write_bytes(b"\0")
    checks = verify_run(run, quick=True)
    assert all(check.passed for check in checks)
    assert any(f"ignored: {name.removeprefix('signatures/')}" in check.text for check in checks)


def test_a_folder_among_the_signatures_is_none(run):
    (run / SIGNATURES / "old").mkdir(parents=True)
    told = signature_check(run / CERTIFICATE, None)
    assert told.passed
    assert "ignored: old" in told.text


# -- signing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["record", "program", "added"])
def test_what_no_longer_fits_its_certificate_is_not_signed(run, tmp_path, what):
    key, _ = make_key(tmp_path / "jane")
    if what == "record":
        changed(run, MANIFEST, ("gates", 0, "text"), "sound")
    elif what == "program":
        (run / "program" / "MAIN.MPF").write_bytes((run / "program" / "MAIN.MPF").read_bytes() + b"\n")
    else:
        (run / "program" / "MAIN_L0009.SPF").write_text("M17\n")
    told = ebamcheck("sign", run, "--key", key, "--name", "Jane", cwd=tmp_path)
    assert told.returncode == ExitCode.USAGE
    assert "is not to be signed" in told.stderr
    assert not (run / SIGNATURES).exists()


def test_the_name_of_a_signer_reaches_no_terminal_as_it_is(run, tmp_path):
    sign(run / CERTIFICATE, two_keys(tmp_path)[0], "Jane\x1b[2K\nFAIL")
    assert "Jane\\x1b[2K\\nFAIL (approver)" in signature_check(run / CERTIFICATE, None).text


# -- figures of the record -------------------------------------------------------------------------------

FIGURES = {
    "wire of the program": (("program", "totals", "wire_kg"), 0.001),
    "time of the program": (("program", "totals", "deposit_s"), 1.0),
    "waits of the plan": (("scan", "wait_s"), 1.0),
    "feed along the contours": (("kinematics", "program", "least_share"), 1.0),
    "volume of the part": (("part", "inspection", "volume_mm3"), 1.0),
    "limit of the heat": (("heat", "limit_k"), 2000.0),
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("what", FIGURES)
def test_a_figure_of_the_record_that_does_not_follow_is_found(run, what):
    path, value = FIGURES[what]
    changed(run, MANIFEST, path, value)
    resealed(run)
    found = failed(run)
    assert set(found) == {"record"}
    assert f"{'.'.join(path)} is not what was found" in found["record"].text


def test_a_program_that_is_its_own_witness_is_found_without_slicing(run):
    found = json.loads((run / MANIFEST).read_text())
    changed(run, MANIFEST, ("program", "witness"), found["primary"])
    resealed(run)
    assert "own witness" in failed(run, quick=True)["record"].text


def test_the_form_of_a_record_has_the_fields_of_what_is_written():
    one = Check.finding("note", "metal-excess", "too much")
    for form, record in {
        CheckForm: check_record(one),
        GateForm: gate_record(one),
        FindingForm: finding_records([one])[0],
    }.items():
        assert list(form.model_fields) == list(record)
    beside = {"program_z_mm"}
    assert set(DisagreementForm.model_fields) == {field.name for field in fields(Disagreement)} | beside

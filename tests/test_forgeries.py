"""What a forger would do to a run, and that each of it is found."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import fields, replace
from pathlib import Path

import pytest
from command_line import ebamcheck, write_stl
from finished_runs import FOUR_MM, certified_plate, thin_plate
from parts import box
from sealed_runs import copied, failed, resealed, two_keys

from ebamcheck.comparison.naming import Disagreement
from ebamcheck.errors import ExitCode, InputError
from ebamcheck.json_values import json_text, read_json, sha256_of_file, write_json
from ebamcheck.layers.files import write_parquet
from ebamcheck.pipeline import run_job
from ebamcheck.record.certificate import (
    CERTIFICATE,
    find_certificate,
    find_record,
    read_certificate,
    released,
    write_sealed,
)
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


@pytest.fixture(scope="module")
def shut(tmp_path_factory):
    return thin_plate(tmp_path_factory)


@pytest.fixture
def run(made, tmp_path):
    return copied(made, tmp_path)


@pytest.fixture
def keys(tmp_path):
    return two_keys(tmp_path)


@pytest.mark.parametrize(
    "name", ["run.json", "report.html", "junit.xml", "scan.csv", "program/MAIN_L0002.SPF", "layers/planecut.parquet"]
)  # fmt: skip
def test_one_changed_byte_of_any_file_is_found(run, name):
    data = (run / name).read_bytes()
    # A byte that changes no meaning where there is one: a blank of JSON, HTML or CSV.
    at = data.find(b"\n ", len(data) // 2) + 1 or data.find(b" ", len(data) // 2)
    at = len(data) // 2 if at < 0 else at
    (run / name).write_bytes(data[:at] + (b"\t" if data[at : at + 1] == b" " else b"\0") + data[at + 1 :])
    assert [c.where for c in verify_run(run, quick=True) if not c.passed] == [name]


@pytest.mark.parametrize("spoil", [b"\n", b" ", b""])
def test_any_byte_of_the_certificate_is_found(run, spoil):
    path = run / CERTIFICATE
    data = path.read_bytes()
    path.write_bytes(data + spoil if spoil else data.rstrip())
    assert "certificate seal" in failed(run, quick=True)


def test_other_settings_a_lost_file_another_part_and_no_certificate_are_found(run, tmp_path):
    other = write_stl(box(), tmp_path / "other.stl")
    assert {"part unchanged"} <= set(failed(run, part=other, quick=True))
    os.remove(run / "beads.parquet")
    (found,) = failed(run, quick=True).values()
    assert (found.where, found.text) == ("beads.parquet", "the file is missing")
    manifest = RunFolder(run).manifest()
    manifest["settings"]["process"]["bead_width_mm"] = 7.0
    write_json(manifest, run / "run.json")
    assert "settings unchanged" in failed(run, quick=True)
    (run / CERTIFICATE).unlink()
    assert "certificate" in failed(run, quick=True)


def test_a_shut_gate_that_is_written_open_is_found(shut, tmp_path):
    shutil.copytree(shut[0], tmp_path / "forged.run")
    run = tmp_path / "forged.run"
    manifest = RunFolder(run).manifest()
    for gate in manifest["gates"]:
        gate |= {"passed": True, "figure": gate["limit"]}
    for check in manifest["program"]["checks"]:
        check |= {"passed": True, "value": check["limit"]}
    manifest |= {"findings": [], "exit_code": 0}
    manifest["program"]["validated"] = True
    write_json(manifest, run / "run.json")
    resealed(run)
    found = failed(run)
    assert {"gate deposit", "recorded figures", "verdict"} <= set(found)
    assert found["gate deposit"].where == "run.json"
    assert "recorded as passed, found shut" in found["gate deposit"].text
    assert not {"certificate seal", "certificate"} & set(found), "the seal alone does not tell"


def test_a_gate_that_is_left_out_or_made_up_is_found(run):
    manifest = RunFolder(run).manifest()
    manifest["gates"] = [g for g in manifest["gates"] if g["name"] != "heat"]
    manifest["gates"].append({**manifest["gates"][0], "name": "blessed"})
    write_json(manifest, run / "run.json")
    resealed(run)
    assert {"gate heat", "gate blessed"} <= set(failed(run))


# Figures of a record: where, what is written there, the check that finds it.
FORGED = {
    "figure of a check": (("program", "checks", -1, "value"), -7.0, "recorded figures"),
    "figure of a gate": (("gates", 2, "figure"), -1.0, "gate fit"),
    "limit of a gate": (("gates", 4, "limit"), 0.5, "gate deposit"),
    "figure under its limit": (("gates", 3, "figure"), 0.5, "gate coverage"),
    "checks left out": (("program", "checks"), [], "recorded figures"),
    "findings left out": (("findings",), [], "record"),
    "comparison": (("comparison", "passed"), False, "record"),
    "name of the part": (("part", "name"), "turbine blade", "record"),
    "wire of the program": (("program", "totals", "wire_kg"), 0.001, "record"),
    "time of the program": (("program", "totals", "deposit_s"), 1.0, "record"),
    "waits of the plan": (("scan", "wait_s"), 1.0, "record"),
    "feed along the contours": (("kinematics", "program", "least_share"), 1.0, "record"),
    "volume of the part": (("part", "inspection", "volume_mm3"), 1.0, "record"),
    "limit of the heat": (("heat", "limit_k"), 2000.0, "record"),
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("what", FORGED)
def test_a_record_that_was_changed_and_sealed_again_is_found(run, what):
    path, value, check = FORGED[what]
    changed(run, MANIFEST, path, value)
    resealed(run)
    found = failed(run)
    assert check in found
    if check == "record" and isinstance(value, float):
        assert f"{'.'.join(path)} is not what was found" in found["record"].text


def test_a_run_relabelled_as_another_part_is_found(run, tmp_path):
    other = write_stl(box((0, 0, 0), (40, 40, 12)), tmp_path / "other.stl")
    manifest = RunFolder(run).manifest()
    manifest["part"] |= {"name": "other", "source": "other.stl", "sha256": sha256_of_file(other)}
    manifest["timings"]["part_path"] = str(other)
    write_json(manifest, run / "run.json")
    resealed(run)
    found = failed(run)
    assert "worked out again" in found
    assert "compare the same part" in found["worked out again"].text


@pytest.mark.slow
def test_layers_swapped_for_those_of_another_height_are_found(run, made, tmp_path):
    """The program, its plan and its layers all come from a part of another size; hashes are made anew."""
    bigger = write_stl(box((0, 0, 0), (40, 40, 12)), tmp_path / "bigger.stl")
    other = run_job(bigger, tmp_path / "bigger.run", FOUR_MM).folder.path
    part = RunFolder(run).manifest()["part"]
    manifest = RunFolder(other).manifest()
    manifest["part"] = part
    manifest["timings"]["part_path"] = str(made[1])
    write_json(manifest, other / "run.json")
    resealed(other)
    assert "worked out again" in failed(other, part=made[1])
    # The same with layers that claim to be cut from the part: the contours themselves tell.
    for name in ("planecut", "manifold"):
        layers = RunFolder(other).read_layers(name)
        write_parquet(replace(layers, part=RunFolder(run).read_layers(name).part), other / "layers" / f"{name}.parquet")
    manifest["files"] = {n: sha256_of_file(other / n) for n in manifest["files"]}
    write_json(manifest, other / "run.json")
    resealed(other)
    assert {"gate agreement", "gate program", "verdict"} <= set(failed(other, part=made[1]))


def test_an_approver_who_did_not_sign_is_found_by_the_signature(run, keys):
    jane, stranger, trusted = keys
    sign(released(run / CERTIFICATE, {"approver": "Jane Doe"}), jane, "Jane Doe")
    found = read_certificate(run / CERTIFICATE)
    found["release"]["approver"] = "Somebody Else"
    write_sealed(run / CERTIFICATE, found)
    assert set(failed(run, quick=True)) == {"signature"}
    shutil.rmtree(run / SIGNATURES)
    sign(run / CERTIFICATE, stranger, "Jane Doe")
    assert failed(run, quick=True) == {}, "a stranger's signature is valid, and told as such"
    assert set(failed(run, quick=True, trusted=trusted)) == {"signature"}


@pytest.mark.parametrize("field", ["name", "role", "date", "signature", "public_key", "certificate_sha256", "format"])
def test_a_signature_whose_text_was_changed_is_broken(run, keys, field):
    file = sign(run / CERTIFICATE, keys[0], "Jane Doe")
    found = json.loads(file.read_text())
    found[field] = found[field][::-1] if isinstance(found[field], str) else 7
    file.write_text(json.dumps(found))
    assert not signature_check(run / CERTIFICATE, None).passed


@pytest.mark.parametrize("text", ["", "[]", "{}", "null", '{"public_key": 1}', "\0", '{"format": 1, "x": '])
def test_what_is_no_signature_is_told_so(run, text):
    (run / SIGNATURES).mkdir()
    (run / SIGNATURES / "a.json").write_text(text)
    told = signature_check(run / CERTIFICATE, None)
    assert not told.passed
    assert told.where == f"{SIGNATURES}/a.json"


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
    "a slicer that did not run as witness": (("program", "witness"), "trimesh", "no slicer of this run"),
    "layers of nobody": (("primary",), "nobody", "no slicer of this run"),
    "a program elsewhere": (("program", "files", 0, "name"), ELSEWHERE, "no plain file name"),
    "a file elsewhere": (("files", ELSEWHERE), "0" * 64, "no name of a file inside"),
    "a file by a detour": (("files", "layers/../run.json"), "0" * 64, "no name of a file inside"),
    "a file with an escape": (("files", "a\x1b[2J"), "0" * 64, "no name of a file inside"),
    "layers elsewhere": (("backends", "planecut", "file"), ELSEWHERE, "no name of a file inside"),
    "a part elsewhere": (("part", "source"), ELSEWHERE, "no plain file name"),
    "a slicer with a path": (("backends", "../x"), {}, "no name of a slicer"),
    "an unknown key": (("blessed",), True, "Extra inputs"),
    "a figure that is a text": (("gates", 0, "figure"), "0", "gates.0.figure"),
    "no hash": (("program", "files", 0, "sha256"), "missing", "program.files.0.sha256"),
    "no files of the program": (("program", "files"), [], "program.files"),
    "an exit code of its own": (("exit_code",), 9, "exit_code"),
    "a code of a finding": (("findings", 0, "code"), "all-is-well", "no code of a finding"),
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
    "a primary elsewhere": (("primary",), "/etc/hostname", "no name of a slicer"),
    "an unknown key": (("blessed",), True, "Extra inputs"),
    "an unknown key of the release": (("release", "blessed"), "yes", "Extra inputs"),
    "a lot of lots": (("release", "lots"), {"wire": {"a": "b"}}, "release.lots.wire"),
    "no release": (("release",), {}, "release"),
    "a verdict in words": (("validated",), "yes", "validated"),
    "another format": (("format",), 1, "is not a certificate of format 2"),
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
def test_json_that_is_none_of_ours_ends_with_code_2(run, name):
    for nasty in (
        '"format": 1, ',
        f'"a": {"9" * 5000}, ',
        f'"a": {"[" * 900}{"]" * 900}, ',
        '"a": Infinity, ',
    ):
        text = (run / name).read_text()
        (run / name).write_text("{" + nasty + text.lstrip()[1:])
        told = ebamcheck("verify", run, "--quick", cwd=run.parent)
        assert (told.returncode, told.stderr.count("\n")) == (ExitCode.USAGE, 1), told.stderr
        (run / name).write_text(text)


def test_no_file_is_opened_that_the_folder_does_not_hold(run, tmp_path):
    """A name inside of the folder may still be a link that leads out of it."""
    (tmp_path / "secret").write_bytes((run / "scan.csv").read_bytes())
    (run / "scan.csv").unlink()
    (run / "scan.csv").symlink_to(tmp_path / "secret")
    os.chmod(tmp_path / "secret", 0)
    assert "leads out of the run folder" in failed(run, quick=True)["file unchanged"].text


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


LOADED = ["_N_MAIN_L0005_SPF", "GUD7.DEF", "main_l0001.spf", "X.TEA"]


def listed(run, name):
    """A forger's list of files, and seal, which know the file."""
    found = read_json(run / MANIFEST)
    found["files"][name] = sha256_of_file(run / name)
    (run / MANIFEST).write_text(json_text(found))
    resealed(run)


@pytest.mark.parametrize("name", LOADED)
def test_a_file_that_a_control_would_load_is_a_fault_of_run_and_program(run, made, name):
    (run / "program" / name).write_text("M17\n")
    resealed(run)
    found = failed(run, quick=True)["file unchanged"]
    assert (found.where, found.text) == (f"program/{name}", "the record does not know this file")
    listed(run, f"program/{name}")
    assert f"{name} is never called" in failed(run, quick=True)["subprograms"].text
    # And by the program alone.
    (run / CERTIFICATE).unlink()
    checks = verify(run / "program" / "MAIN.MPF", made[1], validated(RunFolder(run).manifest()["settings"], "x"))
    assert [c.name for c in checks if not c.passed] == ["subprograms"]


@pytest.mark.parametrize("name", [".DS_Store", "program/.DS_Store", "layers/Thumbs.db", "signatures/.directory"])
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

"""What a forger would do to a run, and that each of it is found."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from command_line import write_stl
from finished_runs import FOUR_MM, certified_plate, thin_plate
from parts import box
from sealed_runs import copied, failed, resealed, two_keys

from ebamcheck.errors import InputError
from ebamcheck.json_values import (
    sha256_of_file,
    write_json,
)
from ebamcheck.layers.files import write_parquet
from ebamcheck.pipeline import run_job
from ebamcheck.record.certificate import (
    CERTIFICATE,
    read_certificate,
    released,
    write_sealed,
)
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.record.signing import (
    SIGNATURES,
    sign,
    signature_check,
)
from ebamcheck.verification.verify import verify_run


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
    assert name in [c.where for c in verify_run(run) if not c.passed]


@pytest.mark.parametrize("spoil", [b"\n", b" ", b""])
def test_any_byte_of_the_certificate_is_found(run, spoil):
    path = run / CERTIFICATE
    data = path.read_bytes()
    path.write_bytes(data + spoil if spoil else data.rstrip())
    assert "certificate seal" in failed(run)


@pytest.mark.parametrize("release", [None, [], {}, {"approver": "Jane Doe"}])
def test_a_certificate_without_its_release_is_refused_in_one_line(run, release):
    found = read_certificate(run / CERTIFICATE)
    write_sealed(run / CERTIFICATE, {**found, "release": release})
    with pytest.raises(InputError, match=r"is not whole: release"):
        verify_run(run, quick=True)
    with pytest.raises(InputError, match=r"is not whole: release"):
        released(run / CERTIFICATE, {"approver": "Jane Doe"})


def test_a_file_that_is_added_is_found(run):
    (run / "program" / "MAIN_L9999.SPF").write_text("M17\n")
    assert failed(run)["file unchanged"].where == "program/MAIN_L9999.SPF"


def test_a_certificate_that_was_removed_is_missed(run):
    (run / CERTIFICATE).unlink()
    assert "certificate" in failed(run)


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


def test_a_figure_that_is_improved_is_found(run):
    manifest = RunFolder(run).manifest()
    check = next(c for c in manifest["program"]["checks"] if c["name"] == "metal")
    check["value"] = 0.5 * check["value"]
    write_json(manifest, run / "run.json")
    resealed(run)
    assert set(failed(run)) == {"recorded figures"}


@pytest.mark.parametrize(("what", "change"), [("findings", []), ("part", {"name": "turbine blade"})])
def test_a_record_that_was_changed_and_sealed_again_is_found(run, what, change):
    manifest = RunFolder(run).manifest()
    manifest[what] = change if isinstance(change, list) else manifest[what] | change
    write_json(manifest, run / "run.json")
    resealed(run)
    assert "record" in failed(run)


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
        write_parquet(
            replace(layers, part=RunFolder(run).read_layers(name).part), other / "layers" / f"{name}.parquet"
        )
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
    assert set(failed(run)) == {"signature"}
    shutil.rmtree(run / SIGNATURES)
    sign(run / CERTIFICATE, stranger, "Jane Doe")
    assert failed(run) == {}, "a stranger's signature is valid, and told as such"
    assert set(failed(run, trusted=trusted)) == {"signature"}


@pytest.mark.parametrize(
    "field", ["name", "role", "date", "signature", "public_key", "certificate_sha256", "format"]
)
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

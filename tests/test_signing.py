"""A certificate that holds: what a forger would do to a run, and that each of it is found."""

from __future__ import annotations

import base64
import json
import os
import shutil
import stat
import subprocess
from dataclasses import replace

import pytest
from command_line import WIDE, ebamcheck, frame, write_stl
from parts import box

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import (
    sha256_of_file,
    write_json,
)
from ebamcheck.layers.files import write_parquet
from ebamcheck.pipeline import run_job
from ebamcheck.pipeline.certificate import (
    CERTIFICATE,
    certificate,
    file_hashes,
    read_certificate,
    released,
    write_sealed,
)
from ebamcheck.pipeline.run_folder import RunFolder
from ebamcheck.pipeline.signing import (
    SIGNATURES,
    make_key,
    read_private_key,
    sign,
    signature_check,
    trusted_keys,
)
from ebamcheck.pipeline.verify import verify, verify_run
from ebamcheck.settings.config import Config

SETTINGS = Config().changed(
    layers={"layer_height_mm": 4.0}, slicing={"backends": ("planecut", "manifold")}, process=WIDE
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A validated run of a plate with a hole, and the part's file."""
    folder = tmp_path_factory.mktemp("made")
    path = write_stl(frame(), folder / "frame.stl")
    return run_job(path, folder / "frame.run", SETTINGS).folder.path, path


@pytest.fixture(scope="module")
def shut(tmp_path_factory):
    """A run that is not validated: a plate so thin that no bead fits it."""
    folder = tmp_path_factory.mktemp("shut")
    path = write_stl(box((0, 0, 0), (40, 2.0, 8)), folder / "thin.stl")
    result = run_job(path, folder / "thin.run", SETTINGS)
    assert result.exit_code == 1
    return result.folder.path, path


@pytest.fixture
def run(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "copy.run")
    return tmp_path / "copy.run"


@pytest.fixture
def keys(tmp_path):
    """Keys of an approver, who is trusted, and of a stranger."""
    (tmp_path / "trusted").mkdir()
    jane, _ = make_key(tmp_path / "trusted" / "jane")
    stranger, _ = make_key(tmp_path / "stranger")
    return read_private_key(jane), read_private_key(stranger), trusted_keys([tmp_path / "trusted"])


def failed(run, **given):
    return {c.name: c for c in verify_run(run, **given) if not c.passed}


def resealed(run):
    """What a forger does who knows this code: everything that follows from the record, and all hashes, made anew."""
    manifest = RunFolder(run).manifest()
    old = read_certificate(run / CERTIFICATE)
    fields = {
        **certificate(manifest, old["software"]),
        "release": old["release"],
        "files": file_hashes(run),
    }
    write_sealed(run / CERTIFICATE, fields)


# -- what holds --------------------------------------------------------------------------------------


def test_every_gate_of_an_untouched_run_is_worked_out_again(made):
    checks = verify_run(*made)
    assert [c for c in checks if not c.passed] == []
    names = [c.name for c in checks]
    for name in ("input", "agreement", "fit", "coverage", "deposit", "heat", "program"):
        assert f"gate {name}" in names
    assert {"recorded figures", "verdict", "signature"} <= set(names)
    by_name = {c.name: c for c in checks}
    assert "unsigned" in by_name["signature"].text
    # The limits stand beside the figures that they are for.
    for c in checks:
        if c.name.startswith("gate ") and c.unit == "K":
            assert c.value <= c.limit


def test_a_quick_check_says_that_it_believes_the_record(made):
    checks = verify_run(made[0], quick=True)
    assert [c for c in checks if not c.passed] == []
    assert all(c.text.startswith("as recorded: ") for c in checks if c.name.startswith("gate "))
    assert "verdict" not in {c.name for c in checks}


def test_a_run_that_is_not_validated_stays_so(shut):
    found = failed(shut[0])
    assert "gate deposit" in found
    assert not {"certificate seal", "certificate", "recorded figures", "verdict", "file unchanged"} & set(
        found
    )


def test_the_part_is_looked_for_where_it_was(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "a.run")
    manifest = RunFolder(tmp_path / "a.run").manifest()
    manifest["timings"]["part_path"] = str(tmp_path / "gone.stl")
    write_json(manifest, tmp_path / "a.run" / "run.json")
    with pytest.raises(SettingsError, match="name it with --part"):
        verify_run(tmp_path / "a.run")
    shutil.copy(made[1], tmp_path / "frame.stl")
    assert set(failed(tmp_path / "a.run")) == {"file unchanged"}, "run.json was changed"


def test_unsigned_signed_and_trusted_are_told_apart(run, keys):
    jane, stranger, trusted = keys
    path = run / CERTIFICATE
    assert "unsigned" in signature_check(path, None).text
    assert not signature_check(path, trusted).passed
    sign(path, stranger, "Nobody")
    told = signature_check(path, trusted)
    assert not told.passed
    assert "no trusted key has signed" in told.text
    assert "Nobody" in told.text
    sign(path, jane, "Jane Doe")
    told = signature_check(path, trusted)
    assert told.passed
    assert "trusted as jane" in told.text
    assert signature_check(path, None).passed
    assert failed(run, trusted=trusted) == {}


def test_the_release_is_sealed_and_cannot_change_under_a_signature(run, keys):
    jane, _, trusted = keys
    path = released(run / CERTIFICATE, {"approver": "Jane Doe", "deviations": ["plate 2 mm thinner"]})
    assert read_certificate(path)["release"]["deviations"] == ["plate 2 mm thinner"]
    assert failed(run) == {}
    sign(path, jane, "Jane Doe")
    with pytest.raises(SettingsError, match="would break the signature"):
        released(path, {"approver": "Somebody Else"})
    assert failed(run, trusted=trusted) == {}


def test_openssl_agrees_with_the_signature(run, keys, tmp_path):
    """An outside judge: the message as the documentation has it, and openssl's own Ed25519."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    file = sign(run / CERTIFICATE, keys[0], "Jane Doe")
    found = json.loads(file.read_text())
    said = {k: found[k] for k in ("certificate_sha256", "date", "name", "role")}
    message = b"ebamcheck certificate signature 1\0" + json.dumps(said, separators=(",", ":")).encode()
    (tmp_path / "message").write_bytes(message)
    (tmp_path / "signature").write_bytes(base64.b64decode(found["signature"]))
    done = subprocess.run(
        ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", tmp_path / "trusted" / "jane.pub", "-rawin",
         "-in", tmp_path / "message", "-sigfile", tmp_path / "signature"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout


# -- keys --------------------------------------------------------------------------------------------


def test_a_private_key_is_private_and_is_never_overwritten(tmp_path):
    private, _public = make_key(tmp_path / "a")
    assert stat.S_IMODE(os.stat(private).st_mode) == 0o600
    with pytest.raises(SettingsError, match="is there already"):
        make_key(tmp_path / "a")


def test_the_folder_of_a_key_is_made_and_what_cannot_be_written_is_told(tmp_path):
    private, public = make_key(tmp_path / "keys" / "jane")
    assert private.is_file()
    assert public.is_file()
    assert (tmp_path / "keys").stat().st_mode & 0o077 == 0
    (tmp_path / "file").write_text("")
    with pytest.raises(SettingsError, match="the keys cannot be written"):
        make_key(tmp_path / "file" / "jane")


def test_a_protected_key_wants_its_password(tmp_path):
    private, _ = make_key(tmp_path / "a", "secret")
    with pytest.raises(InputError, match="is protected"):
        read_private_key(private)
    with pytest.raises(InputError, match="password is wrong"):
        read_private_key(private, "other")
    assert read_private_key(private, "secret")


def test_what_is_no_key_is_refused(tmp_path):
    (tmp_path / "a.pub").write_text("no key")
    with pytest.raises(InputError, match="is no public key in PEM"):
        trusted_keys([tmp_path])
    with pytest.raises(InputError, match="is no private key"):
        read_private_key(tmp_path / "a.pub")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no public key"):
        trusted_keys([tmp_path / "empty"])
    with pytest.raises(InputError, match="cannot be read"):
        trusted_keys([tmp_path / "missing.pub"])


# -- what a forger does ------------------------------------------------------------------------------


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
    with pytest.raises(InputError, match="is not whole: its release"):
        verify_run(run, quick=True)
    with pytest.raises(InputError, match="is not whole: its release"):
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


FORGED = {
    "figure of a gate": (lambda m: m["gates"][2].update(figure=-1.0), "gate fit"),
    "limit of a gate": (lambda m: m["gates"][4].update(limit=0.5), "gate deposit"),
    "figure under its limit": (lambda m: m["gates"][3].update(figure=0.5), "gate coverage"),
    "checks left out": (lambda m: m["program"].update(checks=[]), "recorded figures"),
    "findings left out": (lambda m: m.update(findings=[]), "record"),
    "comparison": (lambda m: m["comparison"].update(passed=False), "record"),
    "name of the part": (lambda m: m["part"].update(name="turbine blade"), "record"),
    "its own witness": (lambda m: m["program"].update(witness=m["primary"]), "record"),
}


@pytest.mark.parametrize("what", FORGED)
def test_a_record_that_was_changed_and_sealed_again_is_found(run, what):
    change, check = FORGED[what]
    manifest = RunFolder(run).manifest()
    change(manifest)
    write_json(manifest, run / "run.json")
    resealed(run)
    assert check in failed(run)


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


def test_layers_swapped_for_those_of_another_height_are_found(run, made, tmp_path):
    """The program, its plan and its layers all come from a part of another size; hashes are made anew."""
    bigger = write_stl(box((0, 0, 0), (40, 40, 12)), tmp_path / "bigger.stl")
    other = run_job(bigger, tmp_path / "bigger.run", SETTINGS).folder.path
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


# -- as a user does it -------------------------------------------------------------------------------


def test_keys_signatures_and_trust_from_the_command_line(run, made, tmp_path):
    def here(*arguments):
        return ebamcheck(*arguments, cwd=tmp_path)

    assert here("key", "keys/jane").returncode == 0
    done = here(
        "sign", "copy.run", "--key", "keys/jane.key", "--name", "Jane Doe", "--part-number", "B-17",
        "--lot", "wire=W-1234", "--deviation", "plate re-used",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert read_certificate(run / CERTIFICATE)["release"] | {"x": 0} == {
        "part_number": "B-17", "revision": "", "machine_serial": "", "lots": {"wire": "W-1234"}, "operator": "",
        "approver": "Jane Doe", "date": "", "deviations": ["plate re-used"], "x": 0,
    }  # fmt: skip
    done = here("verify", "copy.run", "--quick", "--trusted", "keys")
    assert done.returncode == 0, done.stdout
    assert "trusted as jane" in done.stdout
    (run / "report.html").write_text("forged")
    done = here("verify", "copy.run", "--trusted", "keys")
    assert done.returncode == 1
    assert "report.html" in done.stdout
    assert here("sign", "copy.run", "--key", "keys/jane.pub", "--name", "J").returncode == 2
    assert here("sign", "copy.run", "--key", "keys/jane.key", "--name", "J", "--lot", "x").returncode == 2
    told = verify(made[0], quick=True, trusted=[tmp_path / "keys"])
    assert [c.name for c in told if not c.passed] == ["signature"], "the run itself was never signed"

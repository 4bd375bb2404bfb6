"""A certificate that holds: gates worked out again, signatures, keys and trust."""

from __future__ import annotations

import base64
import json
import os
import shutil
import stat
import subprocess

import pytest
from command_line import ebamcheck, started
from finished_runs import certified_plate, thin_plate
from sealed_runs import copied, failed, two_keys

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import write_json
from ebamcheck.record.certificate import CERTIFICATE, read_certificate, released
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.record.signing import make_key, read_private_key, sign, signature_check, trusted_keys
from ebamcheck.verification.verify import verify, verify_run


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
    assert not {"certificate seal", "certificate", "recorded figures", "verdict", "file unchanged"} & set(found)


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
    assert failed(run, quick=True, trusted=trusted) == {}


def test_the_release_is_sealed_and_cannot_change_under_a_signature(run, keys):
    jane, _, trusted = keys
    path = released(run / CERTIFICATE, {"approver": "Jane Doe", "deviations": ["plate 2 mm thinner"]})
    assert read_certificate(path)["release"]["deviations"] == ["plate 2 mm thinner"]
    assert failed(run, quick=True) == {}
    sign(path, jane, "Jane Doe")
    with pytest.raises(SettingsError, match="would break the signature"):
        released(path, {"approver": "Somebody Else"})
    assert failed(run, quick=True, trusted=trusted) == {}


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


def test_a_private_key_is_private_protected_and_never_overwritten(tmp_path):
    private, public = make_key(tmp_path / "keys" / "jane", "secret")
    assert public.is_file()
    assert (tmp_path / "keys").stat().st_mode & 0o077 == 0
    assert stat.S_IMODE(os.stat(private).st_mode) == 0o600
    with pytest.raises(SettingsError, match="is there already"):
        make_key(tmp_path / "keys" / "jane")
    (tmp_path / "file").write_text("")
    with pytest.raises(SettingsError, match="the keys cannot be written"):
        make_key(tmp_path / "file" / "jane")
    with pytest.raises(InputError, match="is protected"):
        read_private_key(private)
    with pytest.raises(InputError, match="password is wrong"):
        read_private_key(private, "other")
    assert read_private_key(private, "secret")


def test_what_is_no_key_is_refused(tmp_path):
    (tmp_path / "a.pub").write_text("no key")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is no private key"):
        read_private_key(tmp_path / "a.pub")
    for place, said in (
        ("", "is no public key in PEM"),
        ("empty", "holds no public key"),
        ("b.pub", "cannot be read"),
    ):
        with pytest.raises(InputError, match=said):
            trusted_keys([tmp_path / place])


# -- as a user does it -------------------------------------------------------------------------------


def test_keys_signatures_and_trust_from_the_command_line(run, made, tmp_path):
    def here(*arguments):
        return ebamcheck(*arguments, cwd=tmp_path)

    assert started("key", "keys/jane", cwd=tmp_path).returncode == 0
    done = started(
        "sign", "copy.run", "--key", "keys/jane.key", "--name", "Jane Doe", "--part-number", "B-17",
        "--lot", "wire=W-1234", "--deviation", "plate re-used", cwd=tmp_path,
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

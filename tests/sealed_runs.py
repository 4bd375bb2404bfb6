"""Runs with a certificate, and what a forger makes of one, for the tests of signing."""

from __future__ import annotations

import shutil

from ebamcheck.pipeline.reports import reports_again
from ebamcheck.record.certificate import CERTIFICATE, certificate, file_hashes, read_certificate, write_sealed
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.record.signing import make_key, read_private_key, trusted_keys
from ebamcheck.verification.verify import verify_run


def failed(run, **given):
    return {c.name: c for c in verify_run(run, **given) if not c.passed}


def resealed(run):
    """What a forger does who knows this code: everything that follows from the record, and all hashes, made anew."""
    manifest = RunFolder(run).manifest()
    for name, text in reports_again(RunFolder(run)).items():
        (run / name).write_bytes(text)
    old = read_certificate(run / CERTIFICATE)
    fields = {**certificate(manifest, old["software"]), "release": old["release"], "files": file_hashes(run)}
    write_sealed(run / CERTIFICATE, fields)


def copied(made, place):
    """A copy of a run, which may be altered."""
    return shutil.copytree(made[0], place / "copy.run")


def two_keys(place):
    """Keys of an approver, who is trusted, and of a stranger."""
    (place / "trusted").mkdir()
    jane, _ = make_key(place / "trusted" / "jane")
    stranger, _ = make_key(place / "stranger")
    return read_private_key(jane), read_private_key(stranger), trusted_keys([place / "trusted"])

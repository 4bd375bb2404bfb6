"""Checks of a certificate: that it is whole, that it says what the record says, and that files, part and settings are those."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.json_values import (
    plain,
    sha256_of_file,
    sha256_of_json,
)
from ebamcheck.mesh.part_source import source_sha256
from ebamcheck.pipeline.certificate import (
    CERTIFICATE,
    certificate,
    file_names,
    is_sealed,
    profile_sha256,
    read_certificate,
)
from ebamcheck.pipeline.run_folder import RunFolder
from ebamcheck.pipeline.signing import signature_check
from ebamcheck.program import Check
from ebamcheck.settings.config import Config

OF_PEOPLE = ("release", "files", "seal", "software")
"""Fields that do not follow from the record of the run."""


def run_certificate_checks(
    run: RunFolder, manifest: Mapping[str, Any], trusted: dict[bytes, str] | None = None
) -> list[Check]:
    """Check the certificate of a run folder: its seal, every field against the record, every file, the signatures."""
    path = run.path / CERTIFICATE
    if not path.is_file():
        missing = ["the run has no certificate: it was removed, or the run is of an earlier version"]
        return [] if manifest.get("job") == "check" else [_faults("certificate", missing)]
    found = read_certificate(path)
    wanted = certificate(manifest, found.get("software", {}))
    names = sorted({*wanted, *found} - set(OF_PEOPLE))
    differ = [
        f"{name} is not what the record of the run says"
        for name in names
        if found.get(name) != wanted.get(name)
    ]
    return [
        _sealed(path, found),
        _faults("certificate", differ),
        *_files(run, found.get("files"), manifest["files"]),
        signature_check(path, trusted),
    ]


def _files(run: RunFolder, listed: Any, recorded: Mapping[str, str]) -> list[Check]:
    """Check every file of the run by the hashes of the certificate; none is missing, none was added.

    Those that the record lists with the same hash are checked by it.
    """
    if not isinstance(listed, dict):
        raise InputError(f"{run.path / CERTIFICATE}: is not whole: it lists no files")
    alone = {name: sha256 for name, sha256 in listed.items() if recorded.get(name) != sha256}
    checks = [file_check(run.path / name, name, sha256) for name, sha256 in alone.items()]
    added = [
        Check("file unchanged", False, 1.0, 0.0, "faults", name, "the certificate does not know this file")
        for name in file_names(run.path)
        if name not in listed
    ]
    return told_once(checks + added)


def certificate_checks(
    path: Path, program: Path, part: Path, config: Config, trusted: dict[bytes, str] | None = None
) -> list[Check]:
    """Check part, settings, profile and every program by the hashes of a certificate.

    Raises
    ------
    InputError
        If the certificate cannot be read or lacks a field.
    """
    found = read_certificate(path)
    folder = program if program.is_dir() else program.parent
    profile = profile_sha256(plain(config.model_dump()))
    try:
        checks = [
            _sealed(path, found),
            hash_check("part unchanged", part_hash(part), found["part"]["sha256"], part.name),
            hash_check(
                "settings unchanged",
                sha256_of_json(config.model_dump()),
                found["settings_sha256"],
                "settings",
            ),
            hash_check("profile unchanged", profile, found["profile_sha256"], "settings"),
        ]
        programs = [
            hash_check(
                "program unchanged",
                _hash_or_missing(folder / file["name"]),
                file["sha256"],
                f"{file['name']}:1",
            )
            for file in found["programs"]
        ]
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: is not whole: {type(error).__name__} at {error}") from None
    return [*checks, *told_once(programs), signature_check(path, trusted)]


def told_once(files: Sequence[Check]) -> list[Check]:
    """Checks of many files: those that failed, each by itself, or one that says that all are as they were."""
    failed = [check for check in files if not check.passed]
    if failed or not files:
        return failed
    return [replace(files[0], where="", text=f"{len(files)} files by their SHA-256")]


def file_check(path: Path, name: str, recorded: str) -> Check:
    """Check that a file of a run is there and is as the run wrote it."""
    if not path.is_file():
        return Check("file unchanged", False, 1.0, 0.0, "faults", name, "the file is missing")
    return hash_check("file unchanged", file_hash(path), recorded, name)


def file_hash(path: Path) -> str:
    """SHA-256 of a file; raises :class:`InputError` where it cannot be read."""
    try:
        return sha256_of_file(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def part_hash(path: Path) -> str:
    """SHA-256 of a part's file, or of a plate and all of its parts; raises :class:`InputError` for what cannot be read."""
    try:
        return source_sha256(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def hash_check(name: str, found: str, recorded: str, where: str) -> Check:
    """Check that a hash is the recorded one."""
    same = found == recorded
    text = f"SHA-256 {recorded[:16]}..."
    if not same:
        text = f"SHA-256 is {found[:16]}..., recorded is {recorded[:16]}..."
    return Check(name, same, float(not same), 0.0, "faults", where, text)


def _hash_or_missing(path: Path) -> str:
    return sha256_of_file(path) if path.is_file() else "missing"


def _sealed(path: Path, found: Mapping[str, Any]) -> Check:
    broken = [] if is_sealed(path, found) else ["its seal does not fit: it was changed after it was written"]
    return _faults("certificate seal", broken)


def _faults(name: str, faults: list[str]) -> Check:
    text = faults[0] if faults else "as written"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Check(name, not faults, float(len(faults)), 0.0, "faults", CERTIFICATE, text + more)

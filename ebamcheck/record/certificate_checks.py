"""Checks of a certificate: that it is whole, that it says what the record says, and that files, part and settings are those."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os.path import lexists, realpath
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import plain, sha256_of_file, sha256_of_json
from ebamcheck.mesh.part_source import source_sha256
from ebamcheck.printable import printable
from ebamcheck.record import certificate as of_run
from ebamcheck.record.certificate import CERTIFICATE, read_certificate
from ebamcheck.record.run_folder import RunFolder, own_file
from ebamcheck.record.signing import signature_check
from ebamcheck.result import Check
from ebamcheck.settings.config import Config

HARMLESS = (".DS_Store", "Thumbs.db", ".directory")  # left by file managers: no stage reads them
OF_THE_RECORD = ("program", "entry", "live", "layers")  # every file in the record of the run
OF_PEOPLE = ("release", "files", "seal", "software")  # fields that do not follow from the record of the run


def run_certificate_checks(
    run: RunFolder, manifest: Mapping[str, Any], trusted: dict[bytes, str] | None = None
) -> list[Check]:
    """Check the certificate of a run folder: its seal, every field against the record, every file, the signatures."""
    path = run.path / CERTIFICATE
    if not own_file(path):
        missing = ["the run has no certificate: it was removed, or the run is of an earlier version"]
        return [] if manifest.get("job") == "check" else [_faults("certificate", missing)]
    found = read_certificate(path)
    wanted = of_run.certificate(manifest, found.get("software", {}))
    names = [n for n in sorted({*wanted, *found} - set(OF_PEOPLE)) if found.get(n) != wanted.get(n)]
    differ = [f"{name} is not what the record of the run says" for name in names]
    return [
        _sealed(path, found),
        _faults("certificate", differ),
        *_files(run, found["files"], manifest["files"]),
        signature_check(path, trusted),
    ]


def refuse_unfit(run: RunFolder) -> None:
    """Refuse to sign a run whose record or files are not those that its certificate is of; the message names the first fault."""
    manifest = run.manifest()
    if not own_file(run.path / CERTIFICATE):
        raise SettingsError(f"{run.path}: has no {CERTIFICATE}: sign a run, not a check")
    checks = [check for check in run_certificate_checks(run, manifest) if check.name != "signature"]
    checks += told_once([file_check(run.path / name, name, h) for name, h in manifest["files"].items()])
    for check in checks:
        if not check.passed:
            why = f"and is not to be signed: {check.in_words()}"
            raise InputError(f"{run.path}: is not what its certificate says, {why}")


def _files(run: RunFolder, listed: Mapping[str, str], recorded: Mapping[str, str]) -> list[Check]:
    """Check every file of the run by the hashes of the certificate, but for those that the record lists with the same hash; none is
    missing or added."""
    alone = {name: sha256 for name, sha256 in listed.items() if recorded.get(name) != sha256}
    checks = [file_check(run.path / name, name, sha256) for name, sha256 in alone.items()]
    unknown = [name for name in of_run.file_names(run.path) if name not in listed]
    ignored = [name for name in unknown if name.rpartition("/")[2] in HARMLESS]
    added = dict.fromkeys(set(unknown) - set(ignored), "the certificate does not know this file")
    strange = {name for name in listed if name.partition("/")[0] in OF_THE_RECORD} - set(recorded)
    added |= dict.fromkeys(strange, "the record does not know this file")
    checks += [Check.fault("file unchanged", printable(name), text) for name, text in sorted(added.items())]
    return told_once(checks, ignored)


def certificate_checks(
    path: Path, program: Path, part: Path, config: Config, trusted: dict[bytes, str] | None = None
) -> list[Check]:
    """Check part, settings, profile and every program by the hashes of a certificate."""
    found = read_certificate(path)
    folder = program if program.is_dir() else program.parent
    settings = config.model_dump()
    checks = [
        _sealed(path, found),
        hash_check("part unchanged", part_hash(part), found["part"]["sha256"], part.name),
        hash_check("settings unchanged", sha256_of_json(settings), found["settings_sha256"], "settings"),
        hash_check("profile unchanged", of_run.profile_sha256(plain(settings)), found["profile_sha256"], "settings"),
    ]
    programs = []
    for file in found["programs"]:
        name, place = str(file["name"]), folder / file["name"]
        sha256 = sha256_of_file(place) if place.is_file() else "missing"
        programs.append(hash_check("program unchanged", sha256, file["sha256"], f"{name}:1"))
    return [*checks, *told_once(programs), signature_check(path, trusted)]


def told_once(files: Sequence[Check], ignored: Sequence[str] = ()) -> list[Check]:
    """Checks of many files: those that failed, each by itself, or one that says that all are as they were, and what was ignored."""
    failed = [check for check in files if not check.passed]
    if failed or not files:
        return failed
    beside = f"; ignored: {', '.join(map(printable, ignored))}" if ignored else ""
    return [replace(files[0], where="", text=f"{len(files)} files by their SHA-256{beside}")]


def file_check(path: Path, name: str, recorded: str) -> Check:
    """Check that a file of a run is there, lies in its folder and is as the run wrote it; a link out of it is not followed."""
    folder = path.parents[name.count("/")]
    # Unlike `Path.resolve`, `realpath` follows a link that leads to itself no further, and raises nothing.
    if not Path(realpath(path)).is_relative_to(realpath(folder)):
        text = "is a link that leads out of the run folder: it was not opened"
        return Check.fault("file unchanged", name, text)
    if not path.is_file():
        text = "is no regular file" if lexists(path) else "the file is missing"
        return Check.fault("file unchanged", name, text)
    return hash_check("file unchanged", part_hash(path, sha256_of_file), recorded, name)


def part_hash(path: Path, sha256_of: Callable[[Path], str] = source_sha256) -> str:
    """SHA-256 of a part's file, or of a plate and all of its parts; raises :class:`InputError` for what cannot be read."""
    try:
        return sha256_of(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def hash_check(name: str, found: str, recorded: str, where: str) -> Check:
    """Check that a hash is the recorded one."""
    if found == recorded:
        return Check(name, True, 0.0, 0.0, "faults", where, f"SHA-256 {recorded[:16]}...")
    return Check.fault(name, where, f"SHA-256 is {found[:16]}..., recorded is {recorded[:16]}...")


def _sealed(path: Path, found: Mapping[str, Any]) -> Check:
    sealed = of_run.is_sealed(path, found)
    broken = [] if sealed else ["its seal does not fit: it was changed after it was written"]
    return _faults("certificate seal", broken)


def _faults(name: str, faults: list[str]) -> Check:
    text = faults[0] if faults else "as written"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Check(name, not faults, float(len(faults)), 0.0, "faults", CERTIFICATE, text + more)
